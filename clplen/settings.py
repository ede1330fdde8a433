"""Settings of an operation, declared once: values in Python, keys of files, options of commands.

A settings model is a frozen dataclass whose fields are made by `setting`. Its ``__post_init__``
calls `check_settings`; `clplen.config` and `clplen.cli.shared.settings_options` derive tables of
TOML files and options of commands from the same fields.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clplen.checks import is_finite, is_integer

_RULES = {
    bool: "must be true or false",
    Path: "must be the name of a file",
    tuple: "must be two finite numbers",
}


class SettingError(ValueError):
    """A setting has a wrong value; ``argument`` is its name in Python.

    Parameters
    ----------
    argument : str
        Name of the setting.
    condition : str
        The rest of the sentence, such as "must be positive, got 0".
    """

    def __init__(self, argument: str, condition: str) -> None:
        super().__init__(f"{argument} {condition}.")
        self.argument, self.condition = argument, condition


@dataclass(frozen=True)
class Setting:
    """What is known of a field: its values, its unit on surfaces, and its help sentence."""

    help: str
    kind: type = float  # bool, int, float, str, Path, or tuple for (y, x)
    least: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    default: Any = None
    default_text: str = ""  # what a default of None means
    example: Any = None  # where the default is None
    unit: str = ""  # "um": metres in Python, micrometres in files and commands
    flags: tuple[str, ...] = ()  # names on the command line besides that of the field
    metavar: str | None = None
    name: str = ""

    @property
    def key(self) -> str:
        """Name in files and on the command line."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    def in_python(self, value: Any) -> Any:
        """Return a value of a file or command as Python takes it, lengths in metres."""
        if self.unit == "um" and value is not None:
            return value / 1e6
        return tuple(value) if isinstance(value, list) else value

    @property
    def rule(self) -> str:
        """What a value must be."""
        if self.kind in _RULES:
            return _RULES[self.kind]
        words = [] if self.kind is str else [self._number]
        names = [f"'{name}'" for name in self.choices]
        if names:
            words.append(" or ".join(filter(None, [", ".join(names[:-1]), names[-1]])))
        return "must be " + " or ".join(words)

    @property
    def _number(self) -> str:
        noun = "whole number" if self.kind is int else "number"
        if self.least is not None:
            return f"a {noun} from {self.least:g} on"
        return f"a positive {noun}" if self.above == 0 else f"a finite {noun}"

    def fits(self, value: Any) -> bool:
        """Return whether a value is allowed."""
        if value is None:
            return self.default is None
        if self.kind is Path:
            return isinstance(value, str | os.PathLike)
        if self.kind is tuple:
            return (
                isinstance(value, list | tuple) and len(value) == 2 and all(map(is_finite, value))
            )
        if self.kind is bool:
            return isinstance(value, bool)
        if isinstance(value, str):
            return value in self.choices
        if self.kind is str or not is_finite(value):
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
    return [
        dataclasses.replace(one.metadata["setting"], name=one.name)
        for one in dataclasses.fields(model)
    ]


def check_settings(values: Any) -> None:
    """Refuse a model with a value that breaks its rule."""
    for one in settings_of(values):
        value = getattr(values, one.name)
        if not one.fits(value):
            raise SettingError(one.name, f"{one.rule}, got {value!r}")
