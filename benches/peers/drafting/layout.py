"""Places the views of a part on a sheet."""

import dataclasses
import math

from .curves import Curve, box_of
from .views import project, section, section_plane, through

SIZES = [(297, 210), (420, 297), (594, 420), (841, 594), (1189, 841)]
TITLE = (170.0, 54.0)


@dataclasses.dataclass
class View:
    """A view in the part's lengths, and the place of its lower left corner on the paper."""

    kind: str
    curves: list
    outlines: list = dataclasses.field(default_factory=list)
    at: tuple = (0.0, 0.0)
    scale: float = 1.0
    cut_at: float | None = None
    box: tuple | None = None

    def __post_init__(self):
        # A section shows a part of the body, but is aligned as the whole.
        self.drawn_box = box_of(self.curves)
        self.box = self.box or self.drawn_box

    @property
    def size(self):
        return [self.scale * (self.box[k + 2] - self.box[k]) for k in (0, 1)]

    def to_paper(self, point):
        return tuple(self.at[k] + self.scale * (point[k] - self.box[k]) for k in (0, 1))

    def on_paper(self, curve):
        return curve.mapped(self.to_paper, self.scale)


def number(scale):
    above, below = (int(n) for n in scale.split(":"))
    return above / below


def needed_views(traits, dice):
    """Names of the views: front and top, a side view, or both."""
    if traits["views"] == "2":
        return ["front", dice.choice(["top", traits["side"]])]
    return ["front", "top", traits["side"]]


def drawn_views(shape, traits, dice):
    """The views of the sheet, not yet placed: those that show the part, a section, and a pictorial view."""
    smooth, hidden = traits["smooth"] == "yes", traits["hidden"] == "yes"
    views = {name: View(name, project(shape, name, smooth, hidden)) for name in needed_views(traits, dice)}
    side, kind = traits["side"], traits["section"]
    # The mark of a section is drawn in another view.
    if kind == "replace-front" and "top" in views:
        views["front"] = cut_view(shape, "front", "front", views["front"].box, dice)
    elif kind == "replace-side" and side in views:
        views[side] = cut_view(shape, side, side, views[side].box, dice)
    elif kind == "extra":
        whole = views[side].box if side in views else box_of(project(shape, side))
        views["section"] = cut_view(shape, "section", side, whole, dice)
    if traits["corner"] == "iso":
        views["iso"] = View("iso", project(shape, "iso", hidden=False))
    elif traits["corner"] == "detail":
        views["detail"] = detail(views["front"], dice)
    return views


def cut_view(shape, kind, direction, whole, dice):
    """A section that is placed as the view of the whole part with the bounds `whole`."""
    at = section_plane(shape, 1 if direction == "front" else 0, dice)
    return View(kind, *section(shape, direction, at), cut_at=at, box=whole)


def detail(front, dice):
    """What a circle around an end of a line of the front view contains."""
    lines = [c for c in front.curves if c.kind == "line" and c.visible] or front.curves
    center = dice.choice(dice.choice(lines).points(1))
    left, bottom, right, top = front.box
    radius = max(3.0, 0.12 * max(right - left, top - bottom))
    curves = [piece for c in front.curves if c.visible for piece in clipped(c, center, radius)]
    found = View("detail", curves + [Curve("arc", (center, radius, 0.0, 360.0))])
    found.center, found.radius = center, radius
    return found


def clipped(curve, center, radius):
    """The pieces of a curve inside a circle."""
    count = 400
    points = curve.points(count)
    inside = [math.dist(p, center) < radius for p in points]
    runs, begin = [], None
    for k, is_in in enumerate([*inside, False]):
        if is_in and begin is None:
            begin = k
        elif not is_in and begin is not None:
            runs.append((begin, k - 1))
            begin = None
    d = curve.data
    for a, b in runs:
        if b - a < 2:
            continue
        if curve.kind == "line":
            yield Curve("line", (points[a], points[b]))
        elif curve.kind == "arc":
            yield Curve("arc", (d[0], d[1], d[2] + d[3] * a / count, d[3] * (b - a) / count))
        elif curve.kind == "ellipse":
            yield Curve("ellipse", (*d[:3], d[3] + d[4] * a / count, d[4] * (b - a) / count))
        elif b - a >= 4:
            yield Curve("spline", through(points[a : b + 1]))


def place(views, traits, dice):
    """Sets places and scales of all views; returns the size of the sheet."""
    scale = number(traits["scale"])
    for view in views.values():
        view.scale = scale
    front, gap = views["front"], dice.randint(38, 56)
    size = front.size
    side_name = next((n for n in ("right", "left") if n in views), None)
    third = traits["projection"] == "third"
    side_at_right = (side_name or traits["side"]) == ("right" if third else "left")
    low, high = list(front.at), [front.at[k] + size[k] for k in (0, 1)]
    if "top" in views:
        top = views["top"]
        top.at = (0.0, size[1] + gap) if third else (0.0, -gap - top.size[1])
        low[1], high[1] = min(low[1], top.at[1]), max(high[1], top.at[1] + top.size[1])
    for name in (side_name, "section" if "section" in views else None):
        if name:
            side = views[name]
            side.at = (high[0] + gap, 0.0) if side_at_right else (low[0] - gap - side.size[0], 0.0)
            low[0], high[0] = min(low[0], side.at[0]), max(high[0], side.at[0] + side.size[0])
    for name in ("iso", "detail"):
        if name in views:
            place_in_corner(views[name], views, gap, third, side_at_right, low, high)
    if traits["misaligned"] == "yes":
        for name in sorted(set(views) - {"front"}):
            views[name].at = tuple(c + dice.uniform(-0.02, 0.02) for c in views[name].at)
    return centred(views, traits, dice, low, high)


def place_in_corner(view, views, gap, third, at_right, low, high):
    """Places a view in the corner that the views leave free."""
    front = views["front"]
    room_x = max(
        40.0, max((v.size[0] for n, v in views.items() if n in ("right", "left", "section")), default=50)
    )
    room_y = max(40.0, views["top"].size[1] if "top" in views else 50.0)
    wide, tall = view.size
    factor = min(room_x / wide, room_y / tall)
    steps = (0.5, 1, 2, 3, 4, 5) if view.kind == "detail" else (0.1, 0.2, 0.25, 0.4, 0.5, 0.7, 0.8, 1, 1.5, 2)
    view.scale *= max([s for s in steps if s <= factor], default=steps[0])
    wide, tall = view.size
    y = front.size[1] + gap + 5 if third else -gap - 5 - tall
    x = front.size[0] + gap + 5 if at_right else -gap - 5 - wide
    view.at = (x, y)
    for k, extent in enumerate((wide, tall)):
        low[k], high[k] = min(low[k], view.at[k]), max(high[k], view.at[k] + extent)


def centred(views, traits, dice, low, high):
    """Moves all views to a sheet that is large enough; with a frame, the title block stays free."""
    margin, title = 33.0, TITLE[1] + 6 if traits["frame"] != "no" else 0.0
    need = (high[0] - low[0] + 2 * margin + 30, high[1] - low[1] + 2 * margin + 20 + title)
    sheet = next((s for s in SIZES if s[0] >= need[0] and s[1] >= need[1]), need)
    shift = [margin + 20 - low[0], margin + 10 + title - low[1]]
    for k in (0, 1):
        shift[k] += (sheet[k] - need[k]) * dice.choice([0.0, 0.5, 0.5])
    shift = [round(s, dice.choice([0, 1, 3])) for s in shift]
    for view in views.values():
        view.at = tuple(view.at[k] + shift[k] for k in (0, 1))
    return sheet
