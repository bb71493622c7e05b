#!/usr/bin/env python3
"""Walls in scans of real logs (CARMEN): readings on walls, and walls of repeated scans compared.

For each log: the share of readings that `planish contour` uses in scans spread over the log and in those that
follow (`--kind walls`), and, for these pairs, the share of walls whose two positions differ by less than 1.96 σ of their difference.
The robot moves between scans, and its pose has errors: one displacement and rotation of each pair is estimated from
its walls with Huber's weights, so that a door or a chair that moved does not displace all others, and differences are
divided by the σ that this leaves. Walls are compared in the middle of the part that
both scans measured, if that is half of each. Pairs with less than five such walls have no redundancy to speak of.

    rooms.py PLANISH SCANS LOG.gz ...
"""

import gzip
import json
import math
import subprocess
import sys

import numpy as np

PROGRAM = sys.argv[1]


def scans(path):
    """Poses and times of the scans of a log."""
    found = []
    opener = gzip.open if path.endswith(".gz") else open
    with opener(path, "rt", errors="replace") as lines:
        for line in lines:
            if line.startswith("FLASER "):
                words = line.split()
                n = int(words[1])
                found.append(tuple(float(w) for w in words[2 + n:5 + n]))
    return found


def contours(path, scan):
    """The JSON object of one scan."""
    done = subprocess.run([PROGRAM, "contour", path, "--kind", "walls", "--scan", str(scan), "--json", "--threads", "1"],
                          capture_output=True, text=True, timeout=300, check=False)
    return json.loads(done.stdout) if done.returncode == 0 else None


def used(report):
    """Readings on walls."""
    return sum(c["readings"] - c["rejected"] for c in report["contours"] if c.get("spans"))


def total(path, scan):
    """Number of readings of a scan within the default range."""
    opener = gzip.open if path.endswith(".gz") else open
    index = -1
    with opener(path, "rt", errors="replace") as lines:
        for line in lines:
            if line.startswith("FLASER "):
                index += 1
                if index == scan:
                    words = line.split()
                    return sum(0.05 <= float(w) <= 20 for w in words[2:2 + int(words[1])])
    return 0


def offsets(report):
    """Walls as (direction, sigma across at the middle, middle, length)."""
    found = []
    for c in report["contours"]:
        if not c.get("spans"):
            continue
        (a, _), (_, b) = c["spans"][0], c["spans"][-1]
        angle = math.radians(c["parameters"]["angle_deg"]["value"])
        found.append((angle, c["covariance"], c["parameters"]["offset"]["value"], a, b, c["readings"]))
    return found


def compared(first, second):
    """Normalised differences of the walls of two scans, at the middle of the part that both measured."""
    rows, differences, variances = [], [], []
    for angle, cov, offset, a, b, _ in first:
        best = None
        for other in second:
            turn = (other[0] - angle + math.pi / 2) % math.pi - math.pi / 2
            along = [math.cos(angle) * p[0] + math.sin(angle) * p[1] for p in (a, b, other[3], other[4])]
            low, high = max(min(along[:2]), min(along[2:])), min(max(along[:2]), max(along[2:]))
            if abs(turn) > 0.1 or high - low < 0.5 * max(abs(along[1] - along[0]), abs(along[3] - along[2])):
                continue
            t = 0.5 * (low + high)
            point = (t * math.cos(angle) - offset * math.sin(angle), t * math.sin(angle) + offset * math.cos(angle))
            away = math.cos(other[0]) * point[1] - math.sin(other[0]) * point[0] - other[2]
            if best is None or abs(away) < abs(best[0]):
                s = math.cos(other[0]) * point[0] + math.sin(other[0]) * point[1]
                best = (away, t, s, other)
        if best is None or abs(best[0]) > 0.1:
            continue
        away, t, s, other = best
        d = math.pi / 180
        own = cov[1][1] + 2 * t * d * cov[0][1] + t * t * d * d * cov[0][0]
        its = other[1][1][1] + 2 * s * d * other[1][0][1] + s * s * d * d * other[1][0][0]
        normal = (-math.sin(other[0]), math.cos(other[0]))
        rows.append((normal[0], normal[1], normal[1] * point[0] - normal[0] * point[1]))
        differences.append(away)
        variances.append(own + its)
    if len(rows) < 5:
        return []
    sigma = np.sqrt(variances)
    design = np.array(rows) / sigma[:, None]
    wanted = np.array(differences) / sigma
    weights = np.ones(len(wanted))
    for _ in range(30):
        root = np.sqrt(weights)
        move = np.linalg.lstsq(design * root[:, None], wanted * root, rcond=None)[0]
        residuals = wanted - design @ move
        weights = np.minimum(1, 1.345 / np.maximum(np.abs(residuals), 1e-9))
    # The estimated displacement changes the variance of each residual.
    gain = np.linalg.inv(design.T @ (design * weights[:, None])) @ (design.T * weights)
    left = np.eye(len(wanted)) - design @ gain
    left = (left * left).sum(axis=1)
    return [float(r / math.sqrt(v)) for r, v in zip(residuals, left) if v > 0.1]


def main():
    count = int(sys.argv[2])
    for path in sys.argv[3:]:
        poses = scans(path)
        picked = [int((k + 0.5) * (len(poses) - 1) / count) for k in range(count)]
        walls = readings = corners = 0
        sigmas, z, deviations = [], [], []
        for first in picked:
            both = contours(path, first), contours(path, first + 1)
            for scan, report in zip((first, first + 1), both):
                readings += total(path, scan)
                if report:
                    walls += used(report)
                    corners += len(report.get("corners", []))
                    sigmas.append(report.get("sigma_range") or math.nan)
                    deviations.append(report.get("wall_errors", {}).get("deviation", math.nan))
            if all(both):
                z += compared(offsets(both[0]), offsets(both[1]))
        inside = sum(abs(v) < 1.96 for v in z) / len(z) if z else math.nan
        print(f"{path.split('/')[-1]:28} scans {2 * count} on walls {walls / readings:.3f} "
              f"corners {corners} median sigma {np.nanmedian(sigmas):.4f} "
              f"deviation {np.nanmedian(deviations):.4f} walls compared {len(z)} within 1.96 sigma {inside:.3f} "
              f"(± {math.sqrt(inside * (1 - inside) / max(len(z), 1)):.3f}) rms "
              f"{math.sqrt(sum(v * v for v in z) / max(len(z), 1)):.2f}", flush=True)


if __name__ == "__main__":
    main()
