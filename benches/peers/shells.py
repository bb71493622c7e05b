"""Compares shells with peers: natural-neighbour weights (natinterp3d) and distances to a mesh (Open3D).

    pip install natinterp3d open3d numpy
    python3 benches/peers/shells.py
    python3 benches/peers/shells.py FOLDER

The tasks are those of `cargo bench -p planish-shell --bench shell`, which runs first: 50 000 points under 200 controls,
and 200 000 points near a ball of 20 480 facets. Missing peers are skipped. Open3D computes a distance without sign and
gradient. natinterp3d has no bounding box of additional controls, so points outside the hull of the controls are counted
separately.

With a folder, the script prints the table of deformations instead (`cargo run --example deformations` writes the ball,
the points and the truth there), and runs Open3D's as-rigid-as-possible deformation on the same task.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

THREADS = os.cpu_count()


def clocked(what, work):
    wall, used = time.perf_counter(), time.process_time()
    result = work()
    wall, used = time.perf_counter() - wall, time.process_time() - used
    print(f"{what}: {wall:.3f} s, {used:.3f} s of processor time; load {os.getloadavg()[0]:.1f}")
    return result


def icosphere(levels):
    t = (1 + 5**0.5) / 2
    points = [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)]
    points = [np.array(p) / np.linalg.norm(p) for p in points]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
             (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]  # fmt: skip
    for _ in range(levels):
        middles, finer = {}, []

        def middle(a, b):
            key = (min(a, b), max(a, b))
            if key not in middles:
                p = points[a] + points[b]
                points.append(p / np.linalg.norm(p))
                middles[key] = len(points) - 1
            return middles[key]

        for a, b, c in faces:
            d, e, f = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, d, f), (d, b, e), (f, e, c), (d, e, f)]
        faces = finer
    return np.array(points), np.array(faces, dtype=np.uint32)


def weights():
    try:
        import natinterp3d
    except ImportError:
        print("natinterp3d is not installed")
        return
    random = np.random.default_rng(1)
    controls, places = random.uniform(-1, 1, (200, 3)), random.uniform(-1, 1, (50_000, 3))
    found = clocked("natinterp3d: weights of 50 000 points under 200 controls", lambda: natinterp3d.get_weights(places, controls, parallel=True))
    off = np.linalg.norm(np.asarray(found @ controls) - places, axis=1)
    print(f"  error of the weighted mean of controls above 1e-6: {np.mean(off > 1e-6):.1%} of the points (outside the hull), their median {np.median(off[off > 1e-6]):.2g}")


def distances():
    try:
        import open3d
    except ImportError:
        print("open3d is not installed")
        return
    points, faces = icosphere(5)
    scene = open3d.t.geometry.RaycastingScene(THREADS)
    scene.add_triangles(open3d.core.Tensor(points.astype(np.float32)), open3d.core.Tensor(faces))
    random = np.random.default_rng(1)
    places = random.uniform(-1, 1, (200_000, 3))
    places *= (random.uniform(0.99, 1.01, 200_000) / np.linalg.norm(places, axis=1))[:, None]
    query = open3d.core.Tensor(places.astype(np.float32))
    clocked(f"Open3D: distances of 200 000 points from {len(faces)} facets", lambda: scene.compute_distance(query).numpy())
    clocked("Open3D: the same with sign", lambda: scene.compute_signed_distance(query).numpy())


def arap(folder, rounds=15, handles=60):
    """Deforms the ball of `--example deformations` by Open3D's as-rigid-as-possible deformation.

    In every round, each handle moves to the median of the points nearest to it.
    """
    try:
        import open3d
    except ImportError:
        print("open3d is not installed")
        return

    def tree_of(places):
        return open3d.geometry.KDTreeFlann(np.ascontiguousarray(places.T))

    mesh = open3d.io.read_triangle_mesh(str(folder / "ball.obj"))
    points, truth = np.loadtxt(folder / "points.csv", delimiter=",", skiprows=1), np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    sigma, gate = points[0, 3], 0.1 * np.linalg.norm(np.ptp(points[:, :3], axis=0))
    at = np.asarray(mesh.vertices)
    chosen = [0]
    far = np.linalg.norm(at - at[0], axis=1)
    while len(chosen) < handles:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(at - at[chosen[-1]], axis=1))
    tree = tree_of(points[:, :3])

    def fit():
        moved = mesh
        for _ in range(rounds):
            here = np.asarray(moved.vertices)
            moved.compute_vertex_normals()
            normals = np.asarray(moved.vertex_normals)[chosen]
            # Along the normal only, because points do not determine a position along the surface. Medians reject
            # outliers.
            steps = []
            for handle, n in zip(here[chosen], normals):
                _, which, squares = tree.search_knn_vector_3d(handle, 30)
                which = np.asarray(which)[np.asarray(squares) < gate**2]
                steps.append(np.median((points[which, :3] - handle) @ n) * n if len(which) else np.zeros(3))
            wanted = open3d.utility.Vector3dVector(here[chosen] + np.array(steps))
            moved = mesh.deform_as_rigid_as_possible(open3d.utility.IntVector(chosen), wanted, max_iter=30)
        return np.asarray(moved.vertices)

    found = clocked(f"Open3D: as rigid as possible, {handles} handles, {rounds} rounds", fit)
    # Distances from the true surface by its dense samples and their normals.
    near_truth = tree_of(truth[:, :3])
    near = [near_truth.search_knn_vector_3d(p, 1)[1][0] for p in found]
    off = ((found - truth[near, :3]) * truth[near, 3:6]).sum(axis=1)
    print(f"  rms distance of {len(found)} vertices from the true surface: {np.sqrt((off**2).mean()) / sigma:.2f} σ")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        for name in ("Dirichlet", "modes", "lattice", "vertices"):
            command = ["cargo", "run", "-q", "--release", "-p", "planish-shell", "--example", "deformations", "--", folder.resolve(), name]
            subprocess.run(command, cwd=Path(__file__).resolve().parents[2], check=True)
        arap(folder)
        sys.exit()
    root = Path(__file__).resolve().parents[2]
    print(f"{THREADS} processors, load {os.getloadavg()[0]:.1f}")
    subprocess.run(["cargo", "bench", "-q", "-p", "planish-shell", "--bench", "shell"], cwd=root, check=True)
    weights()
    distances()
