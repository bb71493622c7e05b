"""Compares the σ predicted by `planish next --views` with that after scans from the proposed poses.

A freeform is scanned coarsely and fitted. `next` proposes views. Open3D casts rays from them at the true surface, noise
is added, and `fit --update` adds the readings. The resulting σ is compared with the prediction.

    python benches/peers/next_views.py --out out [--planish target/release/planish] [--seeds 1 2 3]

Needs NumPy and Open3D.
"""

import argparse
import json
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import open3d as o3d

RAYS = (120, 90)
FOV_DEG = (28, 21)
NEAR, FAR = 150, 400
INCIDENCE_DEG = 60
SIGMA = 0.03


def rotation(quaternion):
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def scan(scene, pose, rng):
    """Readings of one view in the frame of the sensor."""
    turn, place = rotation(pose["quaternion_xyzw"]), np.array(pose["translation"])
    shares = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 - 1 for n in RAYS])
    tangents = [np.tan(np.radians(0.5 * angle)) for angle in FOV_DEG]
    rays = np.stack([shares[0] * tangents[0], shares[1] * tangents[1], np.ones_like(shares[0])], -1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    directions = rays @ turn.T
    cast = scene.cast_rays(o3d.core.Tensor(np.concatenate([np.broadcast_to(place, directions.shape), directions], 1).astype(np.float32)))
    ranges = cast["t_hit"].numpy().astype(float)
    cosine = np.abs((cast["primitive_normals"].numpy() * directions).sum(1))
    read = np.isfinite(ranges) & (ranges >= NEAR) & (ranges <= FAR) & (cosine >= np.cos(np.radians(INCIDENCE_DEG)))
    return rays[read] * ranges[read, None] + rng.normal(0, SIGMA, (read.sum(), 3))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planish", default="planish", help="the command")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    def planish(*words):
        line = [args.planish, *map(str, words), "--json"]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(line)}\n{done.stderr}")
        return json.loads(done.stdout)

    sensor = args.out / "camera.toml"
    sensor.write_text(f'unit = "mm"\nfov_deg = {list(FOV_DEG)}\nrays = {list(RAYS)}\nnear = {NEAR}\nfar = {FAR}\nmax_incidence_deg = {INCIDENCE_DEG}\nsigma_along = {SIGMA}\n')
    print("| seed | largest σ before | predicted | actual | mean σ before | predicted | actual | readings predicted | actual |")
    print("|---" * 9 + "|")
    for seed in args.seeds:
        here = args.out / f"views-{seed}"
        planish("simulate", "scene", "scans", "--seed", seed, "--readings", 3000, "--views", 2, "--no-old-scanner", "--outliers", 0, "--probe-points", 0, "--out", here)
        planish("fit", here / "job.toml", "-o", here / "before.planish")
        predicted = planish("next", here / "before.planish", "--views", args.views, "--sensor", sensor, "-o", here / "views.toml")
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.io.read_triangle_mesh(str(here / "truth.ply")))
        rng = np.random.default_rng(seed)
        count = 0
        for entry in tomllib.loads((here / "views.toml").read_text())["scan"]:
            points = scan(scene, entry["pose"], rng)
            count += len(points)
            np.savetxt(here / entry["file"], points, fmt="%.6f", comments="", header=f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header")
        planish("fit", here / "views.toml", "--update", here / "before.planish", "-o", here / "after.planish")
        actual = planish("next", here / "after.planish", "--count", 0, "--sigma", f"{SIGMA}mm")
        cells = []
        for which in ["worst_sigma", "mean_sigma"]:
            cells += [f"{x:.4f}" for x in [predicted[which]["before"], predicted[which]["after"], actual[which]["before"]]]
        print(f"| {seed} | " + " | ".join(cells) + f" | {sum(v['readings'] for v in predicted['views'])} | {count} |")


if __name__ == "__main__":
    main()
