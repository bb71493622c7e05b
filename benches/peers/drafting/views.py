"""Views of a solid by exact hidden-line removal, sections, and centre lines."""

import math

import numpy
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepLib import BRepLib
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.GeomAbs import (
    GeomAbs_Circle,
    GeomAbs_Cylinder,
    GeomAbs_Ellipse,
    GeomAbs_Line,
    GeomAbs_Plane,
)
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape
from OCP.TopAbs import TopAbs_REVERSED, TopAbs_WIRE
from OCP.TopoDS import TopoDS
from scipy.interpolate import make_interp_spline

from .curves import Curve, tidy
from .shapes import box, cut, edges_of, faces_of, parts_of

# Direction towards the eye, and the direction that points to the right.
DIRECTIONS = {
    "front": ((0, -1, 0), (1, 0, 0)),
    "top": ((0, 0, 1), (1, 0, 0)),
    "right": ((1, 0, 0), (0, 1, 0)),
    "left": ((-1, 0, 0), (0, -1, 0)),
    "iso": ((1, -1, 1), (1, 1, 0)),
}
to_wire = getattr(TopoDS, "Wire_s", None) or TopoDS.Wire


def axes_of(view):
    """Unit vectors to the right, upwards and towards the eye."""
    eye, right = (numpy.array(v, float) / numpy.linalg.norm(v) for v in DIRECTIONS[view])
    return right, numpy.cross(eye, right), eye


def curve_of(edge, visible, smooth):
    curve = BRepAdaptor_Curve(edge)
    lo, hi = curve.FirstParameter(), curve.LastParameter()
    at = lambda t: (curve.Value(t).X(), curve.Value(t).Y())
    kind = curve.GetType()
    if kind == GeomAbs_Line:
        return Curve("line", (at(lo), at(hi)), visible, smooth)
    if kind in (GeomAbs_Circle, GeomAbs_Ellipse):
        conic = curve.Circle() if kind == GeomAbs_Circle else curve.Ellipse()
        center = (conic.Location().X(), conic.Location().Y())
        if conic.Axis().Direction().Z() < 0:
            lo, hi = -hi, -lo
        x = conic.XAxis().Direction()
        start, sweep = math.degrees(lo), math.degrees(hi - lo)
        if kind == GeomAbs_Circle:
            turn = math.degrees(math.atan2(x.Y(), x.X()))
            return Curve("arc", (center, conic.Radius(), start + turn, sweep), visible, smooth)
        major = conic.MajorRadius()
        ratio = conic.MinorRadius() / major
        return Curve(
            "ellipse", (center, (major * x.X(), major * x.Y()), ratio, start, sweep), visible, smooth
        )
    points = [at(lo + (hi - lo) * k / 40) for k in range(41)]
    (x, y), (u, v) = points[0], points[-1]
    length = math.hypot(u - x, v - y)
    if (
        length > 1e-6
        and max(abs((p[0] - x) * (v - y) - (p[1] - y) * (u - x)) for p in points) < 1e-6 * length
    ):
        return Curve("line", (points[0], points[-1]), visible, smooth)
    return Curve("spline", through(points), visible, smooth)


def through(points):
    """A cubic spline through points, as (degree, knots, poles, weights)."""
    steps = numpy.linalg.norm(numpy.diff(points, axis=0), axis=1)
    at = numpy.concatenate([[0.0], numpy.cumsum(numpy.maximum(steps, 1e-9))])
    spline = make_interp_spline(at, numpy.array(points), k=3)
    return 3, [float(k) for k in spline.t], [tuple(map(float, p)) for p in spline.c], None


def curves_of(shape, view, smooth=False, hidden=True):
    """Curves of a view as the hidden-line removal divides them, along its right and its upward axis."""
    eye, right = DIRECTIONS[view]
    algorithm = HLRBRep_Algo()
    algorithm.Add(shape)
    algorithm.Projector(HLRAlgo_Projector(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(*eye), gp_Dir(*right))))
    algorithm.Update()
    algorithm.Hide()
    found = HLRBRep_HLRToShape(algorithm)
    groups = [(found.VCompound(), True, False), (found.OutLineVCompound(), True, False)]
    groups += [(found.HCompound(), False, False), (found.OutLineHCompound(), False, False)] if hidden else []
    groups += [(found.Rg1LineVCompound(), True, True)] if smooth else []
    curves = []
    for compound, visible, is_smooth in groups:
        if compound is None or compound.IsNull():
            continue
        BRepLib.BuildCurves3d_s(compound)
        curves += [curve_of(e, visible, is_smooth) for e in edges_of(compound)]
    return curves


def project(shape, view, smooth=False, hidden=True):
    """Curves of a view, without pieces and repetitions."""
    return tidy(curves_of(shape, view, smooth, hidden))


def section_plane(shape, axis, dice):
    """A position along the axis that passes through a hole if there is one, else the middle."""
    low, high = (min, max)
    found = []
    for face in faces_of(shape):
        surface = BRepAdaptor_Surface(face)
        if surface.GetType() == GeomAbs_Cylinder:
            at = surface.Cylinder().Axis()
            along = (at.Direction().X(), at.Direction().Y(), at.Direction().Z())[axis]
            if abs(along) < 1e-6:
                found.append((at.Location().X(), at.Location().Y(), at.Location().Z())[axis])
    from .shapes import bounds

    low, high = (b[axis] for b in bounds(shape))
    inside = sorted({round(x, 6) for x in found if low + 1 < x < high - 1})
    return dice.choice(inside) if inside else (low + high) / 2


def section(shape, view, at):
    """Curves of the part behind a plane across the direction of view, and the outlines of the cut faces."""
    right, up, eye = axes_of(view)
    axis = int(numpy.argmax(numpy.abs(eye)))
    lo, hi = [-1e4] * 3, [1e4] * 3
    (lo if eye[axis] > 0 else hi)[axis] = at
    rest = cut(shape, box(lo, hi))
    outlines = []
    for face in faces_of(rest):
        surface = BRepAdaptor_Surface(face)
        if surface.GetType() != GeomAbs_Plane:
            continue
        plane = surface.Plane()
        normal = plane.Axis().Direction()
        where = (plane.Location().X(), plane.Location().Y(), plane.Location().Z())[axis]
        if abs(abs((normal.X(), normal.Y(), normal.Z())[axis]) - 1) < 1e-9 and abs(where - at) < 1e-6:
            outlines.append([wire_points(w, face, right, up) for w in parts_of(face, TopAbs_WIRE)])
    return project(rest, view, hidden=False), outlines


def wire_points(wire, face, right, up):
    explorer, points = BRepTools_WireExplorer(to_wire(wire), face), []
    while explorer.More():
        edge = explorer.Current()
        curve = BRepAdaptor_Curve(edge)
        lo, hi = curve.FirstParameter(), curve.LastParameter()
        count = 1 if curve.GetType() == GeomAbs_Line else 24
        steps = [lo + (hi - lo) * k / count for k in range(count)]
        if edge.Orientation() == TopAbs_REVERSED:
            steps = [hi - (hi - lo) * k / count for k in range(count)]
        found = [numpy.array([curve.Value(t).X(), curve.Value(t).Y(), curve.Value(t).Z()]) for t in steps]
        points += [(float(p @ right), float(p @ up)) for p in found]
        explorer.Next()
    return points


def axes_and_centres(shape, view):
    """Centre lines of holes and round ends: (centre, radius) of circles and (begin, end) of axes."""
    right, up, eye = axes_of(view)
    circles, lines = set(), set()
    for face in faces_of(shape):
        surface = BRepAdaptor_Surface(face)
        if surface.GetType() != GeomAbs_Cylinder:
            continue
        u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
        if u1 - u0 < 2.9:
            continue
        axis = surface.Cylinder().Axis()
        along = numpy.array([axis.Direction().X(), axis.Direction().Y(), axis.Direction().Z()])
        at = numpy.array([axis.Location().X(), axis.Location().Y(), axis.Location().Z()])
        flat = lambda p: (round(float(p @ right), 5), round(float(p @ up), 5))
        if abs(abs(along @ eye) - 1) < 1e-9:
            circles.add((flat(at), round(surface.Cylinder().Radius(), 5)))
        elif abs(along @ eye) < 1e-9:
            lines.add(tuple(sorted((flat(at + (v0 - 3) * along), flat(at + (v1 + 3) * along)))))
    largest = {}
    for center, radius in circles:
        largest[center] = max(radius, largest.get(center, 0))
    return list(largest.items()), joined_axes(lines)


def joined_axes(lines):
    """Joins overlapping axes on one line."""
    joined = tidy([Curve("line", line) for line in lines])
    return [c.data for c in joined]
