"""Frame, title block, dimensions, centre lines, marks and notes of a sheet."""

import math

from .layout import TITLE
from .views import axes_and_centres

BASIC = ("front", "top", "right", "left")


def frame(pen, sheet, name, traits, dice):
    """Frame with zones, title block and projection symbol, as lines or as one block with attributes."""
    if traits["frame"] == "no":
        if traits["scale"] != "1:1":
            words = f"{pen.language.words['scale']} {traits['scale']}"
            pen.text("text", (sheet[0] - 60, 12), words, 5)
        return
    is_block = traits["frame"] == "block"
    if is_block:
        pen.in_block("FRAME", (0.0, 0.0), pen.unit * dice.choice([1.0, 0.1]))
    wide, tall = sheet
    corners = lambda x, y, u, v: [(x, y), (u, y), (u, v), (x, v)]
    pen.lines("frame", "thin", corners(0, 0, wide, tall), closed=True)
    inner = corners(20, 10, wide - 10, tall - 10)
    if dice.random() < 0.5:
        pen.lines("frame", "frame", inner, closed=True)
    else:
        for k in range(4):
            pen.line("frame", "frame", inner[k - 1], inner[k])
    zones(pen, sheet)
    title_block(pen, sheet, name, traits, dice, is_block)
    if is_block:
        values = {"TITLE": name, "SCALE": traits["scale"], "DRAWN": dice.choice(["Meier", "Dupont", "Smith"])}
        pen.insert("frame", "FRAME", values)


def zones(pen, sheet):
    wide, tall = sheet
    columns, rows = max(4, 2 * round(wide / 100)), max(2, 2 * round(tall / 100))
    for k in range(columns):
        x, step = 20 + (wide - 30) * k / columns, (wide - 30) / columns
        for lo, hi, y in ((5, 10, 7.5), (tall - 10, tall - 5, tall - 7.5)):
            if k:
                pen.line("frame", "frame", (x, lo), (x, hi))
            pen.text("frame", (x + step / 2, y), str(k + 1), 2.5, "MIDDLE_CENTER", "frame")
    for k in range(rows):
        y, step = 10 + (tall - 20) * k / rows, (tall - 20) / rows
        for lo, hi, x in ((15, 20, 17.5), (wide - 10, wide - 5, wide - 7.5)):
            if k:
                pen.line("frame", "frame", (lo, y), (hi, y))
            pen.text("frame", (x, y + step / 2), chr(65 + rows - 1 - k), 2.5, "MIDDLE_CENTER", "frame")
    # Centring marks.
    pen.line("frame", "frame", (wide / 2, 0), (wide / 2, 15))
    pen.line("frame", "frame", (wide / 2, tall), (wide / 2, tall - 15))


def title_block(pen, sheet, name, traits, dice, is_block):
    words, (w, h) = pen.language.words, TITLE
    x, y = sheet[0] - 10 - w, 10.0
    pen.line("title", "frame", (x, y), (x, y + h))
    for share in (1.0, 0.75, 0.5, 0.25):
        begin = x if share in (1.0, 0.5) else x + 60
        pen.line("title", "frame", (begin, y + share * h), (x + w, y + share * h))
    pen.line("title", "frame", (x + 60, y), (x + 60, y + h))
    pen.line("title", "frame", (x + 120, y), (x + 120, y + 0.5 * h))
    cell = h / 4
    rows = [
        ("title", name, "TITLE"),
        ("material", dice.choice(["S235JR", "EN AW-6082", "C45", "1.4301"]), ""),
    ]
    rows += [
        ("drawn", dice.choice(["Meier", "Dupont", "Smith"]), "DRAWN"),
        ("scale", traits["scale"], "SCALE"),
    ]
    places = [(60, 3), (60, 2), (60, 1), (120, 1)]
    for (label, value, tag), (dx, row) in zip(rows, places):
        pen.text("title", (x + dx + 2, y + (row + 1) * cell - 4), words[label], 2.5, role="frame")
        at = (x + dx + 6, y + row * cell + 2)
        if tag and is_block:
            look = {**pen.look("frame"), "style": "ISO", "height": 4 * pen.factor}
            pen.keep(pen.space.add_attdef(tag, pen.at(at), value, dxfattribs=look), "title")
        else:
            pen.text("title", at, value, 4, role="frame")
    pen.text("title", (x + 62, y + cell - 5), words["date"] + "  2024-05-17", 2.5, role="frame")
    pen.text("title", (x + 2, y + h - 5), words["tolerance"], 2.5, role="frame")
    pen.text("title", (x + 122, y + 3), "A-" + str(dice.randint(1000, 9999)), 4, role="frame")
    symbol(pen, (x + 30, y + h * 0.25), traits["projection"] == "first")


def symbol(pen, middle, is_first):
    """A truncated cone in two views, arranged by the convention of the sheet."""
    x, y = middle
    cone, rings = (x - 9, x + 10) if is_first else (x + 7, x - 10)
    corners = [(cone - 6, y - 2.5), (cone + 6, y - 5), (cone + 6, y + 5), (cone - 6, y + 2.5)]
    for k in range(4):
        pen.line("symbol", "frame", corners[k - 1], corners[k])
    pen.circle("symbol", "frame", (rings, y), 5)
    pen.circle("symbol", "frame", (rings, y), 2.5)
    pen.line("symbol", "centre", (cone - 8, y), (cone + 8, y))
    pen.line("symbol", "centre", (rings - 7, y), (rings + 7, y))
    pen.line("symbol", "centre", (rings, y - 7), (rings, y + 7))


def centre_lines(pen, shape, view):
    kind = view.kind
    circles, axes = axes_and_centres(shape, kind)
    left, bottom, right, top = view.drawn_box
    shown = lambda p: left - 4 < p[0] < right + 4 and bottom - 4 < p[1] < top + 4
    axes = [(p, q) for p, q in axes if shown(p) and shown(q)]
    for center, radius in (c for c in circles if shown(c[0])):
        x, y = view.to_paper(center)
        reach = radius * view.scale + min(3.0, 1 + radius * view.scale * 0.3)
        pen.line("centre", "centre", (x - reach, y), (x + reach, y))
        pen.line("centre", "centre", (x, y - reach), (x, y + reach))
    for begin, end in axes:
        pen.line("centre", "centre", view.to_paper(begin), view.to_paper(end))


def dimensions(pen, view, traits, dice):
    """Overall sizes, positions of circles, diameters, radii and an angle."""
    u0, v0, u1, v1 = view.drawn_box
    (left, bottom), (right, top) = view.to_paper((u0, v0)), view.to_paper((u1, v1))
    circles = [c for c in view.curves if c.kind == "arc" and c.is_closed() and c.visible]
    level, done = 9, set()
    for center in sorted({tuple(round(x, 4) for x in c.data[0]) for c in circles})[: dice.randint(0, 2)]:
        at = view.to_paper(center)
        for k, angle, low in ((0, 0, u0), (1, 90, v0)):
            distance = center[k] - low
            if distance > 2 and (k, distance) not in done:
                done.add((k, distance))
                base = (left, bottom - level) if k == 0 else (left - level, bottom)
                pen.dimension("linear", distance, base=base, p1=(left, bottom), p2=at, angle=angle)
        level += 8
    if view.kind in ("front", "top") or dice.random() < 0.6:
        base = (left, bottom - level)
        pen.dimension("linear", u1 - u0, base=base, p1=(left, bottom), p2=(right, bottom), angle=0)
    if view.kind == "front" or dice.random() < 0.6:
        base = (left - level, bottom)
        pen.dimension("linear", v1 - v0, base=base, p1=(left, bottom), p2=(left, top), angle=90)
    by_radius = {}
    for circle in circles:
        by_radius.setdefault(round(circle.data[1], 4), []).append(circle)
    for radius, same in sorted(by_radius.items())[: dice.randint(1, 4)]:
        prefix = f"{len(same)}x " if len(same) > 1 else ""
        angle = dice.choice([30, 45, 60, 120, 135])
        place = {
            "center": view.to_paper(same[0].data[0]),
            "radius": radius * view.scale * pen.unit,
            "angle": angle,
        }
        pen.dimension("diameter", 2 * radius, prefix, **place)
    arcs = [c for c in view.curves if c.kind == "arc" and not c.is_closed() and c.visible]
    for arc in arcs[: dice.randint(0, 2)]:
        place = {"center": view.to_paper(arc.data[0]), "radius": arc.data[1] * view.scale * pen.unit}
        pen.dimension("radius", arc.data[1], angle=arc.data[2] + arc.data[3] / 2, **place)


def section_marks(pen, views, dice):
    """Cutting line with arrows and letters in the view that shows the plane edge-on."""
    for view in views.values():
        if view.cut_at is None:
            continue
        parent = views["top" if view.kind == "front" else "front"]
        left, bottom = parent.at
        right, top = left + parent.size[0], bottom + parent.size[1]
        if view.kind == "front":
            level = parent.to_paper((0, view.cut_at))[1]
            ends, look = [(left - 8, level), (right + 8, level)], math.pi / 2
        else:
            place = parent.to_paper((view.cut_at, 0))[0]
            from_right = "right" in (view.kind, pen.traits["side"])
            ends, look = [(place, bottom - 8), (place, top + 8)], math.pi if from_right else 0.0
        pen.line("section mark", "section", *ends)
        for end in ends:
            tail = (end[0] - 9 * math.cos(look), end[1] - 9 * math.sin(look))
            pen.line("section mark", "thin", tail, end)
            pen.arrow("section mark", "thin", end, look)
            pen.text("section mark", (tail[0] + 2, tail[1] + 2), "A", 5)
        x, y = view.at
        pen.text("section mark", (x + view.size[0] / 2, y + view.size[1] + 5), "A-A", 5, "BOTTOM_CENTER")


def detail_marks(pen, views, traits):
    view, front = views.get("detail"), views["front"]
    if view is None:
        return
    x, y = front.to_paper(view.center)
    r = view.radius * front.scale
    pen.circle("detail mark", "thin", (x, y), r)
    pen.text("detail mark", (x + 0.75 * r + 1, y + 0.75 * r + 1), "Z", 5)
    ratio = view.scale if view.scale >= 1 else 1 / view.scale
    words = f"Z ({ratio:g}:1)" if view.scale >= 1 else f"Z (1:{ratio:g})"
    pen.text("detail mark", (view.at[0], view.at[1] + view.size[1] + 3), words, 5)


def notes(pen, views, sheet, traits, dice):
    """Names of views, general notes, a leader with text, and a surface symbol."""
    words = pen.language.words
    above = sheet[1] - 16
    pen.paragraph("notes", (26, above), words["note"])
    if dice.random() < 0.4:
        for view in (v for v in views.values() if v.kind in BASIC):
            x, y = view.at
            at = (x + view.size[0] / 2, y + view.size[1] + (14 if view.cut_at is not None else 6))
            pen.text("notes", at, words[view.kind], 4, "BOTTOM_CENTER")
    front = views["front"]
    circle = next((c for c in front.curves if c.kind == "arc" and c.visible), None)
    if circle is not None:
        tip = front.to_paper(circle.points(8)[1])
        knee = (tip[0] + 14, tip[1] + 16)
        if dice.random() < 0.5:
            look = {**pen.look("dimension"), "dimstyle": "ISO-25"}
            points = [pen.at(p) for p in (tip, knee, (knee[0] + 10, knee[1]))]
            pen.keep(pen.space.add_leader(points, dimstyle="ISO-25", dxfattribs=look), "notes")
        else:
            pen.line("notes", "dimension", tip, knee)
            pen.line("notes", "dimension", knee, (knee[0] + 10, knee[1]))
            pen.arrow("notes", "dimension", tip, math.atan2(-16, -14))
        pen.text("notes", (knee[0] + 1, knee[1] + 1), f"M{dice.choice([4, 5, 6, 8])} 8 {words['deep']}", 3.5)
    if dice.random() < 0.6:
        x, y = front.at[0] + front.size[0] * 0.85, front.at[1] + front.size[1]
        for p, q in (((0, 0), (-3, 5)), ((0, 0), (6, 10)), ((-3, 5), (3, 5))):
            pen.line("notes", "thin", (x + p[0], y + p[1]), (x + q[0], y + q[1]))
        pen.text("notes", (x - 4, y + 6), f"Ra {dice.choice([1.6, 3.2, 6.3])}", 2.5)


def annotate(pen, shape, views, sheet, name, traits, dice):
    frame(pen, sheet, name, traits, dice)
    for view in views.values():
        if view.kind in BASIC:
            if traits["centre"] == "yes":
                centre_lines(pen, shape, view)
            if traits["dimensions"] != "none":
                dimensions(pen, view, traits, dice)
    section_marks(pen, views, dice)
    detail_marks(pen, views, traits)
    if traits["notes"] == "yes":
        notes(pen, views, sheet, traits, dice)
