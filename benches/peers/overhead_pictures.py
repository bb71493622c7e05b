#!/usr/bin/env python3
"""Shapes in simulated overhead pictures: parameters of `planish contour` against their σ.

Each picture has a rectangle or a polygon at a random place with exact vertices. Pixels average over their area
(`exact`; also blurred after sampling) or take one or 4 × 4 samples; normal noise is added and grey levels are
rounded. Printed are, for each row: the pictures with the right kind, the share of parameters within 1.96 σ with
its binomial σ, and the rms of the normalised errors. Rectangles are compared by centre, sizes and angle, polygons by
the coordinates of their vertices.

    overhead_pictures.py PLANISH RUNS [ROW ...]

`ROW` selects rows whose name begins with it, such as `rectangle` or `polygon-5 exact`.
"""

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = (120, 100)
GREY = (40.0, 200.0)
ANGLES = [0, 0.3, 1, 3, 10, 30, 45]


def coverage(vertices):
    """The area of each pixel inside a polygon; pixel centres are at integers.

    Each edge adds its signed area to the right of it, row by row; sums along the rows give the coverage.
    """
    width, height = SIZE
    sums = np.zeros((height, width + 2))
    # The corner of the first pixel is at (−½, −½).
    points = np.asarray(vertices) + 0.5
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0)):
        if y0 == y1:
            continue
        sign = 1.0 if y0 < y1 else -1.0
        (xa, ya), (xb, yb) = ((x0, y0), (x1, y1)) if y0 < y1 else ((x1, y1), (x0, y0))
        slope = (xb - xa) / (yb - ya)
        for row in range(int(math.floor(ya)), int(math.ceil(yb))):
            low, high = max(ya, row), min(yb, row + 1)
            # Cut the piece of this row at the columns.
            ends = sorted([xa + (low - ya) * slope, xa + (high - ya) * slope])
            cuts = [ends[0]] + list(range(int(math.floor(ends[0])) + 1, int(math.ceil(ends[1])))) + [ends[1]]
            total = ends[1] - ends[0]
            for left, right in zip(cuts, cuts[1:]):
                share = (high - low) * ((right - left) / total if total > 0 else 1.0)
                column = int(math.floor(0.5 * (left + right)))
                inside = column + 1 - 0.5 * (left + right)
                sums[row, column] += sign * share * inside
                sums[row, column + 1] += sign * share * (1 - inside)
    return np.abs(np.cumsum(sums, axis=1)[:, :width])


def sampled(vertices, samples):
    """The share of `samples` × `samples` places of each pixel inside a polygon."""
    width, height = SIZE
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + steps).ravel()
    y = (np.arange(height)[:, None] + steps).ravel()
    inside = np.zeros((len(y), len(x)), bool)
    points = np.asarray(vertices)
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0)):
        if y0 == y1:
            continue
        crosses = (y >= min(y0, y1)) & (y < max(y0, y1))
        at = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
        inside ^= crosses[:, None] & (x[None] > at[:, None])
    return inside.reshape(height, samples, width, samples).mean(axis=(1, 3))


def turned(points, angle, middle):
    """Points turned about the origin and moved."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points, float) @ np.array([[c, s], [-s, c]]) + middle


def shape(name, angle_deg, random):
    """Vertices in the picture, y downwards, counter-clockwise as seen with y upwards."""
    u = random.uniform
    angle = math.radians(angle_deg if angle_deg is not None else u(0, 360))
    middle = np.array([60 + u(-1, 1), 50 + u(-1, 1)])
    if name == "rectangle":
        w, h = 70 + u(-2, 2), 44 + u(-2, 2)
        return turned([(-w / 2, -h / 2), (w / 2, -h / 2), (w / 2, h / 2), (-w / 2, h / 2)], angle, middle)
    count = int(name.split("-")[1])
    if count == 6:
        # An L, with its centre in the elbow.
        w, h, a, b = 66 + u(-3, 3), 56 + u(-3, 3), 28 + u(-3, 3), 26 + u(-3, 3)
        corners = np.array([(0, 0), (w, 0), (w, a), (b, a), (b, h), (0, h)]) - (0.42 * w, 0.42 * h)
        return turned(corners, angle, middle)
    around = 2 * math.pi * (np.arange(count) + random.uniform(-0.15, 0.15, count)) / count
    return turned(np.column_stack([np.cos(around), np.sin(around)]) * random.uniform(36, 40, (count, 1)), angle, middle)


def picture(vertices, kind, noise, random):
    """Grey levels of the shape."""
    if kind.startswith("exact") or kind.startswith("blurred"):
        share = coverage(vertices)
    else:
        share = sampled(vertices, 1 if kind.startswith("one") else 4)
    if kind.startswith("blurred"):
        x = np.arange(-4, 5)
        kernel = np.exp(-0.5 * (x / 0.8) ** 2)
        kernel /= kernel.sum()
        for axis in (0, 1):
            share = np.apply_along_axis(lambda row: np.convolve(row, kernel, mode="same"), axis, share)
    grey = GREY[0] + (GREY[1] - GREY[0]) * share + noise * random.standard_normal(share.shape)
    return Image.fromarray(np.clip(np.round(grey), 0, 255).astype(np.uint8))


def rectangle_errors(values, vertices):
    """Errors in σ of centre, sizes and angle."""
    p = {k: (v["value"], v["sigma"]) for k, v in values.items()}
    middle = vertices.mean(axis=0)
    side = vertices[1] - vertices[0]
    sizes = [math.hypot(*side), math.hypot(*(vertices[2] - vertices[1]))]
    angle = math.degrees(math.atan2(side[1], side[0]))
    names = ["width", "height"]
    if abs(p["width"][0] - sizes[0]) > abs(p["width"][0] - sizes[1]):
        names = names[::-1]
    # The width is along the angle; exchanged names turn it by 90°.
    turn = (p["angle_deg"][0] - angle - (90 if names[0] == "height" else 0) + 90) % 180 - 90
    errors = [(p["center_x"][0] - middle[0], p["center_x"][1]), (p["center_y"][0] - middle[1], p["center_y"][1]),
              (turn, p["angle_deg"][1])]
    errors += [(p[n][0] - s, p[n][1]) for n, s in zip(names, sizes)]
    return [e / s for e, s in errors]


def polygon_errors(values, vertices):
    """Errors in σ of the coordinates of the vertices, in the order that fits best."""
    count = len(vertices)
    value = np.array([[values[f"{axis}{k}"]["value"] for axis in "xy"] for k in range(count)])
    sigma = np.array([[values[f"{axis}{k}"]["sigma"] for axis in "xy"] for k in range(count)])
    orders = [np.roll(v, k, axis=0) for v in (vertices, vertices[::-1]) for k in range(count)]
    truth = min(orders, key=lambda v: ((v - value) ** 2).sum())
    return list(((value - truth) / sigma).ravel())


ROWS = [("rectangle", "exact", 4.0, angle) for angle in ANGLES]
ROWS += [("rectangle", kind, 4.0, angle) for kind in ("blurred", "one sample", "4 samples") for angle in (0, 10)]
ROWS += [(f"polygon-{n}", kind, noise, None) for n in (3, 5, 6)
         for kind, noise in (("exact", 4.0), ("exact", 1.0), ("exact", 8.0), ("blurred", 4.0), ("4 samples", 4.0))]


def main():
    program, runs, wanted = sys.argv[1], int(sys.argv[2]), sys.argv[3:]
    for name, kind, noise, angle in ROWS:
        title = f"{name} {kind} noise {noise:g}" + (f" {angle:g}°" if angle is not None else "")
        if wanted and not any(title.startswith(w) for w in wanted):
            continue
        errors, found, problems = [], 0, []
        for seed in range(runs):
            random = np.random.default_rng([seed, sum(map(ord, title))])
            vertices = shape(name, angle, random)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "picture.png"
                picture(vertices, kind, noise, random).save(path)
                done = subprocess.run([program, "contour", str(path), "--kind", name, "--pixel-size", "1", "--json",
                                       "--threads", "1"], capture_output=True, text=True, timeout=300, check=False)
            if done.returncode:
                problems.append(done.stderr.strip()[:160])
                continue
            # Contours have y upwards from the centre of the lowest pixels.
            truth = np.column_stack([vertices[:, 0], SIZE[1] - 1 - vertices[:, 1]])
            if name == "rectangle":
                truth = truth[::-1]
            values = json.loads(done.stdout)["parameters"]
            found += 1
            errors += (rectangle_errors if name == "rectangle" else polygon_errors)(values, truth)
        errors = np.array(errors)
        if len(errors):
            share = np.mean(np.abs(errors) < 1.96)
            print(f"{title:40} found {found}/{runs} within 1.96 sigma {share:.3f} of {len(errors)} "
                  f"(± {math.sqrt(share * (1 - share) / len(errors)):.3f}) rms {np.sqrt(np.mean(errors ** 2)):.2f} "
                  f"without 1 % {np.sqrt(np.mean(np.sort(errors ** 2)[:int(0.99 * len(errors))])):.2f}", flush=True)
        for problem in sorted(set(problems))[:3]:
            print("   ", problems.count(problem), problem)


if __name__ == "__main__":
    main()
