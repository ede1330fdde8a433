"""Settings of an operation, declared once: values in Python, keys of files, options of commands.

A settings model is a frozen dataclass, derived from `Settings`, whose fields are made by `setting`.
Tables of files (`clplen.config.setting_tables`), options of commands
(`clplen.cli.shared.setting_options`), help texts and messages follow from its fields.
"""

from __future__ import annotations

import dataclasses
import os
import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import is_finite, is_integer
from clplen.errors import worded

# Headings of help texts in their order.
GROUPS = OPTIONS, PLANES, LENGTHS, FOCUSED, OUTPUT, DEVICE, INPUT = (
    "Options",
    "Planes",
    "Lengths of the camera",
    "Raw images of focused cameras",
    "Output",
    "Device",
    "Input",
)
_PER_METRE = {"um": 1e6, "mm": 1e3, "m": 1.0}
_SHORT = reprlib.Repr()  # of a value in a message
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 80


def shown(value: Any) -> str:
    """Return a value as messages show it: in Python's words, shortened, numbers without type."""
    if isinstance(value, np.generic):
        value = value.item()
    return _SHORT.repr(value)


def named(argument: str, key: str = "") -> str:
    """Return the name of a setting on the surface in use: ``alphas``, ``--alphas``."""
    key = key or argument
    return worded(python=argument, command=f"--{key.replace('_', '-')}", file=key)


class SettingError(ValueError):
    """A setting has a wrong value.

    Parameters
    ----------
    argument : str
        Name of the setting in Python.
    condition : str
        The rest of the sentence, such as "must be positive, got 0".
    key : str, optional
        Name in files and commands, if another.
    """

    def __init__(self, argument: str, condition: str, key: str = "") -> None:
        super().__init__(f"{named(argument, key)} {condition}.")
        self.argument, self.condition, self.key = argument, condition, key or argument

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.argument, self.condition, self.key)


@dataclass(frozen=True)
class Setting:
    """What is known of a field: its values, its unit on surfaces, and its help sentence."""

    help: str
    kind: type = float  # bool, int, float, str or Path
    least: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    pair: bool = False  # two numbers
    check: Callable[[Any], Any] | None = None  # reads other values; ValueError: what they must be
    default: Any = None
    default_text: str = ""  # what a default of None means
    example: Any = None  # where the default is None
    unit: str = ""  # "um" or "mm": metres in Python, this unit in files and commands
    key: str = ""  # name in files and on the command line, if another than follows from the name
    flags: tuple[str, ...] = ()  # names on the command line besides that of the field
    metavar: str = ""
    group: str = ""  # heading below which help texts show it
    name: str = ""

    @property
    def default_words(self) -> str:
        """The default in words; empty for a switch that is off."""
        if self.default is None or self.default is False:
            return self.default_text
        return str(self.default)

    @property
    def rule(self) -> str:
        """What a value must be."""
        if self.kind is bool:
            return "must be true or false"
        if self.kind is Path:
            return "must be the name of a file"
        words = [self._number] if self.kind in (int, float) else []
        names = [f"'{name}'" for name in self.choices]
        if names:
            words.append(" or ".join(filter(None, [", ".join(names[:-1]), names[-1]])))
        return "must be " + (" or ".join(words) or "a text")

    @property
    def _number(self) -> str:
        noun = "whole number" if self.kind is int else "number"
        least = "" if self.least is None else f" from {self.least:g} on"
        kind = "positive " if self.above == 0 else "" if least else "finite "
        if self.kind is int:
            kind = ""
        return f"two {kind}{noun}s{least}" if self.pair else f"a {kind}{noun}{least}"

    def read(self, value: Any) -> Any:
        """Return a value as the model takes it; ValueError says what it must be."""
        if value is None and self.default is None:
            return None
        if self.check is not None:
            return self.check(value)
        if self.pair:
            if not isinstance(value, list | tuple) or len(value) != 2:
                raise ValueError(self.rule)
            values = tuple(value)
        else:
            values = (value,)
        if not all(map(self._fits, values)):
            raise ValueError(self.rule)
        return values if self.pair else value

    def in_metres(self, value: Any) -> Any:
        """Return a length of a file or command, which is in the setting's unit, in metres."""
        return value / _PER_METRE[self.unit] if self.unit and is_finite(value) else value

    def checked(self, value: Any) -> Any:
        """Return a value as the model takes it; SettingError says what it must be."""
        try:
            return self.read(value)
        except ValueError as error:
            raise SettingError(self.name, f"{error}, got {shown(value)}", self.key) from None

    def _fits(self, value: Any) -> bool:
        if self.kind is Path:
            return isinstance(value, str | os.PathLike)
        if self.kind is bool:
            return isinstance(value, bool | np.bool_)
        if isinstance(value, str):
            return value in self.choices if self.choices else self.kind is str
        if self.kind is str or isinstance(value, bool) or not is_finite(value):
            return False
        return (
            (self.kind is float or is_integer(value))
            and (self.least is None or value >= self.least)
            and (self.above is None or value > self.above)
        )


def setting(default: Any, help: str, **known: Any) -> Any:
    """Return a field of a settings model; ``known`` are fields of `Setting`."""
    return dataclasses.field(
        default=default, metadata={"setting": Setting(help, default=default, **known)}
    )


def settings_of(model: type | Any) -> list[Setting]:
    """Return the settings of a model, in order."""
    found = []
    for one in dataclasses.fields(model):
        known: Setting = one.metadata["setting"]
        key = known.key or (f"{one.name}_{known.unit}" if known.unit else one.name)
        found.append(dataclasses.replace(known, name=one.name, key=key))
    return found


def setting_of(model: type, name: str) -> Setting:
    """Return the setting of a name."""
    return next(one for one in settings_of(model) if one.name == name)


@dataclass(frozen=True)
class Settings:
    """A settings model, whose values are checked by their rules when it is made."""

    def __post_init__(self) -> None:
        for one in settings_of(self):
            object.__setattr__(self, one.name, one.checked(getattr(self, one.name)))
