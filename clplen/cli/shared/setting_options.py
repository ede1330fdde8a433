"""Options of commands from the fields of settings models, and help texts in groups."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from clplen.settings.declaration import GROUPS, Setting, format_value, settings_of

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
Model = TypeVar("Model")


class Option(click.Option):
    """An option with the group below which help texts list it."""

    def __init__(self, *arguments: Any, group: str = "", **words: Any) -> None:
        super().__init__(*arguments, **words)
        self.group = group


class Command(click.Command):
    """A command whose help text lists its options in groups, the most used ones first."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each group below its heading."""
        groups: dict[str, list[tuple[str, str]]] = {heading: [] for heading in GROUPS}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None and isinstance(parameter, click.Option):
                groups[getattr(parameter, "group", "") or GROUPS[0]].append(record)
        for heading, records in groups.items():
            if records:
                with formatter.section(heading):
                    formatter.write_dl(records)


class SettingType(click.ParamType):
    """Values of one setting: text to what Python takes, refused in the words of its rule."""

    def __init__(self, one: Setting) -> None:
        self.one = one
        self.name = (
            one.metavar
            or (f"[{'|'.join(one.choices)}]" if one.choices else "")
            or {int: "INTEGER", float: "FLOAT"}.get(one.kind, "VALUE")
        )

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.one.in_metres(self.one.read(_parsed(self.one, value)))
        except ValueError as error:
            self.fail(f"{error}, got {format_value(_parsed(self.one, value))}.", param, ctx)


def _parsed(one: Setting, text: str) -> Any:
    """Return the number or numbers of a text, a choice in any case, or the text."""
    for choice in one.choices:
        if text.lower() == choice.lower():
            return choice
    if one.pair and ":" in text:
        return tuple(_number(part) for part in text.split(":"))
    if one.kind is str and one.check is None:
        return text
    return _number(text)


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def setting_options(
    model: type, *names: str, leave_out: tuple[str, ...] = ()
) -> Callable[[Decorated], Decorated]:
    """Give a command an option for each setting of a model, or for the named ones."""

    def decorated(command: Decorated) -> Decorated:
        for one in reversed(settings_of(model)):
            if one.name not in leave_out and (not names or one.name in names):
                command = _option(one)(command)
        return command

    return decorated


def _option(one: Setting) -> Callable[[Decorated], Decorated]:
    flag = f"--{one.key.replace('_', '-')}"
    help_text = f"{one.help}{f' Default: {one.default_words}.' if one.default_words else ''}"
    how: dict[str, Any] = {"type": SettingType(one)}
    if one.kind is bool and one.default is None:
        flag, how = f"{flag}/--no-{flag[2:]}", {}
    elif one.kind is bool:
        how = {"is_flag": True}
    elif one.kind is Path:
        how = {"type": click.Path(path_type=Path), "metavar": one.metavar or "FILE"}
    elif one.pair and " " in one.metavar:
        how = {"type": int, "nargs": 2, "metavar": one.metavar, "callback": _read_pair(one)}
    return click.option(
        flag, *one.flags, one.name, default=one.default, help=help_text, group=one.group,
        cls=Option, **how,
    )  # fmt: skip


def _read_pair(one: Setting) -> Callable[[click.Context, click.Parameter, Any], Any]:
    def callback(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
        try:
            return one.read(value)
        except ValueError as error:
            raise click.BadParameter(f"{error}, got {format_value(value)}.", ctx, param) from None

    return callback


def take_settings(model: type[Model], given: dict[str, Any]) -> Model:
    """Take the values of a model out of a command's arguments."""
    return model(**{one.name: given.pop(one.name) for one in settings_of(model)})
