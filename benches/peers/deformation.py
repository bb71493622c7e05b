#!/usr/bin/env python3
"""Compares `planish shell fit` with non-rigid registration on meshes deformed by known motions.

    python3 -m venv venv && venv/bin/pip install numpy scipy trimesh rtree open3d libigl
    apt install libusb-1.0-0 libgl1 libgomp1      # for open3d on Debian
    cargo build --release
    venv/bin/python benches/peers/deformation.py [--objects spot] [--motions turn-90] [--seed 0]

Objects. The largest body of each mesh is decimated to `--triangles`, scaled to 100 mm, and its longest
side is turned to z. The motion moves its vertices; the facets between the moved vertices are the ground
truth. All programs get the mesh at rest and the same points, with an error of σ = `--sigma` in every
direction, and no correspondences.

Motions (each with a random phase, axis or place): `twist` about z by 40° from end to end; `bend` by 40°;
`swell` by a quarter around a place on the surface; `turn-30` and `turn-90`, the upper part turned about an
axis within 25° of z with a joint of a fifth of the length; `ripple` along the normals by 1 mm in waves of
30 mm; `scale` by 1.15. Every motion is followed by a rotation of 3° and a translation of 2 mm.

Data: `full`, points on the whole surface; `front`, only what a camera at a random horizontal direction sees;
`gross`, the whole surface with 10 % gross errors, half anywhere in the box of the object, half displaced
along their normal by up to 10 mm.

Programs: Planish; the non-rigid ICP of `trimesh` (Amberg et al. 2007); as-rigid-as-possible deformation of
Open3D and of libigl, with 300 vertices that move along their normals to the median of the nearest points,
in 20 rounds. Options that this script does not know, such as `--controls 200`, are passed to Planish.

Columns, for the vertices that are seen and for those that are not:

- distance: rms distance of the vertices from the true surface, in σ of a point
- slide: rms distance of the vertices from their true places, along the surface, in mm
- 95 %: share of the vertices within 1.96 σ of the true surface; `observed`: share with `observed` = 1 (in the
  JSON lines also the coverage of vertices with `observed` = 1 and of the others)
- folds: triangles turned by more than 90° from their true normals
- σ ratio: estimated over stated σ of the points; `unresolved`: σ of unresolved shape over that of a point

The rows are also written as JSON lines (`--out`). Objects, motions and points depend on the seed only.
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
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import scanning
from topology import read_mesh, rms

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), os.pardir, os.pardir))
OBJECTS = {"max": "decimated-max.obj", "head": "head.obj", "armadillo": "armadillo.obj", "spot": "spot.obj"}
MOTIONS = ["twist", "bend", "swell", "turn-30", "turn-90", "ripple", "scale"]
DATA = ["full", "front", "gross"]
PEERS = {"trimesh": "trimesh", "open3d": "open3d", "libigl": "igl"}
COLUMNS = ["case", "program", "distance", "slide / mm", "95 %", "observed", "folds"]
COLUMNS += ["σ ratio; unresolved", "s"]
GRAZING = 0.2  # Cosine of the angle to the normal, below which a camera sees nothing.
HANDLES, ROUNDS, NEAREST = 300, 20, 12  # Of as-rigid-as-possible deformations.


def load(path, triangles):
    """The largest body of a mesh, decimated and scaled, its longest side along z."""
    mesh = trimesh.load(path, force="mesh", process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh = max(mesh.split(only_watertight=False), key=lambda body: body.area)
    made = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    )
    if len(mesh.faces) > triangles:
        made = made.simplify_quadric_decimation(triangles)
    made.remove_degenerate_triangles().remove_unreferenced_vertices()
    vertices, faces = np.asarray(made.vertices), np.asarray(made.triangles)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2) * (scanning.SIZE / (high - low).max())
    # A cyclic exchange of the axes is a rotation.
    return np.roll(vertices, 2 - np.argmax(high - low), axis=1), faces


def smooth(x):
    x = np.clip(x, 0, 1)
    return x * x * x * (10 + x * (6 * x - 15))


def turned(points, axis, angles, pivot):
    """Points, each turned by its own angle about an axis through the pivot."""
    return Rotation.from_rotvec(angles[:, None] * axis).apply(points - pivot) + pivot


def bent(points, side, angle):
    """Points bent in the plane of z and `side`: the middle line becomes an arc of the same length."""
    length = np.ptp(points[:, 2])
    radius, along = length / angle, points @ side
    turn = points[:, 2] / radius
    across = points - along[:, None] * side - points[:, 2:] * [0, 0, 1]
    out = (radius - along) * np.cos(turn)
    return across + (radius - out)[:, None] * side + ((radius - along) * np.sin(turn))[:, None] * [0, 0, 1]


def moved(name, vertices, normals, rng):
    """The true places of the vertices."""
    z, size = vertices[:, 2], np.ptp(vertices[:, 2])
    phase, heading = rng.uniform(0, 2 * np.pi, 2)
    side = np.array([np.cos(heading), np.sin(heading), 0])
    if name == "twist":
        made = turned(vertices, np.array([0, 0, 1.0]), np.radians(40) * z / size, np.zeros(3))
    elif name == "bend":
        made = bent(vertices, side, np.radians(40))
    elif name == "swell":
        off = vertices - vertices[rng.integers(len(vertices))]
        made = vertices + 0.25 * off * np.exp(-(off**2).sum(axis=1) / (2 * 20**2))[:, None]
        made += 2.5 * normals * np.exp(-(off**2).sum(axis=1) / (2 * 20**2))[:, None]
    elif name.startswith("turn-"):
        axis = np.array([0, 0, 1]) + np.tan(np.radians(rng.uniform(0, 25))) * side
        low, joint = rng.uniform(-0.1, 0.1) * size, 0.2 * size
        angles = np.radians(float(name[5:])) * smooth((z - low) / joint)
        pivot = np.append(vertices[abs(z - low - joint / 2) < joint / 2, :2].mean(axis=0), low + joint / 2)
        made = turned(vertices, axis / np.linalg.norm(axis), angles, pivot)
    elif name == "ripple":
        wave = 2 * np.pi / 30
        height = np.sin(wave * z + phase) * np.sin(wave * vertices @ side + heading)
        made = vertices + 1.0 * height[:, None] * normals
    else:
        made = 1.15 * vertices
    pose = Rotation.from_rotvec(np.radians(3) * scanning.views(1, rng)[0])
    return pose.apply(made) + 2 * scanning.views(1, rng)[0]


def visible(surface, points, normals, direction):
    """Which points a camera far away in a direction sees."""
    facing = normals @ direction > GRAZING
    hit = surface.cast(points + 1e-2 * normals + 1e-2 * direction, np.broadcast_to(direction, points.shape))
    return facing & ~np.isfinite(hit["t_hit"])


def vertex_normals(vertices, triangles):
    """Unit normals of vertices, weighted by areas."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    sums = np.zeros_like(vertices)
    np.add.at(sums, triangles, np.cross(b - a, c - a)[:, None])
    return sums / np.maximum(np.linalg.norm(sums, axis=1), 1e-300)[:, None]


class Case:
    """A mesh at rest, its true places, points on them, and which vertices are seen."""

    def __init__(self, rest, triangles, motion, data, chosen, rng):
        self.rest, self.triangles, self.sigma, self.data = rest, triangles, chosen.sigma, data
        places = moved(motion, rest, vertex_normals(rest, triangles), rng)
        self.truth = scanning.Surface(places, triangles)
        self.normals = vertex_normals(places, triangles)
        heading = rng.uniform(0, 2 * np.pi)
        camera = np.array([np.cos(heading), np.sin(heading), 0])
        points, normals = self.truth.sample(4 * chosen.points, rng)
        if data == "front":
            kept = visible(self.truth, points, normals, camera)
            points, normals = points[kept], normals[kept]
            self.seen = visible(self.truth, places, self.normals, camera)
        else:
            self.seen = np.ones(len(rest), dtype=bool)
        count = chosen.points // 2 if data == "front" else chosen.points
        points, normals = points[:count], normals[:count]
        self.points = points + rng.normal(0, chosen.sigma, points.shape)
        if data == "gross":
            wrong = rng.random(len(points)) < 0.1
            anywhere = wrong & (rng.random(len(points)) < 0.5)
            along = wrong & ~anywhere
            low, high = places.min(axis=0), places.max(axis=0)
            self.points[anywhere] = rng.uniform(low, high, (anywhere.sum(), 3))
            self.points[along] += normals[along] * rng.uniform(-10, 10, (along.sum(), 1))

    def judged(self, found):
        """Errors of fitted vertices."""
        off = found - self.truth.vertices
        along = off - np.einsum("ij,ij->i", off, self.normals)[:, None] * self.normals
        distance = self.truth.distances(found)
        row = {"folds": int((self.turns(found) < 0).sum())}
        for part, which in (("seen", self.seen), ("unseen", ~self.seen)):
            row[f"{part}_distance"] = over(rms(distance[which]), self.sigma)
            row[f"{part}_slide"] = rms(np.linalg.norm(along[which], axis=1))
        return row, distance

    def turns(self, found):
        """Cosines between the normals of fitted and true triangles."""
        return np.einsum("ij,ij->i", scanning.Surface(found, self.triangles).normals, self.truth.normals)


def over(value, sigma):
    return None if value is None else value / sigma


def planish(chosen, case, folder):
    """Runs `planish shell fit`; the row has a `refusal` if it wrote no mesh."""
    files = [os.path.join(folder, name) for name in ("rest.obj", "points.ply", "fitted.ply")]
    with open(files[0], "w") as file:
        np.savetxt(file, case.rest, fmt="v %.9f %.9f %.9f")
        np.savetxt(file, case.triangles + 1, fmt="f %d %d %d")
    scanning.write_ply(files[1], case.points, np.zeros_like(case.points), chosen.sigma)
    command = [chosen.program, "shell", "fit", files[0], "--points", files[1], "-o", files[2]]
    if chosen.landmarks:
        files.append(os.path.join(folder, "landmarks.csv"))
        command += ["--landmarks", files[3]]
        write_landmarks(files[3], chosen, case)
    command += ["--unit", "mm", "--json", "--quiet", *chosen.more]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    row = {"seconds": time.perf_counter() - start, "exit": done.returncode}
    if done.returncode != 0:
        return {**row, "refusal": done.stderr.strip().splitlines()[0] if done.stderr else "no message"}
    report = json.loads(done.stdout)
    _, columns = read_mesh(files[2])
    found = np.stack([columns[c] for c in "xyz"], axis=1).astype(float)
    judged, distance = case.judged(found)
    for part, which in (("seen", case.seen), ("unseen", ~case.seen)):
        if which.any():
            judged[f"{part}_covered"] = float((distance <= 1.96 * columns["sigma"])[which].mean())
            judged[f"{part}_observed"] = float((columns["observed"] == 1)[which].mean())
            judged[f"{part}_sigma"] = over(float(np.median(columns["sigma"][which])), chosen.sigma)
    inside, marked = distance <= 1.96 * columns["sigma"], columns["observed"] == 1
    judged["marked_3"] = float((columns["observed"] == 3).mean())
    judged["marked_covered"] = float(inside[marked].mean()) if marked.any() else None
    judged["rest_covered"] = float(inside[~marked].mean()) if (~marked).any() else None
    keys = ["iterations", "termination", "smoothness_weight"]
    return {
        **row,
        **judged,
        **{key: report[key] for key in keys},
        "sigma_factor": report["points"]["sigma_factor"],
        "outliers": report["points"]["outliers"],
        "unresolved": report["lack_of_fit"] / chosen.sigma,
        "findings": [finding["code"] for finding in report.get("findings", [])],
    }


def write_landmarks(path, chosen, case):
    """Writes places of the mesh with their true positions, with an error of five σ of a point along each axis."""
    places = spread_vertices(case.rest, chosen.landmarks)
    sigma = 5 * chosen.sigma
    errors = np.random.default_rng(chosen.seed).normal(0, sigma, (len(places), 3))
    measured = case.truth.vertices[places] + errors
    if case.data == "gross":
        # Two landmarks are confused with each other.
        measured[:2] = measured[1::-1]
    with open(path, "w") as file:
        file.write("vertex,x,y,z,sigma\n")
        for vertex, at in zip(places, measured):
            file.write(",".join(map(str, [vertex, *at, sigma])) + "\n")


def spread_vertices(vertices, count):
    """Farthest vertices from each other, one after the other."""
    found = [0]
    far = np.linalg.norm(vertices - vertices[0], axis=1)
    while len(found) < min(count, len(vertices)):
        found.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(vertices - vertices[found[-1]], axis=1))
    return np.array(found)


def as_rigid_as_possible(case, solve):
    """Rounds of a deformation whose handles move along their normals to the points."""
    handles, tree = spread_vertices(case.rest, HANDLES), cKDTree(case.points)
    found = case.rest
    for _ in range(ROUNDS):
        here, normals = found[handles], vertex_normals(found, case.triangles)[handles]
        # Farther points belong to other parts. Medians reject outliers.
        distance, near = tree.query(here, NEAREST, distance_upper_bound=0.1 * scanning.SIZE)
        heights = np.einsum("nki,ni->nk", case.points[np.minimum(near, len(case.points) - 1)], normals)
        heights -= np.einsum("ni,ni->n", here, normals)[:, None]
        heights[~np.isfinite(distance)] = np.nan
        kept = np.isfinite(heights).any(axis=1)
        steps = np.nanmedian(heights[kept], axis=1)[:, None] * normals[kept]
        found = solve(handles[kept], here[kept] + steps, found)
    return found


def by_open3d(case):
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(case.rest), o3d.utility.Vector3iVector(case.triangles)
    )

    def solve(handles, places, _):
        made = mesh.deform_as_rigid_as_possible(
            o3d.utility.IntVector(handles.astype(np.int32)), o3d.utility.Vector3dVector(places), max_iter=10
        )
        return np.asarray(made.vertices)

    return as_rigid_as_possible(case, solve)


def by_libigl(case):
    import igl

    rest, faces = np.asarray(case.rest, dtype=float), case.triangles.astype(np.int64)

    def solve(handles, places, found):
        data = igl.ARAPData()
        igl.arap_precomputation(rest, faces, 3, handles.astype(np.int32), data)
        return igl.arap_solve(np.ascontiguousarray(places), data, np.ascontiguousarray(found))

    return as_rigid_as_possible(case, solve)


def by_trimesh(case):
    mesh = trimesh.Trimesh(case.rest, case.triangles, process=False)
    return np.asarray(trimesh.registration.nricp_amberg(mesh, case.points, use_faces=False))


def peer(name, case):
    start = time.perf_counter()
    try:
        found = {"trimesh": by_trimesh, "open3d": by_open3d, "libigl": by_libigl}[name](case)
    except Exception as problem:  # What a peer raises is its refusal.
        return {"seconds": time.perf_counter() - start, "refusal": repr(problem)}
    seconds = time.perf_counter() - start
    if len(found) != len(case.rest) or not np.isfinite(found).all():
        return {"seconds": seconds, "refusal": "vertices are missing or not finite"}
    return {"seconds": seconds, **case.judged(found)[0]}


def figure(value, digits=2, factor=1):
    return "–" if value is None else f"{value * factor:.{digits}f}"


def printed(row):
    """A row of the table."""
    name = f"| {row['object']}, {row['motion']}, {row['data']} | {row['program']} |"
    if "refusal" in row:
        return f"{name} refused: {row['refusal'][:60]} |{' |' * 5} {row['seconds']:.1f} |"
    pairs = []
    shown = [("distance", 2, 1), ("slide", 2, 1), ("covered", 1, 100), ("observed", 0, 100)]
    for key, digits, factor in shown:
        values = [row.get(f"{part}_{key}") for part in ("seen", "unseen")]
        pairs.append(" / ".join(figure(value, digits, factor) for value in values if value is not None))
    quality = f"{figure(row.get('sigma_factor'))}; {figure(row.get('unresolved'))}"
    return f"{name} {' | '.join(pairs)} | {row['folds']} | {quality} | {row['seconds']:.1f} |"


def summary(rows):
    """Medians and worst cases of every program and kind of data."""
    columns = ["data", "program", "cases", "distance: median, maximum", "slide", "unseen: distance, slide"]
    columns += ["95 %: mean, minimum", "unseen 95 %: mean, minimum", "unseen observed"]
    columns += ["folds: cases, triangles", "s: median"]
    print("\n| " + " | ".join(columns) + " |")
    print("|" + "---|" * 11)
    for data in dict.fromkeys(row["data"] for row in rows):
        for program in dict.fromkeys(row["program"] for row in rows):
            chosen = [r for r in rows if (r["data"], r["program"]) == (data, program)]
            chosen = [r for r in chosen if "refusal" not in r]
            if not chosen:
                continue

            def values(key):
                return np.array([r[key] for r in chosen if r.get(key) is not None])

            def pair(key, first, second, factor=1, digits=2):
                found = values(key) * factor
                return f"{first(found):.{digits}f}, {second(found):.{digits}f}" if len(found) else "–"

            distance, slide = values("unseen_distance"), values("unseen_slide")
            unseen = f"{np.median(distance):.1f}, {np.median(slide):.2f}" if len(distance) else "–"
            observed = values("unseen_observed")
            folds = values("folds")
            print(
                f"| {data} | {program} | {len(chosen)} | {pair('seen_distance', np.median, np.max)} "
                f"| {pair('seen_slide', np.median, np.max)} | {unseen} "
                f"| {pair('seen_covered', np.mean, np.min, 100, 1)} "
                f"| {pair('unseen_covered', np.mean, np.min, 100, 1)} "
                f"| {f'{observed.mean():.2f}' if len(observed) else '–'} "
                f"| {(folds > 0).sum()}, {folds.sum()} | {np.median(values('seconds')):.1f} |"
            )


def options():
    found = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    found.add_argument("--meshes", default=os.path.join(ROOT, os.pardir, "shared", "data", "meshes"))
    found.add_argument("--objects", default=",".join(OBJECTS), help=f"of {', '.join(OBJECTS)}")
    found.add_argument("--motions", default=",".join(MOTIONS), help=f"of {', '.join(MOTIONS)}")
    found.add_argument("--data", default=",".join(DATA), help=f"of {', '.join(DATA)}")
    found.add_argument("--peers", default=",".join(PEERS), help="empty for none")
    found.add_argument("--seed", type=int, default=0)
    found.add_argument("--triangles", type=int, default=5000)
    found.add_argument("--points", type=int, default=6000, help="half of them for `front` (default: 6000)")
    found.add_argument("--sigma", type=float, default=0.1, help="in mm, of objects of 100 mm (default: 0.1)")
    found.add_argument("--landmarks", type=int, default=0, help="number of landmarks for Planish (default: 0)")
    found.add_argument("--out", default="deformation.jsonl", help="file for all figures")
    found.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen, chosen.more = found.parse_known_args()
    for key, known in (("objects", OBJECTS), ("motions", MOTIONS), ("data", DATA), ("peers", PEERS)):
        names = [name for name in getattr(chosen, key).split(",") if name]
        unknown = [name for name in names if name not in known]
        if unknown:
            found.error(f"unknown {key}: {', '.join(unknown)}; known are {', '.join(known)}")
        setattr(chosen, key, names)
    absent = [name for name in chosen.peers if importlib.util.find_spec(PEERS[name]) is None]
    for name in absent:
        print(f"{name} is left out: its package is not installed", file=sys.stderr)
    chosen.peers = [name for name in chosen.peers if name not in absent]
    if not os.path.exists(chosen.program):
        raise SystemExit(f"missing: {chosen.program}; run `cargo build --release` or use --program")
    return chosen


def main():
    chosen = options()
    version = subprocess.run([chosen.program, "--version"], capture_output=True, text=True).stdout.strip()
    print(platform.machine(), os.cpu_count(), "cores;", version)
    settings = ["seed", "triangles", "points", "sigma"]
    print("; ".join(f"{key} {getattr(chosen, key)}" for key in settings), end="")
    print(f"; load {os.getloadavg()[0]:.1f}\n\n| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    rows = []
    with open(chosen.out, "w") as file, tempfile.TemporaryDirectory() as folder:
        for name in chosen.objects:
            rest, triangles = load(os.path.join(chosen.meshes, OBJECTS[name]), chosen.triangles)
            for motion in chosen.motions:
                for data in chosen.data:
                    known = {"object": name, "motion": motion, "data": data}
                    seed = [chosen.seed, zlib.crc32(" ".join(known.values()).encode())]
                    case = Case(rest, triangles, motion, data, chosen, np.random.default_rng(seed))
                    for program in ["planish", *chosen.peers]:
                        ours = program == "planish"
                        row = planish(chosen, case, folder) if ours else peer(program, case)
                        row = {**known, "seed": chosen.seed, "program": program, **row}
                        rows.append(row)
                        print(printed(row), flush=True)
                        print(json.dumps(row), file=file, flush=True)
    summary(rows)


if __name__ == "__main__":
    main()
