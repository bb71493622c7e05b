#!/usr/bin/env python3
"""Print the figures that describe the shape of the source: crates, long functions and files, comments, examples.

    python3 tests/metrics.py            # the checkout that holds the script
    python3 tests/metrics.py --root DIR # another checkout, to compare
"""

import argparse
import collections
import pathlib
import re

LONG_FUNCTION = 100
LONG_FILE = 600
COLUMNS = 110


def is_test(path: pathlib.PurePath) -> bool:
    return any(
        part in ("tests", "benches", "examples", "tests.rs", "test_support.rs") or part.endswith("_tests.rs")
        for part in path.parts
    )


def blank_strings_and_comments(text: str) -> str:
    """Replace comments, strings and characters by blanks; lines stay where they are."""
    token = re.compile(
        r'//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|\'(?:\\[^\n]{1,10}?|[^\\\'\n])\'', re.S
    )
    return token.sub(lambda m: re.sub(r"[^\n]", " ", m.group()), text)


def functions(code: str):
    """Yield (name, first line, number of lines) of every function with a body."""
    for match in re.finditer(r"\bfn\s+(\w+)", code):
        depth, at = 0, match.end()
        while at < len(code):
            c = code[at]
            if c in "([":
                depth += 1
            elif c in ")]":
                depth -= 1
            elif depth == 0 and c in "{;":
                break
            at += 1
        if at == len(code) or code[at] == ";":
            continue
        depth, end = 0, at
        while end < len(code):
            depth += (code[end] == "{") - (code[end] == "}")
            if depth == 0:
                break
            end += 1
        first = code.count("\n", 0, match.start()) + 1
        yield match.group(1), first, code.count("\n", 0, end) + 2 - first


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=pathlib.Path, default=pathlib.Path(__file__).resolve().parents[1])
    root = parser.parse_args().root
    crates = collections.defaultdict(collections.Counter)
    long_functions, long_files, longest, wide = [], [], (0, ""), 0
    public = collections.defaultdict(list)
    for path in sorted(p for d in ("crates", "fuzz", "examples") for p in (root / d).rglob("*.rs")):
        below = path.relative_to(root)
        if "target" in below.parts:
            continue
        crate = below.parts[1] if below.parts[0] == "crates" else below.parts[0]
        text = path.read_text()
        lines = text.split("\n")
        figures = crates[crate]
        figures["lines"] += len(lines)
        for number, line in enumerate(lines, 1):
            wide += len(line) > COLUMNS
            longest = max(longest, (len(line), f"{below}:{number}"))
        if len(lines) > LONG_FILE:
            long_files.append((len(lines), str(below)))
        if is_test(pathlib.PurePath(*below.parts[1:])):
            continue
        body = text.split("\n#[cfg(test)]\nmod tests {")[0]
        code = blank_strings_and_comments(body)
        figures["code"] += sum(bool(line.strip()) for line in code.split("\n"))
        figures["comments"] += len(re.findall(r"^\s*//(?![/!])", body, re.M))
        figures["doc"] += len(re.findall(r"^\s*//[/!]", body, re.M))
        figures["examples"] += len(re.findall(r"^\s*//[/!] ```(?!text|toml|ignore|console)", body, re.M)) // 2
        figures["public"] += len(re.findall(r"^\s*pub (?:const |unsafe )?fn ", code, re.M))
        for name, first, count in functions(code):
            if count > LONG_FUNCTION:
                long_functions.append((count, name, f"{below}:{first}"))
        for name in re.findall(r"^pub (?:struct|enum|trait|type) (\w+)", code, re.M):
            public[name].append(str(below))
    total = sum(f["lines"] for f in crates.values())
    whole = collections.Counter()
    print("crate        lines  share  comments/100 code  doc/100 code  examples/100 public fn")
    for name, f in sorted(crates.items(), key=lambda item: -item[1]["lines"]):
        whole.update(f)
        print(row(name, f, total))
    print(row("all", whole, total))
    for title, found in (("functions over 100 lines", long_functions), ("files over 600 lines", long_files)):
        print(f"{title}: {len(found)}")
        for entry in sorted(found, reverse=True):
            print("   ", *entry)
    twice = {name: places for name, places in public.items() if len(places) > 1}
    print(f"public types with the same name: {len(twice)}")
    for name, places in sorted(twice.items()):
        print("   ", name, *places)
    print(f"longest line: {longest[0]} columns ({longest[1]}); {wide} over {COLUMNS}")


def row(name: str, f, total: int) -> str:
    code, public = max(f["code"], 1), max(f["public"], 1)
    return (
        f"{name:12} {f['lines']:6} {100 * f['lines'] / total:5.1f}% {100 * f['comments'] / code:14.1f}"
        f" {100 * f['doc'] / code:17.1f} {100 * f['examples'] / public:18.1f}"
    )


if __name__ == "__main__":
    main()
