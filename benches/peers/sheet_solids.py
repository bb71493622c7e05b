"""Reconstructs the drawings of `sheets.py` with `planish solid` and compares the solids with the true ones.

A solid is *right* if it is valid and sampled points of each of the two surfaces lie on the other one, within
what the decimals and displacements of the drawing explain (0.002 mm, or 0.06 mm with displaced views), and if
their volumes differ by at most 2e-5 (1e-6 in plain files). The first solid may be right; another solid that
is written may be right; or no solid is right. In copies with one wrong line, the place of that line in the
list of unexplained lines or edits is reported. Results are JSON lines and tables by trait. Of pictures, the
intersection over union (IoU) after scaling to one size is reported. Needs cadquery-ocp-novtk.

    python benches/peers/sheet_solids.py target/release/planish FOLDER --out results.jsonl
    python benches/peers/sheet_solids.py target/release/planish FOLDER --projection auto --limit 30
    python benches/peers/sheet_solids.py --table results.jsonl
"""

import argparse
import json
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

from drafting import judge, shapes
from drafting.styles import TRAITS

OUTCOMES = ("right first", "right not first", "scale only", "wrong first", "refused", "timeout")


def command(asked, folder, known, mutated):
    """The command line for a sheet or three plain files, or for a copy with one wrong line."""
    if "traits" in known and "projection" in known["traits"]:
        file = mutated["file"] if mutated else f"{known['name']}{asked.ending}"
        given = known["traits"]["projection"] if asked.projection == "true" else asked.projection
        return [str(folder / file)] + ([] if given == "none" else ["--projection", given])
    if "picture" in known:
        return [str(folder / f"{known['name']}.png")]
    files = [known["views"][v]["file"] for v in ("front", "top", "right")]
    if mutated:
        files[("front", "top", "right").index(mutated["view"])] = mutated["file"]
    return [str(folder / f) for f in files]


def execute(asked, words):
    """Runs the program; returns its report, the solids that it wrote, and the seconds."""
    with tempfile.TemporaryDirectory() as scratch:
        out = pathlib.Path(scratch) / "part.step"
        begun = time.perf_counter()
        line = [asked.planish, "solid", *words, "-o", str(out), "--all", "--json", *asked.options.split()]
        try:
            done = subprocess.run(line, capture_output=True, text=True, timeout=asked.limit)
        except subprocess.TimeoutExpired:
            return {"error": {"message": f"no answer within {asked.limit:g} s"}}, [], asked.limit
        seconds = time.perf_counter() - begun
        try:
            report = json.loads(done.stdout)
        except json.JSONDecodeError:
            report = {"error": {"message": (done.stderr.strip() or f"exit code {done.returncode}")[-400:]}}
        # A single solid is NAME.step, several are NAME.1.step, NAME.2.step, …
        numbers = sorted(
            pathlib.Path(scratch).glob("part*.step"),
            key=lambda p: [int(n) for n in re.findall(r"\d+", p.name)],
        )
        return report, [shapes.read_step(p) for p in numbers[: asked.most]], seconds


def tolerance_of(known):
    """Distance that is explained by the drawing, in millimetres, and the relative error of the volume."""
    traits = known["traits"]
    if "projection" not in traits:
        return 0.002, 1e-6
    return (0.06, 2e-3) if traits["misaligned"] == "yes" else (0.002, 2e-5)


def judged(solids, known, folder):
    true = shapes.read_step(folder / f"{known.get('of', known['name'])}.step")
    tolerance, volume = tolerance_of(known)
    verdicts = []
    for solid in solids:
        try:
            if "picture" in known:
                verdicts.append(judge.compare_picture(solid, true))
                if verdicts[-1]["is_right"]:
                    break
                continue
            verdict = judge.compare(solid, true, tolerance)
        except Exception as problem:  # Open Cascade raises errors of its own.
            verdict = {"is_right": False, "problem": repr(problem)[:200]}
        verdict["is_right"] = bool(verdict["is_right"] and abs(verdict["volume_error"]) <= volume)
        verdicts.append(verdict)
        if verdict["is_right"]:
            break
    return verdicts


def outcome_of(report, verdicts, asked):
    if not verdicts:
        late = "no answer within" in str((report.get("error") or {}).get("message"))
        return "timeout" if late else "refused"
    if verdicts[0]["is_right"]:
        return "right first"
    if any(v["is_right"] for v in verdicts):
        return "right not first"
    return "scale only" if verdicts[0].get("only_scale") else "wrong first"


def reason(report):
    if report.get("error"):
        return str(report["error"].get("message"))[:300]
    named = report.get("unexplained") or report.get("refused") or []
    return (
        f"{named[0].get('view')} view, {named[0].get('entity')}: {named[0].get('why')}"[:300] if named else ""
    )


def names_line(item, mutated, known):
    """Whether an entry of a report names the wrong line, by its handle or by a point on it."""
    text = json.dumps(item, ensure_ascii=False)
    if mutated["change"] != "delete" and re.search(rf"\b{mutated['handle']}\b", text):
        return True
    numbers = [float(n) for n in re.findall(r"-?\d+\.\d+", str(item.get("why", "")))]
    view = known["views"][mutated["view"]]
    origins = [(0.0, 0.0), tuple(view["box"][:2])]
    near = 0.01 * max(view["box"][2] - view["box"][0], view["box"][3] - view["box"][1])
    for points in filter(None, (mutated["before"], mutated["after"])):
        for x, y in zip(numbers, numbers[1:]):
            if any(off(points, (x + u, y + v)) < near for u, v in origins):
                return True
    return False


def off(points, at):
    """Distance of a point from a chain of points."""
    if len(points) == 1:
        return max(abs(points[0][k] - at[k]) for k in (0, 1))
    least = float("inf")
    for p, q in zip(points, points[1:]):
        along = [q[k] - p[k] for k in (0, 1)]
        square = max(along[0] ** 2 + along[1] ** 2, 1e-18)
        share = max(0.0, min(1.0, sum((at[k] - p[k]) * along[k] for k in (0, 1)) / square))
        least = min(least, sum((at[k] - p[k] - share * along[k]) ** 2 for k in (0, 1)) ** 0.5)
    return least


def guilty_rank(report, mutated, known):
    """Place of the wrong line in the list of edits or of unexplained lines: 1 is first, 0 not named."""
    for key in ("edits", "unexplained", "refused"):
        for rank, item in enumerate(report.get(key) or [], 1):
            if names_line(item, mutated, known):
                return rank
    return 0


def one(asked, folder, path):
    known = json.loads(path.read_text())
    mutated = known if "of" in known else None
    if mutated:
        known = json.loads((folder / f"{mutated['of']}.json").read_text())
    report, solids, seconds = execute(asked, command(asked, folder, known, mutated))
    verdicts = judged(solids, known, folder)
    row = {
        "name": path.stem,
        "family": known["family"],
        "features": known["features"],
        "traits": known["traits"],
    }
    row |= {
        "outcome": outcome_of(report, verdicts, asked),
        "seconds": round(seconds, 3),
        "solids": len(solids),
    }
    row |= {"verdict": verdicts[0] if verdicts else None, "why": reason(report)}
    if mutated:
        row |= {"change": mutated["change"], "guilty_rank": guilty_rank(report, mutated, known)}
    return row


def line_of(label, rows):
    counts = [sum(r["outcome"] == o for r in rows) for o in OUTCOMES]
    times = [r["seconds"] for r in rows]
    cells = [label, len(rows), *counts, f"{statistics.median(times):.2f}", f"{max(times):.2f}"]
    return "| " + " | ".join(str(c) for c in cells) + " |"


def table(rows):
    """Markdown: all drawings, then those with each family, feature and value of a trait."""
    print("| drawings | n | " + " | ".join(OUTCOMES) + " | median s | largest s |")
    print("|---|" + "---|" * (len(OUTCOMES) + 3))
    print(line_of("all", rows))
    overlaps = [(r["verdict"] or {}).get("iou", 0.0) for r in rows]
    if any(overlaps):
        given = [o for o in overlaps if o > 0]
        mean, of_solids = statistics.mean(overlaps), statistics.mean(given)
        print(f"\nmean IoU {mean:.3f}, refusals counted as 0; of solids, {of_solids:.3f}")
        return
    for family in sorted({r["family"] for r in rows}):
        print(line_of(family, [r for r in rows if r["family"] == family]))
    for feature in sorted({f for r in rows for f in r["features"]}):
        print(line_of(f"with {feature}", [r for r in rows if feature in r["features"]]))
    for trait, values in TRAITS.items():
        for value in values:
            having = [r for r in rows if r["traits"].get(trait) == value]
            if having and len(having) < len(rows):
                print(line_of(f"{trait}: {value}", having))
    for change in sorted({r["change"] for r in rows if "change" in r}):
        having = [r for r in rows if r.get("change") == change]
        first, named = sum(r["guilty_rank"] == 1 for r in having), sum(r["guilty_rank"] > 0 for r in having)
        print(
            f"\n{change}: of {len(having)} copies, {first} name the wrong line first, {named} name it at all."
        )


def main():
    reading = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    reading.add_argument("planish", nargs="?")
    reading.add_argument("folder", nargs="?", type=pathlib.Path)
    reading.add_argument("--out", type=pathlib.Path, help="JSON lines")
    reading.add_argument("--table", type=pathlib.Path, help="only print the tables of earlier results")
    reading.add_argument("--ending", default=".dxf", help="ending of the sheets: .dxf, .svg, .pdf or .png")
    reading.add_argument("--only", default="*", help="pattern of names")
    reading.add_argument("--limit", type=float, default=60.0, help="seconds for each drawing")
    reading.add_argument("--most", type=int, default=20, help="solids of each drawing that are compared")
    reading.add_argument("--options", default="", help="more options of `planish solid`")
    reading.add_argument(
        "--projection", default="true", help="true (that of the sheet), none, or a value of the option"
    )
    asked = reading.parse_args()
    if asked.table:
        return table([json.loads(line) for line in asked.table.read_text().splitlines()])
    if not (asked.planish and asked.folder):
        reading.error("expected the program and a folder")
    rows = []
    for path in sorted(asked.folder.glob(f"{asked.only}.json")):
        rows.append(one(asked, asked.folder, path))
        text = json.dumps(rows[-1], ensure_ascii=False)
        if asked.out:
            with asked.out.open("a") as log:
                log.write(text + "\n")
        print(
            rows[-1]["name"],
            rows[-1]["outcome"],
            rows[-1]["seconds"],
            rows[-1]["why"][:120],
            sep=", ",
            file=sys.stderr,
        )
    return table(rows)


main()
