"""Makes random machined parts and their drawings as CAD programs write them, for `sheet_solids.py`.

Each part is a solid of Open Cascade. Its views are made by exact hidden-line removal. A part is rejected if a
view lacks an edge or an outline, or draws a point hidden that can be seen. `NAME.dxf` is a sheet with frame,
title block, dimensions, centre lines, sections and notes; its traits are drawn at random, or given by one
option each. `NAME.step` is the part, and `NAME.json` has its volume, bounds and faces, the traits, and the
handles of the entities of each view and of each annotation. The same seed gives the same parts, with
`--clean` (three plain files) and without. `--mutate` deletes, moves or restyles one line of a view in copies
of the drawing and records it. Needs cadquery-ocp-novtk, ezdxf and scipy; pictures need matplotlib.

    python benches/peers/sheets.py --count 40 --seed 1 --out FOLDER
    python benches/peers/sheets.py --count 40 --seed 1 --out FOLDER --clean
    python benches/peers/sheets.py --count 40 --out FOLDER --simple --language de --section extra
    python benches/peers/sheets.py --count 10 --out FOLDER --mutate 3
    python benches/peers/sheets.py --count 20 --out FOLDER --picture free
    python benches/peers/sheets.py --count 20 --out FOLDER --simple --scan 300

`--picture` draws no sheet, but a picture of 800 × 800 pixels: three views with titles and the three overall
dimensions, in the first or third angle or placed freely, with lines and fonts that are drawn at random.
`--scan` also writes `NAME.jpg`, a scan of the sheet at 150 or 300 dpi or a photograph, with rotation or
perspective, blur, noise, uneven light and the artefacts of JPEG; `picture_from_file` in `NAME.json` is the
homography from coordinates of the DXF file to pixels (y down, centres of pixels at whole numbers).
"""

import argparse
import pathlib
import random

from drafting import sheet, shapes
from drafting.mutate import mutated
from drafting.picture import choose_picture, make_picture
from drafting.parts_round import FAMILIES, random_part
from drafting.scan import choose_scan, make_scan
from drafting.styles import EXPLANATIONS, TRAITS, choose


def arguments():
    reading = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    reading.add_argument("--count", type=int, default=10)
    reading.add_argument("--seed", type=int, default=1)
    reading.add_argument("--out", type=pathlib.Path, required=True)
    reading.add_argument("--clean", action="store_true", help="three plain files of each part")
    reading.add_argument("--mutate", type=int, default=0, metavar="N", help="copies with one wrong line each")
    reading.add_argument("--svg", action="store_true")
    reading.add_argument("--pdf", action="store_true")
    reading.add_argument("--png", action="store_true")
    arrangements = ["any", "third", "first", "free"]
    reading.add_argument("--picture", choices=arrangements, help="a picture of three views")
    reading.add_argument("--scan", choices=["150", "300", "photo"], help="a scan or a photograph of the sheet")
    reading.add_argument("--family", choices=sorted(FAMILIES))
    reading.add_argument(
        "--simple", action="store_true", help="the simplest value of each trait that is not given"
    )
    for name, values in TRAITS.items():
        reading.add_argument(f"--{name}", choices=list(values), help=EXPLANATIONS[name])
    return reading.parse_args()


def part_of(asked, index):
    """The part of an index; it depends on the seed only, and on whether it is turned."""
    dice = random.Random(f"{asked.seed}/{index}/traits")
    fixed = {name: getattr(asked, name.replace("-", "_")) for name in TRAITS}
    traits = choose(dice, fixed, asked.simple)
    turn = dice.choice([-1, 1]) * round(dice.uniform(0.1, 0.9), 3) if traits["turned"] == "yes" else 0.0
    drawing = random.Random(f"{asked.seed}/{index}/part")
    for attempt in range(40):
        found = random_part(drawing, asked.family, turn)
        if found and sheet.complete(found[0]):
            return (*found, traits, {"turn_deg": turn, "rejected": attempt})
    raise SystemExit(f"no complete part for index {index}")


def main():
    asked = arguments()
    asked.out.mkdir(parents=True, exist_ok=True)
    rejected = 0
    for index in range(asked.count):
        shape, family, features, traits, more = part_of(asked, index)
        rejected += more["rejected"]
        kind = "picture" if asked.picture else "clean" if asked.clean else "sheet"
        name = f"{kind}_{asked.seed}_{index:03}"
        base = asked.out / name
        known = {**sheet.truth(shape, name, family, features), **more}
        known["traits"] = {"turned": traits["turned"]} if asked.clean else traits
        shapes.write_step(shape, base.with_suffix(".step"))
        if asked.picture:
            dice = random.Random(f"{asked.seed}/{index}/picture")
            drawn = choose_picture(dice, None if asked.picture == "any" else asked.picture)
            known["traits"] = {"turned": traits["turned"]}
            known |= make_picture(shape, base.with_suffix(".png"), drawn, dice)
        elif asked.clean:
            known |= sheet.make_plain(shape, base)
        else:
            doc, layout = sheet.make_sheet(shape, name, traits, random.Random(f"{asked.seed}/{index}/sheet"))
            known |= layout
            doc.saveas(base.with_suffix(".dxf"))
            kinds = [k for k in ("svg", "pdf", "png") if getattr(asked, k)]
            sheet.save_pictures(doc, base, kinds)
            if asked.scan:
                dice = random.Random(f"{asked.seed}/{index}/scan")
                look = choose_scan(dice, 0 if asked.scan == "photo" else int(asked.scan))
                known |= make_scan(doc, known, base, look, dice, sheet.lengths(traits)[0])
        sheet.save_json(base.with_suffix(".json"), known)
        for k in range(asked.mutate):
            mutated(base, known, random.Random(f"{asked.seed}/{index}/{k}"), k)
        print(name, family, *features, sep=", ", flush=True)
    print(f"{asked.count} parts, {rejected} rejected draws")


main()
