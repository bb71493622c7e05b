"""Circles and ellipses from ranges of uncertain pose: odrpack (implicit ODR, started at the truth) on the readings of our own runs.

Needs numpy and odrpack. The readings are written by

    cargo run --release -p planish-solid --example contour_accuracy 300 radius circle,ellipse 50,200 none FOLDER

which runs no method of ours; the same command with `all` in place of `none FOLDER` prints ours for the same seeds.

    python benches/peers/contours.py FOLDER [runs]
"""

import csv
import pathlib
import sys
import time

import numpy as np
from odrpack import odr_fit

TRUTH = {"circle": np.array([0.0, 0.0, 1.0]), "ellipse": np.array([0.0, 0.0, 1.0, 0.6, 0.5])}


def equation(reading, beta):
    """g of a pose and a range, as in the paper: zero where the point lies on the contour."""
    x, y, heading, distance = reading
    px = x + distance * np.cos(heading) - beta[0]
    py = y + distance * np.sin(heading) - beta[1]
    if len(beta) == 3:
        return np.hypot(px, py) - beta[2]
    cos, sin = np.cos(beta[4]), np.sin(beta[4])
    return np.hypot((cos * px + sin * py) / beta[2], (cos * py - sin * px) / beta[3]) - 1.0


def differences(function, at):
    step = 1e-6
    columns = []
    for k in range(len(at)):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2 * step))
    return np.array(columns)


def bound(exact, sigma, truth):
    """The Kanatani-Cramer-Rao bound at the truth: inverse of the sum of h'h over readings without errors."""
    by_noise = differences(lambda reading: equation(reading, truth), exact) * sigma
    rows = differences(lambda beta: equation(exact, beta), truth) / np.sqrt((by_noise**2).sum(axis=0))
    return np.linalg.inv(rows @ rows.T)


def table(path, most):
    name, readings = path.stem.rsplit("-", 1)
    truth = TRUTH[name]
    runs = {}
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            run = int(row.pop("run"))
            if run < most:
                runs.setdefault(run, []).append([float(value) for value in row.values()])
    whitened, normalized, seconds = [], [], 0.0
    for rows in runs.values():
        columns = np.array(rows).T
        columns[[2, 6, 10]] = np.radians(columns[[2, 6, 10]])
        noisy, sigma, exact = columns[:4], columns[4:8], columns[8:]
        kcr = bound(exact, sigma, truth)
        begun = time.perf_counter()
        found = odr_fit(
            equation,
            noisy,
            np.zeros(noisy.shape[1]),
            truth.copy(),
            weight_x=1.0 / sigma**2,
            task="implicit-ODR",
            diff_scheme="central",
            maxit=200,
        )
        seconds += time.perf_counter() - begun
        off = found.beta - truth
        normalized.append(off / np.sqrt(np.diag(kcr)))
        whitened.append(np.linalg.solve(np.linalg.cholesky(kcr), off))
    whitened, count = np.array(whitened), len(runs)
    bias = np.abs(np.mean(normalized, axis=0)).max()
    rmse = np.sqrt((whitened**2).mean())
    scatter = np.sqrt(((whitened - whitened.mean(axis=0)) ** 2).sum() / ((count - 1) * len(truth)))
    print(f"| {name} | {readings} | odrpack | {count} | {bias:.3f} | {rmse:.3f} | {scatter:.3f} | {seconds / count:.4f} |")


def main():
    folder = pathlib.Path(sys.argv[1])
    most = int(sys.argv[2]) if len(sys.argv) > 2 else 10**9
    print("| contour | readings | method | runs | bias / σ_KCR | RMSE / KCR | scatter / KCR | s a fit |")
    print("|---|---|---|---|---|---|---|---|")
    for path in sorted(folder.glob("*.csv")):
        table(path, most)


if __name__ == "__main__":
    main()
