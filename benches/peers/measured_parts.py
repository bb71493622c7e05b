#!/usr/bin/env python3
"""Solids from simulated contours at several heights: sizes against their σ, and the STEP files.

Each run measures a part (L bracket, stepped shaft, plate with a pocket, block with a through hole) with
random sizes: points on the sections at several levels and on the outline from the front, with noise and
outliers. `planish contour` and `planish solid` make the solid. Printed are, for each part and row: the share
of runs with a solid, the share of sizes and heights within 1.96 σ and the rms of their errors in σ, the number of
undecided heights that hold the true one, and the share of STEP files that Open Cascade finds valid and closed,
with the right volume.

Rows differ in the distribution of the noise, its σ, the number of points on a loop, the share of gross errors, and
the places of the points: even, or three times as dense on one half of a loop as on the other.

    measured_parts.py PLANISH RUNS [PART ...] [--row NAME ...] [--seed FIRST]
"""

import argparse
import json
import math
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

@dataclass
class Row:
    """How the readings of a row are made."""

    name: str
    noise: str = "normal"
    gross: float = 0.0
    points: int = 160
    sigma: float = 0.05
    is_even: bool = True


ROWS = [Row("normal"), Row("uniform", noise="uniform"), Row("heavy", noise="heavy"), Row("gross3", gross=0.03),
        Row("gross8", gross=0.08), Row("sparse", points=60), Row("dense", points=400), Row("quiet", sigma=0.01),
        Row("loud", sigma=0.15), Row("uneven", is_even=False)]


def noise(row, random, n):
    """Independent errors with the variance of σ², in x and y."""
    if row.noise == "normal":
        return row.sigma * random.standard_normal((n, 2))
    if row.noise == "uniform":
        return row.sigma * math.sqrt(12) * (random.random((n, 2)) - 0.5)
    wide = np.where(random.random((n, 1)) < 0.1, 4.0, 1.0)
    return row.sigma * wide * random.standard_normal((n, 2)) / math.sqrt(2.5)


def places(n, is_even, random):
    """Places along a loop from 0 to 1."""
    u = random.random(n)
    if is_even:
        return u
    half = np.where(random.random(n) < 0.75, 0.5 * u, 0.5 + 0.5 * u)
    return half


def on_polygon(vertices, along):
    """Points at places along the sides of a polygon."""
    vertices = np.asarray(vertices, float)
    ends = np.roll(vertices, -1, axis=0)
    length = np.linalg.norm(ends - vertices, axis=1)
    begin = np.concatenate([[0], np.cumsum(length)])
    at = along * begin[-1]
    side = np.clip(np.searchsorted(begin, at, side="right") - 1, 0, len(vertices) - 1)
    share = ((at - begin[side]) / length[side])[:, None]
    return vertices[side] + share * (ends[side] - vertices[side])


def on_circle(center, radius, along):
    """Points at places along a circle."""
    angle = 2 * math.pi * along
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


def measured(shape, row, random, n=None):
    """Noisy points on a loop, some of them gross errors."""
    n = n or row.points
    along = places(n, row.is_even, random)
    points = on_circle(shape[1], shape[2], along) if shape[0] == "circle" else on_polygon(shape[1], along)
    points = points + noise(row, random, n)
    gross = random.random(n) < row.gross
    points[gross] += random.uniform(-3, 3, (int(gross.sum()), 2))
    return points


def simulate(name, row, random, folder):
    """Writes the readings of a part; returns what is true of it."""
    sections, outline, heights, volume = part(name, random)
    lines = ["x,y,level"]
    for levels, loops in sections:
        for level in levels:
            for shape in loops:
                lines += [f"{x:.5f},{y:.5f},{level}" for x, y in measured(shape, row, random)]
    (folder / "sections.csv").write_text("\n".join(lines) + "\n")
    # A long outline gets more points: its steps are short.
    points = measured(("box", outline), row, random, 4 * row.points)
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


def share_inside(errors):
    """Share of errors within 1.96 σ, their number and their rms in σ."""
    # Coordinates that a relation to the frame fixes exactly have no σ to test.
    errors = np.array(errors).reshape(-1, 2)
    errors = errors[errors[:, 1] > 1e-9]
    if not len(errors):
        return "-"
    scaled = errors[:, 0] / errors[:, 1]
    return f"{np.mean(np.abs(scaled) < 1.96):.3f} of {len(scaled)} (rms {np.sqrt(np.mean(scaled ** 2)):.2f})"


def row_of_part(program, name, row, runs, first):
    """Simulates and judges the runs of a row."""
    z, high, valid, solved, undecided, holds, problems = [], [], 0, 0, 0, 0, []
    for seed in range(first, first + runs):
        random = np.random.default_rng([seed, sum(map(ord, name + row.name))])
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            sections, heights, volume, corners = simulate(name, row, random, folder)
            kinds = ["--kind", "rectangle", "--kind", "circle", "--gap", 10.5 if name == "pocket" else 7]
            try:
                run(program, "contour", folder / "sections.csv", "--sigma-point", row.sigma, *kinds,
                    "-o", folder / "sections.json")
                run(program, "contour", folder / "front.csv", "--sigma-point", row.sigma,
                    "--kind", f"polygon-{corners}", "-o", folder / "front.json")
                report = run(program, "solid", folder / "sections.json", folder / "front.json",
                             "-o", folder / "part.step")
            except RuntimeError as problem:
                problems.append(str(problem)[-160:].replace("\n", " "))
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
    print(f"{name:8} {row.name:8} solved {solved}/{runs} sizes {share_inside(z)} heights {share_inside(high)} "
          f"undecided {undecided} ({holds} hold) valid STEP {valid}/{solved}", flush=True)
    for problem in sorted(set(problems))[:3]:
        print("   ", problems.count(problem), problem)


def main():
    """Reads the command line and prints the rows."""
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("runs", type=int)
    parser.add_argument("parts", nargs="*", default=[])
    parser.add_argument("--row", action="append", choices=[row.name for row in ROWS])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in options.parts or ["bracket", "shaft", "pocket", "hole"]:
        for row in ROWS:
            if not options.row or row.name in options.row:
                row_of_part(options.program, name, row, options.runs, options.seed)


if __name__ == "__main__":
    main()
