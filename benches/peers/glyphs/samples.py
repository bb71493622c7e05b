"""Samples of glyphs as pictures of drawings show them: any size, width of stroke, blur, noise, JPEG, tilt.

A sample is what `crates/exchange/src/glyphs` gives to the network: `GRID` × `GRID` values of ink and four
numbers about its place in the word. Shapes that are no glyphs (pieces, pairs, lines, arrowheads, hatches) are
the last class.

    python benches/peers/glyphs/samples.py --part train --count 2500 --seed 1 --out train.npz
"""

import argparse
import re

import cv2
import numpy as np
from fonts import BASE, CAP, CLASSES, DIAMETER, DRAWN, SIZE, Strokes, all_fonts, variant

GRID, INNER = 24, 20
REJECT = len(CLASSES)
MASK, EDGE = 0.35, 0.45


def normalised(ink, box):
    """Resamples a box (x0, y0, x1, y1, inclusive) so that its longer side has `INNER` cells."""
    x0, y0, x1, y1 = box
    scale = INNER / max(x1 - x0 + 1, y1 - y0 + 1)
    fine = int(min(6, max(1, np.ceil(1 / scale))))
    steps = (np.arange(GRID * fine) + 0.5) / fine - GRID / 2
    xs, ys = 0.5 * (x0 + x1) + steps / scale, 0.5 * (y0 + y1) + steps / scale
    grid_x, grid_y = np.meshgrid(xs.astype(np.float32), ys.astype(np.float32))
    values = cv2.remap(ink, grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return values.reshape(GRID, fine, GRID, fine).mean((1, 3))


def seen(mask, height, rng):
    """How a picture shows a canvas when capitals are `height` pixels high; with the place of the baseline."""
    scale = height / CAP
    angle, shear = (
        np.radians(rng.uniform(-2.3, 2.3)),
        rng.uniform(-0.05, 0.05) if rng.random() < 0.7 else rng.uniform(-0.1, 0.27),
    )
    stretch = rng.uniform(0.8, 1.25)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = scale * turn @ np.array([[stretch, -shear], [0, 1]])
    size = int(np.ceil(1.3 * SIZE * scale)) + 8
    shift = np.array([size / 2, 0.7 * size]) + rng.uniform(-0.5, 0.5, 2) - linear @ np.array([SIZE / 2, BASE])
    # Areas of pixels: the canvas is blurred by the width of a pixel first.
    soft = cv2.GaussianBlur(mask, (0, 0), 0.35 / scale) if scale < 1 else mask
    ink = cv2.warpAffine(
        soft, np.hstack([linear, shift[:, None]]), (size, size), flags=cv2.INTER_LINEAR
    ) / np.float32(255)
    kind = rng.random()
    if kind < 0.5:
        ink = cv2.GaussianBlur(ink, (0, 0), rng.uniform(0.3, min(1.6, 0.06 * height + 0.25)))
    elif kind < 0.75:
        ink = (ink > rng.uniform(0.35, 0.6)).astype(np.float32)
    ink = ink * rng.uniform(0.5, 1)
    if rng.random() < 0.5:
        ink = ink + rng.normal(0, rng.uniform(0, 0.06), ink.shape).astype(np.float32)
    if rng.random() < 0.25:
        grey = np.uint8(np.clip(255 - 235 * ink, 0, 255))
        done, packed = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(30, 90))])
        ink = (255 - cv2.imdecode(packed, 0)) / np.float32(235)
    return np.clip(ink, 0, 1), shift[1] + (linear @ np.array([SIZE / 2, BASE]))[1]


def sample(ink, baseline, height, rng):
    """The network's inputs for what a picture shows; None if nothing is left."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((ink > MASK * ink.max()).astype(np.uint8))
    keep = [k for k in range(1, count) if stats[k, 4] >= max(1, 0.03 * stats[1:, 4].max())]
    if not keep:
        return None
    own = np.isin(labels, keep)
    dark = np.percentile(ink[own], 90)
    ys, xs = np.nonzero(own & (ink > EDGE * dark))
    if len(xs) == 0:
        return None
    box = (xs.min(), ys.min(), xs.max(), ys.max())
    near = cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    picture = normalised(np.where(near, np.minimum(ink / dark, 1), 0).astype(np.float32), box)
    # Heights of lines are estimated from other glyphs, some of which are higher than capitals.
    chance = rng.random()
    factor = rng.uniform(1.1, 1.35) if chance < 0.1 else rng.uniform(0.72, 0.9) if chance < 0.15 else 1
    line = height * factor * np.exp(rng.normal(0, 0.05))
    baseline = baseline + rng.normal(0, 0.04) * height
    place = [
        (box[3] - box[1] + 1) / line,
        (baseline - box[3] - 0.5) / line,
        (box[2] - box[0] + 1) / line,
        min(line, 48) / 32,
    ]
    return np.uint8(np.round(255 * picture)), np.clip(place, -1, 3).astype(np.float32)


def weight(font, height, rng):
    if isinstance(font, Strokes):
        pixels = rng.uniform(1, max(1.6, 0.16 * height))
        return pixels * CAP / height
    return rng.normal(0, 1.5)


def glyph(font, char, height, rng, with_variants=False):
    if with_variants and isinstance(font, Strokes) and rng.random() < 0.4:
        return font.draw(char, weight(font, height, rng), variant(char, rng))
    return font.draw(char, weight(font, height, rng))


def pair(font, rng, height):
    """Two glyphs that touch, or a glyph and a point."""
    chars = [rng.choice(list("0123456789ABRxm°Ø")) for _ in range(2)]
    if rng.random() < 0.5:
        chars[rng.integers(2)] = rng.choice(list(".,"))
    a, b = (glyph(font, c, height, rng) for c in chars)
    (ax, bx) = (np.nonzero(m.any(0))[0] for m in (a, b))
    if len(ax) == 0 or len(bx) == 0:
        return a
    shift = int(ax[-1] - bx[0] - rng.integers(0, 4))
    canvas = np.maximum(
        np.pad(a, ((0, 0), (SIZE, SIZE))), np.roll(np.pad(b, ((0, 0), (SIZE, SIZE))), shift, 1)
    )
    middle = (SIZE + ax[0] + SIZE + shift + bx[-1]) // 2
    return canvas[:, middle - SIZE // 2 : middle + SIZE // 2]


def piece(font, rng, height):
    """A part of a glyph, cut where touching glyphs would be cut wrongly."""
    mask = glyph(font, rng.choice(list("0245689ABDGHKMNRSwmØ")), height, rng).copy()
    xs = np.nonzero(mask.any(0))[0]
    if len(xs) < 8:
        return mask
    cut = int(xs[0] + rng.uniform(0.3, 0.7) * (xs[-1] - xs[0]))
    mask[:, slice(cut, None) if rng.random() < 0.5 else slice(0, cut)] = 0
    return mask


def shape(rng, height):
    """Line work: strokes longer than glyphs, corners, arrowheads, hatches, circles."""
    mask = np.zeros((SIZE, SIZE), np.uint8)
    width = int(max(1, rng.uniform(0.8, max(1.6, 0.12 * height)) * CAP / height))
    point = lambda low, high: tuple(int(v) for v in rng.integers(low, high, 2))
    draw = lambda a, b: cv2.line(mask, a, b, 255, width, cv2.LINE_AA)
    kind = rng.integers(0, 9)
    x, y = point(50, 110)
    if kind == 0:
        half = int(rng.integers(32, 74))
        draw((80 - half, y), (80 + half, y))
    elif kind == 1:
        half = int(rng.integers(42, 78))
        draw((x, 80 - half), (x, 80 + half))
    elif kind == 2:
        draw(point(4, 70), point(90, 156))
    elif kind in (3, 4):
        length, half = rng.integers(18, 90), rng.integers(4, 16)
        angle = rng.choice([0, 90, 180, 270, rng.uniform(0, 360)]) * np.pi / 180
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        tip = np.array([80, 80]) + 0.5 * length * along
        corners = np.array([tip, tip - length * along + half * across, tip - length * along - half * across])
        cv2.fillPoly(mask, [np.int32(16 * corners)], 255, cv2.LINE_AA, 4)
    elif kind == 5:
        for k in range(int(rng.integers(2, 6))):
            step = 14 * k
            draw((30 + step, 110), (70 + step, 50))
    elif kind == 6:
        draw((x, y), (x + int(rng.choice([-1, 1]) * rng.integers(20, 50)), y))
        draw((x, y), (x, y + int(rng.choice([-1, 1]) * rng.integers(20, 50))))
    elif kind == 7:
        radius = int(rng.integers(20, 60))
        start = rng.uniform(0, 360)
        cv2.ellipse(
            mask, (80, 80), (radius, radius), 0, start, start + rng.uniform(30, 200), 255, width, cv2.LINE_AA
        )
    else:
        radius = int(rng.integers(14, 60))
        cv2.circle(mask, (80, 80), radius, 255, width, cv2.LINE_AA)
        draw((80 - radius - 14, 80), (80 + radius + 14, 80))
        draw((80, 80 - radius - 14), (80, 80 + radius + 14))
    return mask


def family(font):
    return re.split(r"[-_ 0-9\[]", font.name)[0][:7].lower() if not isinstance(font, Strokes) else font.name


def families(fonts):
    groups = {}
    for font in fonts:
        # Fonts of single strokes are those of drawings, so that they count thrice.
        for k in range(3 if isinstance(font, Strokes) else 1):
            groups.setdefault((family(font), k), []).append(font)
    return list(groups.values())


def random_height(rng):
    return float(np.exp(rng.uniform(np.log(7), np.log(60))))


def main():
    reading = argparse.ArgumentParser()
    reading.add_argument("--part", choices=["train", "calibrate", "test"], required=True)
    reading.add_argument("--count", type=int, default=2500, help="samples of a class")
    reading.add_argument("--seed", type=int, required=True)
    reading.add_argument("--lff", help="folder of LibreCAD's fonts")
    reading.add_argument("--out", required=True)
    asked = reading.parse_args()
    rng = np.random.default_rng(asked.seed)
    groups = families(all_fonts(asked.lff, asked.part))
    pictures, places, labels = [], [], []

    def add(mask, height, label):
        found = sample(*seen(mask, height, rng), height, rng)
        if found:
            pictures.append(found[0])
            places.append(found[1])
            labels.append(label)

    for label, char in enumerate(CLASSES):
        often = 2 if char in "0123456789.,:-+±°Ø×R" else 0.7
        for _ in range(int(often * asked.count)):
            group = groups[rng.integers(len(groups))]
            font = group[rng.integers(len(group))]
            drawn = [c for c in DRAWN.get(char, char) if font.has(c)]
            if not drawn:
                continue
            height = random_height(rng)
            shown = drawn[rng.integers(len(drawn))]
            add(glyph(font, shown, height, rng, asked.part == "train"), height, label)
    for _ in range(14 * asked.count):
        group = groups[rng.integers(len(groups))]
        font, height, kind = group[rng.integers(len(group))], random_height(rng), rng.random()
        mask = (
            pair(font, rng, height)
            if kind < 0.45
            else piece(font, rng, height)
            if kind < 0.58
            else shape(rng, height)
        )
        add(mask, height, REJECT)
    order = rng.permutation(len(labels))
    np.savez(
        asked.out,
        pictures=np.array(pictures)[order],
        places=np.array(places)[order],
        labels=np.array(labels)[order],
    )
    print(
        f"{len(labels)} samples of {len(CLASSES) + 1} classes from {len(groups)} families ({DIAMETER} and × included)"
    )


if __name__ == "__main__":
    main()
