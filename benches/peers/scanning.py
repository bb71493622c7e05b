"""Simulated scans of a mesh whose surface is the ground truth.

A scanner at each of several viewpoints around the object measures where its rays first meet the surface.
Readings have an isotropic error of known σ, and some of them are outliers. All numbers follow from the seed.
"""

import os
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

SIZE = 100.0  # Largest extent of every object.
DISTANCE = 3.0  # From the centre of the object to the views, in radii of its bounding sphere.
GRAZING = 0.17  # Rays within 10 degrees of the surface return nothing: cosine of the angle to the normal.
NEIGHBOURS = 12  # For normals, within one scan.


@dataclass
class Scan:
    """Readings of one view: measured points, estimated normals, and what the simulation knows about them."""

    viewpoint: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    hits: np.ndarray  # True points on the surface.
    hit_normals: np.ndarray
    outlier: np.ndarray


@dataclass
class Surface:
    """A triangle mesh for ray casting and distances."""

    vertices: np.ndarray
    triangles: np.ndarray

    def __post_init__(self):
        corners = self.vertices[self.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled = np.linalg.norm(cross, axis=1)
        self.areas = doubled / 2
        self.normals = cross / np.maximum(doubled, 1e-300)[:, None]
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(
            o3d.core.Tensor(self.vertices.astype(np.float32)),
            o3d.core.Tensor(self.triangles.astype(np.uint32)),
        )

    def at(self, triangles, u, v):
        """Points at barycentric coordinates, in full precision."""
        a, b, c = self.vertices[self.triangles[triangles]].transpose(1, 0, 2)
        return a * (1 - u - v)[:, None] + b * u[:, None] + c * v[:, None]

    def cast(self, origins, directions):
        """The answer of Open3D: `t_hit`, `primitive_ids` and `primitive_uvs`, of rays from origins."""
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
        return {
            key: value.numpy()
            for key, value in self.scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32))).items()
        }

    def closest(self, points):
        """The closest points on the surface and their triangles."""
        found = self.scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        triangles, uv = found["primitive_ids"].numpy(), found["primitive_uvs"].numpy().astype(float)
        return self.at(triangles, uv[:, 0], uv[:, 1]), triangles

    def distances(self, points):
        return np.linalg.norm(points - self.closest(points)[0], axis=1)

    def sample(self, count, rng):
        """Points distributed evenly over the surface, and their normals."""
        triangles = rng.choice(len(self.triangles), count, p=self.areas / self.areas.sum())
        u, v = rng.random((2, count))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        return self.at(triangles, u, v), self.normals[triangles]


def load(path, subdivisions=0):
    """A closed mesh, centred and scaled to SIZE, with outward normals, after subdivisions by Loop's rule."""
    mesh = o3d.io.read_triangle_mesh(path)
    mesh.remove_duplicated_vertices()
    if subdivisions:
        # Open3D warns that it drops texture coordinates, which no scan measures.
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            mesh = mesh.subdivide_loop(subdivisions)
    return centred(np.asarray(mesh.vertices), np.asarray(mesh.triangles))


def centred(vertices, triangles):
    """A closed mesh, centred and scaled to SIZE, with outward normals."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2) * (SIZE / (high - low).max())
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        triangles = triangles[:, ::-1]
    return Surface(vertices, triangles)


def views(count, rng):
    """Unit directions, spread over the sphere by a spiral of Fibonacci with a random rotation."""
    i = np.arange(count) + 0.5
    height, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    across = np.sqrt(1 - height**2)
    spiral = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    turn, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    return spiral @ (turn * np.sign(np.diag(upper)))


def first_hits(surface, viewpoint, radius, side, rng):
    """True points and normals where a grid of side × side rays meets the surface, without grazing rays."""
    toward = -viewpoint / np.linalg.norm(viewpoint)
    across = np.cross(toward, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    ticks = (np.arange(side) + rng.random()) / side * 2 - 1
    x, y = (radius * a.ravel() for a in np.meshgrid(ticks, ticks))
    targets = x[:, None] * across + y[:, None] * np.cross(toward, across)
    directions = targets - viewpoint
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = surface.cast(viewpoint, directions)
    hit = np.isfinite(found["t_hit"])
    triangles, uv = found["primitive_ids"][hit], found["primitive_uvs"][hit].astype(float)
    facing = -np.einsum("ij,ij->i", directions[hit], surface.normals[triangles]) > GRAZING
    triangles, uv = triangles[facing], uv[facing]
    return surface.at(triangles, uv[:, 0], uv[:, 1]), surface.normals[triangles]


def add_outliers(points, viewpoint, radius, share, rng):
    """Replaces a share of the points in place, and returns which ones.

    Half lie in a shell around the object, half along their rays.
    """
    outlier = rng.random(len(points)) < share
    in_shell = outlier & (rng.random(len(points)) < 0.5)
    along = outlier & ~in_shell
    directions = rng.standard_normal((in_shell.sum(), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points[in_shell] = directions * radius * rng.uniform(0.2**3, 1.2**3, (len(directions), 1)) ** (1 / 3)
    rays = points[along] - viewpoint
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    points[along] += rays * rng.uniform(-0.2, 0.2, (len(rays), 1)) * SIZE
    return outlier


def estimated_normals(points, toward):
    """Normals from the nearest readings of the scan; `toward` is the direction to the scanner."""
    near = points[cKDTree(points).query(points, NEIGHBOURS)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]
    return np.where(np.einsum("ij,ij->i", normals, toward)[:, None] < 0, -normals, normals)


def scan_all(surface, scans, readings, sigma, outliers, rng):
    """Scans of an object with about `readings` readings in all."""
    radius = np.linalg.norm(surface.vertices, axis=1).max()
    made = []
    for direction in views(scans, rng):
        viewpoint = direction * DISTANCE * radius
        share = len(first_hits(surface, viewpoint, radius, 100, rng)[0]) / 100**2
        side = round(np.sqrt(readings / scans / share))
        hits, hit_normals = first_hits(surface, viewpoint, radius, side, rng)
        points = hits + rng.normal(0, sigma, hits.shape)
        outlier = add_outliers(points, viewpoint, radius, outliers, rng)
        normals = estimated_normals(points, viewpoint - points)
        made.append(Scan(viewpoint, points, normals, hits, hit_normals, outlier))
    return made


def write_ply(path, points, normals, sigma):
    """Writes one scan with its normals and σ."""
    table = np.zeros(len(points), dtype=[("p", "<f8", 3), ("n", "<f4", 3), ("s", "<f8")])
    table["p"], table["n"], table["s"] = points, normals, sigma
    columns = ["double x", "double y", "double z", "float nx", "float ny", "float nz", "double sigma"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {column}" for column in columns] + ["end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode() + table.tobytes())


def write_job(folder, scans, sigma):
    """Writes the scans and a job that lists them. Returns the path of the job."""
    lines = ['unit = "mm"', "", "[sensor.scanner]", 'kind = "range"', f"sigma = {sigma}"]
    for number, scan in enumerate(scans, 1):
        name = f"scan-{number}.ply"
        write_ply(os.path.join(folder, name), scan.points, scan.normals, sigma)
        viewpoint = f"viewpoint = {scan.viewpoint.tolist()}"
        lines += ["", "[[scan]]", 'sensor = "scanner"', f'file = "{name}"', viewpoint]
    path = os.path.join(folder, "job.toml")
    with open(path, "w") as file:
        file.write("\n".join(lines) + "\n")
    return path
