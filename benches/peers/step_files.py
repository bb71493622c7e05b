import sys
from OCP.gp import *
from OCP.BRepPrimAPI import *
from OCP.BRepAlgoAPI import *
from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
from OCP.TopExp import TopExp_Explorer
from OCP.TopAbs import *
from OCP.TopoDS import TopoDS
from OCP.STEPControl import *
from OCP.Interface import Interface_Static
from OCP.GProp import GProp_GProps
from OCP.BRepGProp import BRepGProp
from OCP.BRepBuilderAPI import *
from OCP.GeomAPI import *
from OCP.TColgp import *
from OCP.TopLoc import TopLoc_Location
out=sys.argv[1]
def props(s):
    g=GProp_GProps(); BRepGProp.SurfaceProperties_s(s,g); v=GProp_GProps(); BRepGProp.VolumeProperties_s(s,v); return g.Mass(),v.Mass()
def write(s,name,unit="MM",mode=STEPControl_AsIs):
    w=STEPControl_Writer(); Interface_Static.SetCVal_s("write.step.unit",unit); Interface_Static.SetIVal_s("write.precision.mode",0)
    Interface_Static.SetIVal_s("write.surfacecurve.mode",0)
    w.Transfer(s,mode); w.Write(out+"/"+name)
    print(name,unit,"area %.9g volume %.9g (mm)"%props(s))
# a box with rounded edges and a hole, in inches
b=BRepPrimAPI_MakeBox(40.,30.,20.).Shape()
f=BRepFilletAPI_MakeFillet(b)
e=TopExp_Explorer(b,TopAbs_EDGE); seen=[]
while e.More():
    E=TopoDS.Edge(e.Current())
    if not any(E.IsSame(x) for x in seen): seen.append(E); f.Add(4.,E)
    e.Next()
b=f.Shape()
h=BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(20,15,-1),gp_Dir(0,0,1)),6.,30.).Shape()
write(BRepAlgoAPI_Cut(b,h).Shape(),"rounded_box.step","INCH")
# turned: ball with a bore, cone to its tip, ring, ball quarter
def moved(s,x): 
    t=gp_Trsf(); t.SetTranslation(gp_Vec(x,0,0)); return s.Moved(TopLoc_Location(t))
from OCP.BRep import BRep_Builder
from OCP.TopoDS import TopoDS_Compound
c=TopoDS_Compound(); B=BRep_Builder(); B.MakeCompound(c)
ball=BRepPrimAPI_MakeSphere(10.).Shape()
bore=BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(0,0,-20),gp_Dir(0,0.3,1)),3.,60.).Shape()
parts=[BRepPrimAPI_MakeSphere(10.).Shape(), BRepAlgoAPI_Cut(ball,bore).Shape(), BRepPrimAPI_MakeCone(8.,0.,12.).Shape(), BRepPrimAPI_MakeTorus(10.,3.).Shape(), BRepPrimAPI_MakeSphere(gp_Ax2(gp_Pnt(0,0,0),gp_Dir(0,0,1)),10.,0.2,1.2,1.5).Shape(), BRepPrimAPI_MakeCone(3.,8.,12.,4.).Shape(), BRepPrimAPI_MakeTorus(gp_Ax2(gp_Pnt(0,0,0),gp_Dir(1,1,1)),10.,3.,1.0).Shape(), BRepPrimAPI_MakeTorus(gp_Ax2(gp_Pnt(0,0,0),gp_Dir(0,0,1)),10.,3.,-0.7,2.1).Shape()]
for k,p in enumerate(parts): 
    print(" part",k,"area %.9g volume %.9g"%props(p)); B.Add(c,moved(p,40.*k))
write(c,"turned.step")
# a trimmed sheet of a B-spline with a hole
import math
import OCP, pkgutil, importlib
from OCP.Geom import Geom_BSplineCurve
from OCP.BRepOffsetAPI import BRepOffsetAPI_ThruSections
def curve(points, closed=False):
    # through points by a bezier chain is not needed: fillet-free wires by polygon smoothed in ThruSections
    w=BRepBuilderAPI_MakePolygon()
    for p in points: w.Add(gp_Pnt(*p))
    if closed: w.Close()
    return w.Wire()
L=BRepOffsetAPI_ThruSections(False,False); 
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeWire
def arcwire(i):
    c=gp_Circ(gp_Ax2(gp_Pnt(10*i,35,-40+6*math.sin(0.9*i)),gp_Dir(1,0.1*math.sin(i),0)),52+3*math.cos(1.3*i))
    return BRepBuilderAPI_MakeWire(BRepBuilderAPI_MakeEdge(c,0.9,2.2).Edge()).Wire()
for i in range(1,9): L.AddWire(arcwire(i))
L.Build(); face=L.Shape()
t=BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(45,36,-20),gp_Dir(0,0,1)),26.,60.).Shape()
t2=BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(50,40,-20),gp_Dir(0,0.1,1)),7.,60.).Shape()
sh=BRepAlgoAPI_Cut(BRepAlgoAPI_Common(face,t).Shape(),t2).Shape()
write(sh,"sheet.step")
# swept: a spline turned and moved
from OCP.gp import gp_Elips
ed=BRepBuilderAPI_MakeEdge(gp_Elips(gp_Ax2(gp_Pnt(12,0,10),gp_Dir(0,1,0)),9.,3.),0.3,2.6).Edge()
rev=BRepPrimAPI_MakeRevol(ed,gp_Ax1(gp_Pnt(0,0,0),gp_Dir(0,0,1))).Shape()
ed=BRepBuilderAPI_MakeEdge(gp_Elips(gp_Ax2(gp_Pnt(30,0,0),gp_Dir(0,0,1)),9.,3.)).Edge()
pr=BRepPrimAPI_MakePrism(ed,gp_Vec(1,2,15)).Shape()
part=BRepPrimAPI_MakeRevol(BRepBuilderAPI_MakeEdge(gp_Pnt(60,0,0),gp_Pnt(66,3,9)).Edge(),gp_Ax1(gp_Pnt(50,0,0),gp_Dir(0,0,1)),2.5).Shape()
c=TopoDS_Compound(); B.MakeCompound(c)
for k,s in enumerate([rev,pr,part]): B.Add(c,s); print(" part",k,"area %.9g"%props(s)[0])
write(c,"swept.step")
# assembly
from OCP.TDocStd import TDocStd_Document
from OCP.TCollection import TCollection_ExtendedString
from OCP.XCAFApp import XCAFApp_Application
from OCP.XCAFDoc import XCAFDoc_DocumentTool
from OCP.STEPCAFControl import STEPCAFControl_Writer
doc=TDocStd_Document(TCollection_ExtendedString("x")); XCAFApp_Application.GetApplication_s().NewDocument(TCollection_ExtendedString("MDTV-XCAF"),doc)
st=XCAFDoc_DocumentTool.ShapeTool_s(doc.Main())
box=BRepPrimAPI_MakeBox(10.,20.,30.).Shape()
lb=st.AddShape(box,False); asm=st.NewShape(); top=st.NewShape()
def loc(x,y,z,ang,ax=gp_Dir(0,0,1)):
    t=gp_Trsf(); t.SetRotation(gp_Ax1(gp_Pnt(0,0,0),ax),ang); t2=gp_Trsf(); t2.SetTranslation(gp_Vec(x,y,z)); return TopLoc_Location(t2*t)
st.AddComponent(asm,lb,loc(0,0,0,0)); st.AddComponent(asm,lb,loc(100,0,0,math.pi/2))
st.AddComponent(top,asm,loc(0,0,0,0)); st.AddComponent(top,asm,loc(0,0,500,math.pi/2,gp_Dir(1,0,0)))
st.UpdateAssemblies()
Interface_Static.SetCVal_s("write.step.unit","MM")
w=STEPCAFControl_Writer(); w.Transfer(doc,STEPControl_AsIs); w.Write(out+"/assembly.step")
from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib
bb=Bnd_Box(); BRepBndLib.AddOptimal_s(st.GetShape_s(top),bb,False,False); print("assembly",props(st.GetShape_s(top)), bb.Get())
