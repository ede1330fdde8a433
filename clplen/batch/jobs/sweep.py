"""Sweeps: keys of a file with their values, and every combination of them."""

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

ALL = "*"  # in a key, every entry of a list
_DIGITS = range(6, 18)  # of floats in names; 17 tell all of them apart
_LONGEST = 40  # characters of a value in a name


class Setting(NamedTuple):
    """One key with one of its values, and what the name of an item says of it.

    Numbers in the key count the entries of lists from 0, ``*`` is all of them.
    """

    key: str
    value: Any
    label: str


def distinct(values: Any) -> Any:
    """Refuse an empty sweep, and one that has a value twice."""
    if not isinstance(values, list) or not values:
        raise ValueError("must be a list of at least one value")
    for number, value in enumerate(values):
        if value in values[:number]:
            raise ValueError(f"has {value!r} twice")
    return values


class SweepTable(Table):
    """``[[simulations.sweep]]``: one key of the camera file, or of a scene, with its values."""

    key: Annotated[str, Field(pattern=r"^[^.]+(\.[^.]+)*$")] = setting(
        ..., "Key of the camera file; numbers count entries from 0, * is all of them.",
        example="scene.points_mm.*.2",
    )  # fmt: skip
    values: Annotated[list[Any], BeforeValidator(distinct)] = setting(
        ..., "Values of the key.", example=[-100, -50, 0, 50]
    )
    name: Annotated[str, Field(min_length=1)] | None = setting(
        None, "Name of the key in the names of items.",
        default_text="the key's last word that is no number", example="z_mm",
    )  # fmt: skip


def swept_once(sweep: list[SweepTable]) -> list[SweepTable]:
    """Refuse keys that set the same value, and names that two keys have."""
    for number, one in enumerate(sweep):
        for other in sweep[:number]:
            pairs = zip(one.key.split("."), other.key.split("."), strict=False)
            if all(a == b or ALL in (a, b) for a, b in pairs):
                raise ValueError(
                    f"sweeps {other.key} and {one.key}, which set the same value: leave one out"
                )
            if one.name is not None and one.name == other.name:
                raise ValueError(f"calls {other.key} and {one.key} both {one.name!r}")
    return sweep


def combinations(sweep: Sequence[SweepTable]) -> list[list[Setting]]:
    """Every combination of the values of some keys, the last key fastest."""
    columns = [
        [
            Setting(one.key, value, f"{name}={text}")
            for value, text in zip(one.values, _texts(one.values), strict=True)
        ]
        for one, name in zip(sweep, _names(sweep), strict=True)
    ]
    return [list(chosen) for chosen in product(*columns)]


def label(settings: Iterable[Setting]) -> str:
    """What the name of an item says of a combination, such as "dz_mm=-100_pitch_um=150"."""
    return "_".join(setting.label for setting in settings)


def with_values(content: dict[str, Any], settings: Iterable[Setting]) -> dict[str, Any]:
    """A copy of a file's content with other values.

    The last word of a key may be new to its table: whether it is known there is found when the
    content is read.
    """
    changed = copy.deepcopy(content)
    for one in settings:
        _put(changed, one.key.split("."), one.value, [])
    return changed


def _put(place: Any, words: list[str], value: Any, passed: list[str]) -> None:
    """Set what a key names, in place."""
    word, rest = words[0], words[1:]
    for part in _parts(place, word, rest, passed):
        if rest:
            _put(place[part], rest, value, [*passed, str(part)])
        else:
            place[part] = copy.deepcopy(value)


def _parts(place: Any, word: str, rest: list[str], passed: list[str]) -> Iterable[Any]:
    """Keys of a table, or numbers of a list's entries, that a word of a key means."""
    key, here = ".".join([*passed, word, *rest]), ".".join(passed)
    if isinstance(place, list):
        if word == ALL:
            return range(len(place))
        if word.isdecimal() and int(word) < len(place):
            return [int(word)]
        raise ValueError(
            f"the key {key!r} leads nowhere: {here} is a list, and {word!r} is none of its "
            f"entries, 0 to {len(place) - 1} or {ALL} for all"
        )
    if not isinstance(place, dict):
        raise ValueError(f"the key {key!r} leads nowhere: {here} is {place!r}, which has no parts")
    if word == ALL or (rest and word not in place):
        within = [name for name, one in place.items() if not rest or isinstance(one, dict | list)]
        near = difflib.get_close_matches(word, within, n=1, cutoff=0.6)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(within) or 'none'}"
        where = here or "the file"
        raise ValueError(f"the key {key!r} leads nowhere: {where} has no table {word!r}; {hint}")
    return [word]


def _names(sweep: Sequence[SweepTable]) -> list[str]:
    """What the names of items call each key: its last word, more words where two are the same."""
    whole = [one.key.split(".") for one in sweep]
    starts = [_last_word(words) for words in whole]
    names = [one.name or words[i] for one, words, i in zip(sweep, whole, starts, strict=True)]
    for longer in range(max(map(len, whole), default=0)):
        alike = [n for n, name in enumerate(names) if names.count(name) > 1]
        for n in alike:
            if sweep[n].name is None:
                names[n] = ".".join(whole[n][max(0, starts[n] - longer) :])
    return [_safe(name) for name in names]


def _last_word(words: list[str]) -> int:
    """Place of the last word that is no number of an entry."""
    named = [i for i, word in enumerate(words) if word != ALL and not word.isdecimal()]
    return named[-1] if named else 0


def _texts(values: Sequence[Any]) -> list[str]:
    """Values as they stand in names: short, and all different."""
    for digits in _DIGITS:
        texts = [_text(value, digits)[:_LONGEST] for value in values]
        if len(set(map(str.casefold, texts))) == len(texts):
            return texts
    return [f"{text}-{number}" for number, text in enumerate(texts)]


def _text(value: Any, digits: int) -> str:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return "x".join(_text(one, digits) for one in value)
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    return _safe(str(value).lower() if isinstance(value, bool) else str(value))


def _safe(text: str) -> str:
    """Without what some disks do not take in names."""
    return re.sub(r"[^A-Za-z0-9_.=+-]+", "-", text)
