"""Draws one part: a whole sheet, or three plain files."""

import json

from . import annotate, shapes
from .check import flaws
from .layout import View, drawn_views, number, place
from .pen import Pen
from .views import project

ORTHOGRAPHIC = ("front", "top", "right", "left")


def complete(shape):
    """Whether the views show all edges and outlines, and those in sight as visible lines."""
    return all(flaws(shape, view, project(shape, view)) == (0, 0) for view in ORTHOGRAPHIC)


def lengths(traits):
    """Length of a millimetre of paper in the file, and the factor from the file to true lengths."""
    scale = number(traits["scale"])
    return (1 / scale, 1.0) if traits["scale-mark"] == "frame" else (1.0, 1 / scale)


def draw_view(pen, view, name, traits, dice):
    """Draws the curves of a view; returns handles of its entities in their order."""
    is_block = traits["blocks"] != "no" and view.kind not in ("detail",)
    if is_block:
        factor = pen.unit if traits["blocks"] == "views" else 1 / view.scale
        pen.in_block(
            f"{dice.choice(['View', 'Ansicht', 'VUE', '*U'])}_{name}".replace("*U_", "A$C"), view.at, factor
        )
    for curve in view.curves:
        role = "thin" if curve.smooth else "visible" if curve.visible else "hidden"
        pen.curve(name, role, view.on_paper(curve))
    if view.outlines:
        outlines = [[view.to_paper(p) for p in wire] for face in view.outlines for wire in face]
        pen.hatch("hatch", outlines, dice.random() < 0.4, dice.choice([45, 45, 135]))
    if is_block:
        pen.insert(f"insert {name}", pen.space.name)


def make_sheet(shape, name, traits, dice):
    """A drawing and what is known about it."""
    views = drawn_views(shape, traits, dice)
    sheet = place(views, traits, dice)
    unit, factor = lengths(traits)
    pen = Pen(traits, dice, unit, factor if traits["scale-mark"] == "dimlfac" else 1.0)
    for kind, view in views.items():
        draw_view(pen, view, kind, traits, dice)
    annotate.annotate(pen, shape, views, sheet, name, traits, dice)
    pen.doc.header["$INSUNITS"] = 4
    pen.doc.header["$MEASUREMENT"] = 1
    known = {"true_length_factor": factor, "sheet": [unit * s for s in sheet], "views": {}}
    for kind, view in views.items():
        known["views"][kind] = {
            "box": [unit * c for p in (view.drawn_box[:2], view.drawn_box[2:]) for c in view.to_paper(p)],
            "lengths_per_mm": unit * view.scale,
            "is_section": view.cut_at is not None,
            "entities": pen.entities.pop(kind, []),
        }
    known["annotations"] = pen.entities
    return pen.doc, known


def make_plain(shape, base):
    """Writes front, top and right view as files of their own, in the coordinates of the part."""
    views = {}
    for kind, name in (("front", "front"), ("top", "top"), ("right", "side")):
        traits = {"version": "R2000", "language": "en", "style-by": "layer", "decimals": "full"}
        view = View(kind, project(shape, kind))
        pen = Pen(traits, PLAIN_DICE, 1.0, 1.0)
        for curve in view.curves:
            pen.curve(kind, "visible" if curve.visible else "hidden", curve)
        pen.doc.saveas(f"{base}.{name}.dxf")
        views[kind] = {"file": f"{base.name}.{name}.dxf", "box": list(view.box), "lengths_per_mm": 1.0}
        views[kind] |= {"is_section": False, "entities": pen.entities[kind]}
    return {"true_length_factor": 1.0, "views": views, "annotations": {}}


class PLAIN_DICE:
    """Always the first choice."""

    choice = staticmethod(lambda values: values[0])
    random = staticmethod(lambda: 1.0)


def truth(shape, name, family, features):
    low, high = shapes.bounds(shape)
    return {
        "name": name,
        "family": family,
        "features": features,
        "volume": shapes.volume(shape),
        "bounds": [[round(c, 6) for c in low], [round(c, 6) for c in high]],
        "bodies": len(shapes.solids_of(shape)),
        "faces": shapes.face_kinds(shape),
    }


def save_json(path, content):
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False))


def save_pictures(doc, base, kinds):
    """SVG, PDF or PNG of the whole sheet."""
    from ezdxf.addons.drawing import Frontend, RenderContext, config, layout, svg
    from ezdxf.addons.drawing.matplotlib import qsave

    colors = config.Configuration(background_policy=config.BackgroundPolicy.WHITE, lineweight_scaling=0.5)
    black = colors.with_changes(color_policy=config.ColorPolicy.BLACK)
    for kind in kinds:
        if kind == "svg":
            backend = svg.SVGBackend()
            Frontend(RenderContext(doc), backend, config=colors).draw_layout(doc.modelspace())
            page = layout.Page(0, 0, layout.Units.mm, layout.Margins.all(0))
            text = backend.get_string(page, settings=layout.Settings(scale=1.0, fit_page=False))
            base.with_suffix(".svg").write_text(text)
        else:
            qsave(doc.modelspace(), str(base.with_suffix("." + kind)), config=black, dpi=130, bg="#FFFFFF")
