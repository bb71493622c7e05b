"""Compares the points chosen by `planish next` with random points on a freeform.

A freeform is scanned coarsely, a surface is fitted, and `planish next` chooses points one after another for a
more accurate sensor. For comparison, sets of points are drawn at random by area. Both are evaluated by the
largest remaining σ of the surface. The script only runs the `planish` command.

    python examples/next_against_random.py --out out [--planish target/release/planish]

Writes out/next.svg and out/next.md for several seeds of the freeform. The table lists how many random points
are needed for the result of the chosen ones. Needs only the Python standard library.
"""

import argparse
import json
import math
import subprocess
from pathlib import Path

# Numbers of chosen points in the table.
COUNTS = [5, 10, 20, 50, 100, 200]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planish", default="planish", help="path of the command")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--shape", default="ball")
    parser.add_argument("--readings", type=int, default=3000, help="number of readings of the coarse scans")
    parser.add_argument("--views", type=int, default=6, help="number of coarse scans")
    parser.add_argument("--sigma", default="0.02mm", help="σ of the chosen points")
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--max-points", type=int, default=1500, help="maximum number of points")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    def planish(*words):
        line = [args.planish, *map(str, words), "--json"]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(line)}\n{done.stderr}")
        return json.loads(done.stdout)

    runs = []
    for seed in args.seeds:
        scene, model = args.out / f"scene-{seed}", args.out / f"scene-{seed}.planish"
        planish("simulate", "scene", "scans", "--shape", args.shape, "--seed", seed, "--readings", args.readings, "--views", args.views,
                "--no-old-scanner", "--outliers", 0, "--probe-points", 0, "--out", scene)
        fit = planish("fit", scene / "job.toml", "-o", model)
        result = planish("next", model, "--count", args.max_points, "--sigma", args.sigma, "--against-random", args.draws, "--seed", seed)
        runs.append({
            "seed": seed,
            "coefficients": fit["coefficients"],
            "before": result["worst_sigma"]["before"],
            "chosen": [p["worst_sigma_after"] for p in result["points"]],
            **{key: result["random"][f"worst_sigma_{key}"] for key in ["median", "p10", "p90"]},
        })
        print(f"seed {seed}: {fit['coefficients']} coefficients, largest σ {runs[-1]['before']:.4g} before")
    (args.out / "next.json").write_text(json.dumps(runs) + "\n")
    (args.out / "next.md").write_text(table(runs, args))
    (args.out / "next.svg").write_text(figure(runs))
    print((args.out / "next.md").read_text())


def random_points_needed(run, count):
    """Number of random points needed (median) for the σ after `count` chosen points; None if not reached."""
    goal = run["chosen"][count - 1]
    return next((k for k, sigma in enumerate(run["median"], 1) if sigma <= goal), None)


def table(runs, args):
    lines = ["| seed | before | " + " | ".join(f"{n} points" for n in COUNTS) + " |", "|---" * (2 + len(COUNTS)) + "|"]
    for run in runs:
        cells = []
        for n in COUNTS:
            if n > len(run["chosen"]):
                cells.append("")
                continue
            same = random_points_needed(run, n)
            needed = f"{same} ({same / n:.1f} ×)" if same else f"> {len(run['median'])} (> {len(run['median']) / n:.1f} ×)"
            cells.append(f"{run['chosen'][n - 1]:.4f}, {run['median'][n - 1]:.4f}; {needed}")
        lines.append(f"| {run['seed']} | {run['before']:.4f} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def figure(runs):
    """SVG of the largest σ against the number of points, on logarithmic axes, with a panel for each seed."""
    wide, high, left, top, gap = 300, 260, 60, 40, 30
    sigmas = [s for run in runs for s in [run["before"], *run["chosen"]]]
    low, up = math.log10(min(sigmas)) - 0.03, math.log10(max(sigmas)) + 0.03
    max_points = max(len(run["chosen"]) for run in runs)
    x = lambda n: wide * math.log10(n) / math.log10(max_points)
    y = lambda s: high * (up - math.log10(s)) / (up - low)
    out = []
    width, height = left + len(runs) * (wide + gap), top + high + 60
    out.append(f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">')
    out.append(f'<rect width="{width}" height="{height}" fill="white"/>')
    for k, run in enumerate(runs):
        # At most one point per pixel; the logarithmic axis is dense at the right.
        shown = sorted({round(x(n)): n for n in range(1, len(run["chosen"]) + 1)}.values())
        path = lambda values: " ".join(f"{x(n):.1f},{y(values[n - 1]):.1f}" for n in shown)
        back = " ".join(reversed(path(run["p90"]).split()))
        out.append(f'<g transform="translate({left + k * (wide + gap)},{top})">')
        out.append(f'<text x="0" y="-10">freeform {run["seed"]}, {run["coefficients"]} coefficients</text>')
        for n in [1, 3, 10, 30, 100, 300, 1000]:
            if n <= max_points:
                out.append(f'<path d="M{x(n):.1f},0V{high}" stroke="#eee"/><text x="{x(n):.1f}" y="{high + 16}" text-anchor="middle">{n}</text>')
        for s in [m * 10**e for e in range(-5, 3) for m in (1, 2, 3, 5, 7)]:
            if low <= math.log10(s) <= up:
                out.append(f'<path d="M0,{y(s):.1f}H{wide}" stroke="#eee"/>')
                if k == 0:
                    out.append(f'<text x="-6" y="{y(s) + 4:.1f}" text-anchor="end">{s:.4g}</text>')
        out.append(f'<polygon points="{path(run["p10"])} {back}" fill="#e08030" opacity="0.2"/>')
        out.append(f'<polyline points="{path(run["median"])}" fill="none" stroke="#d06010" stroke-width="2"/>')
        out.append(f'<polyline points="{path(run["chosen"])}" fill="none" stroke="#1060b0" stroke-width="2"/>')
        out.append(f'<rect width="{wide}" height="{high}" fill="none" stroke="#888"/>')
        out.append(f'<text x="{wide / 2}" y="{high + 36}" text-anchor="middle">points</text></g>')
    out.append(f'<text x="{left}" y="14">Largest σ, mm: <tspan fill="#1060b0">chosen one after the other</tspan>, <tspan fill="#d06010">drawn at random (median, 10 to 90 %)</tspan></text>')
    out.append("</svg>")
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    main()
