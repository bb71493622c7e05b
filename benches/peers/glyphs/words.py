"""Draws pictures of dimensions and titles in fonts of a part and judges what the program reads in them.

Each picture has dimension lines with arrowheads, extension lines, dashed lines, hatches, circles and
rectangles; some texts touch or cross a line. Fonts that training did not see: `--part test`; those of the
calibration: `--part calibrate`.

    cargo build --release -p planish-exchange --example read_words
    python benches/peers/glyphs/words.py --part test --count 60 --seed 7 --lff FOLDER --out FOLDER
    python benches/peers/glyphs/words.py --judge FOLDER --reader target/release/examples/read_words
"""

import argparse
import json
import pathlib
import subprocess

import cv2
import numpy as np
from fonts import BASE, CAP, SIZE, Strokes, all_fonts
from samples import families, weight

TITLES = (
    "FRONT TOP SIDE RIGHT LEFT VIEW Vorderansicht Draufsicht Seitenansicht Vue face dessus Alzado Planta "
    "Perfil SECTION Schnitt SCALE Front Top Side ISO DIN Blatt Material Steel NAME DATE"
).split()


def number(rng):
    whole = int(rng.choice([rng.integers(1, 10), rng.integers(10, 100), rng.integers(100, 1000)]))
    digits = int(rng.choice([0, 0, 1, 1, 2, 3]))
    mark = rng.choice([".", ".", ","])
    return f"{whole}{mark}{rng.integers(1, 10**digits):0{digits}d}" if digits else str(whole)


def text(rng):
    kind = rng.random()
    if kind < 0.5:
        return number(rng)
    if kind < 0.62:
        return "Ø" + number(rng)
    if kind < 0.7:
        return "R" + number(rng)
    if kind < 0.75:
        return f"{rng.integers(2, 13)}×{rng.choice(['Ø', 'R'])}{rng.integers(2, 40)}"
    if kind < 0.79:
        return f"{rng.integers(1, 6)}×{rng.choice([30, 45, 60])}°"
    if kind < 0.83:
        return f"{number(rng)}±0.{rng.choice(['1', '2', '05', '02'])}"
    if kind < 0.86:
        return f"{rng.choice([1, 2, 5])}:{rng.choice([1, 2, 5, 10])}"
    if kind < 0.9:
        letter = rng.choice(list("ABCDEF"))
        return f"{letter}-{letter}"
    return str(rng.choice(TITLES))


def line_of_text(font, chars, height, rng):
    """Ink of a text with capitals `height` pixels high, and its baseline; None if the font lacks a character."""
    if not all(font.has(c) for c in chars):
        return None
    width = weight(font, height, rng)
    canvas, x = np.zeros((SIZE, SIZE * (len(chars) + 1)), np.uint8), 30.0
    gap = rng.uniform(0.12, 0.3) * CAP if isinstance(font, Strokes) else 0
    for char in chars:
        mask = font.draw(char, width)
        columns = np.nonzero(mask.any(0))[0]
        if isinstance(font, Strokes):
            place = x - columns[0] + max(0, 0.5 * width)
            x += columns[-1] - columns[0] + gap
        else:
            # Glyphs are drawn in the middle of their advance.
            place = x + 0.5 * font.advance(char) - SIZE / 2
            x += font.advance(char)
        place = int(round(place))
        low = max(0, -place)
        part = canvas[:, place + low : place + SIZE]
        np.maximum(part, mask[:, low : low + part.shape[1]], out=part)
    columns = np.nonzero(canvas.any(0))[0]
    canvas = canvas[:, max(0, columns[0] - 8) : columns[-1] + 9]
    scale = height / CAP
    soft = cv2.GaussianBlur(canvas, (0, 0), 0.35 / scale) if scale < 1 else canvas
    size = (int(canvas.shape[1] * scale) + 2, int(SIZE * scale) + 2)
    linear = np.float32([[scale, 0, rng.uniform(0, 1)], [0, scale, rng.uniform(0, 1)]])
    return cv2.warpAffine(soft, linear, size) / np.float32(255), BASE * scale


class Picture:
    def __init__(self, rng, groups):
        self.rng, self.groups = rng, groups
        self.size = int(rng.choice([800, 1000, 1200]))
        self.ink = np.zeros((self.size, self.size), np.float32)
        self.used = np.zeros((self.size, self.size), bool)
        self.thin = float(rng.uniform(1, 3))
        self.words = []

    def stroke(self, a, b, width=None):
        mask = np.zeros(self.ink.shape, np.uint8)
        points = [tuple(int(16 * v) for v in p) for p in (a, b)]
        cv2.line(mask, *points, 255, max(1, round(width or self.thin)), cv2.LINE_AA, 4)
        np.maximum(self.ink, mask / np.float32(255), out=self.ink)

    def arrow(self, tip, along, length):
        across = np.array([-along[1], along[0]])
        corners = [
            tip,
            tip - length * along + 0.17 * length * across,
            tip - length * along - 0.17 * length * across,
        ]
        mask = np.zeros(self.ink.shape, np.uint8)
        cv2.fillPoly(mask, [np.int32(16 * np.array(corners))], 255, cv2.LINE_AA, 4)
        np.maximum(self.ink, mask / np.float32(255), out=self.ink)

    def free(self, x0, y0, x1, y1):
        if min(x0, y0) < 4 or max(x1, y1) > self.size - 4:
            return False
        part = self.used[int(y0) : int(y1) + 1, int(x0) : int(x1) + 1]
        if part.any():
            return False
        part[:] = True
        return True

    def dimension(self, font, height, chars):
        """A dimension line with its number above it, in a gap, or a text alone."""
        rng = self.rng
        made = line_of_text(font, chars, height, rng)
        if made is None:
            return
        ink, base = made
        kind = rng.choice(["above", "gap", "alone", "touching"], p=[0.4, 0.25, 0.25, 0.1])
        upwards = rng.random() < 0.4
        half = 0.5 * ink.shape[1] + rng.uniform(10, 60) + 2 * height
        tall = ink.shape[0]
        sizes = (2 * half, tall + 2 * height) if kind != "alone" else (ink.shape[1] + 1.3 * height, tall + 6)
        for _ in range(30):
            middle = rng.uniform(0, self.size, 2)
            wide, high = (sizes[1], sizes[0]) if upwards else sizes
            if self.free(
                middle[0] - wide / 2, middle[1] - high / 2, middle[0] + wide / 2, middle[1] + high / 2
            ):
                break
        else:
            return
        along = np.array([0.0, -1.0]) if upwards else np.array([1.0, 0.0])
        down = np.array([1.0, 0.0]) if upwards else np.array([0.0, 1.0])
        turned = np.rot90(ink) if upwards else ink
        # The middle of the capitals is at `middle`; the line is below, or in the middle.
        shift = base - 0.5 * height
        corner = (
            middle - np.array([shift, 0.5 * ink.shape[1]])
            if upwards
            else middle - np.array([0.5 * ink.shape[1], shift])
        )
        x, y = np.round(corner).astype(int)
        part = self.ink[max(y, 0) : y + turned.shape[0], max(x, 0) : x + turned.shape[1]]
        np.maximum(
            part,
            turned[max(-y, 0) : max(-y, 0) + part.shape[0], max(-x, 0) : max(-x, 0) + part.shape[1]],
            out=part,
        )
        kept = {
            "text": chars,
            "at": [float(v) for v in middle],
            "height": float(height),
            "upwards": bool(upwards),
        }
        self.words.append({**kept, "font": font.name, "kind": str(kind)})
        if kind == "alone":
            return
        offset = {
            "above": 0.5 * height + rng.uniform(0.35, 0.8) * height + self.thin,
            "gap": 0,
            "touching": 0.5 * height,
        }[str(kind)]
        for side in (-1, 1):
            end = middle + side * half * along + offset * down
            start = (
                middle + offset * down
                if kind != "gap"
                else middle + side * (0.5 * ink.shape[1] + 0.3 * height) * along
            )
            self.stroke(start, end)
            self.arrow(end, side * along, rng.uniform(0.8, 1.2) * height)
            self.stroke(end - 0.6 * height * down, end + 0.6 * height * down)

    def line_work(self):
        """Views between the texts: rectangles, circles, dashes, hatches."""
        rng = self.rng
        for _ in range(int(rng.integers(2, 5))):
            wide, high = rng.uniform(80, 300, 2)
            x, y = rng.uniform(5, self.size - 5 - wide), rng.uniform(5, self.size - 5 - high)
            if not self.free(x - 3, y - 3, x + wide + 3, y + high + 3):
                continue
            corners = [(x, y), (x + wide, y), (x + wide, y + high), (x, y + high)]
            thick = self.thin * rng.uniform(1, 2)
            for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
                self.stroke(a, b, thick)
            dash, gap = rng.uniform(6, 20), rng.uniform(3, 8)
            row = y + rng.uniform(0.2, 0.8) * high
            for k in np.arange(x, x + wide - dash, dash + gap):
                self.stroke((k, row), (k + dash, row))
            column = x + rng.uniform(0.2, 0.8) * wide
            for k in np.arange(y, y + high - dash, dash + gap):
                self.stroke((column, k), (column, k + dash))
            for _ in range(int(rng.integers(0, 4))):
                radius = rng.uniform(4, 0.2 * high)
                cx, cy = x + rng.uniform(0.25, 0.75) * wide, y + rng.uniform(0.25, 0.75) * high
                mask = np.zeros(self.ink.shape, np.uint8)
                cv2.circle(
                    mask,
                    (int(16 * cx), int(16 * cy)),
                    int(16 * radius),
                    255,
                    max(1, round(thick)),
                    cv2.LINE_AA,
                    4,
                )
                np.maximum(self.ink, mask / np.float32(255), out=self.ink)
            if rng.random() < 0.3:
                for k in np.arange(0, 0.4 * wide, rng.uniform(5, 12)):
                    self.stroke((x + k, y + 20), (x + k + 14, y + 6))

    def finished(self):
        """Tilt, blur, grey levels, noise and JPEG as samples for training have them."""
        rng = self.rng
        angle = rng.uniform(-2, 2) if rng.random() < 0.5 else 0.0
        middle = (0.5 * self.size, 0.5 * self.size)
        linear = cv2.getRotationMatrix2D(middle, angle, 1)
        for word in self.words:
            word["at"] = [float(v) for v in linear @ [*word["at"], 1]]
        ink = cv2.warpAffine(self.ink, linear, self.ink.shape, flags=cv2.INTER_LINEAR)
        kind = rng.random()
        smallest = min([w["height"] for w in self.words], default=20)
        if kind < 0.4:
            ink = cv2.GaussianBlur(ink, (0, 0), rng.uniform(0.3, min(1.5, 0.05 * smallest + 0.25)))
        elif kind < 0.6:
            ink = (ink > 0.5).astype(np.float32)
        light = 1 - rng.uniform(0, 0.3) * np.linspace(0, 1, self.size, dtype=np.float32)[:, None]
        grey = 255 * light * (1 - rng.uniform(0.6, 1) * ink) + rng.normal(0, rng.uniform(0, 8), ink.shape)
        grey = np.uint8(np.clip(grey, 0, 255))
        if rng.random() < 0.3:
            done, packed = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(40, 90))])
            grey = cv2.imdecode(packed, 0)
        return grey


def draw(asked):
    groups = families(all_fonts(asked.lff, asked.part))
    asked.out.mkdir(parents=True, exist_ok=True)
    for index in range(asked.count):
        rng = np.random.default_rng([asked.seed, index])
        picture = Picture(rng, groups)
        group = groups[rng.integers(len(groups))]
        font = group[rng.integers(len(group))]
        height = float(np.exp(rng.uniform(np.log(asked.smallest), np.log(45))))
        for _ in range(int(rng.integers(8, 25))):
            picture.dimension(font, height, text(rng))
        picture.line_work()
        base = asked.out / f"words_{index:03}"
        cv2.imwrite(str(base.with_suffix(".png" if asked.ending == "png" else ".pgm")), picture.finished())
        base.with_suffix(".json").write_text(json.dumps(picture.words))


def judge(folder, reader):
    """Texts at their places; a word that is found elsewhere is spurious."""
    pictures = sorted([*folder.glob("words_*.png"), *folder.glob("words_*.pgm")])
    output = subprocess.run([reader, *map(str, pictures)], capture_output=True, text=True, check=True).stdout
    found = {}
    for row in output.splitlines():
        file, shown, sure, x, y, angle, height, seconds = row.split("\t")
        found.setdefault(file, []).append((shown, float(sure), float(x), float(y), float(seconds)))
    rows, spurious, seconds = [], [], []
    for path in pictures:
        words = json.loads(path.with_suffix(".json").read_text())
        own = found.get(str(path), [])
        seconds += [own[0][4]] if own else []
        used = set()
        for word in words:
            near = [
                (np.hypot(f[2] - word["at"][0], f[3] - word["at"][1]), k)
                for k, f in enumerate(own)
                if k not in used
            ]
            distance, k = min(near, default=(np.inf, -1))
            # A decimal comma and a point state the same number.
            plain = lambda t: t.replace("×", "x").replace(",", ".")
            expected = plain(word["text"])
            shown, sure = "", 0.0
            if distance < 1.5 * word["height"]:
                used.add(k)
                shown, sure = plain(own[k][0]), own[k][1]
            rows.append((expected, shown, sure, word, path.name))
        spurious += [(f[0], f[1], path.name) for k, f in enumerate(own) if k not in used]
    summary(rows, spurious, seconds)
    return rows, spurious


def summary(rows, spurious, seconds):
    right = np.array([r[0] == r[1] for r in rows])
    sure = np.array([r[2] for r in rows])
    numbers = np.array([any(c.isdigit() for c in r[0]) for r in rows])
    height = np.array([r[3]["height"] for r in rows])
    kinds = np.array([r[3]["kind"] for r in rows])
    print(
        f"{len(rows)} words: right {right.mean():.4f}; numbers {right[numbers].mean():.4f} of {numbers.sum()}"
    )
    for low, high in ((0, 10), (10, 16), (16, 30), (30, 99)):
        own = (height >= low) & (height < high)
        if own.any():
            print(f"  {low} to {high} px: {right[own].mean():.4f} of {own.sum()}")
    print(
        "  "
        + ", ".join(
            f"{k}: {right[kinds == k].mean():.4f} of {(kinds == k).sum()}" for k in sorted(set(kinds))
        )
    )
    for least in (0.9, 0.95, 0.99, 0.999):
        own = sure >= least
        extra = sum(s[1] >= least for s in spurious)
        print(
            f"  confidence ≥ {least}: share {own.mean():.4f}, wrong {(~right[own]).sum()} of {own.sum()}, "
            f"spurious {extra}"
        )
    print(f"  median {np.median(seconds):.3f} s, longest {max(seconds):.3f} s a picture")


def main():
    reading = argparse.ArgumentParser()
    reading.add_argument("--part", choices=["train", "calibrate", "test"])
    reading.add_argument("--count", type=int, default=40)
    reading.add_argument("--seed", type=int, default=7)
    reading.add_argument(
        "--smallest", type=float, default=8, help="height of the smallest capitals in pixels"
    )
    reading.add_argument("--lff", help="folder of LibreCAD's fonts")
    reading.add_argument("--ending", choices=["png", "pgm"], default="png")
    reading.add_argument("--out", type=pathlib.Path)
    reading.add_argument("--judge", type=pathlib.Path)
    reading.add_argument("--reader", default="target/release/examples/read_words")
    reading.add_argument("--list", action="store_true", help="print wrong and spurious words")
    asked = reading.parse_args()
    if asked.out:
        draw(asked)
    if asked.judge:
        rows, spurious = judge(asked.judge, asked.reader)
        if asked.list:
            for expected, shown, sure, word, name in rows:
                if expected != shown:
                    print(
                        f"wrong {expected} → {shown} ({sure:.3f}) {word['font']} {word['height']:.0f} px "
                        f"{word['kind']} {name}"
                    )
            for shown, sure, name in spurious:
                print(f"spurious {shown} ({sure:.3f}) {name}")


if __name__ == "__main__":
    main()
