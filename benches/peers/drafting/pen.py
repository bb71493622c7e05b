"""Writes the entities of a sheet and records which of them belong to which view or annotation."""

import math
import random

import ezdxf
from ezdxf.enums import TextEntityAlignment
from ezdxf.render.hatching import hatch_entity

from .styles import LANGUAGES

COLORS = {
    "visible": 7,
    "hidden": 3,
    "centre": 1,
    "dimension": 4,
    "text": 2,
    "hatch": 8,
    "section": 1,
    "thin": 5,
}


class Pen:
    """All positions and lengths are millimetres of paper; `unit` is the length of one of them in the file."""

    def __init__(self, traits, dice, unit, factor):
        self.traits, self.unit = traits, unit
        self.doc = ezdxf.new(traits["version"], units=4)
        self.space = self.model = self.doc.modelspace()
        self.language = LANGUAGES[traits["language"]]
        self.digits = 4 if traits["decimals"] == "4" else 12
        self.shift, self.factor = (0.0, 0.0), unit
        self.entities, self.thick = {}, 2.5
        size = dice.choice([0.2, 0.35, 0.5])
        self.linetypes = {}
        for role, choices in (("hidden", self.language.hidden), ("centre", self.language.centre)):
            name, text, pattern = dice.choice(choices)
            self.linetypes[role] = name
            self.doc.linetypes.add(name, [size * unit * p for p in pattern], description=text)
        self.linetypes["section"] = self.linetypes["centre"]
        by_layer = traits["style-by"] == "layer"
        for role, name in self.language.layers.items():
            line = self.linetypes.get(role, "CONTINUOUS") if by_layer else "CONTINUOUS"
            self.doc.layers.add(name, color=COLORS.get(role, 7), linetype=line)
        self.doc.styles.add("ISO", font="isocp.shx" if dice.random() < 0.5 else "arial.ttf")
        self.add_dimstyle(factor)

    def add_dimstyle(self, factor):
        style = self.doc.dimstyles.new("ISO-25")
        lengths = {"dimtxt": 3.5, "dimasz": 2.5, "dimexe": 1.25, "dimexo": 0.9, "dimgap": 0.8, "dimcen": 0.0}
        for name, value in lengths.items():
            style.dxf.set(name, value * self.unit)
        style.dxf.dimtad, style.dxf.dimdec, style.dxf.dimzin, style.dxf.dimlfac = 1, 2, 8, factor
        style.dxf.dimtxsty, style.dxf.dimtih, style.dxf.dimtoh = "ISO", 0, 0
        style.dxf.dimtofl, style.dxf.dimadec = 1, 1

    def look(self, role):
        """Layer and line type of a role."""
        by = self.traits["style-by"]
        found = {"layer": "0" if by == "entity-on-0" else self.language.layers[role]}
        if by != "layer" and role in self.linetypes:
            found["linetype"] = self.linetypes[role]
        if by == "entity-on-0" and role in COLORS:
            found["color"] = COLORS[role]
        return found

    def at(self, point):
        return tuple(round((point[k] - self.shift[k]) * self.factor, self.digits) for k in (0, 1))

    def keep(self, entity, group):
        self.entities.setdefault(group, []).append(entity.dxf.handle)
        return entity

    def line(self, group, role, p, q):
        return self.keep(self.space.add_line(self.at(p), self.at(q), dxfattribs=self.look(role)), group)

    def lines(self, group, role, points, closed=False):
        points = [self.at(p) for p in points]
        return self.keep(self.space.add_lwpolyline(points, close=closed, dxfattribs=self.look(role)), group)

    def circle(self, group, role, center, radius):
        radius = round(radius * self.factor, self.digits)
        return self.keep(self.space.add_circle(self.at(center), radius, dxfattribs=self.look(role)), group)

    def curve(self, group, role, curve):
        data, look, r = curve.data, self.look(role), self.factor
        if curve.kind == "line":
            return self.line(group, role, *data)
        if curve.is_closed() and curve.kind == "arc":
            return self.circle(group, role, data[0], data[1])
        if curve.kind == "arc":
            angles = [round(a % 360, self.digits + 2) for a in (data[2], data[2] + data[3])]
            radius = round(data[1] * r, self.digits)
            return self.keep(self.space.add_arc(self.at(data[0]), radius, *angles, dxfattribs=look), group)
        if curve.kind == "ellipse":
            major = [round(c * r, self.digits) for c in data[1]]
            ends = [math.radians(data[3]), math.radians(data[3] + data[4])]
            ends = [0.0, math.tau] if curve.is_closed() else ends
            made = self.space.add_ellipse(self.at(data[0]), major, data[2], *ends, dxfattribs=look)
            return self.keep(made, group)
        spline = self.space.add_spline(degree=data[0], dxfattribs=look)
        spline.control_points = [(*self.at(p), 0.0) for p in data[2]]
        spline.knots = data[1]
        return self.keep(spline, group)

    def text(self, group, point, words, height=3.5, align="LEFT", role="text", rotation=0):
        look = {**self.look(role), "style": "ISO", "rotation": rotation}
        made = self.space.add_text(words, height=height * self.factor, dxfattribs=look)
        made.set_placement(self.at(point), align=TextEntityAlignment[align])
        return self.keep(made, group)

    def paragraph(self, group, point, words, height=3.5):
        look = {**self.look("text"), "style": "ISO", "char_height": height * self.factor}
        made = self.space.add_mtext(words, dxfattribs=look)
        made.set_location(self.at(point), attachment_point=1)
        return self.keep(made, group)

    def arrow(self, group, role, tip, direction, size=3.0):
        """A filled arrow head."""
        c, s = math.cos(direction), math.sin(direction)
        back = (tip[0] - size * c, tip[1] - size * s)
        sides = [(back[0] - k * size / 6 * s, back[1] + k * size / 6 * c) for k in (1, -1)]
        made = self.space.add_solid([self.at(p) for p in (tip, *sides)], dxfattribs=self.look(role))
        return self.keep(made, group)

    def hatch(self, group, outlines, exploded, angle=45):
        """Hatches between outlines."""
        hatch = self.space.add_hatch(color=8, dxfattribs=self.look("hatch"))
        hatch.set_pattern_fill("ANSI31", scale=1.0 * self.factor, angle=angle - 45)
        for points in outlines:
            hatch.paths.add_polyline_path([self.at(p) for p in points], is_closed=True, flags=1)
        if not exploded:
            self.keep(hatch, group)
            return
        # ezdxf moves the lines at random, so that they miss corners.
        random.seed(0)
        for line in hatch_entity(hatch):
            ends = [tuple(round(c, self.digits) for c in (p.x, p.y)) for p in line]
            self.keep(self.space.add_line(*ends, dxfattribs=self.look("hatch")), group)
        self.space.delete_entity(hatch)

    def dimension(self, kind, true_length=None, prefix="", **placed):
        """Draws a dimension; without DIMLFAC, its text is fixed to the true length."""
        for key in ("base", "p1", "p2", "center", "mpoint", "location"):
            if key in placed:
                placed[key] = self.at(placed[key])
        text = prefix + "<>"
        if self.traits["scale-mark"] == "title" and true_length is not None:
            sign = {"diameter": "Ø", "radius": "R"}.get(kind, "")
            text = f"{prefix}{sign}{round(true_length, 2):g}"
        add = getattr(self.model, f"add_{kind}_dim")
        look = {**self.look("dimension")}
        made = add(**placed, text=text, dimstyle="ISO-25", dxfattribs=look)
        made.render()
        if self.traits["dimensions"] == "exploded":
            for entity in made.dimension.explode():
                self.keep(entity, "dimensions")
        else:
            self.keep(made.dimension, "dimensions")

    def in_block(self, name, origin, factor):
        """Directs what follows into a block, whose lengths are `factor` times those of the paper."""
        self.space = self.doc.blocks.new(name)
        self.shift, self.factor = origin, factor

    def insert(self, group, name, values=None):
        """Ends the block and inserts it where it was drawn."""
        origin, scale = self.shift, self.unit / self.factor
        self.space, self.shift, self.factor = self.model, (0.0, 0.0), self.unit
        look = {"xscale": scale, "yscale": scale, "layer": "0"}
        made = self.model.add_blockref(name, self.at(origin), dxfattribs=look)
        if values:
            made.add_auto_attribs(values)
        return self.keep(made, group)
