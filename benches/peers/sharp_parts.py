"""Machined parts with sharp edges and random dimensions, as closed meshes for `topology.py`.

Each part has an arbitrary rotation. Facets of round faces miss them by at most 2e-5 of their radius. Needs
manifold3d.
"""

import zlib

import manifold3d as m3
import numpy as np

FACETS = 512  # Around a full circle.


def round_bar(length, radius):
    return m3.Manifold.cylinder(length, radius, circular_segments=FACETS, center=True)


def box(rng):
    return m3.Manifold.cube(rng.uniform(40, 100, 3), True)


def plate(rng):
    """A plate with one to three holes."""
    length, width, height = rng.uniform(80, 100), rng.uniform(45, 70), rng.uniform(10, 25)
    made = m3.Manifold.cube([length, width, height], True)
    count = rng.integers(1, 4)
    for k in range(count):
        at = length * ((k + 0.5) / count - 0.5)
        radius = rng.uniform(0.18, 0.3) * min(width, length / count)
        hole = round_bar(2 * height, radius)
        made -= hole.translate([at, rng.uniform(-0.1, 0.1) * width, 0])
    return made


def cylinder(rng):
    return round_bar(rng.uniform(50, 100), rng.uniform(15, 35))


def wedge(rng):
    length, width, height = rng.uniform(70, 100), rng.uniform(40, 70), rng.uniform(25, 50)
    outline = m3.CrossSection([[[0, 0], [length, 0], [rng.uniform(0.2, 0.8) * length, height]]])
    return m3.Manifold.extrude(outline, width)


def washer(rng):
    height, radius = rng.uniform(15, 30), rng.uniform(35, 50)
    return round_bar(height, radius) - round_bar(2 * height, rng.uniform(0.35, 0.6) * radius)


def shaft(rng):
    """A shaft with two or three steps."""
    made, at = m3.Manifold(), 0.0
    for _ in range(rng.integers(2, 4)):
        length = rng.uniform(20, 40)
        step = m3.Manifold.cylinder(length + 1e-6, rng.uniform(10, 30), circular_segments=FACETS)
        made, at = made + step.translate([0, 0, at]), at + length
    return made


def cut(rng):
    """A box without the corners beyond a tilted plane."""
    size = rng.uniform(50, 90, 3)
    normal = rng.uniform(0.3, 1, 3)
    normal /= np.linalg.norm(normal)
    return m3.Manifold.cube(size, True).trim_by_plane(-normal, -rng.uniform(0.45, 0.7) * normal @ size / 2)


def bracket(rng):
    """An L-shaped bracket with a hole in each leg."""
    length, width, height, wall = rng.uniform([70, 35, 50, 12], [100, 60, 80, 20])
    made = m3.Manifold.cube([length, width, wall]) + m3.Manifold.cube([wall, width, height])
    if rng.random() < 0.5:
        hole = round_bar(4 * wall, rng.uniform(0.15, 0.25) * width)
        made -= hole.translate([0.6 * length, width / 2, 0])
    return made


def pocket(rng):
    """A block with a pocket that is open above."""
    size = rng.uniform([70, 50, 30], [100, 80, 50])
    inner = size * rng.uniform(0.4, 0.65, 3)
    height = (size[2] - 0.7 * inner[2]) / 2
    return m3.Manifold.cube(size, True) - m3.Manifold.cube(inner, True).translate([0, 0, height])


def slotted(rng):
    """A block with a slot along its length."""
    size = rng.uniform([70, 50, 30], [100, 80, 50])
    slot = m3.Manifold.cube([2 * size[0], rng.uniform(0.25, 0.4) * size[1], size[2]], True)
    moved = slot.translate([0, rng.uniform(-0.1, 0.1) * size[1], rng.uniform(0.5, 0.7) * size[2]])
    return m3.Manifold.cube(size, True) - moved


def boss(rng):
    """A block with a round boss."""
    size = rng.uniform([60, 60, 20], [100, 90, 35])
    height, radius = rng.uniform(15, 35), rng.uniform(0.2, 0.35) * size[1]
    at = [*rng.uniform(-0.1, 0.1, 2) * size[:2], (size[2] + height) / 2 - 1e-6]
    return m3.Manifold.cube(size, True) + round_bar(height, radius).translate(at)


PARTS = {
    made.__name__: made
    for made in (box, plate, cylinder, wedge, washer, shaft, cut, bracket, pocket, slotted, boss)
}


def part(name, seed):
    """Vertices and triangles of a part."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    mesh = PARTS[name](rng).to_mesh64()
    turn, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    turn = turn * np.sign(np.diag(upper))
    turn *= np.sign(np.linalg.det(turn))
    return np.asarray(mesh.vert_properties)[:, :3] @ turn.T, np.asarray(mesh.tri_verts).astype(np.int64)
