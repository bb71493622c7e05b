"""Random plates, brackets and blocks."""

from .features import Hole, circle, half, pattern, slots, spread
from .shapes import box, cut, cylinder, fuse, prism, rectangle


def drilled(dice, shape, axis, size, bottom, top, names, radius=None, edge=None):
    """Drills a pattern of equal holes into a rectangle from the origin; leaves out holes that would touch."""
    radius = radius or half(dice, 1.5, max(2, min(size) / 12))
    hole = Hole(dice, radius, bottom, top)
    edge = edge or hole.wide + half(dice, 2, 5)
    if min(size) < 2 * edge + 2 * hole.wide + 1:
        points = [(size[0] / 2, size[1] / 2)] if min(size) > 2 * hole.wide + 3 else []
    else:
        points = pattern(dice, size, edge)
    if points and spread(points, 2 * hole.wide + 1):
        names |= {"holes", hole.kind}
        shape = cut(shape, *(hole.tool(axis, u, v) for u, v in points))
    return shape, hole


def plate(dice, names):
    a, b, t = half(dice, 60, 160), half(dice, 40, 100), half(dice, 6, 25)
    corners = rectangle((0, 0), (a, b))
    rounding = half(dice, 3, min(a, b) / 5)
    look = dice.choice(["sharp", "rounded", "rounded", "chamfered", "notched", "mixed"])
    radii = 0.0
    if look == "rounded":
        radii = rounding
        names.add("fillet in plan")
    elif look == "chamfered":
        c = rounding
        corners = [(c, 0), (a, 0), (a, b - c), (a - c, b), (0, b), (0, c)]
        names.add("chamfer")
    elif look == "notched":
        n, m = half(dice, 8, a / 4), half(dice, 6, b / 4)
        corners = [(0, 0), (a, 0), (a, b), (a / 2 + n, b), (a / 2 + n, b - m), (a / 2 - n, b - m)]
        corners += [(a / 2 - n, b), (0, b)]
    elif look == "mixed":
        radii = [rounding, 0.0, min(a, b) / 3, 0.0]
        names.add("fillet in plan")
    shape = prism("z", corners, 0, t, radii)
    hole = half(dice, 2, max(2.5, min(a, b) / 16))
    shape, drill = drilled(dice, shape, "z", (a, b), 0, t, names, hole, rounding + hole + half(dice, 3, 6))
    middle = dice.choice(["none", "bore", "slots", "boss", "window"])
    room = min(a, b) / 2 - rounding - 2 * drill.wide - 8
    if middle == "bore" and room > 5:
        shape = cut(shape, cylinder((a / 2, b / 2, -1), "z", half(dice, 4, room), t + 2))
    elif middle == "slots":
        shape = cut(shape, *slots(dice, "z", (a, b), 0, t, names))
    elif middle == "boss" and room > 8:
        outer, high = half(dice, 6, room), half(dice, 4, 25)
        shape = fuse(shape, cylinder((a / 2, b / 2, t / 2), "z", outer, t / 2 + high))
        shape = cut(shape, cylinder((a / 2, b / 2, -1), "z", outer * 0.5, t + high + 2))
        names.add("boss")
    elif middle == "window" and room > 6:
        u, v, deep = room, room * 0.7, dice.choice([t + 1, t * 0.5])
        frame = rectangle((a / 2 - u, b / 2 - v), (a / 2 + u, b / 2 + v))
        shape = cut(shape, prism("z", frame, t - deep, t + 1, dice.choice([0.0, half(dice, 1.5, 5)])))
        names.add("pocket")
    return shape


def bracket(dice, names):
    """An angle with holes in both legs, often with a rib or a round end."""
    a, b, c, t = half(dice, 40, 100), half(dice, 30, 80), half(dice, 40, 90), half(dice, 6, 14)
    inner = dice.choice([0.0, half(dice, 3, 10)])
    outer = inner + t if inner and dice.random() < 0.5 else 0.0
    section = [(0, 0), (a, 0), (a, t), (t, t), (t, c), (0, c)]
    shape = prism("y", section, 0, b, [outer, 0, 0, inner, 0, 0])
    if inner:
        names.add("fillet in plan")
    if dice.random() < 0.4:
        # The upright leg ends in a half circle around its hole.
        shape = cut(shape, box((-1, -1, c - b / 2), (t + 1, b + 1, c + 1)))
        shape = fuse(shape, cylinder((0, b / 2, c - b / 2), "x", b / 2, t))
        if c - b / 2 < t + inner + 2:
            return None
        shape = cut(shape, cylinder((-1, b / 2, c - b / 2), "x", half(dice, 3, b / 3), t + 2))
        names.add("round end")
    else:
        hole = Hole(dice, half(dice, 2, 6), 0, t, ["through", "countersink", "counterbore"])
        spots = [(b * k, c * 0.7) for k in dice.choice([[0.5], [0.25, 0.75]])]
        if b > 4 * hole.wide + 6:
            shape = cut(shape, *(hole.tool("x", u, v) for u, v in spots))
            names |= {"holes", hole.kind}
    hole = Hole(dice, half(dice, 2, 6), 0, t, ["through", "through", "counterbore", "countersink"])
    if dice.random() < 0.3:
        shape = cut(shape, *slots(dice, "z", (a + t, b), 0, t, names))
    elif b > 4 * hole.wide + 6 and a - t > 2 * hole.wide + inner + 12:
        shape = cut(shape, *(hole.tool("z", a - hole.wide - 5, b * k) for k in (0.22, 0.78)))
        names |= {"holes", hole.kind}
    if dice.random() < 0.5:
        w, leg = half(dice, 4, 10), min(a, c) * dice.choice([0.5, 0.6]) - t
        corners = [(t / 2, t / 2), (t + leg, t / 2), (t + leg, t), (t, t + leg), (t / 2, t + leg)]
        shape = fuse(shape, prism("y", corners, b / 2 - w / 2, b / 2 + w / 2))
        names.add("rib")
    return shape


def clevis(dice, names):
    """A fork: base, two ears with a common bore, holes in the base."""
    a, b, gap, t = half(dice, 40, 80), half(dice, 24, 50), half(dice, 12, 30), half(dice, 6, 14)
    high, ear = half(dice, b / 2 + 10, 70), half(dice, 6, 14)
    shape = box((0, 0, 0), (a, b, t))
    left = a / 2 - gap / 2 - ear
    if left < 2:
        return None
    for x in (left, a / 2 + gap / 2):
        shape = fuse(shape, box((x, 0, 0), (x + ear, b, t + high)))
        shape = fuse(shape, cylinder((x, b / 2, t + high), "x", b / 2, ear))
    shape = cut(shape, cylinder((-1, b / 2, t + high), "x", half(dice, 4, b / 2 - 4), a + 2))
    names |= {"round end", "ears"}
    if left > 12:
        hole = Hole(dice, half(dice, 2, left / 4), 0, t, ["through", "counterbore"])
        if hole.wide < left / 2 - 1 and b > 2 * hole.wide + 3:
            shape = cut(shape, *(hole.tool("z", x, b / 2) for x in (left / 2, a - left / 2)))
            names |= {"holes", hole.kind}
    if dice.random() < 0.4:
        shape = cut(shape, box((-1, b * 0.35, -1), (a + 1, b * 0.65, t * 0.4)))
        names.add("groove")
    return shape


def block(dice, names):
    """A block with steps, pockets with rounded corners, slots, holes and chamfers."""
    a, b, c = half(dice, 50, 120), half(dice, 40, 90), half(dice, 25, 70)
    shape = box((0, 0, 0), (a, b, c))
    top, low = c, 0.0
    if dice.random() < 0.5:
        step, low = half(dice, 12, a * 0.4), half(dice, 6, c * 0.6)
        shape = cut(shape, box((a - step, -1, low), (a + 1, b + 1, c + 1)))
        hole = Hole(dice, half(dice, 2, min(step, b) / 8 + 1), 0, low)
        if step > 2 * hole.wide + 3 and b / 2 > 2 * hole.wide + 3:
            spots = [(a - step / 2, b * k) for k in (0.25, 0.75)]
            shape = cut(shape, *(hole.tool("z", u, v) for u, v in spots))
            names |= {"holes", hole.kind}
        names.add("step")
        a = a - step
    if dice.random() < 0.6 and a > 25:
        u, v, deep = (
            a * dice.choice([0.2, 0.25, 0.3]),
            b * dice.choice([0.2, 0.25, 0.3]),
            half(dice, 4, c * 0.5),
        )
        around = rectangle((u, v), (a - u, b - v))
        if dice.random() < 0.3:
            around = rectangle((u, -1), (a - u, b - v))
            shape = cut(
                shape, prism("z", around, top - deep, top + 1, [0, 0, half(dice, 2, 6), half(dice, 2, 6)])
            )
        else:
            shape = cut(
                shape,
                prism("z", around, top - deep, top + 1, half(dice, 2, min(8, min(a - 2 * u, b - 2 * v) / 3))),
            )
        names |= {"pocket", "fillet in plan"}
    if dice.random() < 0.5:
        wide, deep = half(dice, 6, 16), half(dice, 4, c * 0.3)
        shape = cut(shape, box((-1, b / 2 - wide / 2, -1), (200, b / 2 + wide / 2, deep)))
        names.add("groove")
    if dice.random() < 0.5:
        s = half(dice, 4, min(c, b) * 0.3)
        shape = cut(shape, prism("y", [(-1, c + 1), (-1, c - s - 1), (s + 1, c + 1)], -1, b + 1))
        names.add("chamfer")
    if dice.random() < 0.5:
        hole = Hole(
            dice, half(dice, 2.5, min(b, c) / 6), 0, b, ["through", "blind", "drilled", "counterbore"]
        )
        shape = cut(shape, hole.tool("y", half(dice, hole.wide + 3, max(hole.wide + 4, a * 0.5)), c * 0.35))
        names |= {"cross hole", hole.kind}
    return shape


def guide(dice, names):
    """A profile with sloped faces: a V block, a dovetail or a wedge, with holes from above."""
    a, b, c = half(dice, 40, 110), half(dice, 40, 90), half(dice, 25, 60)
    look = dice.choice(["vee", "dovetail", "wedge", "trapezoid"])
    if look == "vee":
        d = min(c - 8, a / 2 - 8) * dice.choice([0.6, 0.8])
        section = [(0, 0), (a, 0), (a, c), (a / 2 + d, c), (a / 2, c - d), (a / 2 - d, c), (0, c)]
    elif look == "dovetail":
        w, d = a * 0.25, c * dice.choice([0.3, 0.4])
        section = [(0, 0), (a, 0), (a, c), (a / 2 + w, c), (a / 2 + w + d * 0.5, c - d)]
        section += [(a / 2 - w - d * 0.5, c - d), (a / 2 - w, c), (0, c)]
    elif look == "wedge":
        section = [(0, 0), (a, 0), (a, c * 0.4), (a * 0.3, c), (0, c)]
    else:
        s = a * 0.2
        section = [(0, 0), (a, 0), (a, c * 0.3), (a - s, c), (s, c), (0, c * 0.3)]
    names |= {look, "sloped face"}
    shape = prism("y", section, 0, b)
    if dice.random() < 0.6:
        hole = Hole(dice, half(dice, 2, 5), 0, c, ["through", "through", "blind"])
        at = a * 0.15 if look in ("vee", "dovetail") else a / 2
        spots = [(at, b * k) for k in (0.25, 0.75)]
        if look in ("vee", "dovetail"):
            spots += [(a - u, v) for u, v in spots]
            if at < hole.wide + 2 or look == "vee":
                spots = []
        if spots:
            shape = cut(shape, *(hole.tool("z", u, v) for u, v in spots))
            names |= {"holes", hole.kind}
    if dice.random() < 0.4:
        w = half(dice, 6, b * 0.3)
        shape = cut(shape, box((-1, b / 2 - w / 2, -1), (a + 1, b / 2 + w / 2, c * 0.2)))
        names.add("groove")
    return shape


def housing(dice, names):
    """An open box with rounded corners, bosses for screws, and openings in its walls."""
    a, b, c, t = half(dice, 60, 130), half(dice, 50, 100), half(dice, 20, 55), half(dice, 4, 8)
    rounding = half(dice, t + 2, min(a, b) / 5)
    shape = prism("z", rectangle((0, 0), (a, b)), 0, c, rounding)
    inside = rectangle((t, t), (a - t, b - t))
    shape = cut(shape, prism("z", inside, t, c + 1, rounding - t))
    names |= {"pocket", "fillet in plan"}
    if dice.random() < 0.6:
        r = half(dice, 4, 7)
        high, at = c - dice.choice([0.0, 4.0]), t + r - dice.choice([0.0, 1.0])
        bosses = [(u, v) for u in (at, a - at) for v in (at, b - at)]
        if at >= rounding * 0.6:
            shape = fuse(shape, *(cylinder((u, v, t / 2), "z", r, high - t / 2) for u, v in bosses))
            shape = cut(shape, *(cylinder((u, v, t), "z", r * 0.5, c) for u, v in bosses))
            names |= {"boss", "touching"}
    if dice.random() < 0.6 and c > t + 12:
        r = half(dice, 3, (c - t) / 2 - 2)
        shape = cut(shape, cylinder((a / 2, -1, t + (c - t) / 2), "y", r, dice.choice([t + 2, b + 2])))
        names.add("cross hole")
    if dice.random() < 0.3:
        shape = cut(shape, box((-1, b * 0.35, c * 0.6), (t + 1, b * 0.65, c + 1)))
        names.add("notch")
    return shape


def stacked(dice, names):
    """Bodies that touch along faces: they are separate solids of one part."""
    a, b, t = half(dice, 40, 100), half(dice, 30, 80), half(dice, 8, 20)
    base = box((0, 0, 0), (a, b, t))
    names |= {"bodies"}
    bodies = []
    look = dice.choice(["pin", "bar", "bar", "two"])
    if look in ("pin", "two"):
        r, high = half(dice, 4, min(a, b) / 5), half(dice, 5, 40)
        base = cut(base, cylinder((a * 0.3, b / 2, -1), "z", r, t + 2))
        bodies.append(cylinder((a * 0.3, b / 2, 0), "z", r, t + high))
    if look in ("bar", "two"):
        u, w, high = half(dice, a * 0.55, a * 0.6), half(dice, 10, a * 0.3), half(dice, 8, 40)
        bodies.append(box((u, b * 0.2, t), (u + w, b * 0.8, t + high)))
    return [base, *bodies]


def flanged(dice, names):
    """A plate with a round flange pattern around a tube that stands on it."""
    a, t = half(dice, 50, 110), half(dice, 6, 16)
    outer = half(dice, a * 0.15, a * 0.26)
    high = half(dice, 12, 60)
    rounding = half(dice, 3, 10)
    shape = prism("z", rectangle((0, 0), (a, a)), 0, t, rounding)
    shape = fuse(shape, cylinder((a / 2, a / 2, t / 2), "z", outer, t / 2 + high))
    shape = cut(shape, cylinder((a / 2, a / 2, -1), "z", outer - half(dice, 3, outer / 2), t + high + 2))
    hole = Hole(dice, half(dice, 2, 4), 0, t, ["through", "counterbore", "countersink"])
    ring = (outer + a / 2) / 2
    spots = circle(dice.choice([4, 6, 8]), (a / 2, a / 2), ring, dice.choice([45, 0, 22.5]))
    if spread(spots, 2 * hole.wide + 1) and ring - outer > hole.wide + 1:
        shape = cut(shape, *(hole.tool("z", u, v) for u, v in spots))
        names |= {"holes", hole.kind}
    if dice.random() < 0.5:
        shape = cut(shape, cylinder((a / 2, a / 2, t + high * 0.6), "x", outer * 0.3, a))
        names.add("cross hole")
    names |= {"boss", "fillet in plan"}
    return shape
