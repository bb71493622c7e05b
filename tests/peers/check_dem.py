#!/usr/bin/env python3
"""Reads a raster of heights with GDAL (rasterio) and with tifffile, and compares it with its points.

    pip install rasterio tifffile imagecodecs laspy[lazrs]
    planish fit tile.laz --ground -o ground.tif --json > fit.json
    python tests/peers/check_dem.py ground.tif fit.json [tile.laz]

Fails unless both readers agree, the tags are correct, and the distances of the ground points (classes 2 and 8, if there
are any) from the raster agree with the figures of the fit.
"""

import json
import sys

import numpy as np
import rasterio
import tifffile


def check(condition, words):
    if not condition:
        sys.exit(f"check_dem: {words}")
    print("ok:", words)


def main():
    path, figures = sys.argv[1], json.load(open(sys.argv[2]))
    with rasterio.open(path) as gdal:
        bands = gdal.read()
        transform, crs, nodata = gdal.transform, gdal.crs, gdal.nodata
        check(gdal.count == 2 and set(gdal.dtypes) == {"float32"}, "two bands of 32-bit floats")
        check(gdal.descriptions == ("height", "sigma of the height"), f"bands are named: {gdal.descriptions}")
        check(set(gdal.units) == {figures["unit"]}, f"units are those of the fit: {gdal.units}")
        check(nodata == -9999, "nodata is -9999")
        check(gdal.tags().get("AREA_OR_POINT") == "Area", "a pixel is an area")
        check(transform.a == -transform.e and transform.b == transform.d == 0, f"north is up, cells of {transform.a}")
        check(gdal.compression.name == "deflate", "compressed by deflate")
    print("map:", crs.to_epsg() or crs.to_string()[:100] if crs else None)
    check(np.array_equal(np.moveaxis(tifffile.imread(path), -1, 0), bands), "tifffile reads the same samples")
    height, sigma = bands
    known = height != nodata
    check(np.array_equal(known, sigma != nodata) and known.any(), f"{known.mean():.1%} of the cells have values in both bands")
    check((sigma[known] > 0).all(), "every σ is positive")
    median = np.median(sigma[known])
    check(0.3 < median / figures["sigma"]["median"] < 3, f"median σ {median:.4g} agrees with that of the surface")
    if len(sys.argv) > 3:
        import laspy

        cloud = laspy.read(sys.argv[3])
        ground = np.isin(cloud.classification, [2, 8])
        x, y, z = (np.asarray(c)[ground] for c in (cloud.x, cloud.y, cloud.z))
        column = np.floor((x - transform.c) / transform.a).astype(int)
        row = np.floor((transform.f - y) / transform.a).astype(int)
        inside = (column >= 0) & (column < height.shape[1]) & (row >= 0) & (row < height.shape[0])
        column, row, z, x, y = column[inside], row[inside], z[inside], x[inside], y[inside]
        # Distances from the plane through the cell and its neighbours, because a cell is not level.
        filled = np.where(known, height, np.nan).astype(float)
        down, right = np.gradient(filled, transform.a)
        dx = x - (transform.c + (column + 0.5) * transform.a)
        dy = (transform.f - (row + 0.5) * transform.a) - y
        off = z - (filled[row, column] + right[row, column] * dx + down[row, column] * dy)
        off = off[np.isfinite(off)]
        spread = 1.4826 * np.median(np.abs(off))
        check(len(off) > 0.9 * inside.sum(), f"{len(off)} of {inside.sum()} ground points lie over cells with values")
        check(abs(np.median(off)) < 0.3 * spread, f"they have no bias: median {np.median(off):.3g}, spread {spread:.3g}")
        check(spread < 2 * figures["rms"], f"their spread agrees with the fit: rms {figures['rms']:.3g}")


if __name__ == "__main__":
    main()
