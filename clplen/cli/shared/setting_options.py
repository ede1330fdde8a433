"""Options of commands generated from settings models, and grouped help texts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from clplen.settings.declaration import GROUPS, Setting, format_value, settings_of

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
Model = TypeVar("Model")


class Option(click.Option):
    """Option that belongs to a group of the help text."""

    def __init__(self, *arguments: Any, group: str = "", **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        self.group = group


class Command(click.Command):
    """Command whose help text lists its options in groups, the most used group first."""

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
    """Parameter type that parses the value of a setting and applies its rule."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.name = (
            setting.metavar
            or (f"[{'|'.join(setting.choices)}]" if setting.choices else "")
            or {int: "INTEGER", float: "FLOAT"}.get(setting.kind, "VALUE")
        )

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.setting.in_metres(self.setting.read(_parsed(self.setting, value)))
        except ValueError as error:
            self.fail(f"{error}, got {format_value(_parsed(self.setting, value))}.", param, ctx)


def _parsed(setting: Setting, text: str) -> Any:
    """Return the number or numbers in a text, a choice in any case, or the text itself."""
    for choice in setting.choices:
        if text.lower() == choice.lower():
            return choice
    if setting.pair and ":" in text:
        return tuple(_number(part) for part in text.split(":"))
    if setting.kind is str and setting.check is None:
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
    """Return a decorator that adds an option for each setting of a model, or for some names."""

    def decorated(command: Decorated) -> Decorated:
        for setting in reversed(settings_of(model)):
            if setting.name not in leave_out and (not names or setting.name in names):
                command = _option(setting)(command)
        return command

    return decorated


def _option(setting: Setting) -> Callable[[Decorated], Decorated]:
    flag = f"--{setting.key.replace('_', '-')}"
    default = setting.default_words
    help_text = f"{setting.help}{f' Default: {default}.' if default else ''}"
    attributes: dict[str, Any] = {"type": SettingType(setting)}
    if setting.kind is bool and setting.default is None:
        flag, attributes = f"{flag}/--no-{flag[2:]}", {}
    elif setting.kind is bool:
        attributes = {"is_flag": True}
    elif setting.kind is Path:
        metavar = setting.metavar or "FILE"
        attributes = {"type": click.Path(path_type=Path), "metavar": metavar}
    elif setting.pair and " " in setting.metavar:
        callback = _read_pair(setting)
        attributes = {"type": int, "nargs": 2, "metavar": setting.metavar, "callback": callback}
    return click.option(
        flag, *setting.flags, setting.name, default=setting.default, help=help_text,
        group=setting.group, cls=Option, **attributes,
    )  # fmt: skip


def _read_pair(setting: Setting) -> Callable[[click.Context, click.Parameter, Any], Any]:
    def callback(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
        try:
            return setting.read(value)
        except ValueError as error:
            raise click.BadParameter(f"{error}, got {format_value(value)}.", ctx, param) from None

    return callback


def take_settings(model: type[Model], arguments: dict[str, Any]) -> Model:
    """Remove the settings of a model from a command's arguments, and return them as a model."""
    names = [setting.name for setting in settings_of(model)]
    return model(**{name: arguments.pop(name) for name in names})
