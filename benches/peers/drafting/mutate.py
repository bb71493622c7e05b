"""Copies of a drawing with one wrong line."""

import ezdxf

from .sheet import save_json

ENDS = {"LINE": ("start", "end"), "CIRCLE": ("center",), "ARC": ("center",), "ELLIPSE": ("center",)}


def points_of(entity):
    """Ends, or centre, or control points of an entity, in the coordinates of its block or of the sheet."""
    if entity.dxftype() == "SPLINE":
        return [[float(p[0]), float(p[1])] for p in entity.control_points]
    return [[entity.dxf.get(k).x, entity.dxf.get(k).y] for k in ENDS[entity.dxftype()]]


def size_of(entity):
    """Length of a line, or the radius, the largest axis or the extent of a curve."""
    if entity.dxftype() == "LINE":
        return (entity.dxf.end - entity.dxf.start).magnitude
    if entity.dxftype() == "ELLIPSE":
        return entity.dxf.major_axis.magnitude
    if entity.dxftype() == "SPLINE":
        points = points_of(entity)
        return max(max(p[k] for p in points) - min(p[k] for p in points) for k in (0, 1))
    return entity.dxf.radius


def other_style(doc, entity, known, view):
    """Layer and line type of another entity of the view, so that a visible line becomes hidden or reverse."""
    for handle in known["views"][view]["entities"]:
        other = doc.entitydb.get(handle)
        if line_type(doc, other) != line_type(doc, entity):
            return other
    return None


def line_type(doc, entity):
    own = entity.dxf.get("linetype", "BYLAYER").upper()
    return doc.layers.get(entity.dxf.layer).dxf.linetype.upper() if own == "BYLAYER" else own


def mutated(base, known, dice, k):
    """Writes `NAME.mK.dxf` (or one of three files) and `NAME.mK.json` with what was changed."""
    view = dice.choice([v for v in known["views"] if v in ("front", "top", "right", "left")])
    seen = known["views"][view]
    source = base.with_name(seen.get("file", f"{base.name}.dxf"))
    doc = ezdxf.readfile(source)
    long = [doc.entitydb[h] for h in seen["entities"]]
    long = [e for e in long if size_of(e) > 0.02 * max(size_of(o) for o in long)]
    entity = dice.choice(long)
    change = dice.choice(["delete", "move", "restyle"])
    other = other_style(doc, entity, known, view) if change == "restyle" else None
    if change == "restyle" and other is None:
        change = "delete"
    space = doc.blocks.get(doc.entitydb[entity.dxf.owner].dxf.name)
    record = {"change": change, "view": view, "handle": entity.dxf.handle, "type": entity.dxftype()}
    record["line_type"] = line_type(doc, entity)
    record["before"] = on_sheet(doc, space, points_of(entity))
    if change == "delete":
        space.delete_entity(entity)
    elif change == "restyle":
        for key in ("layer", "linetype", "color"):
            entity.dxf.set(key, other.dxf.get(key, {"linetype": "BYLAYER", "color": 256}.get(key)))
    else:
        move(entity, dice, seen["lengths_per_mm"], block_scale(doc, space))
    record["after"] = on_sheet(doc, space, points_of(entity)) if change != "delete" else None
    name = f"{base.name}.m{k}"
    extension = source.name[len(base.name) :]
    doc.saveas(base.with_name(name + extension))
    save_json(
        base.with_name(name + ".json"), {"name": name, "of": base.name, "file": name + extension, **record}
    )


def move(entity, dice, lengths_per_mm, block):
    """Moves a line across itself, or a curve in any direction, by 0.5 mm to 4 mm of the part."""
    length = dice.choice([-1, 1]) * dice.uniform(0.5, 4.0) * lengths_per_mm / block
    if entity.dxftype() == "LINE":
        along = (entity.dxf.end - entity.dxf.start).normalize()
        entity.translate(-along.y * length, along.x * length, 0)
    else:
        entity.translate(length, dice.choice([-1, 0, 1]) * length, 0)


def insert_of(doc, space):
    """The INSERT of a block; `None` for the model space."""
    if space.name.lower() == "*model_space":
        return None
    return next(i for i in doc.modelspace().query("INSERT") if i.dxf.name == space.name)


def block_scale(doc, space):
    insert = insert_of(doc, space)
    return insert.dxf.xscale if insert else 1.0


def on_sheet(doc, space, points):
    insert = insert_of(doc, space)
    if insert is None:
        return [[round(c, 4) for c in p] for p in points]
    at, scale = insert.dxf.insert, insert.dxf.xscale
    return [[round(at.x + scale * p[0], 4), round(at.y + scale * p[1], 4)] for p in points]
