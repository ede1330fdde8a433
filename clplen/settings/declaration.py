"""Settings of an operation, declared once for Python values, file keys and command options.

A settings model is a frozen dataclass, derived from `Settings`, whose fields are made by `setting`.
Tables of files (`clplen.config.setting_tables`), options of commands
(`clplen.cli.shared.setting_options`), help texts and messages are derived from its fields.
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
_SHORT = reprlib.Repr()  # formats a value in a message
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 80


def format_value(value: Any) -> str:
    """Format a value for a message: its repr, shortened, without NumPy types."""
    if isinstance(value, np.generic):
        value = value.item()
    return _SHORT.repr(value)


def named(argument: str, key: str = "") -> str:
    """Return the name of a setting in the current interface: ``alphas``, ``--alphas``."""
    key = key or argument
    return worded(python=argument, command=f"--{key.replace('_', '-')}", file=key)


class SettingError(ValueError):
    """Invalid value of a setting.

    Parameters
    ----------
    argument : str
        Name of the setting in Python.
    condition : str
        Rest of the sentence, such as "must be positive, got 0".
    key : str, optional
        Name in files and commands, if different.
    """

    def __init__(self, argument: str, condition: str, key: str = "") -> None:
        super().__init__(f"{named(argument, key)} {condition}.")
        self.argument, self.condition, self.key = argument, condition, key or argument

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.argument, self.condition, self.key)


@dataclass(frozen=True)
class Setting:
    """Declaration of a field: its valid values, its unit in files and commands, its help text."""

    help: str
    kind: type = float  # bool, int, float, str or Path
    minimum: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    pair: bool = False  # True for two numbers
    # Converts other values; its ValueError states the condition
    check: Callable[[Any], Any] | None = None
    default: Any = None
    default_text: str = ""  # description of a default of None
    example: Any = None  # example for a default of None
    unit: str = ""  # "um" or "mm": metres in Python, this unit in files and commands
    key: str = ""  # name in files and on the command line, derived from the field's name if empty
    flags: tuple[str, ...] = ()  # further names on the command line
    metavar: str = ""
    group: str = ""  # heading in help texts
    name: str = ""

    @property
    def default_words(self) -> str:
        """Description of the default; empty for a switch that is off."""
        if self.default is None or self.default is False:
            return self.default_text
        return str(self.default)

    @property
    def rule(self) -> str:
        """Condition on a value."""
        if self.kind is bool:
            return "must be true or false"
        if self.kind is Path:
            return "must be the name of a file"
        alternatives = [self._number] if self.kind in (int, float) else []
        names = [f"'{name}'" for name in self.choices]
        if names:
            alternatives.append(" or ".join(filter(None, [", ".join(names[:-1]), names[-1]])))
        return "must be " + (" or ".join(alternatives) or "a text")

    @property
    def _number(self) -> str:
        noun = "whole number" if self.kind is int else "number"
        lower = "" if self.minimum is None else f" from {self.minimum:g} on"
        kind = "positive " if self.above == 0 else "" if lower else "finite "
        if self.kind is int:
            kind = ""
        return f"two {kind}{noun}s{lower}" if self.pair else f"a {kind}{noun}{lower}"

    def read(self, value: Any) -> Any:
        """Return a value in the form of the model; raise ValueError with the condition."""
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
        """Convert a length of a file or command from the setting's unit to metres."""
        return value / _PER_METRE[self.unit] if self.unit and is_finite(value) else value

    def checked(self, value: Any) -> Any:
        """Return a value in the form of the model; raise SettingError with the condition."""
        try:
            return self.read(value)
        except ValueError as error:
            raise SettingError(self.name, f"{error}, got {format_value(value)}", self.key) from None

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
            and (self.minimum is None or value >= self.minimum)
            and (self.above is None or value > self.above)
        )


def setting(default: Any, help: str, **rules: Any) -> Any:
    """Return a field of a settings model; ``rules`` are fields of `Setting`."""
    return dataclasses.field(
        default=default, metadata={"setting": Setting(help, default=default, **rules)}
    )


def settings_of(model: type | Any) -> list[Setting]:
    """Return the settings of a model, in order."""
    settings = []
    for item in dataclasses.fields(model):
        declaration: Setting = item.metadata["setting"]
        key = declaration.key or (
            f"{item.name}_{declaration.unit}" if declaration.unit else item.name
        )
        settings.append(dataclasses.replace(declaration, name=item.name, key=key))
    return settings


def setting_of(model: type, name: str) -> Setting:
    """Return the setting of a name."""
    return next(item for item in settings_of(model) if item.name == name)


@dataclass(frozen=True)
class Settings:
    """A settings model, which checks its values on creation."""

    def __post_init__(self) -> None:
        for item in settings_of(self):
            object.__setattr__(self, item.name, item.checked(getattr(self, item.name)))
