"""Reconstructs the hyperboloid and the carafe of R. Mohr, C. Zhao and G. Koscielny (1994) from occluding contours.

Contours of two camera motions give patches, which are merged into one surface. Writes docs/images/contours-*.png
and prints the table of docs/occluding-contours.md. The first argument is the path of the command; names of shapes
may follow. Needs numpy, scipy and matplotlib.

    python benches/peers/contours.py target/release/planish
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy.spatial import cKDTree

PLANISH = str(pathlib.Path(sys.argv[1]).resolve())
ROOT = pathlib.Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
KINDS = {"double": "<f8", "float64": "<f8", "float": "<f4", "float32": "<f4", "uchar": "u1", "uint8": "u1", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4"}
# Elevation and azimuth of the pictures, in degrees.
LOOK = {"hyperboloid": (18, -60), "carafe": (18, -60)}


def run(*args):
    done = subprocess.run([PLANISH, *map(str, args), "--json"], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"planish {' '.join(map(str, args))}: {done.stderr}")
    return json.loads(done.stdout)


def read(path):
    """Positions, triangles and all vertex columns of a binary PLY file."""
    data = pathlib.Path(path).read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    columns, counts, at = [], {}, None
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[0] == "element":
            at = words[1]
            counts[at] = int(words[2])
        elif words[0] == "property" and at == "vertex":
            columns.append((words[2], KINDS[words[1]]))
    kind = np.dtype(columns)
    vertices = np.frombuffer(data, kind, counts["vertex"], end)
    faces = np.zeros((0, 3), int)
    if counts.get("face"):
        row = np.dtype([("n", "u1"), ("v", "<i4", 3)])
        faces = np.frombuffer(data, row, counts["face"], end + kind.itemsize * counts["vertex"])["v"]
    return np.stack([vertices["x"], vertices["y"], vertices["z"]], 1), faces, vertices


def profile(shape, z):
    if shape == "hyperboloid":
        r = 30 * np.sqrt(1 + (z / 40) ** 2)
        return r, 900 * z / 1600 / r
    belly, lip = 24 * np.exp(-(((z + 20) / 24) ** 2)), 8 * np.exp((z - 50) / 10)
    return 12 + belly + lip, -2 * (z + 20) / 576 * belly + lip / 10


def deviations(shape, points):
    """Distances along the normal, to first order."""
    r, slope = profile(shape, points[:, 2])
    return (np.hypot(points[:, 0], points[:, 1]) - r) / np.hypot(slope, 1)


def judged(shape, path):
    points, faces, vertices = read(path)
    used = np.unique(faces)
    off = deviations(shape, points[used])
    middles = deviations(shape, points[faces].mean(1))
    sigma = vertices["sigma"][used]
    return {
        "vertices": len(used),
        "rms": np.sqrt(np.mean(off**2)),
        "rms_facets": np.sqrt(np.mean(middles**2)),
        "largest": np.abs(off).max(),
        "sigma": np.median(sigma),
        "over_sigma": np.sqrt(np.mean((off / sigma) ** 2)),
    }


def draw(axis, meshes, look, title):
    colours = ["#4c78a8", "#f58518", "#54a24b", "#b279a2"]
    elevation, azimuth = np.radians(look)
    eye = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    for (points, faces), colour in zip(meshes, colours):
        corners = points[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
        light = 0.35 + 0.65 * np.abs(normals @ (eye + [0.3, 0, 0.4]) / 1.2).clip(0, 1)
        base = np.array(matplotlib.colors.to_rgb(colour))
        axis.add_collection3d(Poly3DCollection(corners, facecolors=np.clip(light[:, None] * base, 0, 1), edgecolors=(0, 0, 0, 0.25), linewidths=0.12))
    axis.set_xlim(-45, 45), axis.set_ylim(-45, 45), axis.set_zlim(-50, 50)
    axis.set_box_aspect((9, 9, 10))
    axis.view_init(*look)
    axis.set_axis_off()
    axis.set_title(title, fontsize=9)


def without_shared(meshes, reach):
    """The parts of each patch that no other patch covers, as in figure 8 of the paper."""
    left = []
    for k, (points, faces) in enumerate(meshes):
        others = np.concatenate([p for j, (p, _) in enumerate(meshes) if j != k])
        middles = points[faces].mean(1)
        near = cKDTree(others).query(middles)[0] < reach
        left.append((points, faces[~near]))
    return left


def show(shape, folder):
    run("simulate", "scene", "contours", "--shape", shape, "--out", folder)
    sensed = [run("sense", "contours", folder / f"motion-{m}.toml", "-o", folder / f"points-{m}.ply", "--patch", folder / f"patch-{m}.ply") for m in (1, 2)]
    patches = [pathlib.Path(f["file"]) for s in sensed for p in s["patches"] for f in p["files"]]
    rows = [(p.stem, judged(shape, p)) for p in patches]
    merged = {}
    for method in ("refit", "information"):
        out = folder / f"whole-{method}.ply"
        merged[method] = run("merge", *patches, "--method", method, "--epsilon", "0.5", "--fill", "12", "-o", out)
        rows.append((f"merged, {method}", judged(shape, out)))
    print(f"\n{shape}: {[s['observations'] for s in sensed]} points, rejected {[s['left_out'] for s in sensed]}")
    print("| | vertices | rms / mm | rms of facet centres / mm | largest / mm | median σ / mm | rms over σ |\n|---|---|---|---|---|---|---|")
    for name, j in rows:
        print(f"| {name} | {j['vertices']} | {j['rms']:.4f} | {j['rms_facets']:.4f} | {j['largest']:.3f} | {j['sigma']:.4f} | {j['over_sigma']:.2f} |")
    for method, m in merged.items():
        print(method, {k: m[k] for k in ("parts", "boundary_edges", "nonmanifold_edges", "watertight", "holes_closed", "filled")}, "valence of seams", m["valence"])
    meshes = [read(p)[:2] for p in patches]
    figure = plt.figure(figsize=(13, 7))
    panels = [(meshes[:2], "patches of the first motion"), (meshes[2:], "patches of the second motion"), (meshes, "superposed"), (without_shared(meshes, 1.2), "without common regions")]
    panels += [([read(folder / f"whole-{m}.ply")[:2]], f"merged, --method {m}") for m in merged]
    for k, (drawn, title) in enumerate(panels):
        draw(figure.add_subplot(2, 4, k + 1, projection="3d"), drawn, LOOK[shape], title)
    axis = figure.add_subplot(2, 4, 7)
    valence = merged["information"]["valence"]
    axis.bar(range(len(valence)), valence, color="#4c78a8")
    axis.set_title("valence at seams (information)", fontsize=9)
    axis = figure.add_subplot(2, 4, 8)
    points, faces, _ = read(folder / "whole-information.ply")
    axis.hist(1000 * deviations(shape, points[np.unique(faces)]).clip(-0.15, 0.15), 60, color="#4c78a8")
    axis.set_title("deviations of the whole / µm", fontsize=9)
    figure.suptitle(f"{shape}: occluding contours of two motions, 41 views each, σ = 0.2 px", fontsize=11)
    figure.tight_layout()
    figure.savefig(IMAGES / f"contours-{shape}.png", dpi=110)


IMAGES.mkdir(exist_ok=True)
with tempfile.TemporaryDirectory() as scratch:
    for shape in sys.argv[2:] or ("hyperboloid", "carafe"):
        show(shape, pathlib.Path(scratch) / shape)
