#!/usr/bin/env python3
"""Writes an ellipsoid around the visual hull of the masks in a views.toml, as the start of a fit to silhouettes.

    python3 -m venv venv && venv/bin/pip install numpy pillow
    venv/bin/python benches/peers/real_contours.py TURNTABLES OUT
    venv/bin/python benches/peers/ellipsoid.py OUT/dinosaur.toml ball.obj [levels]
    target/release/planish shell fit ball.obj --silhouettes OUT/dinosaur.toml --controls 200 -o fitted.ply

Held-out views are not used. Space is divided into cells, and those that project into every mask are kept. The
ellipsoid has the mean and the principal axes of these cells, with semi-axes of two standard deviations.
"""

import pathlib
import sys
import tomllib

import numpy as np
from PIL import Image

from shells import icosphere


def projection(view):
    if "P" in view:
        return np.array(view["P"], float)
    return np.array(view["K"], float) @ np.c_[np.array(view["R"], float), np.array(view["t"], float)]


def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    job = tomllib.loads(folder.read_text())
    levels = int(sys.argv[3]) if len(sys.argv) > 3 else 5
    views = [(projection(v), np.asarray(Image.open(folder.parent / v["mask"]).convert("L")) > job.get("mask_threshold", 127))
             for v in job["view"] if not v.get("held_out")]
    # The point nearest to the rays through the centres of all masks, and the width of the object there.
    lines, offsets, widths = np.zeros((3, 3)), np.zeros(3), []
    for p, mask in views:
        centre = -np.linalg.solve(p[:, :3], p[:, 3])
        v, u = np.nonzero(mask)
        ray = np.linalg.solve(p[:, :3], [u.mean(), v.mean(), 1])
        ray /= np.linalg.norm(ray)
        away = np.eye(3) - np.outer(ray, ray)
        lines += away
        offsets += away @ centre
    middle = np.linalg.solve(lines, offsets)
    for p, mask in views:
        v, u = np.nonzero(mask)
        scale = np.linalg.norm(p[0, :3]) / abs(p[2] @ np.r_[middle, 1])
        widths.append(max(np.ptp(u), np.ptp(v)) / scale)
    half, cells = 0.75 * max(widths), 160
    for _ in range(2):
        axis = np.linspace(-half, half, cells)
        places = middle + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        inside = np.ones(len(places), bool)
        for p, mask in views:
            x = places @ p[:, :3].T + p[:, 3]
            u, v = np.rint(x[:, 0] / x[:, 2]).astype(int), np.rint(x[:, 1] / x[:, 2]).astype(int)
            there = (u >= 0) & (v >= 0) & (u < mask.shape[1]) & (v < mask.shape[0])
            inside &= there & mask[v.clip(0, mask.shape[0] - 1), u.clip(0, mask.shape[1] - 1)]
        kept = places[inside]
        middle, half = (kept.max(0) + kept.min(0)) / 2, 0.55 * np.ptp(kept, axis=0).max()
    middle = kept.mean(0)
    values, vectors = np.linalg.eigh(np.cov((kept - middle).T))
    points, faces = icosphere(levels)
    points = middle + (points * 2 * np.sqrt(values)) @ vectors.T
    if np.linalg.det(vectors) < 0:
        faces = faces[:, ::-1]
    with open(sys.argv[2], "w") as file:
        for p in points:
            file.write("v {:.9g} {:.9g} {:.9g}\n".format(*p))
        for f in faces + 1:
            file.write("f {} {} {}\n".format(*f))
    print(f"{len(kept)} cells, middle {middle}, semi-axes {2 * np.sqrt(values)}")


if __name__ == "__main__":
    main()
