"""Judges how `planish solid` reads scans and photographs of `sheets.py --scan`.

Rectification: corners of the views are mapped by the homography of the report (`sheet.picture` of the JSON)
and fitted to the true ones by scale and shift alone; the largest residual is reported in pixels of the
picture. Solids: as in `sheet_solids.py`, the intersection over union after scaling to one size; refusals
count as 0. Needs cadquery-ocp-novtk and numpy.

    python benches/peers/scan_lines.py target/release/planish FOLDER --limit 60 --out results.jsonl
"""

import argparse
import json
import pathlib
import subprocess
import tempfile

import numpy

from drafting import judge, shapes


def mapped(matrix, points):
    at = numpy.asarray(matrix) @ numpy.vstack([numpy.asarray(points, float).T, numpy.ones(len(points))])
    return (at[:2] / at[2]).T


def rectification(picture, known):
    """Largest error at the corners of the views, in pixels of the picture; `picture` may be missing."""
    boxes = [v["box"] for v in known["views"].values()]
    corners = [(x, y) for b in boxes for x in (b[0], b[2]) for y in (b[1], b[3])]
    sheet_from_picture = picture["sheet_from_picture"] if picture else numpy.eye(3)
    in_picture = mapped(known["picture_from_file"], corners)
    found = mapped(sheet_from_picture, in_picture) * (1, -1)
    # Scale and shift: found = scale * corner + shift.
    a = numpy.zeros((2 * len(corners), 3))
    a[::2, 0], a[1::2, 0] = [c[0] for c in corners], [c[1] for c in corners]
    a[::2, 1], a[1::2, 2] = 1, 1
    solution, *_ = numpy.linalg.lstsq(a, found.ravel(), rcond=None)
    off = numpy.hypot(*(found.ravel() - a @ solution).reshape(-1, 2).T)
    # Pixels of the picture per pixel of the straight sheet.
    step = mapped(known["picture_from_file"], [corners[0], (corners[0][0] + 1, corners[0][1])])
    return float(off.max() * numpy.hypot(*(step[1] - step[0])) / solution[0])


def one(asked, path):
    known = json.loads(path.read_text())
    with tempfile.TemporaryDirectory() as scratch:
        out = pathlib.Path(scratch) / "part.step"
        words = ["solid", str(path.with_suffix(".jpg")), "-o", str(out), "--all", "--json"]
        words = [asked.planish, *words, *asked.options.split()]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=asked.limit)
            report = json.loads(done.stdout)
        except subprocess.TimeoutExpired:
            report = {"error": {"message": "timeout"}}
        except json.JSONDecodeError:
            report = {"error": {"message": done.stderr.strip()[-300:]}}
        solids = [shapes.read_step(p) for p in sorted(pathlib.Path(scratch).glob("part*.step"))[:10]]
    true = shapes.read_step(path.with_suffix(".step"))
    verdict = judge.compare_picture(solids[0], true) if solids else None
    sheet = report.get("sheet") or {}
    row = {"name": path.stem, "solids": len(solids), "iou": verdict["iou"] if verdict else 0.0}
    row["is_right"] = bool(verdict and verdict["is_right"])
    row["corner_error_px"] = rectification(sheet.get("picture"), known) if sheet else None
    row["why"] = str((report.get("error") or {}).get("message", ""))[:400]
    row["findings"] = [f.get("code") for f in report.get("findings", [])]
    return row


def main():
    reading = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    reading.add_argument("planish")
    reading.add_argument("folder", type=pathlib.Path)
    reading.add_argument("--out", type=pathlib.Path)
    reading.add_argument("--limit", type=float, default=60.0, help="seconds for each picture")
    reading.add_argument("--options", default="", help="more options of `planish solid`")
    asked = reading.parse_args()
    rows = []
    for path in sorted(asked.folder.glob("*.json")):
        rows.append(one(asked, path))
        print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
        if asked.out:
            with asked.out.open("a") as log:
                log.write(json.dumps(rows[-1], ensure_ascii=False) + "\n")
    right, wrong = sum(r["is_right"] for r in rows), sum(r["solids"] > 0 and not r["is_right"] for r in rows)
    print(f"n = {len(rows)}: right {right}, wrong {wrong}, refused {len(rows) - right - wrong}")
    print(f"mean IoU {numpy.mean([r['iou'] for r in rows]):.3f}, refusals counted as 0")
    errors = sorted(r["corner_error_px"] for r in rows if r["corner_error_px"] is not None)
    if errors:
        print(f"corners of views: median {errors[len(errors) // 2]:.2f} px, largest {errors[-1]:.2f} px")


main()
