"""Compares a solid with the true one: volume, faces, and the distance between their surfaces."""

import random

import numpy

from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex, BRepBuilderAPI_Transform
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.gp import gp_Pnt, gp_Trsf
from OCP.TopLoc import TopLoc_Location

from . import shapes

SAMPLES = 120
# Rays of `shares_by_rays` along each of the two other axes: errors of about 0.001 for parts with holes.
RAYS = 100
# Largest difference of the overlaps by rays and by a Boolean of Open Cascade that has not failed.
BOOLEAN_ERROR = 0.01


def triangulated(shape, chord, angle):
    """Each face with its mesh, the place of the mesh, and the numbers of the three nodes of each triangle."""
    BRepMesh_IncrementalMesh(shape, chord, False, angle)
    for face in shapes.faces_of(shape):
        place = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, place)
        if mesh is not None:
            yield face, mesh, place, [mesh.Triangle(k).Get()[-3:] for k in range(1, mesh.NbTriangles() + 1)]


def points_on(shape, size, count=SAMPLES):
    """Points on all faces, exactly on their surfaces, at the corners and middles of triangles."""
    found = []
    for face, mesh, _, triangles in triangulated(shape, size / 200, 0.3):
        surface = BRepAdaptor_Surface(face)
        on_face = []
        for corners in triangles:
            uv = [mesh.UVNode(c) for c in corners]
            middle = surface.Value(sum(p.X() for p in uv) / 3, sum(p.Y() for p in uv) / 3)
            on_face.append((middle.X(), middle.Y(), middle.Z()))
        found.append(on_face)
    dice, chosen = random.Random(0), []
    # Each face has its share, so that small faces are tested, too.
    for on_face in found:
        chosen += dice.sample(on_face, min(len(on_face), max(3, count // max(1, len(found)))))
    return chosen


def farthest(shape, other, size):
    """Largest distance of sampled points of a shape from the surface of another one."""
    skin = shapes.together(shapes.faces_of(other))
    largest = 0.0
    for point in points_on(shape, size):
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*point)).Vertex()
        largest = max(largest, BRepExtrema_DistShapeShape(vertex, skin).Value())
    return largest


def at_origin(shape):
    low, high = shapes.bounds(shape)
    identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return shapes.moved(shape, identity, [-c for c in low]), [h - c for c, h in zip(low, high)]


def scaled(shape, factor):
    change = gp_Trsf()
    change.SetScaleFactor(factor)
    return BRepBuilderAPI_Transform(shape, change, True).Shape()


def joined(shape):
    """Bodies that touch as one solid: a drawing does not show whether they are one."""
    solids = shapes.solids_of(shape)
    return shapes.unified(shapes.fuse(*solids)) if len(solids) > 1 else shape


def compare(found, true, tolerance):
    """What is equal; both shapes are moved so that the lower corners of their bounds coincide.

    `tolerance` is the distance in millimetres that the decimals and displacements of the drawing explain.
    """
    (found, size), (true, true_size) = at_origin(joined(found)), at_origin(joined(true))
    volume, true_volume = shapes.volume(found), shapes.volume(true)
    result = {
        "is_valid": shapes.is_valid(found),
        "volume_error": volume / true_volume - 1,
        "faces_equal": shapes.face_kinds(found) == shapes.face_kinds(true),
        "scale": max(size) / max(true_size),
    }
    result["distance"] = distance(found, size, true, true_size, volume, true_volume, tolerance)
    factor = max(true_size) / max(size)
    result["is_right"] = result["is_valid"] and result["distance"] <= tolerance
    if not result["is_right"] and abs(factor - 1) > 1e-3:
        # Whether only the scale is wrong.
        other = scaled(found, factor)
        size = [s * factor for s in size]
        away = distance(
            other, size, true, true_size, volume * factor**3, true_volume, tolerance * max(1, factor)
        )
        result["only_scale"] = result["is_valid"] and away <= tolerance * max(1, factor)
    return result


def compare_picture(found, true):
    """What is equal when both shapes are as large: a picture has no scale. Right are solids with the same
    kinds of faces of which 97 % of the union are common."""
    (found, size), (true, true_size) = at_origin(joined(found)), at_origin(joined(true))
    factor = max(true_size) / max(size)
    found = scaled(found, factor)
    volume, true_volume = shapes.volume(found), shapes.volume(true)
    result = {
        "is_valid": shapes.is_valid(found),
        "volume_error": volume / true_volume - 1,
        "faces_equal": shapes.face_kinds(found) == shapes.face_kinds(true),
        "iou": overlap(found, true),
        "size_errors": [factor * s / t - 1 for s, t in zip(size, true_size)],
    }
    result["is_right"] = result["is_valid"] and result["faces_equal"] and result["iou"] > 0.97
    return result


def overlap(found, true):
    """Common volume divided by that of the union, at most 1.

    A Boolean of Open Cascade is exact, but may fail without an error, for example with a volume larger than
    that of both shapes. It counts only if intervals along rays agree with it.
    """
    sampled = shares_by_rays(found, true)
    try:
        common = shapes.volume(shapes.common(found, true))
        exact = common / (shapes.volume(found) + shapes.volume(true) - common)
    except Exception:  # Open Cascade raises errors of its own.
        return sampled
    return min(exact, 1.0) if abs(exact - sampled) <= BOOLEAN_ERROR else sampled


def shares_by_rays(found, true):
    """`overlap` by the intervals in which rays along the z axis are inside of both shapes."""
    low, high = shapes.bounds(shapes.together([found, true]))
    size = max(h - c for c, h in zip(low, high))
    # Not in the middle of a cell: rays along edges of symmetric parts hit no triangle or two.
    steps = (numpy.arange(RAYS) + 0.4142) / RAYS
    grid = [low[k] + (high[k] - low[k]) * steps for k in (0, 1)]
    inside, union = 0.0, 0.0
    depths = [depths_along_rays(shape, grid, size) for shape in (found, true)]
    for key in set(depths[0]) | set(depths[1]):
        ends = [sorted(d.get(key, [])) for d in depths]
        # A ray through an edge has an odd number of triangles.
        if any(len(e) % 2 for e in ends):
            continue
        depth = sorted(ends[0] + ends[1])
        for a, b in zip(depth, depth[1:]):
            is_in = [sum(z <= a for z in e) % 2 for e in ends]
            inside += (b - a) * all(is_in)
            union += (b - a) * any(is_in)
    return inside / union if union > 0 else 0.0


def depths_along_rays(shape, grid, size):
    """Depths at which rays along the z axis cross triangles of the shape, for each place of a grid."""
    found = {}
    for _, mesh, place, triangles in triangulated(shape, size / 1000, 0.2):
        nodes = [mesh.Node(k).Transformed(place.Transformation()) for k in range(1, mesh.NbNodes() + 1)]
        nodes = numpy.array([[p.X(), p.Y(), p.Z()] for p in nodes])
        for corners in triangles:
            a, b, c = nodes[[n - 1 for n in corners]]
            u, v = b - a, c - a
            area = u[0] * v[1] - u[1] * v[0]
            if abs(area) < 1e-12 * size * size:
                continue
            box = [(min(a[i], b[i], c[i]), max(a[i], b[i], c[i])) for i in (0, 1)]
            ranges = [numpy.arange(*numpy.searchsorted(grid[i], box[i])) for i in (0, 1)]
            if not len(ranges[0]) * len(ranges[1]):
                continue
            x, y = (grid[0][ranges[0]] - a[0])[:, None], (grid[1][ranges[1]] - a[1])[None, :]
            s, t = (x * v[1] - y * v[0]) / area, (u[0] * y - u[1] * x) / area
            for i, j in zip(*numpy.nonzero((s >= 0) & (t >= 0) & (s + t <= 1))):
                key = (ranges[0][i], ranges[1][j])
                found.setdefault(key, []).append(a[2] + s[i, j] * u[2] + t[i, j] * v[2])
    return found


def distance(found, size, true, true_size, volume, true_volume, tolerance):
    """Largest distance between the surfaces; infinite if bounds or volumes differ by far more."""
    away = max(abs(a - b) for a, b in zip(size, true_size))
    if away > 3 * tolerance or abs(volume / true_volume - 1) > 0.02:
        return max(away, 1e9)
    return max(farthest(found, true, max(true_size)), farthest(true, found, max(true_size)))
