"""Parts of the kinds that public sets of CAD models hold, for `catalogue_parts.py`.

Each function takes a random generator and returns a solid, or a compound of bodies that touch.
"""

import math

from . import shapes as s


def steps(dice, lo, hi, step=0.5):
    """A multiple of `step` between two values."""
    return step * dice.randint(round(lo / step), round(hi / step))


def turned_about_z(shape, degrees):
    a = math.radians(degrees)
    return s.moved(shape, [[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])


def keyed_shaft(dice):
    """Stepped shaft with a cross hole, a keyway with round ends and chamfered ends."""
    radii = [steps(dice, 6, 10), steps(dice, 11, 16), steps(dice, 7, 10)]
    lengths = [steps(dice, 16, 30) for _ in radii]
    c = dice.choice([0.5, 1.0, 1.5])
    profile, x = [(0, 0), (0, radii[0] - c), (c, radii[0])], 0
    for k, (r, length) in enumerate(zip(radii, lengths)):
        x += length
        profile += [(x, r), (x, radii[k + 1])] if k + 1 < len(radii) else [(x - c, r), (x, r - c)]
    shaft = s.turned([*profile, (x, 0)])
    hole = steps(dice, 1.5, 3)
    at = (lengths[0] / 2, 0, -20) if dice.random() < 0.5 else (lengths[0] / 2, -20, 0)
    shaft = s.cut(shaft, s.cylinder(at, "z" if at[1] == 0 else "y", hole, 40))
    width, depth = steps(dice, 2, 3), steps(dice, 2, 4)
    key = (lengths[0] + lengths[1] / 2, 0)
    length = lengths[1] - 2 * width - 3
    return s.cut(shaft, s.slot("z", key, max(2.0, length), width, radii[1] - depth, 40))


def disc_with_tab(dice):
    """A disc and a thinner tab, so that the whole circle of the disc is drawn in the top view."""
    r, h = steps(dice, 12, 25), steps(dice, 8, 15)
    thin, width = steps(dice, 3, h - 2), steps(dice, 4, r / 2)
    low = dice.choice([0, h - thin, (h - thin) / 2])
    disc = s.fuse(
        s.cylinder((0, 0, 0), "z", r, h),
        s.box((0, -width, low), (r + steps(dice, 8, 20), width, low + thin)),
    )
    bore = steps(dice, 3, r / 2)
    disc = s.cut(disc, s.cylinder((0, 0, -1), "z", bore, h + 2))
    if dice.random() < 0.5:
        disc = s.cut(disc, s.cylinder((r + 4, 0, -1), "z", dice.choice([1.0, 1.5, 2.0]), h + 2))
    return disc


def slot_block(dice):
    """A block of the shape of a slot with two pins, turned by 0.11 degrees."""
    length, r, h = steps(dice, 20, 40), steps(dice, 8, 14), steps(dice, 6, 14)
    block, up = s.slot("z", (0, 0), length, r, 0, h), steps(dice, 5, 12)
    for sign in (-1, 1):
        pin = s.cylinder((sign * length / 2, 0, h), "z", dice.choice([r / 2, r / 2 + 1]), up)
        block = s.fuse(block, pin)
    return turned_about_z(block, dice.choice([0.11, 0.0, -0.11]))


def three_cylinders(dice):
    """A plate with one round end, a bore and a boss: three cylinders and few planes."""
    r, length, h = steps(dice, 10, 16), steps(dice, 20, 40), steps(dice, 6, 12)
    plate = s.fuse(s.box((-length, -r, 0), (0, r, h)), s.cylinder((0, 0, 0), "z", r, h))
    boss, up = steps(dice, 6, r - 1), steps(dice, 4, 12)
    plate = s.fuse(plate, s.cylinder((0, 0, h), "z", boss, up))
    plate = s.cut(plate, s.cylinder((0, 0, -1), "z", boss - 3, h + up + 2))
    if dice.random() < 0.5:
        plate = s.cut(plate, s.box((-length - 1, -r - 1, h / 2), (-length + 6, r + 1, h + 1)))
    return plate


def bolted_flange(dice):
    """A flange with a hub, a bore and a bolt circle."""
    r, h = steps(dice, 25, 40, 1), steps(dice, 6, 12)
    hub, up = steps(dice, 8, r / 2), steps(dice, 5, 20)
    part = s.fuse(s.cylinder((0, 0, 0), "z", r, h), s.cylinder((0, 0, h), "z", hub, up))
    part = s.cut(part, s.cylinder((0, 0, -1), "z", hub - steps(dice, 2, 4), h + up + 2))
    count, at = dice.choice([3, 4, 6, 8]), (r + hub) / 2
    hole = min(steps(dice, 2, 4), (r - hub) / 2 - 1)
    first = dice.choice([0, 180 / count, 90])
    is_counterbored = dice.random() < 0.3
    for k in range(count):
        a = math.radians(first + 360 * k / count)
        place = (at * math.cos(a), at * math.sin(a))
        part = s.cut(part, s.cylinder((*place, -1), "z", hole, h + 2))
        if is_counterbored:
            part = s.cut(part, s.cylinder((*place, h / 2), "z", hole + 0.75, h))
    return part


def ribbed_bracket(dice):
    """An angle bracket with one or two ribs and holes in both legs."""
    width, t = steps(dice, 24, 40), steps(dice, 4, 7)
    deep, high = steps(dice, 25, 45), steps(dice, 25, 45)
    angle = [(0, 0), (deep, 0), (deep, t), (t, t), (t, high), (0, high)]
    part = s.prism("x", angle, 0, width)
    reach = [min(deep, high) - t - dice.choice([2, 4, 8]), min(deep, high) - t - dice.choice([2, 4, 8])]
    rib = [(t, t), (t + reach[0], t), (t, t + reach[1])]
    thick = steps(dice, 3, 5)
    places = [(width - thick) / 2] if dice.random() < 0.6 else [0, width - thick]
    for x in places:
        part = s.fuse(part, s.prism("x", rib, x, x + thick))
    sides = [width / 4 - 1, 3 * width / 4 + 1] if len(places) == 1 else [width / 2]
    for x in sides:
        r = dice.choice([1.5, 2.0, 2.5])
        part = s.cut(part, s.cylinder((x, deep - 8, -1), "z", r, t + 2))
        part = s.cut(part, s.cylinder((x, -1, high - 8), "y", r, t + 2))
    return part


def touching_bodies(dice):
    """Blocks and discs that stand on each other or on one plate, or a pin in a hole."""
    x, y, h = steps(dice, 30, 50), steps(dice, 20, 40), steps(dice, 6, 12)
    plate = s.box((0, 0, 0), (x, y, h))
    kind = dice.choice(["beside", "on", "pin"])
    if kind == "beside":
        other = s.box((x, 2, 0), (x + steps(dice, 8, 16), y - dice.choice([0, 2, 4]), h + dice.choice([-2, 4])))
        return s.together([plate, other])
    if kind == "on":
        first = s.box((4, 4, h), (x / 2, y - 4, h + steps(dice, 5, 15)))
        second = s.cylinder((3 * x / 4, y / 2, h), "z", steps(dice, 3, 5), steps(dice, 5, 15))
        return s.together([plate, first, second])
    r = steps(dice, 3, 6)
    pin = s.cylinder((x / 2, y / 2, 0), "z", r, h + steps(dice, 5, 20))
    return s.together([s.cut(plate, s.cylinder((x / 2, y / 2, -1), "z", r, h + 2)), pin])


def countersunk_plate(dice):
    """A plate with three rows of three countersunk holes."""
    apart, h = steps(dice, 12, 18), steps(dice, 6, 12)
    plate = s.box((0, 0, 0), (3 * apart, 3 * apart, h))
    r = steps(dice, 1.5, 2.5)
    deep = steps(dice, 1, 2.5)
    for i in range(3):
        for j in range(3):
            x, y = (i + 0.5) * apart, (j + 0.5) * apart
            plate = s.cut(plate, s.cylinder((x, y, -1), "z", r, h + 2))
            plate = s.cut(plate, s.cone((x, y, h - deep), "z", r, r + deep, deep))
    return plate


def chamfered_block(dice):
    """A block with chamfers along lower edges, a step and a hole."""
    x, y, h = steps(dice, 30, 50), steps(dice, 20, 40), steps(dice, 15, 30)
    c, d = steps(dice, 2, 5), steps(dice, 2, 5)
    block = s.box((0, 0, 0), (x, y, h))
    block = s.cut(block, s.prism("y", [(-1, -1), (c + 1, -1), (-1, c + 1)], -1, y + 1))
    if dice.random() < 0.6:
        block = s.cut(block, s.prism("x", [(-1, -1), (d + 1, -1), (-1, d + 1)], -1, x + 1))
    if dice.random() < 0.6:
        block = s.cut(block, s.box((x - steps(dice, 5, 10), -1, h - steps(dice, 5, 10)), (x + 1, y + 1, h + 1)))
    if dice.random() < 0.6:
        block = s.cut(block, s.cylinder((x / 2, y / 2, -1), "z", steps(dice, 3, 5), h + 2))
    return block


def pocketed_block(dice):
    """A block with a pocket of rounded corners, with a hole or an island in it."""
    x, y, h = steps(dice, 36, 60), steps(dice, 30, 45), steps(dice, 12, 25)
    wall, deep, r = steps(dice, 3, 6), steps(dice, 5, h - 4), steps(dice, 2, 5)
    inner = s.rectangle((wall, wall), (x - wall, y - wall))
    outer = s.rectangle((0, 0), (x, y))
    block = s.prism("z", outer, 0, h, dice.choice([0.0, r + wall]))
    block = s.cut(block, s.prism("z", inner, h - deep, h + 1, r))
    if dice.random() < 0.5:
        block = s.cut(block, s.cylinder((x / 2, y / 2, -1), "z", steps(dice, 2, 5), h + 2))
    elif dice.random() < 0.7:
        block = s.fuse(block, s.cylinder((x / 2, y / 2, 0), "z", steps(dice, 3, 6), h - dice.choice([0, 2])))
    return block


def half_bores(dice):
    """A block with blind half-round bores in its top face."""
    x, y, h = steps(dice, 40, 60), steps(dice, 24, 36), steps(dice, 14, 24)
    block, r = s.box((0, 0, 0), (x, y, h)), steps(dice, 4, 8)
    block = s.cut(block, s.cylinder((-1, y / 2, h), "x", r, 1 + steps(dice, 10, x - 8)))
    if dice.random() < 0.5:
        other = steps(dice, 3, 6)
        at = (x - other - 4, y - steps(dice, 3, y / 2 - r - 1 if y / 2 - r > 5 else 4), h)
        block = s.cut(block, s.cylinder(at, "y", other, y))
    return block


def drilled_rib(dice):
    """A plate with a standing rib, which has a round end and a hole through it."""
    x, y, h = steps(dice, 36, 60), steps(dice, 24, 40), steps(dice, 5, 10)
    r, t = steps(dice, 6, 10), steps(dice, 4, 8)
    up, mid = h + steps(dice, 12, 24), y / 2 - t / 2
    plate = s.box((0, 0, 0), (x, y, h))
    rib = s.fuse(s.box((x / 2 - r, mid, 0), (x / 2 + r, mid + t, up)), s.cylinder((x / 2, mid, up), "y", r, t))
    part = s.fuse(plate, rib)
    part = s.cut(part, s.cylinder((x / 2, -1, up), "y", r - steps(dice, 2, 4), y + 2))
    for px in (5, x - 5):
        for py in (5, y - 5):
            part = s.cut(part, s.cylinder((px, py, -1), "z", dice.choice([1.5, 2.0]), h + 2))
    return part


def clevis_fork(dice):
    """A fork with two round ears, a cross hole and a shank."""
    r, t, gap = steps(dice, 7, 12), steps(dice, 4, 7), steps(dice, 6, 12)
    length, shank = steps(dice, 14, 30), steps(dice, 12, 25)
    wide = gap + 2 * t
    ears = s.fuse(s.box((0, 0, -r), (length, wide, r)), s.cylinder((length, 0, 0), "y", r, wide))
    ears = s.cut(ears, s.box((5, t, -r - 1), (length + r + 1, t + gap, r + 1)))
    ears = s.cut(ears, s.cylinder((length, -1, 0), "y", r - 3, wide + 2))
    return s.fuse(ears, s.cylinder((-shank, wide / 2, 0), "x", min(r, wide / 2) - 2, shank))


def shelled_box(dice):
    """An open box with bosses, and holes in a wall."""
    x, y, h, t = steps(dice, 40, 60), steps(dice, 30, 45), steps(dice, 15, 25), steps(dice, 2, 4)
    part = s.cut(s.box((0, 0, 0), (x, y, h)), s.box((t, t, t), (x - t, y - t, h + 1)))
    for px in (t + 5, x - t - 5):
        part = s.fuse(part, s.cylinder((px, y / 2, 0), "z", 4, h - steps(dice, 3, 6)))
        part = s.cut(part, s.cylinder((px, y / 2, t), "z", 1.5, h))
    return s.cut(part, s.cylinder((x / 2, -1, h / 2), "y", steps(dice, 2, 4), t + 2))


FAMILIES = [
    keyed_shaft,
    disc_with_tab,
    slot_block,
    three_cylinders,
    bolted_flange,
    ribbed_bracket,
    touching_bodies,
    countersunk_plate,
    chamfered_block,
    pocketed_block,
    half_bores,
    drilled_rib,
    clevis_fork,
    shelled_box,
]
