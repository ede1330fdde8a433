"""Sweeps: combinations of values for keys of a file."""

from __future__ import annotations

import copy
import difflib
import re
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Field

from clplen.config.settings import setting
from clplen.config.tables import Table

ALL = "*"  # stands for every entry of a list in a key
_DIGITS = range(6, 18)  # significant digits of floats in names; 17 distinguish all floats
_MAX_LENGTH = 40  # characters of a value in a name


class Setting(NamedTuple):
    """Key with a value and a label for item names.

    Numbers in the key are indices of list entries from 0; ``*`` stands for all entries.
    """

    key: str
    value: Any
    label: str


def distinct(values: Any) -> Any:
    """Raise an error if a sweep is empty or repeats a value."""
    if not isinstance(values, list) or not values:
        raise ValueError("must be a list of at least one value")
    for number, value in enumerate(values):
        if value in values[:number]:
            raise ValueError(f"must not repeat {value!r}")
    return values


class SweepTable(Table):
    """``[[simulations.sweep]]``: a key of the camera file or scene, with its values."""

    key: Annotated[str, Field(pattern=r"^[^.]+(\.[^.]+)*$")] = setting(
        ..., "Key of the camera file; numbers are list indices from 0, * means all entries.",
        example="scene.points_mm.*.2",
    )  # fmt: skip
    values: Annotated[list[Any], BeforeValidator(distinct)] = setting(
        ..., "Values of the key.", example=[-100, -50, 0, 50]
    )
    name: Annotated[str, Field(min_length=1)] | None = setting(
        None, "Label of the key in the names of items.",
        default_text="the last part of the key that is not a number", example="z_mm",
    )  # fmt: skip


def swept_once(sweep: list[SweepTable]) -> list[SweepTable]:
    """Raise an error if two sweeps set one value or have one name."""
    for number, table in enumerate(sweep):
        for other in sweep[:number]:
            pairs = zip(table.key.split("."), other.key.split("."), strict=False)
            if all(a == b or ALL in (a, b) for a, b in pairs):
                raise ValueError(
                    f"sweeps {other.key} and {table.key}, which set the same value: leave one out"
                )
            if table.name is not None and table.name == other.name:
                raise ValueError(f"has the name {table.name!r} for {other.key} and {table.key}")
    return sweep


def combinations(sweep: Sequence[SweepTable]) -> list[list[Setting]]:
    """Return all combinations of the swept values; the last key varies fastest."""
    columns = [
        [
            Setting(table.key, value, f"{name}={text}")
            for value, text in zip(table.values, _texts(table.values), strict=True)
        ]
        for table, name in zip(sweep, _names(sweep), strict=True)
    ]
    return [list(settings) for settings in product(*columns)]


def label(settings: Iterable[Setting]) -> str:
    """Return the label of a combination, such as "dz_mm=-100_pitch_um=150"."""
    return "_".join(swept.label for swept in settings)


def with_values(content: dict[str, Any], settings: Iterable[Setting]) -> dict[str, Any]:
    """Return a copy of a file's content with other values.

    The last part of a key may be new to its table; the model rejects unknown keys later.
    """
    changed = copy.deepcopy(content)
    for key, value, _ in settings:
        _put(changed, key.split("."), value, [])
    return changed


def _put(node: Any, parts: list[str], value: Any, parents: list[str]) -> None:
    """Set the value of a key in nested tables and lists."""
    part, rest = parts[0], parts[1:]
    for entry in _entries(node, part, rest, parents):
        if rest:
            _put(node[entry], rest, value, [*parents, str(entry)])
        else:
            node[entry] = copy.deepcopy(value)


def _entries(node: Any, part: str, rest: list[str], parents: list[str]) -> Iterable[Any]:
    """Return the keys or indices of a node that match a part of a key."""
    key, path = ".".join([*parents, part, *rest]), ".".join(parents)
    if isinstance(node, list):
        if part == ALL:
            return range(len(node))
        if part.isdecimal() and int(part) < len(node):
            return [int(part)]
        raise ValueError(
            f"the key {key!r} does not exist: {path} is a list with the entries 0 to "
            f"{len(node) - 1} ({ALL} for all), not {part!r}"
        )
    if not isinstance(node, dict):
        raise ValueError(f"the key {key!r} does not exist: {path} is {node!r}, not a table")
    if part == ALL or (rest and part not in node):
        names = [name for name, entry in node.items() if not rest or isinstance(entry, dict | list)]
        near = difflib.get_close_matches(part, names, n=1, cutoff=0.6)
        hint = f"did you mean {near[0]}?" if near else f"tables: {', '.join(names) or 'none'}"
        parent = path or "the file"
        raise ValueError(f"the key {key!r} does not exist: {parent} has no table {part!r}; {hint}")
    return [part]


def _names(sweep: Sequence[SweepTable]) -> list[str]:
    """Return a label for each key: its last part, with parents where labels would be equal."""
    keys = [table.key.split(".") for table in sweep]
    starts = [_last_name(parts) for parts in keys]
    names = [table.name or parts[i] for table, parts, i in zip(sweep, keys, starts, strict=True)]
    for longer in range(max(map(len, keys), default=0)):
        alike = [n for n, name in enumerate(names) if names.count(name) > 1]
        for n in alike:
            if sweep[n].name is None:
                names[n] = ".".join(keys[n][max(0, starts[n] - longer) :])
    return [_safe(name) for name in names]


def _last_name(parts: list[str]) -> int:
    """Return the index of the last part of a key that is not a list index."""
    names = [i for i, part in enumerate(parts) if part != ALL and not part.isdecimal()]
    return names[-1] if names else 0


def _texts(values: Sequence[Any]) -> list[str]:
    """Return short, distinct texts of values for item names."""
    for digits in _DIGITS:
        texts = [_text(value, digits)[:_MAX_LENGTH] for value in values]
        if len(set(map(str.casefold, texts))) == len(texts):
            return texts
    return [f"{text}-{number}" for number, text in enumerate(texts)]


def _text(value: Any, digits: int) -> str:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return "x".join(_text(entry, digits) for entry in value)
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    return _safe(str(value).lower() if isinstance(value, bool) else str(value))


def _safe(text: str) -> str:
    """Replace characters that some file systems do not allow in names."""
    return re.sub(r"[^A-Za-z0-9_.=+-]+", "-", text)
