"""Features of machined parts: holes and patterns of them. Each adds tools to cut, and its names to a set."""

import math

from .shapes import PLANES, cone, cylinder, fuse, slot


def half(dice, lo, hi):
    """A dimension that is a multiple of 0.5 mm, in one of eight cases of 0.01 mm."""
    if dice.random() < 0.12:
        return round(dice.uniform(lo, hi), 2)
    return dice.randint(math.ceil(2 * lo), max(math.ceil(2 * lo), math.floor(2 * hi))) / 2


def point(axis, u, v, w):
    """The point whose coordinates in the plane across the axis are u and v."""
    at = [0.0, 0.0, 0.0]
    for k, value in zip(PLANES[axis], (u, v, w)):
        at[k] = value
    return at


class Hole:
    """One kind of hole, drilled against its axis from the level `top` of a wall down to `bottom`."""

    def __init__(self, dice, radius, bottom, top, kinds=None):
        self.radius, self.bottom, self.top = radius, bottom, top
        thick = top - bottom
        kinds = kinds or ["through"] * 4 + ["counterbore", "countersink", "blind", "drilled"]
        self.kind = dice.choice(kinds)
        if self.kind == "counterbore":
            self.wide, self.deep = radius + half(dice, 1.5, 3), thick * dice.choice([0.25, 0.4, 0.5])
        elif self.kind == "countersink":
            self.wide = radius + min(half(dice, 1, 3), 0.6 * thick)
            self.deep = self.wide - radius
        else:
            self.wide, self.deep = radius, thick * dice.choice([0.4, 0.5, 0.6])

    def tool(self, axis, u, v):
        bottom, top, radius = self.bottom, self.top, self.radius
        if self.kind == "blind":
            return cylinder(point(axis, u, v, top - self.deep), axis, radius, self.deep + 1)
        if self.kind == "drilled":
            # The point of a drill of 120°.
            point_length = min(radius / math.tan(math.radians(60)), 0.3 * (top - bottom))
            tip = cone(point(axis, u, v, top - self.deep - point_length), axis, 0.0, radius, point_length)
            return fuse(tip, cylinder(point(axis, u, v, top - self.deep), axis, radius, self.deep + 1))
        through = cylinder(point(axis, u, v, bottom - 1), axis, radius, top - bottom + 2)
        if self.kind == "counterbore":
            return fuse(through, cylinder(point(axis, u, v, top - self.deep), axis, self.wide, self.deep + 1))
        if self.kind == "countersink":
            sink = cone(point(axis, u, v, top - self.deep), axis, radius, self.wide, self.deep)
            return fuse(through, sink, cylinder(point(axis, u, v, top), axis, self.wide, 1))
        return through


def pattern(dice, size, edge):
    """Centres of a pattern of holes in a rectangle, at least `edge` from its sides."""
    (a, b), kind = size, dice.choice(["corners", "corners", "grid", "row", "circle", "pair"])
    if kind == "corners":
        return [(u, v) for u in (edge, a - edge) for v in (edge, b - edge)]
    if kind == "grid":
        columns, rows = dice.randint(2, 4), dice.randint(2, 3)
        step = [(a - 2 * edge) / (columns - 1), (b - 2 * edge) / (rows - 1)]
        return [(edge + i * step[0], edge + j * step[1]) for i in range(columns) for j in range(rows)]
    if kind == "row":
        count = dice.randint(2, 5)
        return [(edge + i * (a - 2 * edge) / (count - 1), b / 2) for i in range(count)]
    if kind == "pair":
        return [(edge, edge), (a - edge, b - edge)]
    return circle(dice.choice([3, 4, 6]), (a / 2, b / 2), min(a, b) / 2 - edge, dice.choice([0, 45, 90, 30]))


def circle(count, center, radius, start_deg):
    angles = [math.radians(start_deg + 360 * k / count) for k in range(count)]
    return [(center[0] + radius * math.cos(t), center[1] + radius * math.sin(t)) for t in angles]


def spread(points, apart):
    """Whether all points are at least this far from each other."""
    return all(math.dist(p, q) >= apart for i, p in enumerate(points) for q in points[:i])


def slots(dice, axis, size, bottom, top, names):
    """One to three parallel slots around the middle of a rectangle, through or to a depth."""
    (a, b), along = size, dice.randrange(2)
    radius = half(dice, 2, max(2.5, min(a, b) / 10))
    length = half(dice, 2 * radius, max(2 * radius + 1, 0.4 * size[along]))
    names.add("slot")
    low = bottom - 1 if dice.random() < 0.7 else top - (top - bottom) * 0.5
    center = [a / 2, b / 2]
    found = []
    for shift in dice.choice([[0], [0], [-1, 1]]):
        at = list(center)
        at[1 - along] += shift * 2 * radius
        found.append(slot(axis, at, length, radius, low, top + 1, along))
    return found
