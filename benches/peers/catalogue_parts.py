"""Makes parts like those of public CAD sets and clean drawings of them, for `sheet_solids.py`.

Parts take the families of `drafting/parts_catalogue.py` in turn, in a random one of the 24 orientations. Each
`NAME.dxf` holds three views in the first or third angle by the exact hidden-line removal of Open Cascade, with
coordinates rounded to 4, 6 or all decimals; hidden lines behind visible ones are removed in half of the
drawings. `NAME.step` is the part and `NAME.json` its volume and traits. Bodies that touch are one body if
their union has the same lines.

A part is rejected only if its shape is invalid, or a view lacks an edge or shows a wrong one (an error of the
hidden-line removal). Ambiguous parts are kept: with `--ambiguous PROGRAM`, a wrong first solid is drawn again;
if it has the lines of the drawing, the drawing is ambiguous, and the program must report several solids.

    python benches/peers/catalogue_parts.py --count 50 --seed 1 --out FOLDER [--visible]
    python benches/peers/sheet_solids.py target/release/planish FOLDER --projection auto --limit 20
    python benches/peers/catalogue_parts.py --ambiguous target/release/planish --out FOLDER --name part_003
"""

import argparse
import json
import math
import pathlib
import random
import subprocess
import tempfile

import ezdxf

from drafting import shapes
from drafting.check import flaws
from drafting.curves import tidy
from drafting.parts_catalogue import FAMILIES
from drafting.views import curves_of

LAYOUTS = {"third": ("front", "top", "right"), "first": ("front", "top", "left")}


def turns():
    """The 24 rotations that exchange axes."""
    found = []
    for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]:
        for signs in range(8):
            rows = [[0] * 3 for _ in range(3)]
            for row, (axis, bit) in enumerate(((i, 1), (j, 2), (k, 4))):
                rows[row][axis] = -1 if signs & bit else 1
            even = (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
            if even == (bin(signs).count("1") % 2 == 0):
                found.append(rows)
    return found


def lengths(curves):
    """Lengths of visible and hidden lines."""
    size = lambda points: sum(math.dist(p, q) for p, q in zip(points, points[1:]))
    return [sum(size(c.points(60)) for c in curves if c.visible == v) for v in (True, False)]


def has_lines_of(shape, other, views):
    """Whether both shapes have views of the same lines, judged by their lengths."""
    pairs = ([lengths(tidy(curves_of(x, view))) for x in (shape, other)] for view in views)
    return all(abs(a - b) < 1e-3 * max(1.0, a) for one, two in pairs for a, b in zip(one, two))


def write(curve, space, at, rounded):
    attributes = {"layer": "VISIBLE" if curve.visible else "HIDDEN"}
    place = lambda p: tuple(rounded(p[k] + at[k]) for k in (0, 1))
    if curve.kind == "line":
        ends = [place(p) for p in curve.data]
        if math.dist(*ends) > 0:
            space.add_line(*ends, attributes)
    elif curve.kind == "arc":
        center, radius, start, sweep = curve.data
        if sweep >= 360 - 1e-9:
            space.add_circle(place(center), rounded(radius), attributes)
        else:
            ends = [rounded(start), rounded(start + sweep)]
            space.add_arc(place(center), rounded(radius), *ends, dxfattribs=attributes)
    elif curve.kind == "ellipse":
        center, major, ratio, start, sweep = curve.data
        ends = [math.radians(start), math.radians(start + sweep)]
        axis = tuple(rounded(c) for c in major)
        space.add_ellipse(place(center), axis, rounded(ratio), *ends, dxfattribs=attributes)
    else:
        space.add_lwpolyline([place(p) for p in curve.points(40)], dxfattribs=attributes)


def draw(views, traits, dice):
    doc = ezdxf.new("R2010", setup=True, units=4)
    doc.layers.add("VISIBLE", lineweight=50)
    doc.layers.add("HIDDEN", linetype="DASHED", lineweight=25)
    space = doc.modelspace()
    boxes = {}
    for name, curves in views.items():
        points = [p for c in curves for p in c.points(60)]
        boxes[name] = [(min(p[k] for p in points), max(p[k] for p in points)) for k in (0, 1)]
    gap = dice.choice([15, 20, 30.5])
    front, top = boxes["front"], boxes["top"]
    side = "right" if "right" in boxes else "left"
    shift = {"front": [dice.choice([0, 50, 37.25]), dice.choice([0, 40, 61.3])]}
    x, y = shift["front"]
    above = traits["projection"] == "third"
    shift["top"] = [x, y + (front[1][1] + gap - top[1][0] if above else front[1][0] - gap - top[1][1])]
    shift[side] = [x + front[0][1] + gap - boxes[side][0][0], y]
    decimals = {"4": 4, "6": 6}.get(traits["decimals"])
    rounded = (lambda x: round(x, decimals)) if decimals else (lambda x: x)
    for name, curves in views.items():
        for curve in curves:
            write(curve, space, shift[name], rounded)
    return doc


def make(number, dice, asked):
    """One part with its drawing; `None` if it is rejected."""
    family = FAMILIES[number % len(FAMILIES)]
    shape = family(dice)
    traits = {"projection": dice.choice(["third", "first"]), "misaligned": "no"}
    traits |= {"decimals": dice.choice(["full", "6", "4"]), "overlaps": dice.choice(["kept", "removed"])}
    bodies = shapes.solids_of(shape)
    if len(bodies) == 1:
        shape = shapes.unified(bodies[0])
    shape = shapes.moved(shape, dice.choice(turns()))
    names = LAYOUTS[traits["projection"]]
    if len(bodies) > 1:
        parts = shapes.solids_of(shape)
        union = shapes.unified(shapes.fuse(parts[0], *parts[1:]))
        if has_lines_of(union, shape, names):
            shape = union
    if not shapes.is_valid(shape):
        return None
    raw = {name: curves_of(shape, name) for name in names}
    clean = {name: tidy(curves) for name, curves in raw.items()}
    if len(shapes.solids_of(shape)) == 1 and any(any(flaws(shape, n, clean[n])) for n in names):
        return None
    views = raw if traits["overlaps"] == "kept" else clean
    if asked.visible:
        views = {name: [c for c in curves if c.visible] for name, curves in views.items()}
    known = {"name": f"part_{number:03}", "family": family.__name__, "features": [], "traits": traits}
    known |= {"volume": shapes.volume(shape), "faces": shapes.face_kinds(shape)}
    return shape, draw(views, traits, dice), known


def judge_ambiguity(asked):
    """Whether the first solid of the program has the lines of the true part."""
    known = json.loads((asked.out / f"{asked.name}.json").read_text())
    true = shapes.read_step(asked.out / f"{asked.name}.step")
    with tempfile.TemporaryDirectory() as scratch:
        out = pathlib.Path(scratch) / "part.step"
        line = [asked.ambiguous, "solid", str(asked.out / f"{asked.name}.dxf"), "-o", str(out)]
        subprocess.run([*line, "--projection", known["traits"]["projection"]], capture_output=True)
        if not out.exists():
            return print(asked.name, "no solid")
        found = shapes.unified(shapes.read_step(out))
    names = LAYOUTS[known["traits"]["projection"]]
    print(asked.name, "ambiguous" if has_lines_of(found, true, names) else "other lines")
    for view in names:
        print(view, [lengths(tidy(curves_of(x, view))) for x in (found, true)])


def main():
    reading = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    reading.add_argument("--count", type=int, default=50)
    reading.add_argument("--seed", type=int, default=1)
    reading.add_argument("--out", type=pathlib.Path, required=True)
    reading.add_argument("--visible", action="store_true", help="draw no hidden lines")
    reading.add_argument("--ambiguous", help="the program; judges the part of --name")
    reading.add_argument("--name")
    asked = reading.parse_args()
    if asked.ambiguous:
        return judge_ambiguity(asked)
    asked.out.mkdir(parents=True, exist_ok=True)
    rejected = 0
    for number in range(asked.count):
        for attempt in range(20):
            dice = random.Random(1000003 * asked.seed + 101 * number + attempt)
            try:
                made = make(number, dice, asked)
            except (RuntimeError, ValueError) as problem:
                print(number, repr(problem)[:100])
                made = None
            if made:
                break
            rejected += 1
        if not made:
            print(number, "no part in 20 attempts")
            continue
        shape, doc, known = made
        base = asked.out / known["name"]
        doc.saveas(f"{base}.dxf")
        shapes.write_step(shape, f"{base}.step")
        base.with_suffix(".json").write_text(json.dumps(known, indent=1))
    print(f"{asked.count} parts, {rejected} attempts rejected")


if __name__ == "__main__":
    main()
