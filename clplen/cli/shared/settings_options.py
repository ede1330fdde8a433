"""Options of commands from the fields of settings models (`clplen.settings`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from clplen.settings import Setting, SettingError, settings_of

Command = TypeVar("Command", bound=Callable[..., Any])
Model = TypeVar("Model")


class SettingType(click.ParamType):
    """Values of one setting: text to what Python takes, refused in the words of its rule."""

    def __init__(self, one: Setting) -> None:
        self.one = one
        self.name = (
            one.metavar or "|".join(one.choices) or ("INTEGER" if one.kind is int else "FLOAT")
        )

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        found = _parsed(self.one, value)
        if not self.one.fits(found):
            self.fail(f"{self.one.rule}, got {value!r}.", param, ctx)
        return self.one.in_python(found)


def _parsed(one: Setting, text: str) -> Any:
    """Return the number or numbers of a text, or the text."""
    try:
        if one.kind is tuple:
            return tuple(map(float, text.split(":")))
        if one.kind is not str and text not in one.choices:
            return int(text) if one.kind is int else float(text)
    except ValueError:
        return text
    return text


def setting_options(model: type, *names: str) -> Callable[[Command], Command]:
    """Give a command an option for each setting of a model, or for the named ones."""

    def decorated(command: Command) -> Command:
        for one in reversed(settings_of(model)):
            if names and one.name not in names:
                continue
            kind: dict[str, Any] = {"type": SettingType(one)}
            if one.kind is bool:
                kind = {"is_flag": True}
            elif one.kind is Path:
                kind = {"type": click.Path(path_type=Path)}
            shown: bool | str = one.default_text or not (one.default is None or one.kind is bool)
            command = click.option(
                _option(one), *one.flags, one.name, default=one.default, help=one.help,
                show_default=shown, **kind,
            )(command)  # fmt: skip
        return command

    return decorated


def _option(one: Setting) -> str:
    return f"--{one.key.replace('_', '-')}"


def take_settings(model: type[Model], given: dict[str, Any]) -> Model:
    """Take the values of a model out of a command's arguments."""
    with setting_errors(model):
        return model(**{one.name: given.pop(one.name) for one in settings_of(model)})


@contextmanager
def setting_errors(model: type) -> Iterator[None]:
    """Raise errors of settings as those of the options of a model."""
    try:
        yield
    except SettingError as error:
        names = {one.name: _option(one) for one in settings_of(model)}
        raise click.UsageError(f"{names[error.argument]} {error.condition}.") from error
