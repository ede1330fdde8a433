"""Advice leads somewhere: what messages name exists, in the command that says it."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import pytest

import clplen
from clplen import checks
from clplen.cli import main

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PACKAGE = Path(clplen.__file__).parent
PROJECT = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")
_COMMAND = re.compile(r"['`]clplen ([a-z]+)(?: ([a-z]+))?(?![a-z])([^'`]*)['`]")
_NAME = re.compile(r"(?<![\w./\[@-])clplen((?:\.[A-Za-z_]\w*)+)")


def commands(group: click.Group = main, above: str = "") -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        yield f"{above}{name}", command
        if isinstance(command, click.Group):
            yield from commands(command, f"{name} ")


COMMANDS = dict(commands())


def options_of(command: click.Command) -> set[str]:
    """The options of a command, and those of the commands in it."""
    own = {name for param in command.params for name in (*param.opts, *param.secondary_opts)}
    inside = command.commands.values() if isinstance(command, click.Group) else ()
    return own.union({"--help", "--version"}, *map(options_of, inside))


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Strings of a module that are no docstrings, what is put into them as {}."""
    inside: set[int] = set()  # nodes that are seen with those above them, which come first
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr):
            inside.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            inside |= {id(part) for part in node.values}
            parts = [part.value if isinstance(part, ast.Constant) else "{}" for part in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(getattr(node, "value", 0), str) and id(node) not in inside:
            yield node.lineno, node.value  # type: ignore[attr-defined]


MODULES = sorted(PACKAGE.rglob("*.py"))


@cache
def strings() -> list[tuple[Path, int, str]]:
    """Return the strings of all modules with their places, read when a test first asks."""
    return [(path, line, text) for path in MODULES for line, text in texts(path)]


def named_command(match: re.Match[str]) -> click.Command | None:
    return COMMANDS.get(f"{match[1]} {match[2]}") or COMMANDS.get(match[1])


def test_commands_and_their_options_that_are_named_exist():
    wrong = []
    for path, line, text in strings():
        for match in _COMMAND.finditer(text):
            command = named_command(match)
            if command is None or not set(_OPTION.findall(match[3])) <= options_of(command):
                wrong.append(f"{path}:{line}: {match[0]}")
    assert not wrong, "\n".join(wrong)


def test_options_that_are_named_exist():
    """In a module of commands, one of theirs."""
    every = set().union(*map(options_of, COMMANDS.values()))
    own: dict[str, set[str]] = {}
    for command in COMMANDS.values():
        if command.callback is not None:
            own.setdefault(command.callback.__module__, set()).update(options_of(command))
    wrong = []
    for path, line, text in strings():
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        sentence = _COMMAND.sub("", text) if " " in text.strip() else ""
        strange = set(_OPTION.findall(sentence)) - own.get(module, every)
        if strange:
            wrong.append(f"{path}:{line}: {', '.join(strange)}: {text[:200]!r}")
    assert not wrong, "\n".join(wrong)


def test_names_of_python_that_are_named_exist():
    wrong = []
    for path, line, text in strings():
        for match in _NAME.finditer(text):
            if " " in text and not is_there(match[1].split(".")[1:]):
                wrong.append(f"{path}:{line}: {match[0]}: {text[:120]!r}")
    assert not wrong, "\n".join(wrong)


def is_there(names: list[str]) -> bool:
    if names[0] in ("torch", "jax"):  # which may not be installed
        stub = (PACKAGE / names[0] / "__init__.pyi").read_text(encoding="utf-8")
        return all(f"import {name} as" in stub for name in names[1:])
    found: Any = clplen
    for name in names:
        if not hasattr(found, name):
            try:
                import_module(f"{found.__name__}.{name}")
            except (ModuleNotFoundError, AttributeError):
                return False
        found = getattr(found, name)
    return True


def test_extras_that_are_named_exist():
    calls = re.compile(r"install_advice\(['\"](\w+)['\"]\)")
    named = {one for path in MODULES for one in calls.findall(path.read_text(encoding="utf-8"))}
    assert {"zarr", "lenses", "batch", "video", "calibrate", "gpu"} <= named <= set(EXTRAS)
    written = {one for _, _, text in strings() for one in re.findall(r"clplen\[(\w+)\]", text)}
    assert written <= set(EXTRAS) - set(checks._MIN_PYTHON)


def test_extras_tell_the_python_that_they_need(monkeypatch: pytest.MonkeyPatch):
    needs = {}
    for extra, requirements in EXTRAS.items():
        found = [re.fullmatch(r".*; python_version >= '(\d+)\.(\d+)'", one) for one in requirements]
        if all(found):
            needs[extra] = max((int(one[1]), int(one[2])) for one in found if one)
    assert needs == checks._MIN_PYTHON
    monkeypatch.setattr(sys, "version_info", (3, 10, 4))
    advice = 'pip install "clplen[zarr]" in Python 3.11 or newer (this is 3.10)'
    assert checks.install_advice("zarr") == advice
    assert checks.install_advice("video") == 'pip install "clplen[video]"'
    monkeypatch.setattr(sys, "version_info", (3, 11, 0))
    assert checks.install_advice("zarr") == 'pip install "clplen[zarr]"'
