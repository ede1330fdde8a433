"""The share of random mutations of the package and the kernels that tests catch.

    python benchmarks/mutants.py [CHECKOUT] [--count 60] [--seed 1] [--map .coverage]

Works in a copy of any checkout. A mutation changes an operator, a constant, a sign or an index: in
clplen/ by the syntax tree, in kernels/ by regular expressions. Its tests are those that run a line
by a coverage map (`pytest --cov=clplen --cov-context=test -m ""`), else the files that name most of
what the module defines: first those of the README's command, then the thorough ones.
"""

from __future__ import annotations

import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import click

SWAPS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "//", "<": "<=", "<=": "<", ">": ">=",
    ">=": ">", "==": "!=", "!=": "==", "and": "or", "or": "and",
}  # fmt: skip
OPERATOR = re.compile(r"[^()]*?(//|[<>=!]=|[-+*/%<>]|\band\b|\bor\b)[^()]*")
IN_KERNELS = (  # operators between blanks, numbers
    re.compile(r" ([-+*/]|[<>]=?|==) "),
    re.compile(r"(?<![\w.])(\d+\.\d*f?|\d)(?![\w.])"),
)
WAYS = {"README": "not thorough and not nightly", "thorough": "thorough"}
FILES = 6  # most test files of a mutant, where there is no coverage map


class Mutant(NamedTuple):
    """A replacement of some characters of a line."""

    file: Path
    line: int
    span: tuple[int, int]
    new: str


def of_python(file: Path) -> list[Mutant]:
    """Return all mutations of a module that stay in one line."""
    text = file.read_text(encoding="utf-8")
    lines, mutants = text.splitlines(), []
    for node in ast.walk(ast.parse(text)):
        sides = [getattr(node, name, None) for name in ("left", "right")]
        sides = [*filter(None, sides), *getattr(node, "comparators", ())]
        sides = node.values if isinstance(node, ast.BoolOp) else sides
        for left, right in pairwise(sides):
            start, line = left.end_col_offset, lines[right.lineno - 1]
            match = OPERATOR.fullmatch(line[start : right.col_offset])
            if match and left.end_lineno == right.lineno:
                span = (start + match.start(1), start + match.end(1))
                mutants.append(Mutant(file, right.lineno, span, SWAPS[match[1]]))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            at = node.col_offset
            mutants.append(Mutant(file, node.lineno, (at, at + 1), "+"))
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            new = repr(node.value + 1 if type(node.value) is int else 1.5 * node.value + 0.1)
            mutants.append(Mutant(file, node.lineno, (node.col_offset, node.end_col_offset), new))
    return mutants


def of_kernel(file: Path) -> list[Mutant]:
    """Return all mutations of the code of a kernel file."""
    text = re.sub(r"/\*.*?\*/", lambda m: re.sub(r"[^\n]", " ", m[0]), file.read_text(), flags=re.S)
    mutants = []
    for number, line in enumerate(text.splitlines(), 1):
        code = "" if line.lstrip().startswith("#") else line.split("//")[0]
        for match in (m for pattern in IN_KERNELS for m in pattern.finditer(code)):
            changed = f"(1.5f * {match[1]})" if "." in match[1] else f"({match[1]} + 1)"
            mutants.append(Mutant(file, number, match.span(1), SWAPS.get(match[1], changed)))
    return mutants


def covering(mutant: Mutant, root: Path, database: Path) -> list[str]:
    """Return the test files whose tests run a line, by a coverage map with contexts."""
    from coverage import CoverageData

    data = CoverageData(str(database))
    data.read()
    path = str(mutant.file.relative_to(root))
    contexts = [data.contexts_by_lineno(f) for f in data.measured_files() if f.endswith(path)]
    return sorted({c.split("::")[0] for one in contexts for c in one.get(mutant.line, ()) if c})


def naming(mutant: Mutant, root: Path) -> list[str]:
    """Return the test files that name the most of what a file, or a kernel's users, define."""
    sources, name = [mutant.file], mutant.file.name
    if mutant.file.suffix == ".cl":
        sources = [f for f in (root / "clplen").rglob("*.py") if name in f.read_text("utf-8")]
    bodies = [ast.parse(source.read_text("utf-8")).body for source in sources]
    words = {n.name for b in bodies for n in b if isinstance(n, ast.ClassDef | ast.FunctionDef)}
    words |= {name, mutant.file.stem, *(source.stem for source in sources)}
    pattern = re.compile("|".join(rf"\b{re.escape(w)}\b" for w in words if w[0] != "_"))
    ranks = {}
    for file in sorted((root / "tests").rglob("test_*.py")):
        named = len(set(pattern.findall(file.read_text("utf-8"))))
        ranks[str(file.relative_to(root))] = named + 3 * (mutant.file.stem in file.stem)
    return [file for file in sorted(ranks, key=lambda f: -ranks[f])[:FILES] if ranks[file]]


def verdict(files: list[str], root: Path, limit: float) -> str:
    """Return the way whose tests fail, else "nothing" or "out of time"."""
    found = "nothing"
    for way, marks in WAYS.items():
        words = [sys.executable, "-m", "pytest", "-qx", "--device", "pocl", "-m", marks, *files]
        with_root = {"cwd": root, "env": os.environ | {"PYTHONPATH": str(root)}}
        try:
            done = subprocess.run(words, timeout=limit, capture_output=True, **with_root)
        except subprocess.TimeoutExpired:
            found = "out of time"
            continue
        if done.returncode not in (0, 5):  # 5: no test was chosen
            return way
    return found


@click.command(help=__doc__)
@click.argument("checkout", default=Path(__file__).parents[1], type=click.Path(path_type=Path))
@click.option("--count", default=60, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--limit", default=60.0, show_default=True, help="Seconds of tests of each way.")
@click.option("--map", "database", type=click.Path(exists=True, path_type=Path))
def main(checkout: Path, count: int, seed: int, limit: float, database: Path | None) -> None:
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        root = Path(folder, "tree").resolve()
        shutil.copytree(checkout.resolve(), root, ignore=shutil.ignore_patterns(".git", "images"))
        python = [m for file in sorted(root.glob("clplen/**/*.py")) for m in of_python(file)]
        kernels = [m for file in sorted(root.glob("kernels/**/*.cl")) for m in of_kernel(file)]
        draw, verdicts = random.Random(seed), dict.fromkeys((*WAYS, "nothing", "out of time"), 0)
        for mutant in draw.sample(python, count - count // 4) + draw.sample(kernels, count // 4):
            text = mutant.file.read_text(encoding="utf-8")
            lines, (start, end) = text.splitlines(keepends=True), mutant.span
            old = lines[mutant.line - 1]
            lines[mutant.line - 1] = old[:start] + mutant.new + old[end:]
            files = covering(mutant, root, database) if database else []
            files = files or naming(mutant, root)
            mutant.file.write_text("".join(lines), encoding="utf-8")
            way = verdict(files, root, limit)
            mutant.file.write_text(text, encoding="utf-8")
            verdicts[way] += 1
            where = f"{mutant.file.relative_to(root)}:{mutant.line}"
            click.echo(f"{way:11s} {where}: {old.strip()}  ->  {lines[mutant.line - 1].strip()}")
        click.echo(", ".join(f"{way}: {many} of {count}" for way, many in verdicts.items()))


if __name__ == "__main__":
    main()
