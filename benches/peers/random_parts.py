"""Makes random prismatic and cylindrical parts with their three views, for `solids.py`.

Each part is a block to which blocks and cylinders along the axes are added or from which they are cut. All dimensions
are multiples of half a unit, so that faces often touch. The views are made by Open Cascade's hidden-line removal, in
millimetres, on the layers VISIBLE and HIDDEN, without smooth edges. `NAME.step` and `NAME.truth.json` (volume, area,
faces by kind) are written, too. The same seed gives the same parts. Needs cadquery-ocp-novtk and ezdxf.

    python benches/peers/random_parts.py FOLDER 200 --seed 2
"""

import argparse
import json
import pathlib
import random

import ezdxf
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepLib import BRepLib
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
from OCP.GeomAbs import GeomAbs_Circle, GeomAbs_Cylinder, GeomAbs_Line, GeomAbs_Plane
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS

AXES = [gp_Dir(1, 0, 0), gp_Dir(0, 1, 0), gp_Dir(0, 0, 1)]
VIEWS = {
    "front": (gp_Dir(0, -1, 0), gp_Dir(1, 0, 0)),
    "top": (gp_Dir(0, 0, 1), gp_Dir(1, 0, 0)),
    "side": (gp_Dir(1, 0, 0), gp_Dir(0, 1, 0)),
}
to_edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge
to_face = getattr(TopoDS, "Face_s", None) or TopoDS.Face


def parts_of(shape, kind):
    explorer = TopExp_Explorer(shape, kind)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def random_part(dice):
    half = lambda lo, hi: dice.randint(2 * lo, 2 * hi) / 2.0
    size = [half(30, 120) for _ in range(3)]
    shape = BRepPrimAPI_MakeBox(*size).Shape()
    for _ in range(dice.randint(2, 6)):
        if dice.random() < 0.6:
            span = [sorted((half(0, int(s)), half(0, int(s)))) for s in size]
            if any(b - a < 2 for a, b in span):
                continue
            # A step or a pocket, open on at least one side.
            axis = dice.randrange(3)
            span[axis][dice.randrange(2)] = size[axis] if dice.random() < 0.5 else 0.0
            span[axis].sort()
            if any(b - a < 2 for a, b in span):
                continue
            tool = BRepPrimAPI_MakeBox(gp_Pnt(*(s[0] for s in span)), gp_Pnt(*(s[1] for s in span))).Shape()
            shape = BRepAlgoAPI_Cut(shape, tool).Shape()
        else:
            axis = dice.randrange(3)
            radius = half(1, max(2, int(min(size) / 5)))
            at = [half(int(radius), int(s - radius)) for s in size]
            at[axis] = -1.0
            through = dice.random() < 0.6
            depth = size[axis] + 2 if through else half(3, int(size[axis])) + 1
            tool = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*at), AXES[axis]), radius, depth).Shape()
            if dice.random() < 0.25:
                at[axis] = size[axis] / 2
                tool = BRepPrimAPI_MakeCylinder(
                    gp_Ax2(gp_Pnt(*at), AXES[axis]), radius, size[axis] / 2 + half(2, 15)
                ).Shape()
                shape = BRepAlgoAPI_Fuse(shape, tool).Shape()
            else:
                shape = BRepAlgoAPI_Cut(shape, tool).Shape()
    unify = ShapeUpgrade_UnifySameDomain(shape)
    unify.Build()
    return unify.Shape()


def measures(shape):
    volume, area = GProp_GProps(), GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, volume)
    BRepGProp.SurfaceProperties_s(shape, area)
    names = {GeomAbs_Plane: "plane", GeomAbs_Cylinder: "cylinder"}
    faces = {}
    for face in parts_of(shape, TopAbs_FACE):
        name = names.get(BRepAdaptor_Surface(to_face(face)).GetType(), "freeform")
        faces[name] = faces.get(name, 0) + 1
    return {"volume": volume.Mass(), "area": area.Mass(), "faces": faces}


def draw(modelspace, shape, layer):
    if shape is None or shape.IsNull():
        return
    BRepLib.BuildCurves3d_s(shape)
    for found in parts_of(shape, TopAbs_EDGE):
        curve = BRepAdaptor_Curve(to_edge(found))
        lo, hi = curve.FirstParameter(), curve.LastParameter()
        point = lambda t: (curve.Value(t).X(), curve.Value(t).Y())
        style = {"layer": layer}
        if curve.GetType() == GeomAbs_Line:
            modelspace.add_line(point(lo), point(hi), dxfattribs=style)
        elif curve.GetType() == GeomAbs_Circle:
            circle = curve.Circle()
            center = (circle.Location().X(), circle.Location().Y())
            if hi - lo > 6.283185:
                modelspace.add_circle(center, circle.Radius(), dxfattribs=style)
            else:
                turns = circle.Axis().Direction().Z() > 0
                ends = [point(lo), point(hi)] if turns else [point(hi), point(lo)]
                angles = [ezdxf.math.Vec2(e[0] - center[0], e[1] - center[1]).angle_deg for e in ends]
                modelspace.add_arc(center, circle.Radius(), *angles, dxfattribs=style)
        else:
            points = [point(lo + (hi - lo) * k / 32) for k in range(33)]
            straight = max(
                abs((p[0] - points[0][0]) * (points[-1][1] - points[0][1]) - (p[1] - points[0][1]) * (points[-1][0] - points[0][0]))
                for p in points
            )
            if straight < 1e-6:
                modelspace.add_line(points[0], points[-1], dxfattribs=style)
            else:
                modelspace.add_spline(fit_points=points, dxfattribs=style)


def write_views(shape, base):
    for view, (normal, right) in VIEWS.items():
        algorithm = HLRBRep_Algo()
        algorithm.Add(shape)
        algorithm.Projector(HLRAlgo_Projector(gp_Ax2(gp_Pnt(0, 0, 0), normal, right)))
        algorithm.Update()
        algorithm.Hide()
        found = HLRBRep_HLRToShape(algorithm)
        drawing = ezdxf.new("R2000", units=4)
        for layer, shapes in {
            "VISIBLE": (found.VCompound(), found.OutLineVCompound()),
            "HIDDEN": (found.HCompound(), found.OutLineHCompound()),
        }.items():
            drawing.layers.add(layer)
            for shape_of in shapes:
                draw(drawing.modelspace(), shape_of, layer)
        drawing.saveas(f"{base}.{view}.dxf")


def main():
    reading = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reading.add_argument("folder", type=pathlib.Path)
    reading.add_argument("count", type=int)
    reading.add_argument("--seed", type=int, default=2)
    asked = reading.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    dice = random.Random(asked.seed)
    made = 0
    while made < asked.count:
        shape = random_part(dice)
        if len(list(parts_of(shape, TopAbs_SOLID))) != 1 or not BRepCheck_Analyzer(shape).IsValid():
            continue
        name = f"random_{asked.seed}_{made:03}"
        base = asked.folder / name
        write_views(shape, base)
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_AsIs)
        writer.Write(f"{base}.step")
        pathlib.Path(f"{base}.truth.json").write_text(json.dumps({"name": name, **measures(shape)}))
        made += 1


main()
