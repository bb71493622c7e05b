"""Draws three views of a part as a picture: titles, dashed hidden lines, three overall dimensions."""

import dataclasses
import math

from .curves import Curve
from .layout import View
from .views import project

SIZE = 800
FONTS = ("DejaVu Sans", "DejaVu Serif", "DejaVu Sans Mono", "STIXGeneral", "cmr10")
TITLES = {
    "en": ("FRONT", "TOP", "RIGHT"),
    "view": ("Front View", "Top View", "Side View"),
    "de": ("Vorderansicht", "Draufsicht", "Seitenansicht"),
    "fr": ("Vue de face", "Vue de dessus", "Vue de droite"),
}
KINDS = ("front", "top", "right")
PICTURE_TRAITS = {
    "arrangement": ("third", "first", "free"),
    "rendering": ("smooth", "smooth", "snapped", "binary"),
    "width": (1.0, 1.5, 2.0, 2.0, 3.0),
    "thin": (1.0, 0.5, 0.7),
    "font": FONTS,
    "titles": tuple(TITLES),
    "arrow": ("filled", "filled", "filled", "open"),
    "gap": (3.0, 5.0, 8.0),
}


def choose_picture(dice, arrangement=None):
    traits = {name: dice.choice(values) for name, values in PICTURE_TRAITS.items()}
    traits["arrangement"] = arrangement or traits["arrangement"]
    traits["dash"] = (dice.uniform(4, 8), dice.uniform(2.5, 4))
    traits["text"] = dice.uniform(9, 14)
    return traits


@dataclasses.dataclass
class Painter:
    """An axis of matplotlib whose units are pixels, y up."""

    axis: object
    traits: dict

    def curve(self, points, width, dashed=False):
        t = self.traits
        pixels = 72 / 100 * width
        style = (0, tuple(t["dash"])) if dashed else "-"
        [line] = self.axis.plot(*zip(*points), color="black", linewidth=pixels, linestyle=style)
        line.set_antialiased(t["rendering"] != "binary")
        line.set_snap(t["rendering"] == "snapped")
        line.set_solid_capstyle("butt")
        line.set_dash_capstyle("butt")

    def text(self, at, text, turned=False):
        self.axis.text(
            *at,
            text,
            fontsize=self.traits["text"],
            family=self.traits["font"],
            ha="center",
            va="center",
            rotation=90 if turned else 0,
        )

    def arrow(self, tip, along):
        """An arrowhead of 11 pixels with its tip at a point."""
        u, v = along
        wings = [(tip[0] - 11 * u + s * 3 * v, tip[1] - 11 * v - s * 3 * u) for s in (-1, 1)]
        if self.traits["arrow"] == "filled":
            self.axis.fill(*zip(tip, *wings), color="black", linewidth=0)
        else:
            self.curve([wings[0], tip, wings[1]], self.thin)

    @property
    def thin(self):
        return max(0.8, self.traits["width"] * self.traits["thin"])

    def dimension(self, a, b, side, value):
        """A dimension of the distance between two corners, beside them by `side` pixels."""
        k = 0 if a[1] == b[1] else 1
        off = lambda p, d: (p[0], p[1] + d) if k == 0 else (p[0] + d, p[1])
        sign = math.copysign(1, side)
        for p in (a, b):
            self.curve([off(p, sign * self.traits["gap"]), off(p, side + 5 * sign)], self.thin)
        self.curve([off(a, side), off(b, side)], self.thin)
        along = (1, 0) if k == 0 else (0, 1)
        self.arrow(off(b, side), along)
        self.arrow(off(a, side), (-along[0], -along[1]))
        middle = [(p + q) / 2 for p, q in zip(off(a, side), off(b, side))]
        away = 0.9 * self.traits["text"]
        self.text((middle[0], middle[1] + away) if k == 0 else (middle[0] - away, middle[1]), value, k == 1)


def places(sizes, traits, dice):
    """Scale, and lower left corners of front, top and side view, in pixels."""
    width, height = sizes["front"]
    depth = sizes["right"][0]
    margin, between = 75, dice.randint(75, 110)
    room = SIZE - 2 * margin - between
    scale = min(room / (width + depth), room / (height + depth), 2.2 * room / 3 / max(width, height, depth))
    w, h, d = (scale * s for s in (width, height, depth))
    spare = [max(0.0, SIZE - 2 * margin - between - s - d) for s in (w, h)]
    x, y = (margin + dice.uniform(0, s) for s in spare)
    if traits["arrangement"] == "third":
        at = {"front": (x, y), "top": (x, y + h + between), "right": (x + w + between, y)}
    elif traits["arrangement"] == "first":
        # The view from the right is at the left.
        at = {
            "front": (x + d + between, y + d + between),
            "top": (x + d + between, y),
            "right": (x, y + d + between),
        }
    else:
        cell = (SIZE - 2 * margin - between) / 2
        scale = min(scale, cell / max(width, height, depth))
        cells = dice.sample([(0, 0), (1, 0), (0, 1), (1, 1)], 3)
        at = {}
        for kind, (column, row) in zip(KINDS, cells):
            size = [scale * s for s in sizes[kind]]
            at[kind] = tuple(
                margin + c * (cell + between) + dice.uniform(0, cell - s)
                for c, s in zip((column, row), size)
            )
    return scale, at


def make_picture(shape, path, traits, dice):
    """Writes the picture; returns what is known about it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    views = {kind: View(kind, project(shape, kind)) for kind in KINDS}
    scale, at = places({kind: view.size for kind, view in views.items()}, traits, dice)
    figure = pyplot.figure(figsize=(SIZE / 100, SIZE / 100), dpi=100)
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_xlim(0, SIZE)
    axis.set_ylim(0, SIZE)
    axis.axis("off")
    painter = Painter(axis, traits)
    known = {"pixels_per_mm": scale, "picture": traits, "views": {}}
    for kind, title in zip(KINDS, TITLES[traits["titles"]]):
        view = views[kind]
        view.at, view.scale = at[kind], scale
        for curve in sorted(view.curves, key=lambda c: c.visible):
            count = 1 if curve.kind == "line" else 96
            painter.curve(view.on_paper(curve).points(count), traits["width"], not curve.visible)
        left, bottom = view.at
        right, top = left + view.size[0], bottom + view.size[1]
        known["views"][kind] = {"box": [left, bottom, right, top]}
        painter.text(((left + right) / 2, bottom - 58), title)
        value = lambda k: f"{view.size[k] / scale:.2f}".rstrip("0").rstrip(".")
        if kind == "front":
            painter.dimension((left, bottom), (right, bottom), -32, value(0))
            painter.dimension((left, bottom), (left, top), -32, value(1))
        elif kind == "right":
            painter.dimension((left, bottom), (right, bottom), -32, value(0))
    figure.savefig(path, facecolor="white")
    pyplot.close(figure)
    if traits["rendering"] == "binary":
        from PIL import Image

        Image.open(path).convert("L").point(lambda v: 255 if v > 127 else 0).save(path)
    return known
