"""Checks that the views of a solid show its edges and outlines, and nothing else, by rays that are
independent of the hidden-line removal."""

import math

import numpy
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepClass import BRepClass_FaceClassifier
from OCP.BRepTools import BRepTools
from OCP.GeomAbs import GeomAbs_C0, GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Line, GeomAbs_Plane
from OCP.gp import gp_Dir, gp_Lin, gp_Pnt, gp_Pnt2d, gp_Vec
from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
from OCP.TopAbs import TopAbs_IN, TopAbs_ON

from .curves import distances
from .shapes import edges_of, faces_of
from .views import axes_of

NEAR = 0.01
REPORT = False
# Values of the other parameter at which the outline of a curved face is computed.
LEVELS = [0.001, *(k / 40 for k in range(1, 40)), 0.999]


def edges_by_kind(shape):
    """Sharp edges, between two faces that meet at an angle, and smooth edges and seams."""
    owners, sharp, smooth = {}, [], []
    for face in faces_of(shape):
        for edge in edges_of(face):
            owners.setdefault(hash(edge), (edge, []))[1].append(face)
    for edge, faces in owners.values():
        if BRep_Tool.Degenerated_s(edge):
            continue
        is_seam = len(faces) < 2 or BRep_Tool.IsClosed_s(edge, faces[0])
        meets = not is_seam and (
            not BRep_Tool.HasContinuity_s(edge, faces[0], faces[-1])
            or BRep_Tool.Continuity_s(edge, faces[0], faces[-1]) == GeomAbs_C0
        )
        (sharp if meets else smooth).append(edge)
    return sharp, smooth


def outline_of(face, eye):
    """Pieces of the outline of a curved face, as pairs of points where it is seen edge-on."""
    surface = BRepAdaptor_Surface(face)
    if surface.GetType() == GeomAbs_Plane:
        return
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)

    def facing(u, v):
        point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(u, v, point, du, dv)
        normal = du.Crossed(dv)
        return normal.X() * eye[0] + normal.Y() * eye[1] + normal.Z() * eye[2], point

    yield from traced(face, lambda u, v: facing(u, v), (u0, u1), (v0, v1), False)
    if surface.GetType() not in (GeomAbs_Cylinder, GeomAbs_Cone):
        yield from traced(face, lambda v, u: facing(u, v), (v0, v1), (u0, u1), True)


def traced(face, facing, across, along, is_swapped):
    """Pieces of an outline between neighbouring values of one parameter."""
    before = []
    for level in (along[0] + (along[1] - along[0]) * k for k in LEVELS):
        now = []
        for root in roots(lambda x: facing(x, level)[0], *across):
            place = gp_Pnt2d(level, root) if is_swapped else gp_Pnt2d(root, level)
            if BRepClass_FaceClassifier(face, place, 1e-4).State() in (TopAbs_IN, TopAbs_ON):
                point = facing(root, level)[1]
                now.append((root, (point.X(), point.Y(), point.Z())))
        for root, point in now:
            yield from ((other, point) for last, other in before if abs(root - last) < 0.2)
        before = now


def roots(value, lo, hi):
    """Where a function changes its sign by more than rounding."""
    # The outline often is at a multiple of 90° or at the seam: neither may be a node of the grid.
    step = (hi - lo) / 24
    grid = [lo - 0.37 * step if hi - lo > 6.28 else lo, *(lo + (k + 0.63) * step for k in range(24))]
    grid += [] if hi - lo > 6.28 else [hi]
    found = [value(u) for u in grid]
    for a, b, at_a, at_b in zip(grid, grid[1:], found, found[1:]):
        # A face seen edge-on as a whole has no outline but its edges.
        if at_a * at_b > -1e-9:
            continue
        for _ in range(40):
            middle = (a + b) / 2
            at = value(middle)
            a, b, at_a = (middle, b, at) if at_a * at > 0 else (a, middle, at_a)
        yield a


class Sight:
    """Whether a point of a shape can be seen, by rays that pass close to it."""

    def __init__(self, shape, view):
        self.axes = axes_of(view)
        self.rays = IntCurvesFace_ShapeIntersector()
        self.rays.Load(shape, 1e-7)

    def sees(self, point):
        right, up, eye = self.axes
        for k in range(8):
            angle = math.radians(45 * k + 11)
            start = point + 0.004 * (math.cos(angle) * right + math.sin(angle) * up)
            self.rays.Perform(gp_Lin(gp_Pnt(*start), gp_Dir(*eye)), 0.05, 1e4)
            if self.rays.NbPnt() == 0:
                return True
        return False


def pieces(edges):
    """Short pieces of edges, as pairs of points."""
    for edge in edges:
        curve = BRepAdaptor_Curve(edge)
        lo, hi = curve.FirstParameter(), curve.LastParameter()
        count = 8 if curve.GetType() == GeomAbs_Line else 720
        points = [curve.Value(lo + (hi - lo) * k / count) for k in range(count + 1)]
        points = [(p.X(), p.Y(), p.Z()) for p in points]
        yield from zip(points, points[1:])


def segments(shape, eye):
    """Begins and ends of short pieces that must be drawn, and of those that may be drawn."""
    sharp, smooth = edges_by_kind(shape)
    must = [*pieces(sharp), *(pair for face in faces_of(shape) for pair in outline_of(face, eye))]
    # A smooth edge is an outline if one of its faces is seen edge-on.
    both = numpy.array([*must, *pieces(smooth)])
    return len(must), both[:, 0], both[:, 1]


def flaws(shape, view, curves):
    """Number of places that the view lacks, and of drawn places that are wrong.

    A drawn place is wrong if no edge or outline is there, or if it is drawn visible but cannot be seen, or
    reverse.
    """
    right, up, eye = axes_of(view)
    count, begins, ends = segments(shape, eye)
    flat = lambda p: numpy.stack([p @ right, p @ up], axis=-1)
    # Begins lie on the edges; middles of pieces only nearly.
    missing = int((distances(flat(begins[:count:4]), curves) > NEAR).sum())
    sight, wrong = Sight(shape, view), 0
    a, along = flat(begins), flat(ends) - flat(begins)
    square = (along**2).sum(1)
    for curve in curves:
        chain = curve.points(100)
        for place in (chain[k] for k in (13, 52, 87)):
            to = numpy.array(place) - a
            share = numpy.clip((to * along).sum(1) / numpy.maximum(square, 1e-12), 0, 1)
            away = numpy.linalg.norm(to - share[:, None] * along, axis=1)
            # A hidden curve may be close to a visible one.
            # Outlines of tori are given as splines that deviate by some 0.01 mm.
            near = (away < (5 * NEAR if curve.kind == "spline" else NEAR)) & (away < away.min() + 0.002)
            points = (begins + share[:, None] * (ends - begins))[near]
            # A piece along the line of sight is one point of the view: its upper end decides.
            upper = numpy.where((begins @ eye > ends @ eye)[:, None], begins, ends)[near & (square < 1e-12)]
            seen = any(sight.sees(p) for p in (*upper, *points))
            is_wrong = not len(points) or (seen != curve.visible and not curve.smooth)
            wrong += is_wrong
            if is_wrong and REPORT:
                print(view, curve.kind, "visible" if curve.visible else "hidden", place, len(points), seen)
    return missing, wrong
