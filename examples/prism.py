"""Reconstructs the prism of Weiss-Cohen, Bondarenko and Halevi (2009) from simulated readings, many times.

    cargo build --release -p planish-cli
    python3 examples/prism.py --runs 100 --picture prism.png

Every run simulates readings of the prism's three views by a sensor with an uncertain pose (planish simulate
scene views), estimates the contours and their constraints (planish contour --constrain), and combines them into
one geometry and a solid (planish solid). The sizes and their σ are compared with the ground truth. --picture
needs matplotlib. --judge needs the module OCP (cadquery-ocp), with which Open Cascade reads every STEP file.
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile

WIDTH, DEPTH, HEIGHT = 80.0, 100.0, 60.0
KINDS = {"front": "polygon-3", "top": "polygon-4", "side": "polygon-4"}


def planish(command, *args, folder):
    done = subprocess.run([command, *map(str, args), "--quiet"], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stderr.strip()


def run_once(command, seed, readings, noise, folder, views):
    """Runs all commands; returns the content of prism.json, or None and the error message."""
    planish(command, "simulate", "scene", "views", "--out", "prism", "--seed", seed, "--readings", readings, "--noise", noise, folder=folder)
    for view in views:
        kind = ["--kind", KINDS[view]]
        code, message = planish(command, "contour", f"prism/{view}/readings.csv", *kind, "--constrain", "-o", f"{view}.json", folder=folder)
        if code:
            return None, f"contour of the {view} view: {message}"
    files = [f"{view}.json" for view in views]
    code, message = planish(command, "solid", *files, "--as", ",".join(views), "-o", "prism.step", "-o", "prism.json", "--graphs", "graphs.json", folder=folder)
    if code:
        return None, message
    return json.loads((folder / "prism.json").read_text()), None


def nearest_true_length(value):
    return min((WIDTH, DEPTH, HEIGHT, math.hypot(WIDTH, HEIGHT)), key=lambda length: abs(length - value))


def open_cascade_volume(path):
    """Volume computed by Open Cascade, or None if the shape is invalid."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    shape = reader.OneShape()
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return properties.Mass() if BRepCheck_Analyzer(shape).IsValid() else None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--planish", default=str(pathlib.Path(__file__).resolve().parents[1] / "target/release/planish"))
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--readings", type=int, default=300)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--views", default="front,top,side", help="use front,side for the two views of the paper")
    parser.add_argument("--picture", type=pathlib.Path)
    parser.add_argument("--judge", action="store_true")
    args = parser.parse_args()
    views = args.views.split(",")

    sizes = {"extent x": [], "extent y": [], "extent z": [], "lengths of edges": []}
    lost, volumes, agreed, ranks = [], [], [], set()
    for seed in range(args.first_seed, args.first_seed + args.runs):
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            found, why = run_once(args.planish, seed, args.readings, args.noise, folder, views)
            if found is None:
                lost.append((seed, why))
                continue
            faces = found["solutions"][0]["faces"]
            if faces["plane"] != 5 or sum(faces.values()) != 5:
                lost.append((seed, f"another solid: {faces}"))
                continue
            geometry = found["geometry"]
            agreed.append(geometry["p_value"])
            ranks.add(tuple((view["view"], view["rank"], view["parameters"]) for view in geometry["views"]))
            for dimension in geometry["dimensions"]:
                error = (dimension["value"] - nearest_true_length(dimension["value"])) / dimension["sigma"]
                group = f"extent {dimension['name']}" if dimension["kind"] == "extent" else "lengths of edges"
                sizes[group].append((error, dimension["sigma"]))
            if args.judge:
                volumes.append((open_cascade_volume(folder / "prism.step"), found["solutions"][0]["volume"]))
            if args.picture and seed == args.first_seed:
                draw(args.picture, found, folder, views)

    print(f"{args.runs - len(lost)} of {args.runs} runs found the prism.")
    for seed, why in lost:
        print(f"  seed {seed}: {why.splitlines()[0]}")
    print("\n| size | n | within 1.96 σ | mean square over σ² | mean error over σ | median σ / mm |\n|---|---|---|---|---|---|")
    for group, errors in sizes.items():
        if errors:
            n = len(errors)
            inside = sum(abs(error) < 1.96 for error, _ in errors) / n
            square = sum(error * error for error, _ in errors) / n
            mean = sum(error for error, _ in errors) / n
            print(f"| {group} | {n} | {100 * inside:.1f} % | {square:.2f} | {mean:+.2f} | {sorted(s for _, s in errors)[n // 2]:.3f} |")
    below = sum(p < 0.05 for p in agreed)
    print(f"\np of the views' agreement below 0.05 in {below} of {len(agreed)} runs. Ranks (view, rank, parameters): {sorted(ranks)}")
    if volumes:
        worst = max(abs(ours / theirs - 1) for theirs, ours in volumes if theirs)
        print(f"Open Cascade: {sum(v is not None for v, _ in volumes)} of {len(volumes)} valid, volumes within {worst:.1e}")
    return 0


def draw(path, found, folder, views):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(13, 4.2))
    names = {"front": ("x", "z"), "top": ("x", "y"), "side": ("y", "z")}
    for i, view in enumerate(views):
        axes = figure.add_subplot(1, len(views) + 1, i + 1)
        rows = [row.split(",") for row in (folder / f"prism/{view}/readings.csv").read_text().splitlines()[1:]]
        points = []
        for row in rows:
            x, y, heading, distance = map(float, row[:4])
            points.append((x + distance * math.cos(math.radians(heading)), y + distance * math.sin(math.radians(heading))))
        axes.plot(*zip(*points), ".", color="#999999", markersize=3, label="readings")
        contour = json.loads((folder / f"{view}.json").read_text())["constrained"]
        corners = [point["position"] for point in contour["points"]]
        axes.plot(*zip(*(corners + corners[:1])), color="#1f5fa8", linewidth=1.5, label="contour")
        for point in contour["points"]:
            axes.annotate(point["name"], point["position"], textcoords="offset points", xytext=(4, 4))
        axes.set_aspect("equal")
        axes.set_title(f"{view}: p = {contour['p_value']:.2f}")
        axes.set_xlabel(f"{names[view][0]} / mm")
        axes.set_ylabel(f"{names[view][1]} / mm")
        if i == 0:
            axes.legend(loc="upper right", fontsize=8)
    axes = figure.add_subplot(1, len(views) + 1, len(views) + 1, projection="3d")
    vertices = {vertex["name"]: vertex["position"] for vertex in found["geometry"]["vertices"]}
    for dimension in found["geometry"]["dimensions"]:
        if dimension["kind"] != "length":
            continue
        a, b = ("V" + part for part in dimension["name"][1:].split("V"))
        ends = list(zip(vertices[a], vertices[b]))
        axes.plot(*ends, color="#1f5fa8")
        middle = [sum(pair) / 2 for pair in ends]
        axes.text(*middle, f"{dimension['value']:.2f}±{dimension['sigma']:.2f}", fontsize=6.5)
    axes.set_box_aspect((WIDTH, DEPTH, HEIGHT))
    axes.view_init(22, -50)
    axes.set_title("solid, sizes ± σ in mm")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
