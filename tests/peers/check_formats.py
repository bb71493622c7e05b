"""Exchanges files with the libraries of other programs in both directions, and prints a table of the differences.

    pip install numpy trimesh laspy lazrs pye57 pillow tifffile cadquery-ocp-novtk
    cargo build --release
    python tests/peers/check_formats.py [--planish target/release/planish] [--pcd organised.pcd]

Reading: the peer writes points of the example scans in every format, and `planish info --json` must report the same
number of points in the same box. Writing: the example is fitted, and the peer must read the same surface from every
file. Peers that are not installed are reported and skipped. With `--pcd`, an organised cloud of a depth camera
(fx = fy = 525, cx = 319.5, cy = 239.5) is also converted to depth images. Exits with 1 if anything differs.
"""

import argparse
import gzip
import importlib
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

EXAMPLE = Path(__file__).parents[2] / "examples" / "data" / "pebble"
PLY_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4"}
PCD_TYPES = {"F4": "<f4", "F8": "<f8", "U4": "<u4", "U1": "u1", "U2": "<u2", "I4": "<i4"}
rows = []


def peer(name):
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"{name} is not installed: its formats are skipped")
        return None


def report(what, by, expected, found, largest, tolerance):
    good = expected == found and largest <= tolerance
    rows.append((what, by, str(expected), str(found), f"{largest:.1e}", f"{tolerance:.0e}", "ok" if good else "WRONG"))


def read_ply(path):
    """Vertices, triangles and range grid of a binary little-endian PLY file."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    elements, size = [], {}
    for words in (line.split() for line in data[:end].decode().splitlines()):
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            elements[-1][2].append(words[1:])
        elif words[0] == "obj_info":
            size[words[1]] = int(words[2])
    found, at = {}, end
    for name, count, properties in elements:
        if properties[0][0] == "list":
            lists = []
            for _ in range(count):
                n = data[at]
                lists.append(struct.unpack_from(f"<{n}i", data, at + 1))
                at += 1 + 4 * n
            found[name] = lists
        else:
            kind = np.dtype([(word[1], PLY_TYPES[word[0]]) for word in properties])
            found[name] = np.frombuffer(data, kind, count, at)
            at += count * kind.itemsize
    found["size"] = (size.get("num_rows"), size.get("num_cols"))
    return found


def columns(table, names):
    return np.stack([table[name].astype(float) for name in names], axis=1)


def read_pcd(path):
    """Coordinates of every record of a binary_compressed PCD file, row by row."""
    data = path.read_bytes()
    end = data.index(b"DATA binary_compressed\n") + len(b"DATA binary_compressed\n")
    header = {line.split()[0]: line.split()[1:] for line in data[:end].decode().splitlines()}
    packed, length = struct.unpack_from("<II", data, end)
    source, out, at = data[end + 8 : end + 8 + packed], bytearray(), 0
    while at < len(source):
        control = source[at]
        at += 1
        if control < 32:
            out += source[at : at + control + 1]
            at += control + 1
            continue
        count = control >> 5
        if count == 7:
            count += source[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - source[at] - 1
        at += 1
        for k in range(start, start + count + 2):
            out.append(out[k])
    assert len(out) == length
    n, at, found = int(header["POINTS"][0]), 0, {}
    for name, size, kind in zip(header["FIELDS"], header["SIZE"], header["TYPE"]):
        found[name] = np.frombuffer(bytes(out), PCD_TYPES[kind + size], n, at)
        at += n * int(size)
    shape = (int(header["HEIGHT"][0]), int(header["WIDTH"][0]), 3)
    return columns(found, "xyz").reshape(shape)


class Planish:
    def __init__(self, path):
        self.path = path

    def __call__(self, *arguments):
        done = subprocess.run([self.path, *map(str, arguments), "--json"], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"planish {' '.join(map(str, arguments))}: {done.stderr.strip()}")
        return json.loads(done.stdout)

    def holds(self, path, by, points, tolerance, unit=None, what=None, key="points"):
        """Reports whether a file holds the finite points, by their number and bounding box."""
        points = points.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        try:
            info = self("info", path)
        except RuntimeError as e:
            print(e)
            report(what or path.name, by, len(points), "error", np.inf, tolerance)
            return {}
        box = np.array([info["box"]["min"], info["box"]["max"]])
        largest = np.abs(box - [points.min(axis=0), points.max(axis=0)]).max()
        report(what or path.name, by, len(points), info[key], largest, tolerance)
        if unit is not None:
            report(f"{what or path.name}: unit", by, unit, info["unit"], 0.0, 0.0)
        return info


def check_arrays(planish, folder, points, organised):
    sigma = np.linspace(0.1, 0.2, len(points))
    # Tolerance for single precision.
    f4 = 1e-5
    files = {
        "c.npy": (points, 0),
        "fortran.npy": (np.asfortranarray(points), 0),
        "big.npy": (points.astype(">f8"), 0),
        "single.npy": (points.astype("<f4"), f4),
        "big-single-fortran.npy": (np.asfortranarray(points.astype(">f4")), f4),
        "organised.npy": (organised, 0),
        "organised-fortran.npy": (np.asfortranarray(organised), 0),
    }
    for name, (array, tolerance) in files.items():
        np.save(folder / name, array)
        info = planish.holds(folder / name, "numpy", array.astype(float), tolerance)
        if array.ndim == 3:
            grid = info.get("grid") or {}
            report(f"{name}: grid", "numpy", array.shape[:2], (grid.get("rows"), grid.get("columns")), 0.0, 0.0)
    whole = np.rint(points * 1000).astype("<i4")
    np.save(folder / "integers.npy", whole)
    planish.holds(folder / "integers.npy", "numpy", whole.astype(float), 0)
    table = np.zeros(len(points), [("id", "<i8"), ("x", "<f8"), ("y", ">f8"), ("z", "<f8"), ("sigma", "<f4")])
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    table["sigma"] = sigma
    np.save(folder / "structured.npy", table)
    info = planish.holds(folder / "structured.npy", "numpy", points, 0)
    report("structured.npy: columns", "numpy", "x y z sigma", " ".join(info.get("columns", [])), 0.0, 0.0)
    np.savez(folder / "stored.npz", points=points, sigma=sigma)
    np.savez_compressed(folder / "packed.npz", points=points.astype("<f4"), sigma=sigma, normals=np.asfortranarray(points))
    planish.holds(folder / "stored.npz", "numpy", points, 0)
    info = planish.holds(folder / "packed.npz", "numpy", points, f4)
    report("packed.npz: columns", "numpy", "x y z sigma nx ny nz", " ".join(info.get("columns", [])), 0.0, 0.0)
    np.savez(folder / "single.npz", points)
    planish.holds(folder / "single.npz", "numpy", points, 0)
    np.savetxt(folder / "plain.xyz", points, fmt="%.17g")
    planish.holds(folder / "plain.xyz", "numpy", points, 0)
    np.savetxt(folder / "named.csv", np.c_[sigma, points], fmt="%.17g", delimiter=",", header="sigma,x,y,z", comments="")
    planish.holds(folder / "named.csv", "numpy", points, 0)


def check_meshes_in(planish, folder, points, vertices, triangles):
    trimesh = peer("trimesh")
    if trimesh is None:
        return
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    cloud = trimesh.PointCloud(points)
    for name, geometry, tolerance, options in [
        ("mesh.ply", mesh, 1e-5, {}),
        ("mesh-ascii.ply", mesh, 1e-5, {"encoding": "ascii"}),
        ("mesh.obj", mesh, 1e-6, {"digits": 10}),
        ("normals.obj", mesh, 1e-6, {"digits": 10, "include_normals": True}),
        ("mesh.stl", mesh, 1e-5, {}),
        ("mesh-ascii.stl", mesh, 1e-5, {"file_type": "stl_ascii"}),
        ("mesh.glb", mesh, 1e-5, {}),
    ]:
        path = folder / name
        geometry.export(path, **options)
        info = planish.holds(path, "trimesh", vertices, tolerance, key="vertices")
        report(f"{name}: triangles", "trimesh", len(triangles), info.get("triangles"), 0.0, 0.0)
        volume = info.get("volume") or np.nan
        report(f"{name}: volume", "trimesh", True, info.get("watertight"), abs(volume / mesh.volume - 1), 1e-6)
    far = trimesh.Scene()
    far.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([4e6, -1e6, 300]))
    far.export(folder / "far.glb")
    planish.holds(folder / "far.glb", "trimesh", vertices + [4e6, -1e6, 300], 1e-5, unit="m", key="vertices")
    cloud.export(folder / "cloud.ply")
    planish.holds(folder / "cloud.ply", "trimesh", points, 1e-5)
    with gzip.open(folder / "mesh.obj.gz", "wb") as packed:
        packed.write((folder / "mesh.obj").read_bytes())
    planish.holds(folder / "mesh.obj.gz", "gzip", vertices, 1e-6, key="vertices")


def check_lidar(planish, folder, points):
    laspy = peer("laspy")
    if laspy is None:
        return
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [1e-6] * 3
    las.x, las.y, las.z = points.T
    for name in ["a.las", "a.laz"]:
        try:
            las.write(str(folder / name))
        except Exception as e:
            print(f"laspy did not write {name}: {e}")
            continue
        planish.holds(folder / name, "laspy", points, 1e-6)


def check_e57(planish, folder, points):
    pye57 = peer("pye57")
    if pye57 is None:
        return
    path = folder / "two.e57"
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    quaternion = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
    file = pye57.E57(str(path), mode="w")
    state = np.zeros(len(points), dtype=np.uint8)
    state[::10] = 2
    kept = points[state == 0]
    for shift in ([1.0, 2.0, 3.0], [-50.0, 0.0, 7.0]):
        data = {f"cartesian{axis}": points[:, k].copy() for k, axis in enumerate("XYZ")}
        data["cartesianInvalidState"] = state
        file.write_scan_raw(data, rotation=quaternion, translation=np.array(shift))
    file.close()
    world = np.concatenate([kept @ turn.T + shift for shift in ([1.0, 2.0, 3.0], [-50.0, 0.0, 7.0])])
    # pye57 writes float32.
    info = planish.holds(path, "pye57", world, 1e-4, unit="m")
    report("two.e57: scans", "pye57", 2, len(info.get("scans", [])), 0.0, 0.0)
    found = info["scans"][1]
    largest = np.abs(np.array(found["translation"]) - [-50.0, 0.0, 7.0]).max()
    q = np.array(found["quaternion_xyzw"])
    largest = max(largest, np.abs(q - np.roll(quaternion, -1)).max())
    report("two.e57: pose", "pye57", "second", "second", largest, 1e-12)


def check_depth(planish, folder, cloud, name, tolerance):
    """Checks depth images of an organised cloud in metres, which hold it up to one step of depth."""
    height, width, _ = cloud.shape
    depth = np.nan_to_num(cloud[..., 2])
    steps = np.rint(depth * 1000).astype(np.uint16)
    v, u = np.mgrid[0:height, 0:width]
    ray = np.stack([(u - 319.5) / 525, (v - 239.5) / 525, np.ones_like(u)], axis=2)
    calibration = "unit = 'm'\nfx = 525\nfy = 525\ncx = 319.5\ncy = 239.5\nsigma_a = 0.0015\nsigma_b = 0.0019\n"
    images = []
    Image = peer("PIL.Image")
    if Image is not None:
        Image.fromarray(steps).save(folder / f"{name}.png")
        images.append(("png", "pillow", steps / 1000.0, 0.001))
    tifffile = peer("tifffile")
    if tifffile is not None:
        tifffile.imwrite(folder / f"{name}-plain.tif", depth.astype(np.float32))
        tifffile.imwrite(folder / f"{name}-packed.tif", steps, compression="zlib", predictor=True)
        images += [("-plain.tif", "tifffile", depth, 1), ("-packed.tif", "tifffile", steps / 1000.0, 0.001)]
    np.save(folder / f"{name}-array.npy", depth)
    images.append(("-array.npy", "numpy", depth, 1))
    for suffix, by, z, scale in images:
        path = folder / (f"{name}.{suffix}" if suffix == "png" else f"{name}{suffix}")
        path.with_suffix(".toml").write_text(f"{calibration}scale = {scale}\n")
        points = np.where(z[..., None] > 0, ray * z[..., None], np.nan)
        info = planish.holds(path, by, points, 1e-6, unit="m")
        grid = info.get("grid") or {}
        report(f"{path.name}: grid", by, (height, width), (grid.get("rows"), grid.get("columns")), 0.0, 0.0)
    if tolerance is not None:
        # The points of the camera itself, because the image does not contain x and y.
        points = np.where(depth[..., None] > 0, ray * depth[..., None], np.nan)
        largest = np.nanmax(np.abs(points - cloud))
        report(f"{name}: the camera's own points", "its cloud", "same", "same", largest, tolerance)


def check_out(planish, folder):
    trimesh = peer("trimesh")
    names = ["a.ply", "a.ply.gz", "a.obj", "a.obj.gz", "a.stl", "a.stl.gz", "a.glb", "a.step", "a.step.gz", "a.planish"]
    outputs = [word for name in names for word in ("-o", folder / name)]
    planish("fit", EXAMPLE / "job.toml", *outputs)
    for name in names:
        if name.endswith(".gz"):
            plain = gzip.open(folder / name).read()
            report(name, "gzip", True, plain == (folder / name[:-3]).read_bytes(), 0.0, 0.0)
    found = read_ply(folder / "a.ply")
    vertices, faces = columns(found["vertex"], "xyz"), np.array(found["face"])
    corners = vertices[faces]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    if trimesh is not None:
        for name, factor, tolerance in [("a.ply", 1, 1e-5), ("a.obj", 1, 1e-12), ("a.stl", 1, 1e-5), ("a.glb", 1000, 1e-5)]:
            loaded = trimesh.load(folder / name, process=name == "a.stl")
            mesh = loaded.to_geometry() if hasattr(loaded, "to_geometry") else loaded
            read = np.asarray(mesh.vertices) * factor
            largest = np.abs([read.min(axis=0) - vertices.min(axis=0), read.max(axis=0) - vertices.max(axis=0)]).max()
            if name != "a.stl":
                largest = np.abs(read - vertices).max() if len(read) == len(vertices) else np.inf
            report(name, "trimesh", (len(vertices), len(faces)), (len(read), len(mesh.faces)), largest, tolerance)
            report(f"{name}: closed", "trimesh", True, mesh.is_watertight, abs(mesh.volume * factor**3 / volume - 1), 1e-6)
            if name == "a.glb":
                stored = next(iter(loaded.geometry.values()))
                attributes = stored.vertex_attributes
                for key, column in [("_SIGMA", "sigma"), ("_OBSERVED", "observed")]:
                    values = np.asarray(attributes.get(key, np.full(1, np.nan))).reshape(-1)
                    truth = found["vertex"][column].astype(float)
                    same = len(values) == len(truth)
                    largest = np.abs(values / np.maximum(truth, 1e-30) - 1)[truth > 0].max() if same else np.inf
                    report(f"{name}: {key}", "trimesh", len(truth), len(values), largest, 1e-6)
                largest = np.abs(stored.vertex_normals - columns(found["vertex"], ["nx", "ny", "nz"])).max()
                report(f"{name}: NORMAL", "trimesh", "same", "same", largest, 1e-5)
    for name in ["a.ply", "a.obj", "a.stl", "a.glb", "a.stl.gz"]:
        factor = 0.001 if name == "a.glb" else 1
        planish.holds(folder / name, "planish", vertices * factor, 1e-5, unit="m" if name == "a.glb" else "mm", key="vertices")
        done = planish("compare", folder / "a.planish", folder / name)
        # The chord error of the mesh is at most half the median σ; its vertices lie on the surface.
        report(f"compare with {name}", "planish", len(vertices), done["backward"]["n"], done["backward"]["max"], 1e-4)
        done = planish("compare", folder / name, EXAMPLE / "truth.ply")
        covered = done["coverage95"]
        # Only these formats contain σ, without which there is no coverage.
        with_sigma = {"a.ply", "a.glb"}
        report(f"compare {name} with truth", "planish", name in with_sigma, covered is not None, abs((covered or 0.95) - 0.95), 0.05)


def check_step(planish, folder):
    try:
        import check_step
    except ImportError as e:
        print(f"Open Cascade is not installed ({e}): STEP is skipped")
        return
    job = (EXAMPLE / "job.toml").read_text()
    assert 'unit = "mm"' in job
    for unit, millimetres in [("mm", 1.0), ("m", 1000.0), ("in", 25.4)]:
        for name in EXAMPLE.glob("*.ply"):
            # Each file states its unit, too.
            data = name.read_bytes().replace(b"comment unit mm", f"comment unit {unit}".encode(), 1)
            (folder / name.name).write_bytes(data)
        (folder / "job.toml").write_text(job.replace('unit = "mm"', f'unit = "{unit}"'))
        mesh = folder / f"{unit}.ply"
        planish("fit", folder / "job.toml", "-o", folder / f"{unit}.step", "-o", mesh)
        read = check_step.check(str(folder / f"{unit}.step"))
        vertices = columns(read_ply(mesh)["vertex"], "xyz") * millimetres
        box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        largest = np.abs(np.array(read["box"]) - box).max() / millimetres
        report(f"{unit}.step", "Open Cascade", (True, 1), (read["valid"], read["solids"]), largest, 0.05)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planish", default="target/release/planish")
    parser.add_argument("--pcd", type=Path, help="an organised cloud of a depth camera, binary_compressed")
    arguments = parser.parse_args()
    planish = Planish(arguments.planish)
    scan, truth = read_ply(EXAMPLE / "laser-1.ply"), read_ply(EXAMPLE / "truth.ply")
    points = columns(scan["vertex"], "xyz")
    cells = [points[cell[0]] if cell else [np.nan] * 3 for cell in scan["range_grid"]]
    organised = np.array(cells).reshape(*scan["size"], 3)
    vertices, triangles = columns(truth["vertex"], "xyz"), np.array(truth["face"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        check_arrays(planish, folder, points, organised)
        check_meshes_in(planish, folder, points, vertices, triangles)
        check_lidar(planish, folder, points)
        check_e57(planish, folder, points)
        v, u = np.mgrid[0:480, 0:640]
        slope = 0.8 + 0.001 * u + 0.0005 * v
        slope[::7, ::5] = np.nan
        check_depth(planish, folder, np.dstack([slope, slope, slope]), "slope", None)
        if arguments.pcd:
            check_depth(planish, folder, read_pcd(arguments.pcd), "camera", 1e-5)
        check_out(planish, folder)
        check_step(planish, folder)
    heads = ("file", "peer", "expected", "found", "largest difference", "allowed", "")
    widths = [max(len(row[k]) for row in [heads, *rows]) for k in range(len(heads))]
    for row in [heads, *rows]:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
    wrong = sum(row[-1] != "ok" for row in rows)
    print(f"{len(rows)} comparisons, {wrong} wrong")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
