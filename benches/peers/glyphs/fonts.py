"""Fonts for the glyph reader, drawn at one size: outlines, and strokes of Hershey and LibreCAD.

Every font draws a character on a canvas of `SIZE` pixels with capitals `CAP` pixels high and the baseline at
row `BASE`. Outline fonts need the packages of `fonts.md`, Hershey's `hershey-fonts-data`, and LibreCAD's
`librecad-data`.
"""

import functools
import math
import pathlib
import re

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

CAP, BASE, SIZE = 64, 112, 160
DIAMETER = "Ø"
CLASSES = "0123456789.,:-+±°Ø×/%()=ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwyzäöüé"
# What is drawn for a class; one that fonts lack is drawn as another with a stroke through it.
DRAWN = {DIAMETER: "Ø⌀∅φΦ", "×": "×x", "-": "-−–"}
HERSHEY = pathlib.Path("/usr/share/hershey-fonts")


class Outlines:
    """An outline font."""

    def __init__(self, path):
        self.name = pathlib.Path(path).stem
        self.font = ImageFont.truetype(path, 100)
        cap = self._height("H")
        digits = [self._height(c) for c in "0123456789"]
        # Old-style digits have descenders, and fonts of symbols have other shapes.
        if cap <= 0 or min(digits) < 0.85 * cap or max(digits) > 1.15 * cap:
            raise ValueError("no digits as high as capitals")
        self.font = ImageFont.truetype(path, 100 * CAP / cap)
        self.missing = self._mask("\ufffe")
        if np.array_equal(self._mask("A"), self._mask("B")):
            raise ValueError("no letters")

    def _height(self, char):
        left, top, right, bottom = self.font.getbbox(char, anchor="ls")
        return bottom - top

    @functools.lru_cache(maxsize=None)
    def _mask(self, char):
        picture = Image.new("L", (SIZE, SIZE))
        ImageDraw.Draw(picture).text((SIZE / 2, BASE), char, 255, self.font, anchor="ms")
        return np.asarray(picture, np.uint8)

    def has(self, char):
        mask = self._mask(char)
        return mask.max() > 128 and not np.array_equal(mask, self.missing)

    def draw(self, char, weight):
        """Draws a character; weight: change of the width of strokes in pixels of the canvas."""
        mask = self._mask(char)
        if abs(weight) >= 0.5:
            size = 2 * round(abs(weight) / 2) + 1
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
            changed = (cv2.dilate if weight > 0 else cv2.erode)(mask, kernel)
            # Thin strokes would vanish.
            if changed.sum() > 0.6 * mask.sum():
                return changed
        return mask

    def advance(self, char):
        return self.font.getlength(char)


class Strokes:
    """A font of polylines: {char: (lines, advance)} in units of the height of capitals, y up."""

    def __init__(self, name, glyphs, ready=False):
        self.name = name
        if not ready:
            ys = [y for line in glyphs["H"][0] for _, y in line]
            low, unit = min(ys), max(ys) - min(ys)
            move = lambda p: (p[0] / unit, (p[1] - low) / unit)
            glyphs = {c: ([[move(p) for p in line] for line in g], a / unit) for c, (g, a) in glyphs.items()}
        self.glyphs = glyphs
        circle = [(0.4 + 0.4 * math.cos(t), 0.5 + 0.4 * math.sin(t)) for t in np.linspace(0, 2 * math.pi, 25)]
        small = [
            (0.15 + 0.15 * math.cos(t), 0.85 + 0.15 * math.sin(t)) for t in np.linspace(0, 2 * math.pi, 17)
        ]
        self.glyphs.setdefault(DIAMETER, ([circle, [(0.05, 0.0), (0.75, 1.0)]], 1.0))
        self.glyphs.setdefault("°", ([small], 0.5))
        if "×" not in self.glyphs:
            self.glyphs["×"] = ([[(0, 0.2), (0.6, 0.8)], [(0, 0.8), (0.6, 0.2)]], 0.8)
        if "±" not in self.glyphs:
            lines = [[(0, 0.5), (0.6, 0.5)], [(0.3, 0.25), (0.3, 0.75)], [(0, 0.1), (0.6, 0.1)]]
            self.glyphs["±"] = (lines, 0.8)
        for char, base in zip("äöü", "aou", strict=True):
            if char not in self.glyphs and base in self.glyphs:
                lines, advance = self.glyphs[base]
                xs = [x for line in lines for x, _ in line]
                dots = [[(min(xs) + f * (max(xs) - min(xs)), 0.9)] * 2 for f in (0.25, 0.75)]
                self.glyphs[char] = (lines + dots, advance)

    def has(self, char):
        return char in self.glyphs

    def draw(self, char, weight, variant=None):
        """Draws a character; weight: width of strokes in pixels of the canvas; variant: other lines."""
        lines = variant or self.glyphs[char][0]
        xs = [x for line in lines for x, _ in line]
        middle = 0.5 * (min(xs) + max(xs))
        picture = np.zeros((SIZE, SIZE), np.uint8)
        for line in lines:
            points = [[16 * (SIZE / 2 + CAP * (x - middle)), 16 * (BASE - CAP * y)] for x, y in line]
            points = np.round(points).astype(np.int32)
            cv2.polylines(picture, [points], False, 255, max(1, round(weight)), cv2.LINE_AA, 4)
        return picture

    def advance(self, char):
        return CAP * self.glyphs[char][1]


def variant(char, rng):
    """Characters as standards of drawings and CAD programs draw them, and fonts rarely; None for others."""
    x = lambda low, high: rng.uniform(low, high)
    if char == "4":
        wide, bar, stem = x(0.5, 0.7), x(0.15, 0.35), x(0.35, 0.5)
        return [[(x(0.25, 0.5), 1), (0, bar), (wide, bar)], [(stem, x(0.45, 0.7)), (stem, 0)]]
    if char == "7":
        wide = x(0.5, 0.7)
        bar = [[(0.15 * wide, 0.5), (0.85 * wide, 0.5)]] if rng.random() < 0.5 else []
        return [[(0, 1), (wide, 1), (x(0.1, 0.5) * wide, 0)], *bar]
    if char == "1":
        flag, low = x(0.15, 0.35), x(0.65, 0.85)
        return [[(0, low), (flag, 1), (flag, 0)]]
    if char == "Ø":
        wide, over = x(0.35, 0.5), x(0.0, 0.25)
        turns = np.linspace(0, 2 * math.pi, 25)
        return [
            [(wide * math.cos(t), 0.5 + 0.45 * math.sin(t)) for t in turns],
            [(-wide - 0.3 * over, -over), (wide + 0.3 * over, 1 + over)],
        ]
    if char == "0":
        turns, wide = np.linspace(0, 2 * math.pi, 25), x(0.25, 0.45)
        return [[(wide * math.cos(t), 0.5 + 0.5 * math.sin(t)) for t in turns]]
    return None


def hershey(path):
    """A font of Hershey in the format JHF: characters from space to tilde, one after the other."""
    text = path.read_text().replace("\n", "")
    glyphs, at, code = {}, 0, 32
    while at + 8 <= len(text) and code < 127:
        count = int(text[at + 5 : at + 8])
        pairs = text[at + 8 : at + 8 + 2 * count]
        at += 8 + 2 * count
        offset = lambda c: ord(c) - ord("R")
        left, right = offset(pairs[0]), offset(pairs[1])
        lines = [[]]
        for k in range(2, len(pairs), 2):
            if pairs[k : k + 2] == " R":
                lines.append([])
            else:
                lines[-1].append((offset(pairs[k]) - left, -offset(pairs[k + 1])))
        lines = [line if len(line) > 1 else line * 2 for line in lines if line]
        if lines:
            glyphs[chr(code)] = (lines, right - left)
        code += 1
    return Strokes("hershey-" + path.stem, glyphs)


def librecad(path):
    """A font of LibreCAD in the format LFF; arcs are given by their bulge."""
    text = path.read_text(encoding="utf-8", errors="replace")
    spacing = re.search(r"LetterSpacing:\s*([\d.]+)", text)
    spacing = float(spacing.group(1)) if spacing else 0
    glyphs = {}
    for block in re.split(r"\n(?=\[[0-9a-fA-F]+\])", text)[1:]:
        rows = [r for r in block.splitlines() if not r.startswith("#")]
        char, lines = chr(int(rows[0][1 : rows[0].index("]")], 16)), []
        for row in rows[1:]:
            if row.startswith("C"):
                lines += glyphs.get(chr(int(row[1:], 16)), ([], 0))[0]
            elif row.strip():
                lines.append(_bulged(row))
        xs = [x for line in lines for x, _ in line]
        if xs:
            glyphs[char] = (lines, max(xs) + spacing)
    return Strokes(path.stem, glyphs)


def _bulged(row):
    points = []
    for vertex in row.split(";"):
        parts = vertex.split(",")
        p = (float(parts[0]), float(parts[1]))
        bulge = float(parts[2][1:]) if len(parts) > 2 and parts[2].startswith("A") else 0
        if bulge and points:
            a, chord = points[-1], complex(p[0] - points[-1][0], p[1] - points[-1][1])
            angle = 4 * math.atan(bulge)
            centre = complex(*a) + chord / 2 + 1j * chord / 2 / math.tan(angle / 2)
            start = complex(*a) - centre
            for k in range(1, 13):
                q = centre + start * complex(math.cos(angle * k / 12), math.sin(angle * k / 12))
                points.append((q.real, q.imag))
        else:
            points.append(p)
    return points if len(points) > 1 else points * 2


# Whole families, so that no variant of a tested font was trained on.
CALIBRATED = ("OpenSans", "FreeSans", "NationalPark", "hershey-futuram", "CourierPrime", "PT", "Jura", "P052")
TESTED = ("osifont", "OSP-DIN", "Lato", "Carlito", "Switzera", "Play", "iso", "iso3098", "standard",
          "simplex", "azomix", "Andika", "Clear")  # fmt: skip
SKIPPED = ("Initial", "Keyboard", "Outline", "Hairline", "Display-Black", "Smallcaps", "Z003", "D050000L", "cursor-bold",
           "chorus", "Symbols", "Integrals", "SizeO", "SizeT", "SizeF", "Variants", "NonUni", "Dingbat", "Humor",
           "Script", "Braille", "Nastaliq", "Kufi", "Urdu")  # fmt: skip
TRAINED_LFF = ("lc_opengost-ar", "lc_opengost-br")
TRAINED_STROKES = ("futural", "rowmans", "rowmand", "rowmant", "timesr", "timesi")


def share(name):
    """Which part of the work a font has: `train`, `calibrate` or `test`."""
    short = name.replace(" ", "")
    if any(short.startswith(t) for t in TESTED):
        return "test"
    return "calibrate" if any(short.startswith(c) for c in CALIBRATED) else "train"


def all_fonts(lff=None, part=None):
    """All usable fonts, or those of one part; lff: the folder of LibreCAD's fonts (only those under OFL train)."""
    found = []
    for path in sorted(pathlib.Path("/usr/share/fonts").rglob("*")):
        if path.suffix.lower() not in (".ttf", ".otf") or any(s in path.stem for s in SKIPPED):
            continue
        # Of Noto only those with Latin letters; the others share the digits of Noto Sans or have none.
        noto = re.match(r"Noto(Sans|Serif|SansMono|SansDisplay|SerifDisplay)-", path.stem)
        if path.stem.startswith("Noto") and (
            not noto or not re.search("(Regular|Bold|Italic|Light|Condensed)$", path.stem)
        ):
            continue
        if part and share(path.stem) != part:
            continue
        try:
            found.append(Outlines(str(path)))
        except (ValueError, OSError):
            continue
    stroke_fonts = [(HERSHEY / f"{n}.jhf", hershey) for n in (*TRAINED_STROKES, "futuram")]
    if lff:
        names = (*TRAINED_LFF, "iso", "iso3098", "standard", "simplex", "azomix")
        stroke_fonts += [(pathlib.Path(lff) / f"{n}.lff", librecad) for n in names]
    for path, read in stroke_fonts:
        name = ("hershey-" if read is hershey else "") + path.stem
        if not part or share(name) == part:
            found.append(read(path))
    return found
