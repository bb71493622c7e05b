#!/usr/bin/env python3
"""Compares Planish with OpenCV's StereoSGBM on stereo pairs with ground truth, and evaluates photometric normals.

    pip install numpy scipy opencv-python-headless
    python benches/peers/stereo.py target/release/planish ../shared/data [PICTURES]

Only pixels with known truth that both cameras see are counted: by the mask of `cones`, and for `aloe` if no nearer
point falls on the same pixel of the right image. A pixel is bad if its error exceeds one pixel. OpenCV does not match
the left columns, where the range of disparities is incomplete, so its images are padded on the left by this range.

Three figures show whether sigma predicts the errors: the errors of each tenth of the pixels, ordered by sigma;
Spearman's rank correlation; and AUSE, the area between the curve of bad pixels with the largest sigma removed first and
the best such curve, also for a random order. The truth of `aloe` has whole pixels, so errors below half a pixel have no
meaning there. With a folder PICTURES, images of disparities, sigma and errors are written.
"""

import pathlib
import subprocess
import sys
import tarfile
import tempfile
import time

import cv2
import numpy as np
from scipy.stats import spearmanr

RANGE = {"cones": 64, "aloe": 224}


def seen_by_both(truth):
    """Pixels that are not hidden by nearer ones in the right image."""
    rows, columns = truth.shape
    y, x = np.nonzero(truth > 0)
    there = np.round(x - truth[y, x]).astype(int)
    inside = there >= 0
    nearest = np.full((rows, columns), -1.0)
    np.maximum.at(nearest, (y[inside], there[inside]), truth[y[inside], x[inside]])
    seen = np.zeros((rows, columns), bool)
    seen[y[inside], x[inside]] = truth[y[inside], x[inside]] >= nearest[y[inside], there[inside]] - 1
    return seen


def scenes(data):
    stereo = data / "stereo"
    truth = cv2.imread(str(stereo / "cones/Cones_LEFT_GT.tif"), -1).astype(float)
    mask = cv2.imread(str(stereo / "cones/Occlusion_LEFT.png"), 0) > 0
    yield "cones", stereo / "cones/Cones_LEFT.tif", stereo / "cones/Cones_RIGHT.tif", truth, mask & (truth > 0)
    truth = cv2.imread(str(stereo / "aloe/aloeGT.png"), -1).astype(float)
    yield "aloe", stereo / "aloe/aloeL.jpg", stereo / "aloe/aloeR.jpg", truth, seen_by_both(truth)


def judge(name, seconds, disparity, truth, counted):
    known = counted & np.isfinite(disparity)
    error = np.abs(disparity - truth)[known]
    print(
        f"{name:24} {seconds:6.2f} s   matched {known.sum() / counted.sum():6.1%}   bad of matched {np.mean(error > 1):6.2%}"
        f"   bad or missing {1 - np.sum(error <= 1) / counted.sum():6.2%}   median error {np.median(error):.3f} px"
    )
    return known, error


def sparsification(bad, order):
    """Share of bad pixels if a growing share at the end of the order is removed."""
    shares = np.linspace(0, 0.99, 100)
    return np.array([np.mean(bad[order[: int(len(bad) * (1 - s))]]) for s in shares]), shares


def ranking(sigma, error):
    order = np.argsort(sigma, kind="stable")
    print("  tenth by sigma:  sigma, rms error, median error, share of bad, share within 1.96 sigma")
    for part in np.array_split(order, 10):
        e, s = error[part], sigma[part]
        print(f"    {s.mean():6.3f} {np.sqrt(np.mean(e**2)):7.3f} {np.median(e):7.3f} {np.mean(e > 1):7.2%} {np.mean(e < 1.96 * s):7.2%}")
    bad = error > 1
    by_sigma, shares = sparsification(bad, order)
    best, _ = sparsification(bad, np.argsort(error, kind="stable"))
    area = np.trapezoid(by_sigma - best, shares)
    random = np.mean(bad) * 0.99 - np.trapezoid(best, shares)
    print(f"  Spearman {spearmanr(sigma, error)[0]:.3f}   AUSE of bad pixels {area:.5f} (random order {random:.5f})   within 1.96 sigma {np.mean(error < 1.96 * sigma):.1%}")


def opencv(left, right, count, block):
    pad = lambda image: cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE)
    matcher = cv2.StereoSGBM_create(
        0, count, block, P1=8 * block**2, P2=32 * block**2, disp12MaxDiff=1, uniquenessRatio=5,
        speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_HH,
    )
    left, right = pad(left), pad(right)
    start = time.perf_counter()
    found = matcher.compute(left, right)[:, count:].astype(float) / 16
    seconds = time.perf_counter() - start
    found[found < 0] = np.nan
    return found, seconds


def draw(folder, name, disparity, sigma, truth):
    def coloured(values, maximum):
        shade = cv2.applyColorMap(np.uint8(np.clip(np.nan_to_num(values) / maximum, 0, 1) * 255), cv2.COLORMAP_VIRIDIS)
        shade[~np.isfinite(values)] = 0
        return shade

    error = np.where(truth > 0, np.abs(disparity - truth), np.nan)
    rows = [np.hstack([coloured(truth, truth.max()), coloured(disparity, truth.max())]), np.hstack([coloured(sigma, 2), coloured(error, 2)])]
    cv2.imwrite(str(folder / f"{name}.png"), np.vstack(rows))


def sphere(planish, data, folder):
    """Compares the normals of the grey ball with those of the sphere given by its mask."""
    for name in ("gray", "chrome"):
        with tarfile.open(data / f"normals/uw_psm/psm_{name}.tgz") as archive:
            archive.extractall(folder, filter="data")
    images = [str(folder / f"gray/gray.{k}.tga") for k in range(12)]
    balls = ", ".join(f'"chrome/chrome.{k}.tga"' for k in range(12))
    calibration = folder / "lights.toml"
    calibration.write_text(f'[ball]\nimages = [{balls}]\nmask = "chrome/chrome.mask.tga"\n')
    out = folder / "normals.npy"
    mask = folder / "gray/gray.mask.tga"
    subprocess.run([planish, "sense", "photometric", *images, "--mask", mask, "--calib", calibration, "-o", out, "--quiet"], check=True)
    found = np.load(out)
    # An uncompressed TGA file of 24 bits with rows from the bottom to the top.
    raw = mask.read_bytes()
    columns, rows = raw[12] | raw[13] << 8, raw[14] | raw[15] << 8
    inside = np.frombuffer(raw[18 + raw[0] :][: columns * rows * 3], np.uint8).reshape(rows, columns, 3)[::-1, :, 0] > 128
    y, x = np.nonzero(inside)
    radius = np.sqrt(len(x) / np.pi)
    u, v = (x - x.mean()) / radius, (y - y.mean()) / radius
    front = u**2 + v**2 < 0.96
    truth = np.stack([u, v, -np.sqrt(np.clip(1 - u**2 - v**2, 0, 1))], 1)[front]
    values = found[y[front], x[front]]
    known = np.isfinite(values[:, 0])
    angle = np.degrees(np.arccos(np.clip(np.sum(values[known, :3] * truth[known], axis=1), -1, 1)))
    rank = spearmanr(values[known, 3], angle)[0]
    print(f"grey ball: {known.mean():.1%} of its pixels, median error {np.median(angle):.2f} deg, mean {angle.mean():.2f}, stated sigma {np.median(values[known, 3]):.2f}, Spearman {rank:.3f}")


def main():
    planish, data = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2])
    pictures = pathlib.Path(sys.argv[3]) if len(sys.argv) > 3 else None
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for name, left, right, truth, counted in scenes(data):
            out = folder / f"{name}.npy"
            start = time.perf_counter()
            subprocess.run(
                [planish, "sense", "stereo", left, right, "--disparities", f"0..{RANGE[name] - 1}", "-o", out, "--quiet"], check=True
            )
            seconds = time.perf_counter() - start
            disparity, sigma = np.moveaxis(np.load(out).astype(float), 2, 0)
            known, error = judge(f"{name} Planish", seconds, disparity, truth, counted)
            ranking(sigma[known], error)
            grey = [cv2.imread(str(path), 0) for path in (left, right)]
            for block in (3, 5):
                found, seconds = opencv(*grey, RANGE[name], block)
                judge(f"{name} OpenCV, block {block}", seconds, found, truth, counted)
            if pictures:
                draw(pictures, name, disparity, sigma, truth)
        sphere(planish, data, folder)


if __name__ == "__main__":
    main()
