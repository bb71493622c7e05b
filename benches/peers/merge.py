#!/usr/bin/env python3
"""Merges ten range scans of the Stanford bunny with `planish merge` and with Open3D's Poisson reconstruction.

    python3 -m venv venv && venv/bin/pip install numpy open3d     # Debian: apt install libusb-1.0-0 libgl1 libgomp1
    cargo build --release
    venv/bin/python benches/peers/merge.py SCANS/bun.conf [--depths 8]

Prints distances in mm from every scan point to the mesh: mean, root mean square and 95 % quantile. A single outlier at
79 mm dominates the root mean square, so it is also printed without the farthest thousandth of the points. Poisson's
mesh is also evaluated with the number of triangles of ours (quadric decimation). Seconds, of the clock and of
all processors, include the whole command for Planish, and normals and reconstruction for Open3D.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import tempfile
import time

import numpy as np
import open3d as o3d

from surface import ROOT, poisson, scans


def processor_seconds(who):
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def line(name, seconds, processor, mesh, points):
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    found = 1e3 * scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
    near = np.sort(found)[: -len(found) // 1000]
    edges = np.sort(np.asarray(mesh.triangles)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    print(f"{name:<34} {seconds:>7.1f} {processor:>9.1f} {len(mesh.triangles):>9}  {found.mean():.4f} / {np.sqrt((found**2).mean()):.4f} / "
          f"{np.quantile(found, 0.95):.4f} / {np.sqrt((near**2).mean()):.4f}  {(counts == 1).sum():>7} {(counts > 2).sum():>6}", flush=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("conf")
    arguments.add_argument("--depths", default="8")
    arguments.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen = arguments.parse_args()
    print(platform.machine(), os.cpu_count(), "cores; open3d", o3d.__version__, "; load", os.getloadavg()[0])
    points = np.concatenate([p @ turn.T + shift for p, turn, shift in scans(chosen.conf)])
    print(f"{'program':<34} {'seconds':>7} {'processor':>9} {'triangles':>9}  mean / rms / 95 % / rms of 99.9 %  open, non-manifold edges")
    triangles = 0
    for method in ["mean", "refit", "information"]:
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "whole.ply")
            before, start = processor_seconds(resource.RUSAGE_CHILDREN), time.perf_counter()
            done = subprocess.run([chosen.program, "merge", chosen.conf, "--unit", "m", "--method", method, "-o", out, "--json", "--quiet"],
                                  capture_output=True, check=True)
            seconds = time.perf_counter() - start
            processor = processor_seconds(resource.RUSAGE_CHILDREN) - before
            triangles = json.loads(done.stdout)["triangles"]
            line(f"planish merge --method {method}", seconds, processor, o3d.io.read_triangle_mesh(out), points)
    for depth in map(int, chosen.depths.split(",")):
        before = processor_seconds(resource.RUSAGE_SELF)
        seconds, mesh = poisson(chosen.conf, depth)
        processor = processor_seconds(resource.RUSAGE_SELF) - before
        line(f"Open3D Poisson depth {depth}", seconds, processor, mesh, points)
        line("  with the number of triangles of ours", seconds, processor, mesh.simplify_quadric_decimation(triangles), points)


if __name__ == "__main__":
    main()
