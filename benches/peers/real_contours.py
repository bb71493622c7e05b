"""Writes the data sets templeSparseRing and vgg_dinosaur as views.toml for `planish sense contours`.

Some views are held out. Of two views from the same position, only one is used.

    python benches/peers/real_contours.py FOLDER_OF_TURNTABLES OUT
"""

import pathlib
import sys

import numpy as np

DATA, OUT = (pathlib.Path(word).resolve() for word in sys.argv[1:3])


def rows(matrix):
    return "[" + ", ".join("[" + ", ".join(repr(float(x)) for x in row) + "]" for row in matrix) + "]"


def write(name, views, held, head):
    with open(OUT / name, "w") as file:
        file.write(head)
        for k, (view, mask, camera) in enumerate(views):
            held_out = "held_out = true\n" if k in held else ""
            file.write(f'\n[[view]]\nname = "{view}"\nmask = "{mask}"\n{held_out}{camera}\n')


def temple():
    folder = DATA / "templeSparseRing"
    cameras = []
    for line in (folder / "templeSR_par.txt").read_text().splitlines()[1:]:
        name, *numbers = line.split()
        v = np.array(numbers, float)
        k, r, t = v[:9].reshape(3, 3), v[9:18].reshape(3, 3), v[18:]
        cameras.append((name, k, r, t, -r.T @ t))
    centres = np.array([c[4] for c in cameras])
    flat = centres - centres.mean(0)
    axes = np.linalg.svd(flat)[2]
    views, seen = [], []
    for i in np.argsort(np.arctan2(flat @ axes[1], flat @ axes[0])):
        name, k, r, t, centre = cameras[i]
        if all(np.linalg.norm(centre - other) > 1e-3 for other in seen):
            seen.append(centre)
            views.append((name[:-4], folder / name, f"K = {rows(k)}\nR = {rows(r)}\nt = {[float(x) for x in t]}"))
    held = {k for k, v in enumerate(views) if v[0] in ("templeSR0006", "templeSR0014")}
    write("temple.toml", views, held, 'unit = "m"\nmask_threshold = 40\n')


def dinosaur():
    folder = DATA / "vgg_dinosaur"
    views = []
    for row in np.loadtxt(folder / "P_matrices.txt"):
        k = int(row[0])
        views.append((f"v{k:02d}", folder / f"mask_{k:03d}.png", f"P = {rows(row[1:].reshape(3, 4))}"))
    write("dinosaur.toml", views, set(range(4, 36, 9)), 'unit = "m"\n')


OUT.mkdir(parents=True, exist_ok=True)
temple()
dinosaur()
