"""Reconstructs neck and shoulders of a simulated person from stereo points, and from stereo points and outlines.

    python3 experiment.py PLANISH person.obj FOLDER [--same-controls]

This follows figure 4 of S. Ilic and P. Fua, *From explicit to implicit surfaces for visualization, animation and
modeling*, with a simulated person instead of a video. Input: the command, and the person made by make.py. Output in
FOLDER: the ground truth (the person deformed by a pose file), points of stereo pairs, views.toml with masks, both fits,
a table, and overlays.png.

Stereo points are visible to two neighbouring cameras. Their σ along the line of sight is SIGMA / cos² of the angle of
incidence, a tenth of this across, and stated correctly. Surfaces beyond 70° are not matched, and one point of twenty is
an outlier.

The truth is posed by 120 control points, and 40 others are fitted. With --same-controls, the truth is posed by 40
control points, and the same are fitted. The remaining error is then not unresolved shape of the controls. Needs numpy,
scipy and matplotlib.
"""

import json
import subprocess
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial import cKDTree

# σ of stereo points that are seen at a right angle, in the unit of the mesh.
SIGMA = 0.15
POINTS = 4000
SIZE = (480, 480)
FOCAL = 900.0
DISTANCE = 110.0
DEGREES = [-50, -30, -10, 10, 30, 50]
MAX_INCIDENCE_DEGREES = 70.0

TRUTH = """controls = %d
blend = 6.8
[[rigid]]
part = "head"
motion = "follow"
[[pose]]
name = "truth"
move = [
  { near = [-18, -27, -3], within = 16, by = [2.0, 1.5, 0.5] },
  { near = [-20, -30, -3], within = 12, by = [1.5, 1.0, 0] },
  { near = [18, -27, -3], within = 16, by = [1.0, -2.0, 1.0] },
  { near = [22, -32, -3], within = 12, by = [1.5, -1.5, 0] },
  { near = [0, -35, 8], within = 14, by = [0, 0, 2.5] },
  { near = [0, -20, 0], within = 7, by = [1.2, 0, 0.8] },
  { near = [0, 0, 0], within = 16, by = [0.8, 0.4, 1.0] },
]
"""


def read_obj(path):
    points, faces, group, groups = [], [], "", []
    for line in open(path):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            points.append([float(x) for x in words[1:4]])
        elif words[0] == "g":
            group = words[1]
        elif words[0] == "f":
            face = [int(word.split("/")[0]) - 1 for word in words[1:]]
            for k in range(1, len(face) - 1):
                faces.append([face[0], face[k], face[k + 1]])
                groups.append(group)
    return np.array(points), np.array(faces), np.array(groups)


def read_ply(path):
    """Vertex columns of a binary PLY file with float64, float32 and bytes."""
    data = open(path, "rb").read()
    end = data.index(b"end_header\n") + 11
    kinds, count = [], 0
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[:2] == ["element", "vertex"]:
            count = int(words[2])
        elif words[0] == "property" and words[1] != "list":
            kinds.append((words[2], {"double": "<f8", "float": "<f4", "uchar": "u1"}[words[1]]))
    return np.frombuffer(data, dtype=kinds, count=count, offset=end)


def cameras(middle):
    for degrees in DEGREES:
        a = np.radians(degrees)
        forward = -np.array([np.sin(a), 0.12, np.cos(a)])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 1, 0])
        right /= np.linalg.norm(right)
        r = np.stack([right, np.cross(forward, right), forward])
        yield np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]]), r, -r @ (middle - DISTANCE * forward)


def depths(points, faces, camera):
    """Depth and index of the nearest triangle in each pixel."""
    k, r, t = camera
    inside = points @ r.T + t
    seen = inside @ k.T
    at, z = seen[:, :2] / seen[:, 2:], inside[:, 2]
    depth, which = np.full(SIZE[::-1], np.inf), np.full(SIZE[::-1], -1)
    for number, face in enumerate(faces):
        a, b, c = at[face]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        low = np.maximum(np.ceil(np.minimum(np.minimum(a, b), c)), 0).astype(int)
        high = np.minimum(np.floor(np.maximum(np.maximum(a, b), c)), np.array(SIZE) - 1).astype(int)
        if area == 0 or (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        second = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
        near = (1 - second - third) / z[face[0]] + second / z[face[1]] + third / z[face[2]]
        ok = (second >= 0) & (third >= 0) & (second + third <= 1)
        x, y, own = x[ok], y[ok], 1 / near[ok]
        better = own < depth[y, x]
        depth[y[better], x[better]] = own[better]
        which[y[better], x[better]] = number
    return depth, which


def normals_of(points, faces):
    n = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    return n / (np.linalg.norm(n, axis=1)[:, None] + 1e-30)


def sees(place, depth, camera):
    """For each point, whether a camera sees it. Depths are rounded to pixels, hence the tolerance."""
    k, r, t = camera
    inside = place @ r.T + t
    pixel = inside @ k.T
    column, row = (np.round(pixel[:, :2] / pixel[:, 2:]).astype(int)).T
    ok = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
    found = np.full(len(place), np.inf)
    found[ok] = depth[row[ok], column[ok]]
    return ok & (inside[:, 2] < found + 0.5)


def from_triangles(p, a, b, c):
    """Distance of each point from the triangle with the same index."""
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1)[:, None] + 1e-30
    height = ((p - a) * n).sum(axis=1)
    beside, edges = np.zeros(len(p), bool), np.full(len(p), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        share = np.clip(((p - start) * side).sum(axis=1) / ((side**2).sum(axis=1) + 1e-30), 0, 1)
        edges = np.minimum(edges, np.linalg.norm(p - start - share[:, None] * side, axis=1))
        beside |= (np.cross(side, p - start) * n).sum(axis=1) < 0
    return np.where(beside, edges, np.abs(height))


def sampled(points, faces, count, random):
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = random.choice(len(faces), count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen], chosen


def simulate(planish, person, folder, controls):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "truth.toml").write_text(TRUTH % controls if controls > 100 else (TRUTH % controls).replace(", within = 7", ""))
    posed = [planish, "shell", "pose", person, "--poses", folder / "truth.toml", "-o", folder / "truth.obj", "--json"]
    places = json.loads(subprocess.run(posed, check=True, capture_output=True, text=True).stdout)["control_points"]
    (folder / "controls.csv").write_text("x,y,z\n" + "".join("%r,%r,%r\n" % tuple(p) for p in places))
    points, faces, _ = read_obj(folder / "truth.obj")
    random = np.random.default_rng(4)
    middle = np.array([0.0, -10.0, 0.0])
    views, text = list(cameras(middle)), "mask_threshold = 127\nsigma_px = 0.5\n"
    drawn = []
    for number, (k, r, t) in enumerate(views):
        depth, _ = depths(points, faces, (k, r, t))
        drawn.append(depth)
        plt.imsave(folder / f"mask{number}.png", np.isfinite(depth).astype(float), cmap="gray")
        rows = lambda m: "[" + ", ".join("[%r, %r, %r]" % tuple(map(float, row)) for row in m) + "]"
        text += f'\n[[view]]\nmask = "mask{number}.png"\nK = {rows(k)}\nR = {rows(r)}\nt = [%r, %r, %r]\n' % tuple(map(float, t))
    (folder / "views.toml").write_text(text)
    place, of = sampled(points, faces, 60 * POINTS, random)
    normal = normals_of(points, faces)[of]
    lines = []
    for pair in range(len(views) - 1):
        two = [views[pair], views[pair + 1]]
        eye = -0.5 * sum(r.T @ t for _, r, t in two)
        toward = eye - place
        toward /= np.linalg.norm(toward, axis=1)[:, None]
        cosine = (toward * normal).sum(axis=1)
        ok = cosine > np.cos(np.radians(MAX_INCIDENCE_DEGREES))
        for k, camera in enumerate(two):
            ok &= sees(place, drawn[pair + k], camera)
        # Stereo points have uniform density in the image, so the density on the surface follows the cosine.
        ok &= random.random(len(place)) < cosine
        for k in random.choice(np.flatnonzero(ok), POINTS // (len(views) - 1), replace=False):
            u = toward[k]
            deep = SIGMA / cosine[k] ** 2
            across = 0.1 * deep
            covariance = across**2 * np.eye(3) + (deep**2 - across**2) * np.outer(u, u)
            p = place[k] + across * random.normal(size=3) + np.sqrt(deep**2 - across**2) * random.normal() * u
            if random.random() < 0.05:
                p = place[k] + random.uniform(-8, 8) * u
            lines.append(",".join("%.6g" % x for x in [*p, *covariance[np.triu_indices(3)]]))
    (folder / "stereo.csv").write_text("x,y,z,cxx,cxy,cxz,cyy,cyz,czz\n" + "\n".join(lines) + "\n")


def fits(planish, person, folder, same):
    for name, more in (("points", []), ("both", ["--silhouettes", folder / "views.toml"])):
        arguments = [planish, "shell", "fit", person, "--points", folder / "stereo.csv", "--rigid", "head", "--blend", "6.8"]
        arguments += ["--controls-file", folder / "controls.csv"] if same else ["--controls", "40"]
        arguments += ["--outline-step", "8", "-o", folder / f"{name}.ply", "-o", folder / f"{name}.obj", "--json", *more]
        done = subprocess.run(arguments, check=True, capture_output=True, text=True)
        (folder / f"{name}.json").write_text(done.stdout)
        report = json.loads(done.stdout)
        print(name, "took %.1f s," % report["seconds"], {key: report.get(key) for key in ("lack_of_fit", "points", "outlines", "sigma")})


def table(person, folder):
    points, faces, _ = read_obj(folder / "truth.obj")
    start, _, groups = read_obj(person)
    random = np.random.default_rng(5)
    views = list(cameras(np.array([0.0, -10.0, 0.0])))
    drawn = [depths(points, faces, view)[0] for view in views]
    dense, of = sampled(points, faces, 600_000, random)
    normal = normals_of(points, faces)
    tree = cKDTree(dense)
    # Largest cosine of incidence among the cameras that see a vertex.
    own = np.zeros_like(points)
    for k in range(3):
        np.add.at(own, faces[:, k], normal)
    own /= np.linalg.norm(own, axis=1)[:, None] + 1e-30
    max_cosine = np.full(len(points), -1.0)
    for view, depth in zip(views, drawn):
        toward = -view[1].T @ view[2] - points
        toward /= np.linalg.norm(toward, axis=1)[:, None]
        cosine = np.where(sees(points, depth, view), (toward * own).sum(axis=1), -1.0)
        max_cosine = np.maximum(max_cosine, cosine)
    head = np.zeros(len(points), bool)
    head[faces[groups == "head"]] = True
    in_view = points[:, 1] > -33
    body = ~head & in_view
    regions = [
        ("head (rigid)", head & (max_cosine > 0.34)),
        ("neck and shoulders, seen within 45°", body & (max_cosine >= 0.71)),
        ("the same, 45° to 70°", body & (max_cosine >= 0.34) & (max_cosine < 0.71)),
        ("the same, beyond 70° or not seen", body & (max_cosine < 0.34)),
    ]
    print("\n| where on the truth | vertices | start | points alone | covered | points and outlines | covered |\n|---|---|---|---|---|---|---|")
    found = {name: read_ply(folder / f"{name}.ply") for name in ("points", "both")}

    def off(p):
        """Distances from the triangles of the nearest samples."""
        nearest = np.full(len(p), np.inf)
        for near in tree.query(p, k=8)[1].T:
            nearest = np.minimum(nearest, from_triangles(p, *(points[faces[of[near], k]] for k in range(3))))
        return nearest

    for name, where in regions:
        cells = [name, str(where.sum()), "%.3f" % np.sqrt((off(start[where]) ** 2).mean())]
        for columns in found.values():
            p = np.stack([columns["x"], columns["y"], columns["z"]], axis=1)[where]
            miss = off(p)
            cells += ["%.3f" % np.sqrt((miss**2).mean()), "%.3f" % (np.abs(miss) < 1.96 * columns["sigma"][where]).mean()]
        print("| " + " | ".join(cells) + " |")
    figure, axes = plt.subplots(2, len(views), figsize=(2.6 * len(views), 5.6))
    for row, name in enumerate(found):
        columns = found[name]
        p = np.stack([columns["x"], columns["y"], columns["z"]], axis=1)
        iou = []
        for k, view in enumerate(views):
            mask, own = np.isfinite(drawn[k]), np.isfinite(depths(p, faces, view)[0])
            iou.append((mask & own).sum() / (mask | own).sum())
            picture = np.ones((*mask.shape, 3))
            picture[mask & own] = [0.75, 0.75, 0.75]
            picture[mask & ~own] = [0.85, 0.1, 0.1]
            picture[own & ~mask] = [0.1, 0.2, 0.85]
            axes[row, k].imshow(picture)
            axes[row, k].set_title("%d°: IoU %.3f" % (DEGREES[k], iou[-1]), fontsize=8)
            axes[row, k].set_xticks([])
            axes[row, k].set_yticks([])
        axes[row, 0].set_ylabel({"points": "points alone", "both": "points and outlines"}[name])
        print(name, "IoU", " ".join("%.3f" % x for x in iou))
    plt.tight_layout()
    plt.savefig(folder / "overlays.png", dpi=70)


if __name__ == "__main__":
    planish, person, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    same = "--same-controls" in sys.argv[4:]
    simulate(planish, person, folder, 40 if same else 120)
    fits(planish, person, folder, same)
    table(person, folder)
