"""Checks STEP files with Open Cascade and prints one JSON object per file.

    pip install cadquery-ocp-novtk
    python tests/peers/check_step.py part.step ...

Lengths are in millimetres for any unit of the file. Exits with 1 if a file cannot be read or is not valid.
"""

import json
import math
import sys
from collections import Counter

from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.gp import gp_Pnt, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_RetDone
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import (
    TopAbs_EDGE,
    TopAbs_FACE,
    TopAbs_REVERSED,
    TopAbs_SHELL,
    TopAbs_SOLID,
    TopAbs_VERTEX,
)
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS

try:  # Open Cascade 8
    from OCP.collections import (
        IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher as FacesOfEdges,
    )
    from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher as IndexedMap
except ImportError:
    from OCP.TopTools import TopTools_IndexedDataMapOfShapeListOfShape as FacesOfEdges
    from OCP.TopTools import TopTools_IndexedMapOfShape as IndexedMap

# Relative accuracy of areas and volumes.
RELATIVE_ERROR = 1e-6

# In bindings before Open Cascade 8, the names of static functions end with `_s`.
as_vertex, as_edge, as_face = (
    getattr(TopoDS, name + "_s", None) or getattr(TopoDS, name) for name in ("Vertex", "Edge", "Face")
)


def parts(shape, kind):
    """The different parts of a shape of one kind."""
    found = IndexedMap()
    TopExp.MapShapes_s(shape, kind, found)
    return [found.FindKey(i) for i in range(1, found.Extent() + 1)]


def surface_type(face):
    name = BRepAdaptor_Surface(as_face(face)).GetType().name
    return name.removeprefix("GeomAbs_")


def tolerance(shape):
    """Maximum tolerance of vertices and edges. It shows the gaps that the reader had to close."""
    vertices = [BRep_Tool.Tolerance_s(as_vertex(v)) for v in parts(shape, TopAbs_VERTEX)]
    edges = [BRep_Tool.Tolerance_s(as_edge(e)) for e in parts(shape, TopAbs_EDGE)]
    return max(vertices + edges, default=0.0)


def normal_at(edge, face, t):
    """The outer normal of a face at a parameter of one of its edges."""
    place = BRepAdaptor_Curve2d(edge, face).Value(t)
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    BRepAdaptor_Surface(face, False).D1(place.X(), place.Y(), point, along_u, along_v)
    normal = along_u.Crossed(along_v)
    return normal.Reversed() if face.Orientation() == TopAbs_REVERSED else normal


def crease(shape):
    """Maximum angle in degrees between the normals of neighbouring faces, along their common edges."""
    faces_of = FacesOfEdges()
    TopExp.MapShapesAndAncestors_s(shape, TopAbs_EDGE, TopAbs_FACE, faces_of)
    largest = 0.0
    for i in range(1, faces_of.Extent() + 1):
        edge = as_edge(faces_of.FindKey(i))
        faces = [as_face(face) for face in faces_of.FindFromIndex(i)]
        if len(faces) != 2 or BRep_Tool.Degenerated_s(edge):
            continue
        curve = BRepAdaptor_Curve2d(edge, faces[0])
        start, end = curve.FirstParameter(), curve.LastParameter()
        for k in range(1, 20):
            normals = [normal_at(edge, face, start + (end - start) * k / 20) for face in faces]
            if all(normal.Magnitude() > 0.0 for normal in normals):
                largest = max(largest, normals[0].Angle(normals[1]))
    return math.degrees(largest)


def check(path):
    reader = STEPControl_Reader()
    if reader.ReadFile(path) != IFSelect_RetDone:
        return {"file": path, "valid": False, "why": "cannot be read"}
    reader.TransferRoots()
    shape = reader.OneShape()
    if shape.IsNull():
        return {"file": path, "valid": False, "why": "contains no shape"}
    solids, shells, faces = (parts(shape, kind) for kind in (TopAbs_SOLID, TopAbs_SHELL, TopAbs_FACE))
    area, volume, box = GProp_GProps(), GProp_GProps(), Bnd_Box()
    # Without this limit, the area that Open Cascade computes for a ball has an error of 1e-4.
    BRepGProp.SurfaceProperties_s(shape, area, RELATIVE_ERROR)
    if solids:
        BRepGProp.VolumeProperties_s(shape, volume, RELATIVE_ERROR)
    BRepBndLib.AddOptimal_s(shape, box, False, False)
    low, high = box.CornerMin(), box.CornerMax()
    edges = parts(shape, TopAbs_EDGE)
    return {
        "file": path,
        "valid": BRepCheck_Analyzer(shape).IsValid(),
        "faces": len(faces),
        "shells": len(shells),
        "solids": len(solids),
        "edges": len(edges),
        "degenerate_edges": sum(BRep_Tool.Degenerated_s(as_edge(e)) for e in edges),
        "area": area.Mass(),
        "volume": volume.Mass() if solids else None,
        "box": [[p.X(), p.Y(), p.Z()] for p in (low, high)],
        "tolerance": tolerance(shape),
        "crease_deg": crease(shape),
        "surfaces": dict(Counter(surface_type(f) for f in faces)),
    }


def main():
    results = [check(path) for path in sys.argv[1:]]
    for result in results:
        print(json.dumps(result))
    sys.exit(0 if results and all(result["valid"] for result in results) else 1)


if __name__ == "__main__":
    main()
