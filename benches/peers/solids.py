"""Makes solids from every drawing of a folder and checks them with Open Cascade.

A part counts as solved if the first solid is valid, has the true volume within 1e-6 (relative), and the true number of
faces of each kind. Volumes are integrated to 1e-9. With the fixed number of points that Open Cascade uses by default,
the volume of a part of a torus has an error of up to 1e-5. Needs cadquery-ocp-novtk.

    python benches/peers/solids.py target/release/planish ../shared/data/drawings
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.STEPControl import STEPControl_Reader


def judge(path):
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    shape = reader.OneShape()
    measured = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, measured, 1e-9)
    return BRepCheck_Analyzer(shape).IsValid(), measured.Mass()


def run(planish, folder, name):
    views = [str(folder / f"{name}.{view}.dxf") for view in ("front", "top", "side")]
    with tempfile.TemporaryDirectory() as scratch:
        out = pathlib.Path(scratch) / "part.step"
        begun = time.perf_counter()
        try:
            done = subprocess.run(
                [planish, "solid", *views, "-o", str(out), "--json"], capture_output=True, text=True, timeout=60
            )
        except subprocess.TimeoutExpired:
            return time.perf_counter() - begun, {"error": {"message": "no answer within 60 s"}}, (False, 0.0)
        seconds = time.perf_counter() - begun
        report = json.loads(done.stdout) if done.stdout.strip() else {"error": {"message": done.stderr.strip()}}
        return seconds, report, judge(out) if out.exists() else (False, 0.0)


def reason(report, kinds):
    if report.get("error"):
        return report["error"]["message"][-110:]
    if report.get("unexplained"):
        first = report["unexplained"][0]
        return f"{first['view']} view, {first['entity'] or 'a missing line'}: {first['why']}"
    return f"faces {kinds}"


def main():
    planish, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    print("| part | faces | solved | valid | volume error | solids | unexplained | s | reason |")
    print("|---|---|---|---|---|---|---|---|---|")
    solved_plain = plain = 0
    for path in sorted(folder.glob("*.truth.json")):
        truth = json.loads(path.read_text())
        name = truth["name"]
        seconds, report, (valid, volume) = run(planish, folder, name)
        found = report.get("solutions") or []
        off = abs(volume / truth["volume"] - 1.0)
        kinds = {k: n for k, n in found[0]["faces"].items() if n} if found else {}
        solved = bool(found) and valid and off < 1e-6 and kinds == truth["faces"]
        if set(truth["faces"]) <= {"plane", "cylinder"}:
            plain += 1
            solved_plain += solved
        why = "" if solved else reason(report, kinds)
        faces = " ".join(f"{n} {k}" for k, n in truth["faces"].items())
        row = [name, faces, "yes" if solved else "no", "yes" if valid else "no", f"{off:.1e}" if found else "–"]
        row += [len(found), len(report.get("unexplained") or []), f"{seconds:.3f}", why]
        print("| " + " | ".join(str(c) for c in row) + " |", flush=True)
    print(f"\nOf {plain} parts with planes and cylinders only, {solved_plain} are solved.")


main()
