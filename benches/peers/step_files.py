"""Makes the STEP files of the reader's tests with Open Cascade, and prints area and volume in mm² and mm³.

Needs cadquery-ocp.

    python benches/peers/step_files.py FOLDER && gzip -9n FOLDER/*.step
"""

import math
import pathlib
import sys

from OCP.BRep import BRep_Builder
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeWire
from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
from OCP.BRepGProp import BRepGProp
from OCP.BRepOffsetAPI import BRepOffsetAPI_ThruSections
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakePrism,
    BRepPrimAPI_MakeRevol,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.gp import gp_Ax1, gp_Ax2, gp_Circ, gp_Dir, gp_Elips, gp_Pnt, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.Interface import Interface_Static
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_EDGE
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Compound
from OCP.XCAFApp import XCAFApp_Application
from OCP.XCAFDoc import XCAFDoc_DocumentTool

ORIGIN = gp_Pnt(0, 0, 0)
UP = gp_Dir(0, 0, 1)


def measured(shape):
    area, volume = GProp_GProps(), GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, area)
    BRepGProp.VolumeProperties_s(shape, volume)
    return f"area {area.Mass():.9g} volume {volume.Mass():.9g}"


def write(shape, path, unit="MM"):
    """Writes edges as curves in space only, so that a reader has to find their position on the surface."""
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    Interface_Static.SetIVal_s("write.precision.mode", 0)
    Interface_Static.SetIVal_s("write.surfacecurve.mode", 0)
    writer.Transfer(shape, STEPControl_AsIs)
    writer.Write(str(path))
    print(path.name, unit, measured(shape))


def edges(shape):
    explorer, seen = TopExp_Explorer(shape, TopAbs_EDGE), []
    while explorer.More():
        edge = TopoDS.Edge(explorer.Current())
        if not any(edge.IsSame(other) for other in seen):
            seen.append(edge)
        explorer.Next()
    return seen


def cylinder(at, along, radius, length):
    return BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*at), gp_Dir(*along)), radius, length).Shape()


def together(parts):
    compound, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(compound)
    for k, part in enumerate(parts):
        print(" part", k, measured(part))
        builder.Add(compound, part)
    return compound


def placed(at, angle=0.0, axis=UP):
    turn, move = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(ORIGIN, axis), angle)
    move.SetTranslation(gp_Vec(*at))
    return TopLoc_Location(move * turn)


def rounded_box():
    """A box with rounded edges and corners, and a bore."""
    box = BRepPrimAPI_MakeBox(40.0, 30.0, 20.0).Shape()
    rounding = BRepFilletAPI_MakeFillet(box)
    for edge in edges(box):
        rounding.Add(4.0, edge)
    return BRepAlgoAPI_Cut(rounding.Shape(), cylinder((20, 15, -1), (0, 0, 1), 6.0, 30.0)).Shape()


def turned():
    """Complete balls and tori with seams and poles, a cone up to its tip, and pieces of each."""
    ball = BRepPrimAPI_MakeSphere(10.0).Shape()
    upright = gp_Ax2(ORIGIN, UP)
    parts = [
        ball,
        BRepAlgoAPI_Cut(ball, cylinder((0, 0, -20), (0, 0.3, 1), 3.0, 60.0)).Shape(),
        BRepPrimAPI_MakeCone(8.0, 0.0, 12.0).Shape(),
        BRepPrimAPI_MakeTorus(10.0, 3.0).Shape(),
        BRepPrimAPI_MakeSphere(upright, 10.0, 0.2, 1.2, 1.5).Shape(),
        BRepPrimAPI_MakeCone(3.0, 8.0, 12.0, 4.0).Shape(),
        BRepPrimAPI_MakeTorus(gp_Ax2(ORIGIN, gp_Dir(1, 1, 1)), 10.0, 3.0, 1.0).Shape(),
        BRepPrimAPI_MakeTorus(upright, 10.0, 3.0, -0.7, 2.1).Shape(),
    ]
    return together([part.Moved(placed((40.0 * k, 0, 0))) for k, part in enumerate(parts)])


def sheet():
    """A B-spline through eight arcs, trimmed by a cylinder and pierced by another."""
    through = BRepOffsetAPI_ThruSections(False, False)
    for i in range(1, 9):
        middle = gp_Pnt(10 * i, 35, -40 + 6 * math.sin(0.9 * i))
        circle = gp_Circ(gp_Ax2(middle, gp_Dir(1, 0.1 * math.sin(i), 0)), 52 + 3 * math.cos(1.3 * i))
        through.AddWire(BRepBuilderAPI_MakeWire(BRepBuilderAPI_MakeEdge(circle, 0.9, 2.2).Edge()).Wire())
    through.Build()
    trimmed = BRepAlgoAPI_Common(through.Shape(), cylinder((45, 36, -20), (0, 0, 1), 26.0, 60.0)).Shape()
    return BRepAlgoAPI_Cut(trimmed, cylinder((50, 40, -20), (0, 0.1, 1), 7.0, 60.0)).Shape()


def swept():
    """Faces swept by an arc of an ellipse, an ellipse and a line."""
    upright = gp_Ax1(ORIGIN, UP)
    arc = BRepBuilderAPI_MakeEdge(gp_Elips(gp_Ax2(gp_Pnt(12, 0, 10), gp_Dir(0, 1, 0)), 9.0, 3.0), 0.3, 2.6).Edge()
    ellipse = BRepBuilderAPI_MakeEdge(gp_Elips(gp_Ax2(gp_Pnt(30, 0, 0), UP), 9.0, 3.0)).Edge()
    line = BRepBuilderAPI_MakeEdge(gp_Pnt(60, 0, 0), gp_Pnt(66, 3, 9)).Edge()
    return together(
        [
            BRepPrimAPI_MakeRevol(arc, upright).Shape(),
            BRepPrimAPI_MakePrism(ellipse, gp_Vec(1, 2, 15)).Shape(),
            BRepPrimAPI_MakeRevol(line, gp_Ax1(gp_Pnt(50, 0, 0), UP), 2.5).Shape(),
        ]
    )


def write_assembly(path):
    """Two blocks in an assembly, which occurs twice in another one."""
    document = TDocStd_Document(TCollection_ExtendedString("assembly"))
    XCAFApp_Application.GetApplication_s().NewDocument(TCollection_ExtendedString("MDTV-XCAF"), document)
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    block = tool.AddShape(BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape(), False)
    pair, top = tool.NewShape(), tool.NewShape()
    tool.AddComponent(pair, block, placed((0, 0, 0)))
    tool.AddComponent(pair, block, placed((100, 0, 0), math.pi / 2))
    tool.AddComponent(top, pair, placed((0, 0, 0)))
    tool.AddComponent(top, pair, placed((0, 0, 500), math.pi / 2, gp_Dir(1, 0, 0)))
    tool.UpdateAssemblies()
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    writer = STEPCAFControl_Writer()
    writer.Transfer(document, STEPControl_AsIs)
    writer.Write(str(path))
    print(path.name, "MM", measured(tool.GetShape_s(top)))


def main():
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    write(rounded_box(), folder / "rounded_box.step", "INCH")
    write(turned(), folder / "turned.step")
    write(sheet(), folder / "sheet.step")
    write(swept(), folder / "swept.step")
    write_assembly(folder / "assembly.step")


main()
