#!/usr/bin/env python3
"""Compares `planish fit` with Poisson reconstruction on closed objects with and without handles.

    python3 -m venv venv && venv/bin/pip install numpy scipy open3d pymeshlab manifold3d
    apt install libusb-1.0-0 libgl1 libgomp1      # for open3d on Debian
    cargo build --release
    venv/bin/python benches/peers/topology.py [--objects spot,eight] [--seed 0] [--data FOLDER]

Objects. Each mesh of the data folder is scaled to 100 mm, and its surface is the ground truth. Simulated
scanners at `--scans` viewpoints around it take about `--readings` readings, each with an isotropic error
of σ = `--sigma`. A share of `--outliers` is wrong: half lies in a shell around the object, half is
displaced along its ray by up to 20 mm. Normals are estimated from the neighbours in the same scan. The
scans state σ. `--objects parts` are machined parts with random dimensions (see `sharp_parts.py`). `bunny` is
the ten real scans of Stanford, which have neither a ground truth nor a σ.

Programs. All get the same readings and normals. Planish also gets σ and the viewpoints; it estimates the
normals of the bunny itself. Open3D removes outliers before Poisson reconstruction (see `mesh_worker.py`).
PyMeshLab finds self-intersections; without this package they are not reported. Options that this script
does not know, such as `--force`, are passed to `planish fit`.

Columns:

- genus: of the mesh, all bodies together, and the number of bodies if not one; `open` if an edge has not
  two triangles. The genus that Planish states in JSON is added if it differs
- folded: triangles that intersect others
- truth, result: rms / median distance in mm from the truth to the result, where a reading is near; then
  from the result to the truth, where the truth is seen
- readings: rms distance from the result of the readings that are no outliers, in σ; for the bunny in mm,
  without the farthest thousandth
- 95 %: share of the area marked as measured (`observed` = 1) where the truth lies within 1.96 σ along the
  normal, or in any direction near edges; the same of the remaining area; the share of the area that is
  marked as measured
- edges: the same of the area within 2 mm of edges of more than 30° of the truth: measured / share of it that
  is marked as measured; rms error of that area in mm
- wrong: share of the whole area that is marked as measured although the truth is farther than 5 σ away, in
  %; 99.9 % quantile of the errors along the normal of the area marked as measured, in mm
- size: control vertices of Planish, with the number of extraordinary ones; vertices of meshes
- s, MB: of the whole command with its files for Planish; of the removal of outliers and the reconstruction
  for the others, whose memory includes Python

The rows are also written as JSON lines with all figures (`--out`). The scans depend on the seed only.
Poisson reconstruction on several threads may differ in the last digits.
"""

import argparse
import importlib.util
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import zlib

import numpy as np
import open3d as o3d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import scanning
import sharp_parts
import surface as bunny_scans
from peak_memory import measured

FOLDER = os.path.dirname(os.path.abspath(__file__))
WORKER = os.path.join(FOLDER, "mesh_worker.py")
BUNNY = "scans/bunny/bun.conf"
MESHES = {  # Files below `meshes/`.
    "armadillo": "armadillo.obj",
    "spot": "spot.obj",
    "rocker-arm": "rocker-arm.obj",
    "eight": "genus/eight.off",
    "joint": "genus/joint.obj",
    "cup": "genus/cup_input_simple_10000.off",
    "universal-joint": "genus/modular_universal_joint.off",
    "fertility": "fertility.off",
    "deckel": "genus/deckel_input.off",
    "botijo": "genus/botijo.obj",
    "fandisk": "fandisk.obj",
    "anchor": "anchor_dense.off",
    "coupling": "couplingdown.off",
    "spool": "spool.off",
    "rotor": "rotor_small.off",
}
MECHANICAL = ["fandisk", "anchor", "coupling", "spool", "rotor"]
STANDARD = ["bunny"] + [name for name in MESHES if name not in MECHANICAL]
KNOWN = ["bunny", *MESHES, *sharp_parts.PARTS]
COLUMNS = [
    "object (genus)",
    "program",
    "genus",
    "folded",
    "truth: rms / median; result: rms / median",
    "readings",
    "95 %: measured / rest / measured area",
    "edges: 95 % / measured area; rms",
    "wrong / worst",
    "size",
    "s",
    "MB",
]
SAMPLES = 100_000  # On each surface, for distances.
SHARP = 30.0  # Edges of a larger angle are sharp, in degrees.
NEAR_EDGE = 2.0  # In mm.
SIGHT = 3.0  # The truth is seen if a reading is within this many mean spacings of all readings.


def genus_of(triangles):
    """Genus of all bodies of a mesh (none if it is open), number of bodies, and whether it is closed."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, uses = np.unique(edges, axis=0, return_counts=True)
    used, corners = np.unique(triangles, return_inverse=True)
    ends = np.searchsorted(used, edges)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(used), len(used)))
    bodies = connected_components(graph, directed=False)[0]
    closed = bool((uses == 2).all())
    characteristic = len(used) - len(edges) + len(triangles)
    return (bodies - characteristic // 2 if closed else None), bodies, closed


def read_mesh(path):
    """The mesh as a surface, with all columns of the vertices of a PLY file in little-endian binary."""
    with open(path, "rb") as file:
        kinds = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4", "uint": "<u4"}
        counts, columns = {}, []
        while (words := file.readline().decode().split()) != ["end_header"]:
            if words[0] == "element":
                element, counts[words[1]] = words[1], int(words[2])
            elif words[0] == "property" and element == "vertex":
                columns.append((words[2], kinds[words[1]]))
        vertices = np.fromfile(file, dtype=columns, count=counts["vertex"])
        faces = np.frombuffer(file.read(), dtype=np.uint8).reshape(counts["face"], -1)
        triangles = np.ascontiguousarray(faces[:, 1:13]).view("<i4")
    points = np.stack([vertices[c] for c in "xyz"], axis=1).astype(float)
    return scanning.Surface(points, triangles.astype(np.int64)), vertices


def points_on_edges(surface):
    """Points on the sharp edges of a closed mesh, at most a quarter of NEAR_EDGE apart."""
    directed = surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    order = np.lexsort(np.sort(directed, axis=1).T)
    first, second = order[::2], order[1::2]
    turn = np.einsum("ij,ij->i", surface.normals[first // 3], surface.normals[second // 3])
    a, b = surface.vertices[directed[first[turn < np.cos(np.radians(SHARP))]]].transpose(1, 0, 2)
    counts = np.ceil(4 * np.linalg.norm(b - a, axis=1) / NEAR_EDGE).astype(int) + 1
    share = np.concatenate([np.linspace(0, 1, n) for n in counts]) if len(counts) else np.zeros(0)
    start = np.repeat(a, counts, axis=0)
    return start + share[:, None] * (np.repeat(b, counts, axis=0) - start)


class Truth:
    """The surface of an object and where the scans see it."""

    def __init__(self, surface, scans):
        self.surface = surface
        self.hits = np.concatenate([s.hits[~s.outlier] for s in scans])
        self.normals = np.concatenate([s.hit_normals[~s.outlier] for s in scans])
        self.tree = cKDTree(self.hits)
        edges = points_on_edges(surface)
        self.edges = cKDTree(edges) if len(edges) else None
        self.reach = SIGHT * np.sqrt(surface.areas.sum() / len(self.hits))

    def seen(self, points, normals):
        """Whether a reading is near each point, on the same side of a wall."""
        distance, near = self.tree.query(points, 8, distance_upper_bound=self.reach)
        found = np.isfinite(distance)
        sides = np.einsum("nki,ni->nk", self.normals[np.where(found, near, 0)], normals)
        return (found & (sides > 0.5)).any(axis=1)

    def near_edges(self, points):
        """Whether a sharp edge is near each point."""
        if self.edges is None:
            return np.zeros(len(points), dtype=bool)
        return np.isfinite(self.edges.query(points, distance_upper_bound=NEAR_EDGE)[0])

    def along_normals(self, points, normals):
        """Distances to the surface along the normals, in either direction; infinite if there is none."""
        ways = [self.surface.cast(points, side * normals)["t_hit"] for side in (1, -1)]
        return np.minimum(*ways).astype(float)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None


def distances_to_truth(result, truth, rng):
    """Rms and median distances in both directions, of the parts that are seen."""
    points, normals = truth.surface.sample(SAMPLES, rng)
    there = result.distances(points[truth.seen(points, normals)])
    points, _ = result.sample(SAMPLES, rng)
    closest, triangles = truth.surface.closest(points)
    seen = truth.seen(closest, truth.surface.normals[triangles])
    back = np.linalg.norm(points - closest, axis=1)[seen]
    return {
        "truth_rms": rms(there),
        "truth_median": float(np.median(there)),
        "result_rms": rms(back),
        "result_median": float(np.median(back)),
    }


def shares(flags, areas):
    return float(areas[flags].sum() / areas.sum()) if areas.sum() > 0 else None


def coverage(result, vertices, truth):
    """How σ predicts the errors at the vertices of Planish, each weighted by its part of the area."""
    normals = np.stack([vertices["n" + c] for c in "xyz"], axis=1).astype(float)
    areas = np.bincount(result.triangles.ravel(), np.repeat(result.areas / 3, 3), len(vertices))
    errors, distances = truth.along_normals(result.vertices, normals), truth.surface.distances(result.vertices)
    # Normals on an edge, or rounded ones near it, may miss the truth.
    beside = truth.near_edges(result.vertices)
    errors[beside] = distances[beside]
    wrong = distances > 5 * vertices["sigma"]
    within, measured_part = errors <= 1.96 * vertices["sigma"], vertices["observed"] == 1
    order = np.argsort(errors[measured_part])
    places = np.cumsum(areas[measured_part][order])
    worst = errors[measured_part][order][np.searchsorted(places, 0.999 * places[-1])] if len(places) else None
    return {
        "covered": shares(within[measured_part], areas[measured_part]),
        "covered_rest": shares(within[~measured_part], areas[~measured_part]),
        "measured_area": shares(measured_part, areas),
        "covered_edges": shares(within[measured_part & beside], areas[measured_part & beside]),
        "covered_away": shares(within[measured_part & ~beside], areas[measured_part & ~beside]),
        "measured_edges": shares(measured_part[beside], areas[beside]),
        "edges_rms": rms(distances[measured_part & beside]),
        "wrong": shares(measured_part & wrong, areas),
        "worst": None if worst is None else float(worst),
        "median_sigma": float(np.median(vertices["sigma"][measured_part])) if measured_part.any() else None,
    }


def intersections(path):
    """Number of triangles that intersect others, if PyMeshLab is installed."""
    if importlib.util.find_spec("pymeshlab") is None:
        return None
    done = subprocess.run([sys.executable, WORKER, "intersections", path], stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)["triangles"]


def planish(chosen, job, unit, out):
    """Runs `planish fit`; the row has a `refusal` if it wrote no mesh."""
    command = [
        "timeout",
        str(chosen.time_limit),
        chosen.program,
        "fit",
        job,
        "--unit",
        unit,
        "-o",
        out,
        "--json",
        *chosen.more,
    ]
    start = time.perf_counter()
    done, megabytes = measured(command, capture_output=True, text=True)
    seconds = time.perf_counter() - start
    row = {"method": "planish", "seconds": seconds, "megabytes": megabytes, "exit": done.returncode}
    if done.returncode != 0:
        errors = [line for line in done.stderr.splitlines() if line and "warning:" not in line]
        reason = errors[0].removeprefix("planish: ").replace(f"{job}: ", "") if errors else "no message"
        return {**row, "refusal": reason}
    report = json.loads(done.stdout)
    keys = [
        "genus",
        "components",
        "coefficients",
        "extraordinary_vertices",
        "cells",
        "verdict",
        "rms_normalised",
        "observed_area_fraction",
        "unresolved_area_fraction",
        "held_out",
        "rejected",
        "warnings",
    ]
    return {**row, **{f"planish_{key}": report.get(key) for key in keys}}


def poisson(method, cloud, out):
    """Runs a Poisson reconstruction such as `open3d-8` in its own process."""
    program, depth = method.rsplit("-", 1)
    command = [sys.executable, WORKER, program, depth, cloud, out]
    done, megabytes = measured(command, capture_output=True, text=True)
    row = {"method": method, "seconds": None, "megabytes": megabytes, "exit": done.returncode}
    if done.returncode != 0:
        return {**row, "refusal": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    return {**row, **json.loads(done.stdout.splitlines()[-1])}


def judged(row, out, scale, readings, sigma, truth, seed):
    """Adds to a row what its mesh shows. Lengths are multiplied by `scale` first."""
    result, vertices = read_mesh(out)
    row["folded"] = intersections(out)
    row["genus"], row["bodies"], row["closed"] = genus_of(result.triangles)
    row["vertices"] = len(vertices)
    if scale != 1:
        result = scanning.Surface(result.vertices * scale, result.triangles)
    left = result.distances(readings)
    row["readings_median"] = float(np.median(left))
    if truth is None:
        return {**row, "readings_rms": rms(np.sort(left)[: -len(left) // 1000])}
    row["readings_rms"] = rms(left) / sigma
    row.update(distances_to_truth(result, truth, np.random.default_rng(seed)))
    return {**row, **(coverage(result, vertices, truth) if "sigma" in (vertices.dtype.names or ()) else {})}


def figure(value, digits=3, factor=1):
    return "–" if value is None else f"{value * factor:.{digits}f}"


def printed(name, row):
    """A row of the table."""
    method = row["method"]
    if "refusal" in row:
        cost = f"{figure(row['seconds'], 1)} | {figure(row['megabytes'], 0)}"
        return f"| {name} | {method} | refused, exit code {row['exit']} |{' |' * 7} {cost} |"
    genus = str(row["genus"]) if row["closed"] else "open"
    if row["bodies"] != 1:
        genus += f" in {row['bodies']}"
    stated = row.get("planish_genus")
    if stated is not None and stated != row["genus"]:
        genus += f" (states {stated})"
    truth = "–"
    if "truth_rms" in row:
        truth = "; ".join(f"{row[d + '_rms']:.4f} / {row[d + '_median']:.4f}" for d in ("truth", "result"))
    covered = "–"
    if "covered" in row:
        covered = " / ".join(figure(row[key], 1, 100) for key in ("covered", "covered_rest", "measured_area"))
    edges = "–"
    if row.get("edges_rms") is not None:
        edges = " / ".join(figure(row[key], 1, 100) for key in ("covered_edges", "measured_edges"))
        edges += f"; {figure(row['edges_rms'])}"
    wrong = "–" if "wrong" not in row else f"{figure(row['wrong'], 3, 100)} / {figure(row['worst'])}"
    size = str(row["vertices"])
    if method == "planish":
        size = f"{row['planish_coefficients']} ({row['planish_extraordinary_vertices']})"
    folded = "–" if row["folded"] is None else row["folded"]
    return (
        f"| {name} | {method} | {genus} | {folded} | {truth} | {row['readings_rms']:.3f} | {covered} "
        f"| {edges} | {wrong} | {size} | {row['seconds']:.1f} | {row['megabytes']:.0f} |"
    )


def real_bunny(chosen):
    """The list of scans of the bunny, which are in metres, and their points and normals in mm."""
    job = os.path.join(chosen.data, BUNNY)
    points, normals = [], []
    for scan, turn, shift in bunny_scans.scans(job):
        # The scanner looks along -z of its own frame.
        normals.append(scanning.estimated_normals(scan, np.array([[0.0, 0.0, 1.0]])) @ turn.T)
        points.append(1e3 * (scan @ turn.T + shift))
    return job, np.concatenate(points), np.concatenate(normals)


def rows_of(name, chosen, folder):
    """Runs all programs on one object and yields a row for each."""
    seed = [chosen.seed, zlib.crc32(name.encode())]
    if name == "bunny":
        job, points, normals = real_bunny(chosen)
        readings, sigma, truth, unit, scale = points, None, None, "m", 1e3
    else:
        if name in sharp_parts.PARTS:
            surface = scanning.centred(*sharp_parts.part(name, chosen.seed))
        else:
            surface = scanning.load(os.path.join(chosen.data, "meshes", MESHES[name]), chosen.subdivide)
        scans = scanning.scan_all(
            surface, chosen.scans, chosen.readings, chosen.sigma, chosen.outliers, np.random.default_rng(seed)
        )
        job, truth = scanning.write_job(folder, scans, chosen.sigma), Truth(surface, scans)
        points, normals = (
            np.concatenate([getattr(s, part) for s in scans]) for part in ("points", "normals")
        )
        readings = np.concatenate([s.points[~s.outlier] for s in scans])
        sigma, unit, scale = chosen.sigma, "mm", 1
    cloud, out = os.path.join(folder, "cloud.npz"), os.path.join(folder, "result.ply")
    np.savez(cloud, points=points, normals=normals)
    known = {
        "object": name,
        "seed": chosen.seed,
        "readings": len(points),
        "true_genus": genus_of(truth.surface.triangles)[0] if truth else None,
    }
    for method in ["planish", *chosen.peers]:
        ours = method == "planish"
        row = planish(chosen, job, unit, out) if ours else poisson(method, cloud, out)
        if "refusal" not in row:
            row = judged(row, out, scale if ours else 1, readings, sigma, truth, seed)
        yield {**known, **row}


def options():
    found = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = bunny_scans.ROOT
    found.add_argument(
        "--data",
        default=os.path.join(root, os.pardir, "shared", "data"),
        help="folder with meshes/ and scans/bunny/ (default: ../shared/data of the repository)",
    )
    found.add_argument(
        "--objects",
        default="standard",
        help="`standard`, `mechanical`, `parts`, `all`, or names separated by commas (default: standard): "
        f"{', '.join(KNOWN)}",
    )
    found.add_argument("--peers", default="open3d-8,open3d-9,pymeshlab-8", help="programs with their depths")
    found.add_argument("--seed", type=int, default=0)
    found.add_argument("--scans", type=int, default=10)
    found.add_argument(
        "--readings", type=int, default=60_000, help="of all scans of an object (default: 60000)"
    )
    found.add_argument(
        "--sigma", type=float, default=0.05, help="in mm, of objects of 100 mm (default: 0.05)"
    )
    found.add_argument("--outliers", type=float, default=0.03, help="share of the readings (default: 0.03)")
    found.add_argument(
        "--subdivide",
        type=int,
        default=0,
        metavar="N",
        help="subdivide the meshes N times by Loop's rule first, which smooths their facets",
    )
    found.add_argument("--time-limit", type=int, default=900, help="of planish, in seconds (default: 900)")
    found.add_argument(
        "--out", default="topology.jsonl", help="file for all figures (default: topology.jsonl)"
    )
    found.add_argument("--program", default=os.path.join(root, "target", "release", "planish"))
    chosen, chosen.more = found.parse_known_args()
    sets = {"standard": STANDARD, "mechanical": MECHANICAL, "parts": [*sharp_parts.PARTS]}
    sets["all"] = sum(sets.values(), [])
    chosen.objects = sets.get(chosen.objects) or chosen.objects.split(",")
    chosen.peers = [peer for peer in chosen.peers.split(",") if peer]
    return chosen


def check(chosen):
    """Ends the script with a message if an object or its file is missing, and leaves out peers that are."""
    files = {
        name: os.path.join(chosen.data, BUNNY if name == "bunny" else f"meshes/{MESHES.get(name)}")
        for name in chosen.objects
        if name not in sharp_parts.PARTS
    }
    unknown = [name for name in chosen.objects if name not in KNOWN]
    if unknown:
        raise SystemExit(f"unknown objects: {', '.join(unknown)}; known are {', '.join(KNOWN)}")
    missing = [path for path in files.values() if not os.path.exists(path)]
    if missing:
        raise SystemExit(
            f"missing: {', '.join(missing)}\n"
            "Use --data to name the folder that contains meshes/ and scans/bunny/."
        )
    if not os.path.exists(chosen.program):
        raise SystemExit(f"missing: {chosen.program}; run `cargo build --release` or use --program")
    absent = [peer for peer in chosen.peers if importlib.util.find_spec(peer.rsplit("-", 1)[0]) is None]
    for peer in absent:
        print(f"{peer} is left out: its package is not installed", file=sys.stderr)
    chosen.peers = [peer for peer in chosen.peers if peer not in absent]


def main():
    chosen = options()
    check(chosen)
    version = subprocess.run([chosen.program, "--version"], capture_output=True, text=True).stdout.strip()
    print(platform.machine(), os.cpu_count(), "cores; open3d", o3d.__version__, ";", version)
    settings = ["seed", "scans", "readings", "sigma", "outliers", "subdivide"]
    print("; ".join(f"{key} {getattr(chosen, key)}" for key in settings), end="")
    print(f"; load {os.getloadavg()[0]:.1f}\n")
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS), flush=True)
    refusals = []
    with open(chosen.out, "w") as file:
        for name in chosen.objects:
            with tempfile.TemporaryDirectory() as folder:
                for row in rows_of(name, chosen, folder):
                    known = "" if row["true_genus"] is None else f" ({row['true_genus']})"
                    print(printed(name + known, row), flush=True)
                    print(json.dumps(row), file=file, flush=True)
                    if "refusal" in row:
                        refusals.append(f"{name}, {row['method']}: {row['refusal']}")
    if refusals:
        print("\nRefused:\n- " + "\n- ".join(refusals))


if __name__ == "__main__":
    main()
