#!/usr/bin/env python3
"""Hash every output of every command of the book and the README.

A change of structure or wording must not change results. Run this before and after, and compare:

    python3 tests/outputs/hash.py target/release/planish > before.txt
    python3 tests/outputs/hash.py target/release/planish > after.txt
    diff before.txt after.txt

Every `$ planish …` line of a ```console block in `docs/*.md` and every complete command of README.md runs in a
folder of its page, with the blocks ```toml file=NAME written first. `--docs` reads the book of another checkout, so
that both sides run the same commands. One line is printed per file written and per stream:

    PAGE COMMAND-NUMBER NAME EXACT NUMBERS

EXACT is the hash of all bytes without run times. NUMBERS is the hash of the numbers in a text file (words may change
while results may not); it is `-` for binary files.
"""

import argparse
import concurrent.futures
import hashlib
import os
import pathlib
import re
import shlex
import subprocess
import tempfile

# Run times and folders of a run differ between two runs of the same program.
VOLATILE = [
    re.compile(rb'"(?:[a-z_]*seconds|started|finished)": *[-+0-9.eE]+'),
    re.compile(rb"\b[0-9.]+ (?:s|ms|min)\b"),
]
NUMBER = re.compile(rb"(?<![A-Za-z_])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
TEXT = {".txt", ".csv", ".json", ".svg", ".html", ".toml", ".md", ".dxf", ".step", ".obj", ".1", ""}


def pages(root: pathlib.Path):
    """Yield (page name, list of actions); an action writes a file or runs a command."""
    summary = (root / "docs/SUMMARY.md").read_text()
    names = ["docs/" + n for n in re.findall(r"\]\(([^)#]+\.md)\)", summary)]
    for name in ["README.md", *names]:
        text = (root / name).read_text()
        actions = []
        for kind, body in re.findall(r"^```(\S[^\n]*)\n(.*?)^```$", text, re.M | re.S):
            if "file=" in kind:
                actions.append(("write", kind.split("file=")[1], body))
            if kind == "console":
                actions += [("run", line[2:]) for line in body.splitlines() if line.startswith("$ planish")]
        if name == "README.md":
            first = re.search(r"^    cargo run --release -p planish-cli -- (.*)$", text, re.M)
            if first:
                actions.append(("run", "planish " + first.group(1)))
            for line in re.findall(r"^    (?:\$ )?(planish .*?)(?:  .*)?$", text, re.M):
                words = shlex.split(line)
                if any(w.startswith("examples/") for w in words) or "simulate" in words:
                    actions.append(("run", line))
        if actions:
            yield name.removeprefix("docs/"), actions


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def row(page, number, name, data: bytes, folder: str, is_text: bool) -> str:
    data = data.replace(folder.encode(), b"FOLDER")
    for pattern in VOLATILE:
        data = pattern.sub(b"TIME", data) if is_text else data
    numbers = digest(b" ".join(NUMBER.findall(data))) if is_text else "-"
    return f"{page} {number} {name} {digest(data)} {numbers}"


def run_page(binary: str, examples: pathlib.Path, page: str, actions) -> list[str]:
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "examples").symlink_to(examples)
        number, seen = 0, {}
        for action in actions:
            if action[0] == "write":
                (folder / action[1]).write_text(action[2])
                seen[action[1]] = digest((folder / action[1]).read_bytes())
                continue
            number += 1
            words = shlex.split(action[1])[1:]
            done = subprocess.run([binary, *words], cwd=folder, capture_output=True, env={**os.environ, "NO_COLOR": "1"})
            rows.append(f"{page} {number} command {action[1]!r} exit {done.returncode}")
            rows.append(row(page, number, "stdout", done.stdout, name, True))
            rows.append(row(page, number, "stderr", done.stderr, name, True))
            for path in sorted(p for p in folder.rglob("*") if p.is_file()):
                relative = path.relative_to(folder).as_posix()
                data = path.read_bytes()
                if seen.get(relative) != digest(data):
                    seen[relative] = digest(data)
                    rows.append(row(page, number, relative, data, name, path.suffix in TEXT))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=pathlib.Path, help="the planish command to run")
    root = pathlib.Path(__file__).resolve().parents[2]
    parser.add_argument("--docs", type=pathlib.Path, default=root, help="checkout whose book and README give the commands")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="pages that run at the same time")
    arguments = parser.parse_args()
    binary = str(arguments.binary.resolve())
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        jobs = [
            pool.submit(run_page, binary, root / "examples", page, actions) for page, actions in pages(arguments.docs)
        ]
        for job in jobs:
            print("\n".join(job.result()))


if __name__ == "__main__":
    main()
