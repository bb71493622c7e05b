#!/usr/bin/env python3
"""Solids from simulated contours at several heights: sizes against their σ, and the STEP files.

Each run measures a part (L bracket, stepped shaft, plate with a pocket, block with a through hole) with
random sizes: points on the sections at several levels and on the outline from the front, with noise and
outliers. `planish contour` and `planish solid` make the solid. Printed are, for each part and noise: the share
of runs with a solid, the share of sizes and heights within 1.96 σ, the number of undecided heights that hold
the true one, and the share of STEP files that Open Cascade finds valid and closed, with the right volume.

    measured_parts.py PLANISH RUNS [PART]
"""

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SIGMA = 0.05


def noise(kind, random, n):
    """Independent errors with the variance of SIGMA², in x and y."""
    if kind == "normal":
        return SIGMA * random.standard_normal((n, 2))
    if kind == "uniform":
        return SIGMA * math.sqrt(12) * (random.random((n, 2)) - 0.5)
    wide = np.where(random.random((n, 1)) < 0.1, 4.0, 1.0)
    return SIGMA * wide * random.standard_normal((n, 2)) / math.sqrt(2.5)


def on_polygon(vertices, n, random):
    """Points spread evenly over the sides of a polygon."""
    vertices = np.asarray(vertices, float)
    ends = np.roll(vertices, -1, axis=0)
    length = np.linalg.norm(ends - vertices, axis=1)
    side = random.choice(len(vertices), n, p=length / length.sum())
    share = random.random((n, 1))
    return vertices[side] + share * (ends[side] - vertices[side])


def on_circle(center, radius, n, random):
    """Points spread evenly over a circle."""
    angle = 2 * math.pi * random.random(n)
    return np.column_stack([center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)])


def box(x0, y0, x1, y1):
    """Corners of a rectangle."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def part(name, random):
    """Sections as (levels, loops), the outline from the front, true heights, and the volume."""
    u = random.uniform
    if name == "bracket":
        w, d, h, foot, wall = u(55, 65), u(35, 45), u(45, 55), u(8, 12), u(7, 11)
        sections = [([2, 5], [("box", box(0, 0, w, d))]), ([20, 30, 40], [("box", box(0, 0, wall, d))])]
        outline = [(0, 0), (w, 0), (w, foot), (wall, foot), (wall, h), (0, h)]
        return sections, outline, [0, foot, h], d * (w * foot + wall * (h - foot))
    if name == "shaft":
        r = [u(18, 20), u(12, 14), u(7, 9)]
        z = [0, u(12, 16), u(32, 38), u(55, 60)]
        sections = [([4, 9], [("circle", (0, 0), r[0])]), ([20, 28], [("circle", (0, 0), r[1])]),
                    ([42, 50], [("circle", (0, 0), r[2])])]
        outline = [(-r[0], z[0]), (r[0], z[0]), (r[0], z[1]), (r[1], z[1]), (r[1], z[2]), (r[2], z[2]),
                   (r[2], z[3]), (-r[2], z[3]), (-r[2], z[2]), (-r[1], z[2]), (-r[1], z[1]), (-r[0], z[1])]
        return sections, outline, z, sum(math.pi * r[k] ** 2 * (z[k + 1] - z[k]) for k in range(3))
    if name == "pocket":
        w, d, h, floor = u(75, 85), u(45, 55), u(18, 22), u(9, 12)
        px, py, pw, pd = u(12, 16), u(12, 15), u(28, 34), u(18, 22)
        sections = [([3, 7], [("box", box(0, 0, w, d))]),
                    ([13, 16], [("box", box(0, 0, w, d)), ("box", box(px, py, px + pw, py + pd))])]
        return sections, box(0, 0, w, h), [0, floor, h], w * d * h - pw * pd * (h - floor)
    w, d, h, r = u(45, 55), u(35, 45), u(28, 32), u(7, 10)
    center = (u(20, 25), u(17, 20))
    sections = [([5, 15, 25], [("box", box(0, 0, w, d)), ("circle", center, r)])]
    return sections, box(0, 0, w, h), [0, h], (w * d - math.pi * r * r) * h


def measured(shape, kind, outliers, random):
    """Noisy points on a loop, some of them gross errors."""
    n = 160
    points = on_circle(shape[1], shape[2], n, random) if shape[0] == "circle" else on_polygon(shape[1], n, random)
    points = points + noise(kind, random, n)
    gross = random.random(n) < outliers
    points[gross] += random.uniform(-3, 3, (int(gross.sum()), 2))
    return points


def simulate(name, kind, outliers, random, folder):
    """Writes the readings of a part; returns what is true of it."""
    sections, outline, heights, volume = part(name, random)
    lines = ["x,y,level"]
    for levels, loops in sections:
        for level in levels:
            for shape in loops:
                lines += [f"{x:.5f},{y:.5f},{level}" for x, y in measured(shape, kind, outliers, random)]
    (folder / "sections.csv").write_text("\n".join(lines) + "\n")
    points = measured(("box", outline), kind, outliers, random)
    # A long outline gets more points: its steps are short.
    points = np.vstack([points] + [measured(("box", outline), kind, outliers, random) for _ in range(3)])
    (folder / "front.csv").write_text("x,y\n" + "\n".join(f"{x:.5f},{y:.5f}" for x, y in points) + "\n")
    return sections, heights, volume, len(outline)


def run(*words):
    """Runs the program; returns its JSON object."""
    done = subprocess.run([str(w) for w in words] + ["--json", "--threads", "1"], capture_output=True, text=True,
                          timeout=300, check=False)
    if done.returncode:
        raise RuntimeError(done.stdout[-300:] + done.stderr[-300:])
    return json.loads(done.stdout)


def size_errors(found, loops):
    """Normalised errors of the sizes of a section."""
    errors = []
    for shape in loops:
        if shape[0] == "circle":
            near = [c for c in found if c["kind"] == "circle"]
            if near:
                sizes = near[0]["sizes"]
                truth = {"center_x": shape[1][0], "center_y": shape[1][1], "radius": shape[2]}
                errors += [(sizes[k]["value"] - v, sizes[k]["sigma"]) for k, v in truth.items()]
            continue
        corners = np.asarray(shape[1])
        for contour in (c for c in found if c["kind"] in ("rectangle", "polygon-4")):
            sizes = contour["sizes"]
            if contour["kind"] == "rectangle":
                truth = sorted(corners.max(axis=0) - corners.min(axis=0))
                mine = sorted((sizes[k] for k in ("width", "height")), key=lambda s: s["value"])
                middle = corners.mean(axis=0)
                away = math.hypot(sizes["center_x"]["value"] - middle[0], sizes["center_y"]["value"] - middle[1])
                if away < 2 and all(abs(m["value"] - t) < 2 for m, t in zip(mine, truth)):
                    errors += [(m["value"] - t, m["sigma"]) for m, t in zip(mine, truth)]
                    errors += [(sizes["center_x"]["value"] - middle[0], sizes["center_x"]["sigma"]),
                               (sizes["center_y"]["value"] - middle[1], sizes["center_y"]["sigma"])]
    return errors


def closed(path):
    """Whether Open Cascade reads a valid, closed solid; its volume."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_SHELL, TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    shape = reader.OneShape()
    solids = TopExp_Explorer(shape, TopAbs_SOLID)
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    is_closed = solids.More() and BRepCheck_Analyzer(shape).IsValid()
    shells = TopExp_Explorer(shape, TopAbs_SHELL)
    while shells.More():
        is_closed = is_closed and shells.Current().Closed()
        shells.Next()
    return bool(is_closed), properties.Mass()


def main():
    program, runs = sys.argv[1], int(sys.argv[2])
    names = sys.argv[3:] or ["bracket", "shaft", "pocket", "hole"]
    for name in names:
        for kind, outliers in [("normal", 0.0), ("uniform", 0.0), ("heavy", 0.0), ("normal", 0.03)]:
            z, high, valid, solved, undecided, holds, problems = [], [], 0, 0, 0, 0, []
            for seed in range(runs):
                random = np.random.default_rng(1000 * seed + sum(map(ord, name + kind)) + int(100 * outliers))
                with tempfile.TemporaryDirectory() as folder:
                    folder = Path(folder)
                    sections, heights, volume, corners = simulate(name, kind, outliers, random, folder)
                    kinds = ["--kind", "rectangle", "--kind", "circle", "--gap", 10.5 if name == "pocket" else 7]
                    try:
                        run(program, "contour", folder / "sections.csv", "--sigma-point", SIGMA, *kinds,
                            "-o", folder / "sections.json")
                        run(program, "contour", folder / "front.csv", "--sigma-point", SIGMA,
                            "--kind", f"polygon-{corners}", "-o", folder / "front.json")
                        report = run(program, "solid", folder / "sections.json", folder / "front.json",
                                     "-o", folder / "part.step")
                    except RuntimeError as problem:
                        problems.append(str(problem)[:160].replace("\n", " "))
                        continue
                    found = report["stack"]["sections"]
                    if len(found) != len(sections):
                        problems.append(f"{len(found)} sections for {len(sections)}")
                        continue
                    solved += 1
                    for own, (_, loops) in zip(found, sections):
                        z += size_errors(own["contours"], loops)
                    for height, true in zip([found[0]["bottom"]] + [s["top"] for s in found], heights):
                        if "between" in height:
                            undecided += 1
                            holds += height["between"][0] <= true <= height["between"][1]
                        else:
                            high.append((height["value"] - true, height["sigma"]))
                    is_closed, mass = closed(folder / "part.step")
                    valid += is_closed and abs(mass - report["solutions"][0]["volume"]) < 1e-6 * volume
            # Coordinates that a relation to the frame fixes exactly have no σ to test.
            shares = []
            for errors in (z, high):
                errors = np.array(errors).reshape(-1, 2)
                errors = errors[errors[:, 1] > 1e-9]
                inside = np.mean(np.abs(errors[:, 0]) < 1.96 * errors[:, 1]) if len(errors) else math.nan
                shares.append(f"{inside:.3f} of {len(errors)}")
            print(f"{name:8} {kind:8} {outliers:4.2f} solved {solved}/{runs} sizes {shares[0]} heights {shares[1]} "
                  f"undecided {undecided} ({holds} hold) valid STEP {valid}/{solved}", flush=True)
            for problem in sorted(set(problems))[:3]:
                print("   ", problems.count(problem), problem)


if __name__ == "__main__":
    main()
