"""Fits a textured object after one, two and three views, at three subdivision depths.

This is the main experiment of the paper on Kalman spline fusion (figures 4 to 12) on a simulated object. Stereo
pairs give positions, and crossed stripes give normals and curvatures from the same viewpoints. The surface is
fitted after each view. The script only runs the `planish` command.

    python examples/three_views.py --mesh spot.obj --up y --subdivide 2 --out out [--planish target/release/planish]

Writes out/table.md and, for each view and depth, out/view-V-depth-D.png (the model from the first camera) and
out/view-V-depth-D-behind.png. out/pictures.png contains all of them (needs Pillow).
"""

import argparse
import json
import shutil
import subprocess
from pathlib import Path

DEPTHS = [0, 1, 2]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planish", default="planish", help="path of the command")
    parser.add_argument("--mesh", required=True, help="mesh of the object")
    parser.add_argument("--up", default="z", help="vertical axis of the mesh")
    parser.add_argument("--subdivide", default="0", help="number of smooth subdivisions of the mesh")
    parser.add_argument("--unit", default="m")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--without", choices=["stereo", "grid"], help="omit one of the sensors")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    def planish(*words):
        line = [args.planish, *map(str, words), "--unit", args.unit, "--json"]
        done = subprocess.run(line, capture_output=True, text=True)
        # Exit code 1: the data do not determine the answer. Other cells of the table may still be computed.
        if done.returncode not in (0, 1):
            raise SystemExit(f"{' '.join(line)}\n{done.stderr}")
        return json.loads(done.stdout) if done.returncode == 0 else None

    mesh_options = ["--mesh", args.mesh, "--up", args.up, "--subdivide", args.subdivide]
    sensors = {
        # Matching windows of neighbouring pixels overlap. At a step of 6 the errors are nearly independent.
        # The errors of points beside silhouettes have a bias.
        "stereo": (["left", "right"], [], ["--step", 6, "--max-sigma", 0.3]),
        "grid": (["stripes", "plain"], ["--plain"], []),
    }
    sensors = {name: how for name, how in sensors.items() if name != args.without}
    for name, (stems, between, options) in sensors.items():
        folder = args.out / name
        # Reuse existing pictures.
        if not (folder / "truth.ply").is_file():
            planish("simulate", "scene", name, *mesh_options, "--views", args.views, "--stripe-spacing", 14, "--out", folder)
        calibration = folder / ("cameras.toml" if name == "stereo" else "grid.toml")
        for view in range(1, args.views + 1):
            first, second = (folder / f"{stem}-{view}.png" for stem in stems)
            sensed = planish("sense", name, first, *between, second, *options, "--calib", calibration, "-o", folder / f"{name}-{view}.ply")
            print(f"{name} {view}: {sensed['observations']} readings")

    truth = args.out / next(iter(sensors)) / "truth.ply"
    diagonal = json.loads((truth.parent / "truth.json").read_text())["diagonal"]
    rows = []
    for view in range(1, args.views + 1):
        cells = []
        for depth in DEPTHS:
            jobs = [args.out / name / f"view-{k}.toml" for name in sensors for k in range(1, view + 1)]
            cell = args.out / f"view-{view}-depth-{depth}"
            model, mesh = cell.with_suffix(".planish"), cell.with_suffix(".ply")
            fit = planish("fit", *jobs, "--shape", "ball", "--max-depth", depth, "-o", model, "-o", mesh)
            if fit is None:
                cells.append("–")
                continue
            comparison = planish("compare", model, truth)
            forward = comparison["forward"]
            percent = 100 / diagonal
            cells.append(
                f"{forward['rms'] * percent:.3f} % ({abs(forward['p50']) * percent:.3f} %), "
                f"{comparison['coverage95']:.3f}, {100 * fit['observed_area_fraction']:.0f} %, {fit['coefficients']}"
            )
            print(f"view {view}, depth {depth}: {cells[-1]}")
            pictures = args.out / "model-pictures"
            planish("simulate", "scene", "stereo", "--mesh", mesh, "--up", args.up, "--texture", "0", "--views", "2",
                    "--size", "480x360", "--sigma-brightness", "0", "--out", pictures)
            for k, side in [(1, ""), (2, "-behind")]:
                shutil.move(pictures / f"left-{k}.png", args.out / f"view-{view}-depth-{depth}{side}.png")
            shutil.rmtree(pictures)
        rows.append(cells)

    head = "| views | " + " | ".join(f"depth {d}" for d in DEPTHS) + " |"
    lines = [head, "|" + "---|" * (len(DEPTHS) + 1)]
    lines += [f"| {v} | " + " | ".join(cells) + " |" for v, cells in enumerate(rows, 1)]
    lines.append("")
    lines.append("Root mean square error (median) in % of the diagonal, coverage of 1.96 σ, measured share of the surface, "
                 "number of control vertices.")
    (args.out / "table.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))
    montage(args)


def montage(args):
    try:
        from PIL import Image
    except ImportError:
        return
    width, height = 480, 360
    whole = Image.new("L", (2 * width * len(DEPTHS), height * args.views))
    for view in range(1, args.views + 1):
        for depth in DEPTHS:
            for k, side in enumerate(["", "-behind"]):
                path = args.out / f"view-{view}-depth-{depth}{side}.png"
                if path.is_file():
                    whole.paste(Image.open(path), ((2 * depth + k) * width, (view - 1) * height))
    whole.save(args.out / "pictures.png")


if __name__ == "__main__":
    main()
