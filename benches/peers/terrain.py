#!/usr/bin/env python3
"""Pictures of terrain: hillshade with contours and the map of sigma, from what `planish fit --ground -o dem.tif` wrote.

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
    # Axes count from the corner: seven digits before the point do not fit under a picture.
    west, south = np.floor(bounds.left), np.floor(bounds.bottom)
    extent = [bounds.left - west, bounds.right - west, bounds.bottom - south, bounds.top - south]
    filled = height.filled(np.nan)
    shade = LightSource(azdeg=315, altdeg=40).hillshade(filled, vert_exag=2, dx=cell, dy=cell)
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 6.2), constrained_layout=True)
    left.imshow(shade, cmap="gray", extent=extent, vmin=0, vmax=1)
    span = float(height.max() - height.min())
    interval = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0 ** np.floor(np.log10(span / 5))
    levels = np.arange(np.floor(height.min() / interval) * interval, height.max(), interval)
    x = bounds.left - west + (np.arange(height.shape[1]) + 0.5) * cell
    y = bounds.top - south - (np.arange(height.shape[0]) + 0.5) * cell
    lines = left.contour(x, y, filled, levels, cmap="terrain", linewidths=0.6)
    figure.colorbar(lines, ax=left, shrink=0.7, label=f"height, {unit}; contours every {interval:g}")
    left.set_title("bare earth")
    known = sigma.compressed()
    shown = right.imshow(
        sigma.filled(np.nan), cmap="viridis", extent=extent, norm="log", vmin=np.quantile(known, 0.01), vmax=np.quantile(known, 0.995)
    )
    figure.colorbar(shown, ax=right, shrink=0.7, label=f"sigma of the height, {unit}")
    right.set_title("how well it is known")
    for axes in (left, right):
        axes.set(xlabel=f"east of {west:.0f}, {unit}", ylabel=f"north of {south:.0f}, {unit}", aspect="equal")
    figure.savefig(picture, dpi=90)


if __name__ == "__main__":
    main()
