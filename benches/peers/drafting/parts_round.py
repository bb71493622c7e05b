"""Random shafts, discs, levers and bearings, and the choice of a part."""

import math

from . import parts_flat
from .features import Hole, circle, half, spread
from .shapes import (
    bounds,
    box,
    cut,
    cylinder,
    fuse,
    is_valid,
    moved,
    prism,
    slot,
    solids_of,
    sphere,
    together,
    torus,
    turned,
    unified,
)


def shaft(dice, names):
    """A stepped shaft along x with chamfers, grooves, a keyway, flats and a cross hole."""
    count = dice.randint(2, 4)
    radii, lengths = [half(dice, 6, 25) for _ in range(count)], [half(dice, 15, 45) for _ in range(count)]
    if any(abs(r - s) < 1 for r, s in zip(radii, radii[1:])):
        return None
    chamfer = dice.choice([0.0, 1.0, 1.5, 2.0])
    profile, x = [(0, 0)], 0.0
    for k, (r, length) in enumerate(zip(radii, lengths)):
        first, last = k == 0 and chamfer, k == count - 1 and chamfer
        profile += [(x, r - chamfer), (x + chamfer, r)] if first else [(x, r)]
        x += length
        profile += [(x - chamfer, r), (x, r - chamfer)] if last else [(x, r)]
    profile.append((x, 0))
    shape = turned(profile)
    names.add("steps")
    if chamfer:
        names.add("chamfer")
    starts = [sum(lengths[:k]) for k in range(count)]
    if dice.random() < 0.5:
        k = dice.randrange(count)
        r, w = radii[k], half(dice, 1.5, 4)
        at = starts[k] + lengths[k] / 2
        ring = cut(
            cylinder((at, 0, 0), "x", r + 5, w), cylinder((at - 1, 0, 0), "x", r - min(2, r / 4), w + 2)
        )
        shape = cut(shape, ring)
        names.add("groove")
    k = max(range(count), key=lambda k: radii[k])
    r, length = radii[k], lengths[k]
    if dice.random() < 0.6:
        w = half(dice, 1.5, max(2, r / 4))
        key = slot(
            "z",
            (starts[k] + length / 2, 0),
            length * 0.5 - 2 * w if length > 6 * w else w,
            w,
            r * 0.65,
            r + 2,
        )
        shape = cut(shape, key)
        names.add("keyway")
    k = dice.randrange(count)
    if dice.random() < 0.5:
        axis = dice.choice(["y", "z"])
        at = [starts[k] + lengths[k] * 0.25, 0, 0]
        at["xyz".index(axis)] = -30
        shape = cut(shape, cylinder(at, axis, half(dice, 1, radii[k] / 3), 60))
        names.add("cross hole")
    if dice.random() < 0.3:
        r = radii[-1]
        for sign in (-1, 1):
            edge = sign * r * 0.7
            lo, hi = sorted((edge, sign * 40))
            shape = cut(shape, box((x - lengths[-1] * 0.6, lo, -40), (x + 1, hi, 40)))
        names.add("flats")
    if dice.random() < 0.4:
        hole = Hole(dice, half(dice, 1.5, max(2, radii[0] / 3)), 0, lengths[0], ["blind", "drilled"])
        shape = cut(
            shape, moved(hole.tool("x", 0, 0), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], (lengths[0], 0, 0))
        )
        names.add(hole.kind)
    return shape


def disc(dice, names):
    """A disc or flange with hub, bore, bolt circle, tabs, keyway or notches."""
    r, t = half(dice, 25, 70), half(dice, 5, 16)
    shape = cylinder((0, 0, 0), "z", r, t)
    hub, high = half(dice, r * 0.3, r * 0.45), half(dice, 4, 30)
    if dice.random() < 0.6:
        shape = fuse(shape, cylinder((0, 0, 0), "z", hub, t + high))
        names.add("boss")
    else:
        high = 0.0
    bore = half(dice, hub * 0.4, hub * 0.7)
    shape = cut(shape, cylinder((0, 0, -1), "z", bore, t + high + 2))
    if dice.random() < 0.4:
        w = half(dice, 1, bore * 0.4)
        shape = cut(shape, box((0, -w, -1), (bore + 2, w, t + high + 1)))
        names.add("keyway")
    hole = Hole(dice, half(dice, 1.5, r / 12), 0, t, ["through", "through", "counterbore", "countersink"])
    ring = (hub + r) / 2
    spots = circle(dice.choice([3, 4, 6, 8]), (0, 0), ring, dice.choice([0, 30, 45, 90]))
    if spread(spots, 2 * hole.wide + 1) and r - hub > 2 * hole.wide + 4:
        shape = cut(shape, *(hole.tool("z", u, v) for u, v in spots))
        names |= {"holes", hole.kind}
    look = dice.choice(["none", "tabs", "tabs", "ears", "notches"])
    count = dice.choice([2, 3, 4])
    start = dice.choice([0, 45, 90])
    for t_rad in (math.radians(start + 360 * k / count) for k in range(count)):
        turn = [[math.cos(t_rad), -math.sin(t_rad), 0], [math.sin(t_rad), math.cos(t_rad), 0], [0, 0, 1]]
        if look == "tabs":
            w, out = r * 0.15, r * 1.2
            shape = fuse(shape, moved(box((r * 0.8, -w, 0), (out, w, t)), turn))
        elif look == "ears":
            w, out = r * 0.2, r * 1.15
            ear = fuse(box((r * 0.8, -w, 0), (out, w, t)), cylinder((out, 0, 0), "z", w, t))
            shape = cut(
                fuse(shape, moved(ear, turn)), moved(cylinder((out, 0, -1), "z", w * 0.5, t + 2), turn)
            )
        elif look == "notches":
            w = r * 0.1
            shape = cut(shape, moved(box((r * 0.85, -w, -1), (r * 1.2, w, t + 1)), turn))
    if look != "none":
        names.add(look)
    return shape


def lever(dice, names):
    """Two bosses of different height joined by a bar with tangent sides."""
    distance, r, s = half(dice, 45, 110), half(dice, 10, 22), half(dice, 7, 14)
    if distance < r + s + 10 or r <= s:
        return None
    t, high, low = half(dice, 5, 12), half(dice, 14, 35), half(dice, 12, 20)
    # Points where the common tangents of the two circles touch them.
    angle = math.acos((r - s) / distance)
    touch = [(r * math.cos(angle), r * math.sin(angle))]
    touch.append((distance + s * math.cos(angle), s * math.sin(angle)))
    corners = [touch[0], touch[1], (touch[1][0], -touch[1][1]), (touch[0][0], -touch[0][1])]
    shape = prism("z", corners[::-1], 0, t)
    for x, radius, top in ((0.0, r, high), (distance, s, low)):
        shape = fuse(shape, cylinder((x, 0, 0), "z", radius, top))
    for x, radius, top in ((0.0, r, high), (distance, s, low)):
        shape = cut(shape, cylinder((x, 0, -1), "z", half(dice, radius * 0.35, radius * 0.65), top + 2))
    names |= {"tangent sides", "boss"}
    if dice.random() < 0.4:
        w = half(dice, 1.5, 3)
        shape = cut(shape, box((0, -w, -1), (r * 0.85, w, high + 1)))
        names.add("keyway")
    if dice.random() < 0.4:
        length = distance - r - s - 12
        if length > 6:
            shape = cut(shape, slot("z", ((r + distance - s) / 2, 0), length - 4, 2.5, -1, t + 1))
            names.add("slot")
    if dice.random() < 0.4:
        shape = cut(shape, cylinder((0, -40, t + (high - t) / 2), "y", half(dice, 1, (high - t) / 4 + 1), 80))
        names.add("cross hole")
    return shape


def bearing(dice, names):
    """A pedestal: base, web, a horizontal hub with its bore, often a rib."""
    a, b, t, r = half(dice, 60, 120), half(dice, 30, 60), half(dice, 8, 16), half(dice, 12, 24)
    z, web, long = half(dice, t + r + 5, t + r + 40), half(dice, 8, 16), half(dice, 20, 45)
    if 2 * r > a - 10 or long > b:
        return None
    shape = box((0, 0, 0), (a, b, t))
    y = (b - long) / 2
    if dice.random() < 0.5:
        shape = fuse(shape, box((a / 2 - r, b / 2 - web / 2, t / 2), (a / 2 + r, b / 2 + web / 2, z)))
    else:
        side = [(a / 2 - r - 8, t / 2), (a / 2 + r + 8, t / 2), (a / 2 + r + 8, t), (a / 2 + r * 0.8, z)]
        side += [(a / 2 - r * 0.8, z), (a / 2 - r - 8, t)]
        if r + 8 > a / 2:
            return None
        shape = fuse(shape, prism("y", side, b / 2 - web / 2, b / 2 + web / 2))
        names.add("sloped face")
    shape = fuse(shape, cylinder((a / 2, y, z), "y", r, long))
    if dice.random() < 0.5:
        w, top = half(dice, 5, 10), z - r * 0.7
        if top > t + 4:
            rib = [(b / 2, t / 2), (b - 2, t / 2), (b - 2, t), (b / 2 + web / 2, top), (b / 2, top)]
            shape = fuse(shape, prism("x", rib, a / 2 - w / 2, a / 2 + w / 2))
            names.add("rib")
    shape = cut(shape, cylinder((a / 2, y - 1, z), "y", half(dice, r * 0.4, r * 0.75), long + 2))
    hole = Hole(dice, half(dice, 2.5, 5), 0, t, ["through", "counterbore", "countersink"])
    if a / 2 - r - 8 > 2 * hole.wide + 4:
        side = (a / 2 - r - 8) / 2
        shape = cut(shape, *(hole.tool("z", x, b / 2) for x in (side, a - side)))
        names |= {"holes", hole.kind}
    names.add("boss")
    return shape


def turned_part(dice, names):
    """A turned part along x with a dome, a cone, a rounded rim or a round groove."""
    r, s, long = half(dice, 12, 30), half(dice, 5, 11), half(dice, 15, 40)
    look = dice.choice(["dome", "cone", "rim", "knob", "groove"])
    names.add(look)
    if look == "dome":
        shape = fuse(turned([(0, 0), (0, s), (long, s), (long, 0)]), cylinder((long, 0, 0), "x", r, 6))
        dome = cut(sphere((long + 6, 0, 0), r), box((long - 2 * r, -2 * r, -2 * r), (long + 6, 2 * r, 2 * r)))
        shape = fuse(shape, dome)
    elif look == "cone":
        shape = turned(
            [
                (0, 0),
                (0, s),
                (long, s),
                (long, r),
                (long + 8, r),
                (long + 8 + r / 2, s),
                (long + 8 + r / 2, 0),
            ]
        )
    elif look == "rim":
        shape = turned([(0, 0), (0, r), (10, r), (10, s), (10 + long, s), (10 + long, 0)], [0, 3, 3, 2, 0, 0])
    elif look == "knob":
        shape = turned(
            [(0, 0), (0, s), (long, s), (long, r), (long + 12, r), (long + 12, 0)], [0, 0, 0, 4, 4, 0]
        )
    else:
        shape = cut(
            turned([(0, 0), (0, r), (long, r), (long, 0)]), torus((long / 2, 0, 0), "x", r, min(3.0, r / 4))
        )
    if dice.random() < 0.6:
        hole = Hole(dice, half(dice, 1.5, max(2, s * 0.5)), -60, long * 0.6, ["through"])
        shape = cut(shape, cylinder((-1, 0, 0), "x", hole.radius, 1 + long * 0.6))
        names.add("blind")
    return shape


FAMILIES = {
    "plate": parts_flat.plate,
    "bracket": parts_flat.bracket,
    "clevis": parts_flat.clevis,
    "block": parts_flat.block,
    "guide": parts_flat.guide,
    "housing": parts_flat.housing,
    "stacked": parts_flat.stacked,
    "flanged": parts_flat.flanged,
    "shaft": shaft,
    "disc": disc,
    "lever": lever,
    "bearing": bearing,
    "turned": turned_part,
}
WEIGHTS = {"plate": 4, "bracket": 3, "block": 4, "shaft": 3, "disc": 3}


def orientation(dice):
    """A rotation that maps axes to axes; most parts keep their upright position."""
    if dice.random() < 0.5:
        return [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    order, signs = dice.sample(range(3), 3), [dice.choice([-1, 1]) for _ in range(3)]
    rows = [[signs[k] if order[k] == j else 0 for j in range(3)] for k in range(3)]
    swaps = sum(order[i] > order[j] for i in range(3) for j in range(i + 1, 3))
    if (-1) ** swaps * signs[0] * signs[1] * signs[2] < 0:
        rows[2] = [-c for c in rows[2]]
    return rows


def random_part(dice, family=None, turn_deg=0.0):
    """A valid part: its shape, the family and the features it has; `None` if this draw makes no valid one."""
    names = sorted(FAMILIES)
    family = family or dice.choices(names, [WEIGHTS.get(n, 2) for n in names])[0]
    features = set()
    bodies = FAMILIES[family](dice, features)
    matrix = orientation(dice)
    if bodies is None:
        return None
    count = len(bodies) if isinstance(bodies, list) else 1
    bodies = [unified(b) for b in (bodies if isinstance(bodies, list) else [bodies])]
    shape = together(bodies) if count > 1 else bodies[0]
    shape = moved(shape, matrix)
    if turn_deg:
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        shape = moved(shape, [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    if len(solids_of(shape)) != count or not is_valid(shape):
        return None
    low, _ = bounds(shape)
    shape = moved(shape, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [-round(c, 6) for c in low])
    return shape, family, sorted(features)
