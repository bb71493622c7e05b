"""Three views of a textured thing, arriving one after another, at three depths of subdivision.

The main experiment of the paper on Kalman spline fusion (figures 4 to 12), on a thing that is known: pairs of pictures give positions, crossed stripes give normals and curvatures from the same places,
and the surface is fitted to what has arrived so far. Everything is done by the command line.

    python examples/three_views.py --mesh spot.obj --up y --subdivide 2 --out out [--planish target/release/planish]

Writes out/table.md and, for each view and depth, out/view-V-depth-D.png: the model from the first camera and from behind. out/pictures.png holds all of them (it takes Pillow).
"""

import argparse
import json
import shutil
import subprocess
from pathlib import Path

DEPTHS = [0, 1, 2]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planish", default="planish", help="the command")
    parser.add_argument("--mesh", required=True, help="the thing")
    parser.add_argument("--up", default="z", help="its upright axis")
    parser.add_argument("--subdivide", default="0", help="steps of smooth subdivision before it is looked at")
    parser.add_argument("--unit", default="m")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--without", choices=["stereo", "grid"], help="leave one of the sensors out")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    def planish(*words):
        line = [args.planish, *map(str, words), "--unit", args.unit, "--json"]
        done = subprocess.run(line, capture_output=True, text=True)
        # 1: the data do not determine the answer. The other cells may be determined.
        if done.returncode not in (0, 1):
            raise SystemExit(f"{' '.join(line)}\n{done.stderr}")
        return json.loads(done.stdout) if done.returncode == 0 else None

    thing = ["--mesh", args.mesh, "--up", args.up, "--subdivide", args.subdivide]
    sensors = {
        # Windows of neighbouring pixels overlap: points so far apart err nearly independently. Those beside silhouettes err one way.
        "stereo": (["left", "right"], [], ["--step", 6, "--max-sigma", 0.3]),
        "grid": (["stripes", "plain"], ["--plain"], []),
    }
    sensors = {name: how for name, how in sensors.items() if name != args.without}
    for name, (stems, between, options) in sensors.items():
        folder = args.out / name
        # Pictures that are there are not taken again.
        if not (folder / "truth.ply").is_file():
            planish("simulate", "scene", name, *thing, "--views", args.views, "--stripe-spacing", 14, "--out", folder)
        calibration = folder / ("cameras.toml" if name == "stereo" else "grid.toml")
        for view in range(1, args.views + 1):
            first, second = (folder / f"{stem}-{view}.png" for stem in stems)
            said = planish("sense", name, first, *between, second, *options, "--calib", calibration, "-o", folder / f"{name}-{view}.ply")
            print(f"{name} {view}: {said['observations']} readings")

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
            judged = planish("compare", model, truth)
            forward = judged["forward"]
            percent = 100 / diagonal
            cells.append(
                f"{forward['rms'] * percent:.3f} % ({abs(forward['p50']) * percent:.3f} %), "
                f"{judged['coverage95']:.3f}, {100 * fit['observed_area_fraction']:.0f} %, {fit['coefficients']}"
            )
            print(f"view {view}, depth {depth}: {cells[-1]}")
            looked = args.out / "looked"
            planish("simulate", "scene", "stereo", "--mesh", mesh, "--up", args.up, "--texture", "0", "--views", "2",
                    "--size", "480x360", "--sigma-brightness", "0", "--out", looked)
            for k, side in [(1, ""), (2, "-behind")]:
                shutil.move(looked / f"left-{k}.png", args.out / f"view-{view}-depth-{depth}{side}.png")
            shutil.rmtree(looked)
        rows.append(cells)

    head = "| views | " + " | ".join(f"depth {d}" for d in DEPTHS) + " |"
    lines = [head, "|" + "---|" * (len(DEPTHS) + 1)]
    lines += [f"| {v} | " + " | ".join(cells) + " |" for v, cells in enumerate(rows, 1)]
    lines.append("")
    lines.append("Root mean square error (median) in % of the diagonal, coverage of 1.96 σ, share of the surface that was measured, control vertices.")
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
