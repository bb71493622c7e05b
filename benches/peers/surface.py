#!/usr/bin/env python3
"""Fits ten range scans of the Stanford bunny with Planish and with Open3D's Poisson reconstruction.

    python3 -m venv venv && venv/bin/pip install numpy open3d     # Debian: apt install libusb-1.0-0 libgl1 libgomp1
    cargo build --release
    venv/bin/python benches/peers/surface.py SCANS/bun.conf REFERENCE/bun_zipper.ply [--depths 8,9]

Both get the same scans with their poses. For Open3D, normals are estimated from thirty neighbours within each scan and
oriented towards the scanner. Its time includes normals and reconstruction of points in memory. The time of Planish is
that of the whole command with its files. Planish computes a spline surface with its covariance and a mesh, Open3D only
a mesh. Distances are in mm, from every third scan point and from every vertex of the reference to the mesh.
"""

import argparse
import json
import os
import platform
import shlex
import subprocess
import tempfile
import time

import numpy as np
import open3d as o3d

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def rotation(x, y, z, w):
    """Rotation of a quaternion in a VRIP .conf file, which contains the inverse."""
    w = -w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def scans(conf):
    """Points of every scan, with the rotation and translation of its pose."""
    for line in open(conf):
        words = shlex.split(line)
        if words and words[0] == "bmesh":
            cloud = o3d.io.read_point_cloud(os.path.join(os.path.dirname(conf), words[1]))
            turn, shift = rotation(*map(float, words[5:9])), np.array(words[2:5], float)
            yield np.asarray(cloud.points), turn, shift


def poisson(conf, depth):
    clouds = []
    start = time.perf_counter()
    for points, turn, shift in scans(conf):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
        # The scanner looks along -z of its own frame.
        cloud.orient_normals_to_align_with_direction([0.0, 0.0, 1.0])
        cloud.points = o3d.utility.Vector3dVector(points @ turn.T + shift)
        cloud.normals = o3d.utility.Vector3dVector(np.asarray(cloud.normals) @ turn.T)
        clouds.append(cloud)
    whole = clouds[0]
    for cloud in clouds[1:]:
        whole += cloud
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(whole, depth=depth)
    seconds = time.perf_counter() - start
    return seconds, mesh


def planish(program, conf, coefficients, folder):
    out = os.path.join(folder, "surface.ply")
    start = time.perf_counter()
    child = subprocess.Popen(
        [program, "fit", conf, "--unit", "m", "-o", os.path.join(folder, "surface.planish"), "-o", out, "--json", "--quiet",
         "--max-coefficients", str(coefficients)],
        stdout=subprocess.PIPE,
    )
    report = json.loads(child.stdout.read())
    _, _, usage = os.wait4(child.pid, 0)
    return time.perf_counter() - start, o3d.io.read_triangle_mesh(out), report, usage


def distances(mesh, points):
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    found = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy() * 1e3
    return f"{np.median(found):.4f} / {np.quantile(found, 0.95):.4f} / {np.sqrt(np.mean(found**2)):.4f}"


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("conf")
    arguments.add_argument("reference")
    arguments.add_argument("--depths", default="8,9")
    arguments.add_argument("--coefficients", default="12000,40000", help="maximum numbers of control vertices for Planish")
    arguments.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen = arguments.parse_args()
    print(platform.machine(), os.cpu_count(), "cores; open3d", o3d.__version__, ";",
          subprocess.run([chosen.program, "--version"], capture_output=True, text=True).stdout.strip())
    readings = np.concatenate([p @ turn.T + shift for p, turn, shift in scans(chosen.conf)])[::3]
    reference = np.asarray(o3d.io.read_point_cloud(chosen.reference).points)
    print(f"{'program':<24} {'seconds':>8} {'cpu s':>7} {'triangles':>10}  distance in mm, median / 95 % / rms, of readings; of the reference's vertices")
    for maximum in map(int, chosen.coefficients.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            seconds, mesh, report, usage = planish(chosen.program, chosen.conf, maximum, folder)
        cpu = usage.ru_utime + usage.ru_stime
        name = f"planish ({report['coefficients']} nodes)"
        print(f"{name:<24} {seconds:>8.2f} {cpu:>7.1f} {len(mesh.triangles):>10}  {distances(mesh, readings)}; {distances(mesh, reference)}", flush=True)
    for depth in map(int, chosen.depths.split(",")):
        cpu = time.process_time()
        seconds, mesh = poisson(chosen.conf, depth)
        cpu = time.process_time() - cpu
        print(f"{'Open3D Poisson depth ' + str(depth):<24} {seconds:>8.2f} {cpu:>7.1f} {len(mesh.triangles):>10}  {distances(mesh, readings)}; {distances(mesh, reference)}", flush=True)


if __name__ == "__main__":
    main()
