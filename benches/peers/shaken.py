#!/usr/bin/env python3
"""Measures how well `planish fit --align` restores perturbed poses of the scans in a VRIP list.

    python3 -m venv venv && venv/bin/pip install numpy
    cargo build --release
    venv/bin/python benches/peers/shaken.py bun.conf --unit m --move 0.002 --turn 1

Every scan but the first is rotated about a random axis through the centre of the scans, and moved in a random
direction. For each seed, the script prints the rms of the fit with that of the unperturbed list, and the difference of
each pose from the one that `--align` estimates without perturbation: in length, in degrees, and in standard deviations
of both fits (root mean square over six parameters).
"""

import argparse
import json
import os
import subprocess
import tempfile

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def rotation(x, y, z, w):
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def quaternion(r):
    """The quaternion of a rotation: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = r
    k = np.array([
        [a - e - i, b + d, c + g, h - f],
        [b + d, e - a - i, f + h, c - g],
        [c + g, f + h, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ])
    return np.linalg.eigh(k)[1][:, -1]


def turn(omega):
    angle = np.linalg.norm(omega)
    if angle == 0:
        return np.eye(3)
    x, y, z = omega / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def shaken(lines, folder, center, rng, move, angle):
    """The lines of the list with perturbed poses. The rotation of a list is the inverse of that of its quaternion."""
    first = True
    for line in lines:
        parts = line.split()
        if not parts or parts[0] != "bmesh":
            continue
        t, q = np.array(parts[2:5], float), np.array(parts[5:9], float)
        r = rotation(*(q / np.linalg.norm(q))).T
        if not first:
            axis, direction = rng.standard_normal((2, 3))
            by = turn(angle * axis / np.linalg.norm(axis))
            r, t = by @ r, by @ (t - center) + center + move * direction / np.linalg.norm(direction)
        first = False
        numbers = [*t, *quaternion(r.T)]
        yield "bmesh " + os.path.join(folder, parts[1]) + " " + " ".join(repr(float(x)) for x in numbers)


def fit(program, conf, out, more):
    command = [program, "fit", conf, "-o", out, "--json", "--quiet", *more]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)


def difference(a, b):
    """Difference of two estimates of a pose: length, degrees, standard deviations."""
    ra, rb = rotation(*a["quaternion_xyzw"]), rotation(*b["quaternion_xyzw"])
    by = ra @ rb.T
    omega = np.array([by[2, 1] - by[1, 2], by[0, 2] - by[2, 0], by[1, 0] - by[0, 1]]) / 2
    d = np.concatenate([np.subtract(a["translation"], b["translation"]), omega])
    covariance = np.array(a["covariance"]) + np.array(b["covariance"])
    return np.linalg.norm(d[:3]), np.degrees(np.linalg.norm(omega)), np.sqrt(d @ np.linalg.solve(covariance, d) / 6)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("conf")
    arguments.add_argument("--move", type=float, default=0.002)
    arguments.add_argument("--turn", type=float, default=1.0, help="degrees")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--center", type=float, nargs=3, default=[-0.017, 0.11, -0.0015])
    arguments.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen, more = arguments.parse_known_args()
    with open(chosen.conf) as f:
        lines = f.readlines()
    source = os.path.dirname(os.path.abspath(chosen.conf))
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "out.planish")
        plain = fit(chosen.program, chosen.conf, out, more)
        still = fit(chosen.program, chosen.conf, out, ["--align", *more])
        print(f"as listed: rms {plain['rms']:.4g}; aligned: rms {still['rms']:.4g}")
        for seed in range(chosen.seeds):
            conf = os.path.join(folder, "shaken.conf")
            rng = np.random.default_rng(seed)
            with open(conf, "w") as f:
                f.write("\n".join(shaken(lines, source, np.array(chosen.center), rng, chosen.move, np.radians(chosen.turn))) + "\n")
            left, found = fit(chosen.program, conf, out, more), fit(chosen.program, conf, out, ["--align", *more])
            print(f"seed {seed}: rms {left['rms']:.4g} perturbed, {found['rms']:.4g} aligned ({found['rms'] / plain['rms'] - 1:+.1%} of the list)")
            for a, b in zip(found["poses"], still["poses"]):
                if a.get("covariance"):
                    length, degrees, sigmas = difference(a, b)
                    print(f"    {a['scan']:<14} moved {a['moved']:.3g}, remaining difference {length:.2e} and {degrees:.4f} degrees: {sigmas:.2f} sigma")


if __name__ == "__main__":
    main()
