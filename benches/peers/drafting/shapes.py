"""Solids of Open Cascade: primitives, prisms of rounded profiles, booleans, measures, STEP."""

import math

from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Builder
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Transform,
)
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepLib import BRepLib
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakePrism,
    BRepPrimAPI_MakeRevol,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.GC import GC_MakeArcOfCircle
from OCP.GeomAbs import (
    GeomAbs_Cone,
    GeomAbs_Cylinder,
    GeomAbs_Plane,
    GeomAbs_Sphere,
    GeomAbs_Torus,
)
from OCP.gp import gp_Ax1, gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.Message import Message, Message_PrinterOStream
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Reader, STEPControl_Writer
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Compound

# Reading and writing STEP otherwise prints statistics.
Message.DefaultMessenger_s().RemovePrinters(Message_PrinterOStream.get_type_descriptor_s())

AXES = {"x": gp_Dir(1, 0, 0), "y": gp_Dir(0, 1, 0), "z": gp_Dir(0, 0, 1)}
# Profiles of `prism` are (u, v) along these two axes, and the prism grows along the third.
PLANES = {"z": (0, 1, 2), "y": (0, 2, 1), "x": (1, 2, 0)}
KINDS = {
    GeomAbs_Plane: "plane",
    GeomAbs_Cylinder: "cylinder",
    GeomAbs_Cone: "cone",
    GeomAbs_Sphere: "sphere",
    GeomAbs_Torus: "torus",
}
to_edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge
to_face = getattr(TopoDS, "Face_s", None) or TopoDS.Face


def parts_of(shape, kind):
    """Each face, edge or solid of the shape once, also if several shapes share it."""
    explorer, seen = TopExp_Explorer(shape, kind), set()
    while explorer.More():
        found = explorer.Current()
        # `==` compares orientations, too; the hash depends on the geometry and its place only.
        key = hash(found)
        if key not in seen:
            seen.add(key)
            yield found
        explorer.Next()


def faces_of(shape):
    return [to_face(f) for f in parts_of(shape, TopAbs_FACE)]


def edges_of(shape):
    return [to_edge(e) for e in parts_of(shape, TopAbs_EDGE)]


def solids_of(shape):
    return list(parts_of(shape, TopAbs_SOLID))


def box(lo, hi):
    return BRepPrimAPI_MakeBox(gp_Pnt(*lo), gp_Pnt(*hi)).Shape()


def frame(at, axis):
    return gp_Ax2(gp_Pnt(*at), AXES[axis])


def cylinder(at, axis, radius, length):
    return BRepPrimAPI_MakeCylinder(frame(at, axis), radius, length).Shape()


def cone(at, axis, first, last, length):
    return BRepPrimAPI_MakeCone(frame(at, axis), first, last, length).Shape()


def sphere(at, radius):
    return BRepPrimAPI_MakeSphere(gp_Pnt(*at), radius).Shape()


def torus(at, axis, ring, tube):
    return BRepPrimAPI_MakeTorus(frame(at, axis), ring, tube).Shape()


def cut(shape, *tools):
    for tool in tools:
        shape = BRepAlgoAPI_Cut(shape, tool).Shape()
    return shape


def common(shape, other):
    return BRepAlgoAPI_Common(shape, other).Shape()


def fuse(shape, *tools):
    for tool in tools:
        shape = BRepAlgoAPI_Fuse(shape, tool).Shape()
    return shape


def corner(before, at, after, radius):
    """Ends and middle of the arc that rounds a corner, or `None` if the sides are too short."""
    back = [before[k] - at[k] for k in (0, 1)]
    on = [after[k] - at[k] for k in (0, 1)]
    lengths = [math.hypot(*back), math.hypot(*on)]
    back, on = [c / lengths[0] for c in back], [c / lengths[1] for c in on]
    half = math.acos(max(-1.0, min(1.0, back[0] * on[0] + back[1] * on[1]))) / 2
    reach = radius / math.tan(half)
    if reach > min(lengths) + 1e-9:
        return None
    bisector = [back[k] + on[k] for k in (0, 1)]
    length = math.hypot(*bisector)
    away = radius / math.sin(half) - radius
    middle = [at[k] + away * bisector[k] / length for k in (0, 1)]
    return [at[k] + reach * back[k] for k in (0, 1)], middle, [at[k] + reach * on[k] for k in (0, 1)]


def wire(points, radii, place):
    """Closed wire through the corners; each corner is rounded with its radius (0: sharp)."""
    n, arcs = len(points), []
    for k, at in enumerate(points):
        arcs.append(corner(points[k - 1], at, points[(k + 1) % n], radii[k]) if radii[k] > 0 else None)
    made = BRepBuilderAPI_MakeWire()
    for k in range(n):
        begin = arcs[k][2] if arcs[k] else points[k]
        end = arcs[(k + 1) % n][0] if arcs[(k + 1) % n] else points[(k + 1) % n]
        if arcs[k]:
            arc = GC_MakeArcOfCircle(*(place(p) for p in arcs[k])).Value()
            made.Add(BRepBuilderAPI_MakeEdge(arc).Edge())
        if math.dist(begin, end) > 1e-7:
            made.Add(BRepBuilderAPI_MakeEdge(place(begin), place(end)).Edge())
    return made.Wire()


def prism(axis, points, start, end, radii=0.0):
    """Solid between two values of one axis, with a polygon of the other two axes as its section."""
    u, v, w = PLANES[axis]

    def place(point):
        at = [0.0, 0.0, 0.0]
        at[u], at[v], at[w] = point[0], point[1], start
        return gp_Pnt(*at)

    radii = [radii] * len(points) if isinstance(radii, (int, float)) else radii
    section = BRepBuilderAPI_MakeFace(wire(points, radii, place)).Face()
    along = [0.0, 0.0, 0.0]
    along[w] = end - start
    return BRepPrimAPI_MakePrism(section, gp_Vec(*along)).Shape()


def rectangle(lo, hi):
    return [(lo[0], lo[1]), (hi[0], lo[1]), (hi[0], hi[1]), (lo[0], hi[1])]


def slot(axis, center, length, radius, start, end, along=0):
    """Slot with round ends; `length` is between the centres of the ends."""
    middle = prism(
        axis,
        rectangle(
            [center[k] - (length / 2 if k == along else radius) for k in (0, 1)],
            [center[k] + (length / 2 if k == along else radius) for k in (0, 1)],
        ),
        start,
        end,
    )
    u, v, w = PLANES[axis]
    for sign in (-1, 1):
        at = [0.0, 0.0, 0.0]
        at[u], at[v], at[w] = center[0], center[1], start
        at[(u, v)[along]] += sign * length / 2
        middle = fuse(middle, cylinder(at, axis, radius, end - start))
    return unified(middle)


def turned(points, radii=0.0):
    """Solid of revolution about the x axis; the profile is (x, radius)."""
    radii = [radii] * len(points) if isinstance(radii, (int, float)) else radii
    section = BRepBuilderAPI_MakeFace(wire(points, radii, lambda p: gp_Pnt(p[0], 0.0, p[1]))).Face()
    return BRepPrimAPI_MakeRevol(section, gp_Ax1(gp_Pnt(0, 0, 0), AXES["x"])).Shape()


def moved(shape, matrix, shift=(0.0, 0.0, 0.0)):
    """The shape after a rotation by a matrix and a translation."""
    rows = [list(matrix[k]) + [shift[k]] for k in range(3)]
    change = gp_Trsf()
    change.SetValues(*rows[0], *rows[1], *rows[2])
    return BRepBuilderAPI_Transform(shape, change, True).Shape()


def together(shapes):
    compound, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(compound)
    for shape in shapes:
        builder.Add(compound, shape)
    return compound


def unified(shape):
    """Joins faces of the same surface and marks smooth edges, which hidden-line removal tells apart."""
    join = ShapeUpgrade_UnifySameDomain(shape)
    join.Build()
    shape = join.Shape()
    BRepLib.EncodeRegularity_s(shape, 1e-5)
    return shape


def is_valid(shape):
    return BRepCheck_Analyzer(shape).IsValid()


def bounds(shape):
    """Lower and upper corner of the exact bounding box."""
    around = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, around, False, False)
    low, high, gap = around.CornerMin(), around.CornerMax(), around.GetGap()
    return [c + gap for c in (low.X(), low.Y(), low.Z())], [c - gap for c in (high.X(), high.Y(), high.Z())]


def volume(shape):
    measured = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, measured, 1e-9)
    return measured.Mass()


def face_kinds(shape):
    found = {}
    for face in faces_of(shape):
        kind = KINDS.get(BRepAdaptor_Surface(face).GetType(), "freeform")
        found[kind] = found.get(kind, 0) + 1
    return found


def write_step(shape, path):
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_AsIs)
    writer.Write(str(path))


def read_step(path):
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return reader.OneShape()
