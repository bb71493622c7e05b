"""Plane curves of a view, in millimetres: lines, arcs, ellipses and splines, and joining of their pieces."""

import dataclasses
import math

import numpy
from scipy.interpolate import BSpline

NEAR = 1e-5
# Hidden pieces shorter than this (mm) beside a visible piece of one line become visible.
SLIVER = 0.12


@dataclasses.dataclass
class Curve:
    """A curve of a view.

    Its data are (p, q) of a `line`; (centre, radius, start, sweep) in degrees of an `arc`; (centre, major
    axis, ratio, start, sweep) in degrees of the parameter of an `ellipse`; (degree, knots, poles, weights
    or None) of a `spline`.
    """

    kind: str
    data: tuple
    visible: bool = True
    smooth: bool = False

    def mapped(self, change, factor):
        """The curve after a translation and a scaling; `change` maps points, `factor` lengths."""
        d = self.data
        if self.kind == "line":
            data = (change(d[0]), change(d[1]))
        elif self.kind == "arc":
            data = (change(d[0]), d[1] * factor, d[2], d[3])
        elif self.kind == "ellipse":
            data = (change(d[0]), (d[1][0] * factor, d[1][1] * factor), *d[2:])
        else:
            data = (d[0], d[1], [change(p) for p in d[2]], d[3])
        return dataclasses.replace(self, data=data)

    def points(self, count=48):
        d = self.data
        steps = [k / count for k in range(count + 1)]
        if self.kind == "line":
            return [tuple(d[0][k] + t * (d[1][k] - d[0][k]) for k in (0, 1)) for t in steps]
        if self.kind == "arc":
            return [on_circle(d[0], d[1], d[2] + t * d[3]) for t in steps]
        if self.kind == "ellipse":
            return [on_ellipse(d, d[3] + t * d[4]) for t in steps]
        return spline_points(d, count)

    def is_closed(self):
        return self.kind in ("arc", "ellipse") and self.data[-1] >= 360


def on_circle(center, radius, angle_deg):
    angle = math.radians(angle_deg)
    return center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle)


def on_ellipse(data, parameter_deg):
    center, major, ratio = data[:3]
    c, s = math.cos(math.radians(parameter_deg)), ratio * math.sin(math.radians(parameter_deg))
    return center[0] + c * major[0] - s * major[1], center[1] + c * major[1] + s * major[0]


def spline_points(data, count):
    degree, knots, poles, _ = data
    curve = BSpline(knots, numpy.array(poles), degree)
    return [tuple(map(float, p)) for p in curve(numpy.linspace(knots[degree], knots[-degree - 1], count + 1))]


def extremes(curve):
    """Points among which are the leftmost, lowest, rightmost and uppermost ones of a curve."""
    if curve.kind in ("line", "spline"):
        return curve.points(1 if curve.kind == "line" else 400)
    d = curve.data
    if curve.kind == "arc":
        turns, at = [0, 90, 180, 270], lambda t: on_circle(d[0], d[1], t)
    else:
        (x, y), ratio = d[1], d[2]
        turns = [math.degrees(math.atan2(-ratio * y, x)), math.degrees(math.atan2(ratio * x, y))]
        turns, at = [t + k for t in turns for k in (0, 180)], lambda t: on_ellipse(d, t)
    start, sweep = d[-2:]
    return [at(t) for t in [start, start + sweep, *(t for t in turns if (t - start) % 360 <= sweep)]]


def box_of(curves):
    """Left, bottom, right and top of curves."""
    points = [p for c in curves for p in extremes(c)]
    x, y = [p[0] for p in points], [p[1] for p in points]
    return min(x), min(y), max(x), max(y)


def union(intervals):
    joined = []
    for lo, hi in sorted(intervals):
        if joined and lo <= joined[-1][1] + NEAR:
            joined[-1][1] = max(joined[-1][1], hi)
        else:
            joined.append([lo, hi])
    return joined


def without(intervals, covered):
    """The parts of intervals that other intervals do not cover."""
    for lo, hi in covered:
        left = []
        for a, b in intervals:
            left += [(x, y) for x, y in ((a, min(b, lo)), (max(a, hi), b)) if y - x > NEAR]
        intervals = left
    return intervals


def carrier_of(curve):
    """The unbounded curve on which a curve lies, as numbers, and the interval that it covers there."""
    d = curve.data
    if curve.kind == "line":
        (x, y), (u, v) = d
        angle = math.atan2(v - y, u - x) % math.pi
        angle = 0.0 if math.pi - angle < 1e-9 else angle
        along = (math.cos(angle), math.sin(angle))
        reach = sorted((x * along[0] + y * along[1], u * along[0] + v * along[1]))
        return ("line", angle * 100, y * along[0] - x * along[1]), tuple(reach)
    if curve.kind == "arc":
        return ("arc", d[0][0], d[0][1], d[1]), (d[2] % 360, d[2] % 360 + d[3])
    turn = math.degrees(math.atan2(d[1][1], d[1][0]))
    shift = 180 if turn % 360 >= 180 - 1e-9 else 0
    start = (d[3] + shift) % 360
    size = math.hypot(*d[1])
    return ("ellipse", d[0][0], d[0][1], turn % 180, size, d[2]), (start, start + d[4])


def from_carrier(carrier, lo, hi, visible):
    if carrier[0] == "line":
        c, s = math.cos(carrier[1] / 100), math.sin(carrier[1] / 100)
        at = lambda t: (t * c - carrier[2] * s, t * s + carrier[2] * c)
        return Curve("line", (at(lo), at(hi)), visible)
    if carrier[0] == "arc":
        return Curve("arc", (carrier[1:3], carrier[3], lo, min(hi - lo, 360.0)), visible)
    turn = math.radians(carrier[3])
    major = (carrier[4] * math.cos(turn), carrier[4] * math.sin(turn))
    return Curve("ellipse", (carrier[1:3], major, carrier[5], lo, min(hi - lo, 360.0)), visible)


def cyclic(intervals):
    """Cuts intervals of angles at 360°."""
    parts = []
    for lo, hi in intervals:
        parts += [(0.0, 360.0)] if hi - lo > 360 - 1e-6 else [(lo, min(hi, 360.0))]
        if hi > 360 and hi - lo <= 360 - 1e-6:
            parts.append((0.0, hi - 360))
    return parts


def rejoined(intervals):
    """Joins an interval that ends at 360° with one that begins at 0°."""
    intervals = [list(i) for i in intervals]
    if len(intervals) > 1 and intervals[0][0] < NEAR and intervals[-1][1] > 360 - NEAR:
        first = intervals.pop(0)
        intervals[-1][1] += first[1]
    return intervals


def tidy(curves):
    """Joins pieces of one line or circle, and removes hidden pieces that lie under visible ones."""
    plain = [c for c in curves if c.kind != "spline"]
    circles = {c.data[:2] for c in plain if c.kind == "arc"}
    curves = plain + [on_known_circle(c, circles) for c in curves if c.kind == "spline"]
    carriers, splines = [], []
    for curve in curves:
        if curve.kind == "spline":
            splines.append(curve)
            continue
        key, interval = carrier_of(curve)
        found = next((c for c in carriers if same(c[0], key)), None)
        if found is None:
            found = (key, {True: [], False: []})
            carriers.append(found)
        found[1][curve.visible].append(interval)
    result = []
    for key, pieces in carriers:
        turns = key[0] != "line"
        seen = union(cyclic(pieces[True]) if turns else pieces[True])
        hidden = without(union(cyclic(pieces[False]) if turns else pieces[False]), seen)
        # Degrees of circles and ellipses to lengths.
        length = math.radians(key[3 if key[0] == "arc" else 4]) if turns else 1.0
        seen, hidden = bridged(seen, hidden, SLIVER / length)
        for visible, intervals in ((True, seen), (False, hidden)):
            for lo, hi in rejoined(intervals) if turns else intervals:
                if hi - lo > 1e-4:
                    result.append(from_carrier(key, lo, hi, visible))
    visible = [c for c in (*result, *splines) if c.visible]
    result = [c for c in result if c.visible or not is_sliver(c, visible)]
    return result + distinct(splines, [c for c in result if c.visible])


def is_sliver(curve, visible):
    """Whether a short hidden piece lies under visible curves, but for its rounding."""
    points = curve.points(4)
    return (
        not curve.is_closed()
        and math.dist(points[0], points[-1]) < SLIVER
        and distances(points, visible).max() < SLIVER / 2
    )


def on_known_circle(spline, circles):
    """Hidden-line removal gives some arcs as splines: they become arcs if the circle is drawn elsewhere."""
    points = numpy.array(spline.points(24))
    for center, radius in circles:
        if numpy.abs(numpy.hypot(*(points - center).T) - radius).max() > 1e-3:
            continue
        angles = numpy.degrees(numpy.unwrap(numpy.arctan2(*(points - center).T[::-1])))
        lo, hi = sorted((float(angles[0]), float(angles[-1])))
        return dataclasses.replace(spline, kind="arc", data=(center, radius, lo, hi - lo))
    return spline


def bridged(seen, hidden, limit):
    """Hidden pieces shorter than the limit between visible ones are errors of the hidden-line removal."""
    seen, hidden = [list(i) for i in seen], [list(i) for i in hidden]
    short = [i for i in hidden if i[1] - i[0] < limit]
    short = [i for i in short if any(abs(i[0] - s[1]) < 1e-4 or abs(i[1] - s[0]) < 1e-4 for s in seen)]
    return union(seen + short), [i for i in hidden if i not in short]


def distinct(splines, visible):
    """Splines that do not lie on another one, or as hidden ones close to visible curves."""
    kept = []
    for curve in sorted(splines, key=lambda c: not c.visible):
        if any(distances(curve.points(12), [c]).max() < 2e-4 for c in kept):
            continue
        above = [*visible, *(c for c in kept if c.visible)]
        if not curve.visible and distances(curve.points(12), above).max() < 0.03:
            continue
        kept.append(curve)
    return kept


def same(a, b):
    if a[0] != b[0]:
        return False
    return all(abs(x - y) < 2e-5 for x, y in zip(a[1:], b[1:]))


def distances(points, curves):
    """Distance of each point from the nearest curve; ellipses and splines are taken as fine polygons."""
    points = numpy.array(points, float)
    nearest = numpy.full(len(points), numpy.inf)
    for curve in curves:
        nearest = numpy.minimum(
            nearest, from_arc(points, curve) if curve.kind == "arc" else from_chain(points, curve)
        )
    return nearest


def from_arc(points, curve):
    center, radius, start, sweep = curve.data
    to = points - numpy.array(center)
    angle = (numpy.degrees(numpy.arctan2(to[:, 1], to[:, 0])) - start) % 360
    radial = numpy.abs(numpy.hypot(to[:, 0], to[:, 1]) - radius)
    ends = numpy.array([on_circle(center, radius, start), on_circle(center, radius, start + sweep)])
    end = numpy.linalg.norm(points[:, None] - ends[None], axis=2).min(1)
    return numpy.where((angle <= sweep) | (sweep >= 360), radial, end)


def from_chain(points, curve):
    chain = numpy.array(curve.points(1 if curve.kind == "line" else 300))
    a, along = chain[:-1], chain[1:] - chain[:-1]
    square = numpy.maximum((along**2).sum(1), 1e-18)
    to = points[:, None, :] - a[None]
    share = numpy.clip((to * along[None]).sum(2) / square, 0, 1)
    away = to - share[:, :, None] * along[None]
    return numpy.sqrt((away**2).sum(2)).min(1)
