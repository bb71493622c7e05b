#!/usr/bin/env python3
"""Draws a hillshade with contours and a map of sigma from a raster of `planish fit --ground -o dem.tif`.

    pip install numpy rasterio matplotlib
    planish fit tile.laz --ground -o dem.tif
    python benches/peers/terrain.py dem.tif picture.png [INTERVAL]
"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import rasterio
from matplotlib.colors import LightSource


def main():
    path, picture = sys.argv[1:3]
    with rasterio.open(path) as raster:
        height, sigma = raster.read(masked=True).astype(float)
        bounds, cell, unit = raster.bounds, raster.transform.a, raster.units[0]
    # Axes start at the corner, because map coordinates with seven digits do not fit under the picture.
    west, south = np.floor(bounds.left), np.floor(bounds.bottom)
    extent = [bounds.left - west, bounds.right - west, bounds.bottom - south, bounds.top - south]
    filled = height.filled(np.nan)
    # Flat terrain is exaggerated until its relief is visible; steep terrain is not.
    slope = np.hypot(*np.gradient(filled, cell))
    exaggeration = float(np.clip(0.4 / np.nanquantile(slope, 0.9), 0.5, 8))
    low, high = np.nanquantile(filled, [0.01, 0.99])
    shade = LightSource(azdeg=315, altdeg=45).shade(
        filled, plt.get_cmap("gist_earth"), blend_mode="soft", vmin=low - 0.3 * (high - low), vmax=high + 0.3 * (high - low), vert_exag=exaggeration, dx=cell, dy=cell
    )
    shade[~np.isfinite(filled)] = 1
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 12 * min(0.48, 0.09 + 0.42 * height.shape[0] / height.shape[1])), constrained_layout=True)
    left.imshow(shade, extent=extent)
    span = float(height.max() - height.min())
    interval = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0 ** np.floor(np.log10(span / 4))
    levels = np.arange(np.floor(height.min() / interval) * interval, height.max(), interval)
    x = bounds.left - west + (np.arange(height.shape[1]) + 0.5) * cell
    y = bounds.top - south - (np.arange(height.shape[0]) + 0.5) * cell
    lines = left.contour(x, y, filled, levels, colors="black", linewidths=0.4)
    left.clabel(lines, fontsize=6, fmt="%g")
    left.set_title(f"bare earth, contours every {interval:g} {unit}")
    known = sigma.compressed()
    shown = right.imshow(
        sigma.filled(np.nan), cmap="viridis", extent=extent, norm="log", vmin=float(np.quantile(known, 0.01)), vmax=float(known.max())
    )
    figure.colorbar(shown, ax=right, shrink=0.7, label=f"sigma of the height, {unit}")
    right.set_title("sigma of the height")
    for axes in (left, right):
        axes.set(xlabel=f"east of {west:.0f}, {unit}", ylabel=f"north of {south:.0f}, {unit}", aspect="equal")
    figure.savefig(picture, dpi=90)


if __name__ == "__main__":
    main()
