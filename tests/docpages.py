"""Blocks of the README and the guides as a reader meets them: commands, Python, job files."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from clplen.cli import main

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
_GENERATED = ("docs/gallery/figures", "docs/reference/api", "docs/site", "docs/jupyter_execute")
PAGES = (
    "README.md",
    *sorted(
        str(file.relative_to(ROOT))
        for file in (ROOT / "docs").rglob("*.md")
        if not str(file.relative_to(ROOT)).startswith(_GENERATED)
    ),
)
# directives such as {code-cell} too, so that their ends are not taken for beginnings
_FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"<!-- (not run|thorough|nightly|file): (.+?) -->\s*\Z")
_INSTALL = re.compile(r"pip install (?:\.|\"\.\[(\w+)\]\")")


@dataclass(frozen=True)
class Block:
    """One fenced block.

    ``mark`` is "not run", "thorough" or "nightly", said with a reason by an HTML comment before it,
    else empty; ``file`` the name that the comment gives to what the block shows.
    """

    page: str
    line: int
    language: str
    text: str
    mark: str = ""
    file: str = ""

    @property
    def commands(self) -> list[str]:
        """Its command lines, without prompts, continued lines joined."""
        if self.language not in ("", "sh"):
            return []
        lines = self.text.replace("\\\n", " ").splitlines()
        plain = (line.removeprefix("$ ") for line in lines)
        return [line for line in plain if line.startswith(("clplen ", "pip install "))]


def blocks(page: str) -> Iterator[Block]:
    """All blocks of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        before = text[: found.start()]
        mark = _MARK.search(before)
        line = before.count("\n") + 1
        kind, what = mark.groups() if mark else ("", "")
        named = kind == "file"
        yield Block(page, line, found[1], found[2], "" if named else kind, what if named else "")


def run_block(block: Block, names: dict[str, Any]) -> None:
    """Run a block in the present folder, Python with the names that the page has so far."""
    if block.language == "python":
        code = compile(block.text, f"{block.page}:{block.line}", "exec")
        with contextlib.redirect_stdout(io.StringIO()):
            exec(code, names)
    elif block.language == "toml":
        tomllib.loads(block.text)
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
    for command in block.commands:
        run_command(block, command)


def run_command(block: Block, command: str) -> None:
    """Run one command line of ``clplen`` here; of ``pip install`` see that the extra exists."""
    if (install := _INSTALL.match(command)) is not None:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        assert install[1] is None or install[1] in project["optional-dependencies"], command
        return
    words, target = shlex.split(command, comments=True), None
    if ">" in words:
        words, target = words[: words.index(">")], words[-1]
    words = [name for word in words for name in _expanded(word)]
    result = CliRunner().invoke(main, words[1:], catch_exceptions=False)
    assert result.exit_code == 0, f"{block.page}:{block.line}: {command}\n{result.output}"
    if target is not None:
        Path(target).write_text(result.stdout, encoding="utf-8")


def _expanded(word: str) -> list[str]:
    """As a shell does it with names of files."""
    if "*" not in word or "{" in word:
        return [word]
    return sorted(str(path) for path in Path().glob(word)) or [word]
