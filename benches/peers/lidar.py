#!/usr/bin/env python3
"""Measures time and memory of `planish fit --shape sheet` for ten million points of simulated airborne lidar.

    python3 -m venv venv && venv/bin/pip install numpy "laspy[lazrs]"
    cargo build --release
    venv/bin/python benches/peers/lidar.py [--points 10000000] [--laz]

Writes a tile of 2 km by 2 km with simulated hills and valleys, in map coordinates, with sigma = 0.05 m. Of 1,000
points, 2 are outliers of up to 30 m. Then fits the tile and prints seconds, peak memory and the figures of the fit.
The terrain has more shape than the default of 12,000 control vertices can follow. This unresolved shape counts as
noise.
"""

import argparse
import json
import os
import resource
import tempfile
import time

import laspy
import numpy as np

import peak_memory

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def height(x, y):
    """A sum of waves; shorter ones are lower."""
    random = np.random.default_rng(5)
    z = np.full_like(x, 200.0)
    for k in range(24):
        length = 1800.0 * 0.8**k
        direction, phase = random.uniform(0, np.pi), random.uniform(0, 2 * np.pi)
        z += 0.012 * length * np.sin(2 * np.pi * (x * np.cos(direction) + y * np.sin(direction)) / length + phase)
    return z


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--points", type=int, default=10_000_000)
    arguments.add_argument("--laz", action="store_true", help="compressed")
    arguments.add_argument("--keep", help="write the tile here and keep it")
    arguments.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen, more = arguments.parse_known_args()
    random = np.random.default_rng(1)
    n = chosen.points
    with tempfile.TemporaryDirectory() as folder:
        path = chosen.keep or os.path.join(folder, "tile.laz" if chosen.laz else "tile.las")
        if not (chosen.keep and os.path.exists(chosen.keep)):
            x, y = random.uniform(0, 2000, n), random.uniform(0, 2000, n)
            z = height(x, y) + 0.05 * random.standard_normal(n)
            gross = random.random(n) < 0.002
            z[gross] += random.uniform(-30, 30, gross.sum())
            header = laspy.LasHeader(point_format=1, version="1.2")
            header.offsets, header.scales = [500000, 4200000, 0], [0.001, 0.001, 0.001]
            tile = laspy.LasData(header)
            tile.x, tile.y, tile.z = x + 500000, y + 4200000, z
            tile.write(path)
            del tile, x, y, z
        out = os.path.join(folder, "land.planish")
        start = time.perf_counter()
        printed, memory = peak_memory.run(
            [chosen.program, "fit", path, "--shape", "sheet", "--unit", "m", "-o", out, "--json", "--quiet", *more]
        )
        seconds = time.perf_counter() - start
        report = json.loads(printed)
        work = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        print(f"{n} points: {seconds:.1f} s, of them {report['fit_seconds']:.1f} s for the fit; {work:.1f} s of both cores; {memory:.0f} MB")
        print({k: report[k] for k in ("observations", "rejected", "coefficients", "rms", "held_out", "sigma", "termination")})


if __name__ == "__main__":
    main()
