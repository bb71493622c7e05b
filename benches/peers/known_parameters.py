#!/usr/bin/env python3
"""Compares Planish with G+Smo and FITPACK on Franke's function with known (u, v), in one run.

    python3 -m venv venv && venv/bin/pip install numpy scipy pygismo
    cargo build --release
    venv/bin/python benches/peers/known_parameters.py [--sizes 100000,1000000,10000000] [--fitpack 1000000] [--smooth 1e-9]

Every program fits 64 x 64 bicubic coefficients to the same samples of the unit square with sigma = 0.01. Planish
estimates the smoothness by restricted likelihood and computes the marginal sigma of every coefficient. G+Smo gets a
smoothing weight and FITPACK none. The times of the peers are those of their own calls on arrays in memory. Planish has
two times: `fit` from its report, without reading and writing files, and `whole` for the complete command. RMSE refers
to the true function on a grid of 301 x 301 points. The weight of G+Smo is the best of a list, which favours G+Smo.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version

import numpy as np

import peak_memory

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
SIGMA = 0.01


def franke(x, y):
    x, y = 9 * x, 9 * y
    return (
        0.75 * np.exp(-((x - 2) ** 2 + (y - 2) ** 2) / 4)
        + 0.75 * np.exp(-((x + 1) ** 2) / 49 - (y + 1) / 10)
        + 0.5 * np.exp(-((x - 7) ** 2 + (y - 3) ** 2) / 4)
        - 0.2 * np.exp(-((x - 4) ** 2) - (y - 7) ** 2)
    )


def grid():
    t = np.linspace(0, 1, 301)
    u, v = np.meshgrid(t, t, indexing="ij")
    return u.ravel(), v.ravel()


def write_ply(path, uv, z):
    """Binary PLY with the columns of docs: x y z u v."""
    n = len(z)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment unit m\nelement vertex %d\n" % n
        + "".join("property double %s\n" % name for name in "xyzuv")
        + "end_header\n"
    )
    with open(path, "wb") as f:
        f.write(header.encode())
        np.column_stack([uv, z, uv]).astype("<f8").tofile(f)


def planish(program, path, folder):
    out = os.path.join(folder, "fit.planish")
    command = [program, "fit", path, "--known-uv", "61x61", "-o", out, "--json", "--quiet"]
    start = time.perf_counter()
    printed = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    whole = time.perf_counter() - start
    report = json.loads(printed)
    _, report["peak_memory_mb"] = peak_memory.run(command)
    return out, whole, report


def control_grid(path):
    """Control heights of a saved model, read as the specification of safetensors describes."""
    with open(path, "rb") as f:
        length = int.from_bytes(f.read(8), "little")
        header = json.loads(f.read(length))
        start, end = header["vertices"]["data_offsets"]
        f.seek(8 + length + start)
        return np.frombuffer(f.read(end - start), "<f8").reshape(-1, 3)


def rmse_of_control_grid(vertices, u, v):
    """RMSE of a uniform bicubic surface with n x n coefficients on the unit square, ordered along u."""
    n = int(round(len(vertices) ** 0.5))
    heights = vertices[:, 2].reshape(n, n)
    plan = vertices[:, 0].reshape(n, n)
    if abs(plan[0, -1] - plan[0, 0]) < abs(plan[-1, 0] - plan[0, 0]):
        heights = heights.T

    def weights(t):
        cell = np.minimum((t * (n - 3)).astype(int), n - 4)
        s = t * (n - 3) - cell
        b = np.stack([(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3], 1) / 6
        return cell, b

    (i, bu), (j, bv) = weights(u), weights(v)
    value = sum(bu[:, a] * bv[:, b] * heights[j + b, i + a] for a in range(4) for b in range(4))
    return np.sqrt(np.mean((value - franke(u, v)) ** 2))


def gismo(uv, z, smooth):
    import pygismo as gs

    inner = np.linspace(0, 1, 62)
    knots = gs.nurbs.gsKnotVector([0.0] * 3 + list(inner) + [1.0] * 3, 3)
    basis = gs.nurbs.gsTensorBSplineBasis2(knots, knots)
    parameters = np.asfortranarray(uv.T)
    points = np.asfortranarray(np.column_stack([uv, z]).T)
    start = time.perf_counter()
    fitter = gs.modelling.gsFitting(parameters, points, basis)
    fitter.compute(smooth)
    seconds = time.perf_counter() - start
    u, v = grid()
    value = fitter.result().eval(np.asfortranarray(np.stack([u, v])))[2]
    return seconds, np.sqrt(np.mean((value - franke(u, v)) ** 2)), basis.size()


def fitpack(uv, z):
    from scipy.interpolate import LSQBivariateSpline

    knots = np.linspace(0, 1, 62)[1:-1]
    start = time.perf_counter()
    fitted = LSQBivariateSpline(uv[:, 0], uv[:, 1], z, knots, knots, bbox=[0, 1, 0, 1])
    seconds = time.perf_counter() - start
    u, v = grid()
    return seconds, np.sqrt(np.mean((fitted(u, v, grid=False) - franke(u, v)) ** 2))


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--sizes", default="100000,1000000,10000000")
    arguments.add_argument("--fitpack", type=int, default=100000, help="largest size for FITPACK")
    arguments.add_argument("--gismo", type=int, default=1000000, help="largest size for G+Smo")
    arguments.add_argument("--smooth", default="0,1e-9,1e-8,1e-7,1e-6", help="smoothing weights for G+Smo at the smallest size")
    arguments.add_argument("--repeat", type=int, default=3)
    arguments.add_argument("--program", default=os.path.join(ROOT, "target", "release", "planish"))
    chosen = arguments.parse_args()
    sizes = [int(n) for n in chosen.sizes.split(",")]
    print(platform.processor() or platform.machine(), os.cpu_count(), "cores; python", platform.python_version())
    print(subprocess.run([chosen.program, "--version"], capture_output=True, text=True).stdout.strip(),
          "; pygismo", version("pygismo"), "; scipy", version("scipy"), "; numpy", np.__version__)
    u, v = grid()
    print(f"{'points':>9} {'program':<22} {'seconds':>9} {'whole':>8} {'MB':>6} {'RMSE':>10}  note")
    weight = None
    for n in sizes:
        random = np.random.default_rng(1)
        uv = random.random((n, 2))
        z = franke(uv[:, 0], uv[:, 1]) + SIGMA * random.standard_normal(n)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "samples.ply")
            write_ply(path, uv, z)
            best = None
            for _ in range(chosen.repeat):
                out, whole, report = planish(chosen.program, path, folder)
                if best is None or report["fit_seconds"] < best[0]:
                    best = (report["fit_seconds"], whole, report, rmse_of_control_grid(control_grid(out), u, v))
            seconds, whole, report, rmse = best
            note = f"sigma {report['sensors'][0]['sigma_estimated']:.5f}, held out {report['held_out']['rms_normalised']:.3f}, median sigma {report['sigma']['median']:.2e}"
            print(f"{n:>9} {'planish':<22} {seconds:>9.3f} {whole:>8.3f} {report.get('peak_memory_mb', 0):>6.0f} {rmse:>10.3e}  {note}", flush=True)
        ours = seconds
        if n <= chosen.gismo:
            if weight is None:
                tried = [(gismo(uv, z, float(w)), float(w)) for w in chosen.smooth.split(",")]
                (best_of, weight) = min(tried, key=lambda t: t[0][1])
            seconds, rmse, size = min((gismo(uv, z, weight) for _ in range(1 if n > 100000 else 2)), key=lambda t: t[0])
            print(f"{n:>9} {'G+Smo gsFitting':<22} {seconds:>9.3f} {'':>8} {'':>6} {rmse:>10.3e}  weight {weight:g}, {size} coefficients: {seconds / ours:.0f} times our time", flush=True)
        if n <= chosen.fitpack:
            seconds, rmse = fitpack(uv, z)
            print(f"{n:>9} {'FITPACK LSQBivariate':<22} {seconds:>9.3f} {'':>8} {'':>6} {rmse:>10.3e}  {seconds / ours:.0f} times our time", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
