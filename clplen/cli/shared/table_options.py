"""Options of the command line from settings models, and help texts in groups."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import click

from clplen.config.settings import GROUPS, checked, default_of, extra_of
from clplen.config.tables import Table

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


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


class Checked(click.ParamType):
    """A value of a settings model, read as in a file and refused in the same words."""

    def __init__(self, field: Any, name: str = "") -> None:
        self._field = field
        self.name = name or "VALUE"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the value as the model takes it."""
        if not isinstance(value, str):
            return value
        try:
            return checked(self._field, _literal(value, self._field))
        except ValueError as error:
            self.fail(f"{error}.", param, ctx)


def _literal(text: str, field: Any) -> Any:
    """Return a number if the text is one and the field takes more than texts."""
    if set(_choices(field.annotation)) <= {str}:
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _choices(annotation: Any) -> list[Any]:
    """Return the types of a union without None."""
    parts = get_args(annotation) if type(None) in get_args(annotation) else (annotation,)
    return [part for part in parts if part is not type(None)]


def options_of(
    model: type[Table], *, leave_out: Iterable[str] = ()
) -> Callable[[Decorated], Decorated]:
    """Decorate a command with the options of a settings model.

    An option is named as its field, with hyphens, unless `setting` names another; values are
    checked by the model. Defaults are the model's; a switch is a flag.
    """
    excluded = set(leave_out)

    def decorate(command: Decorated) -> Decorated:
        for name in reversed(model.model_fields):
            if name not in excluded:
                command = option_of(model, name)(command)
        return command

    return decorate


def option_of(model: type[Table], name: str, **words: Any) -> Callable[[Decorated], Decorated]:
    """Return the decorator of one option; ``words`` replace what follows from the field."""
    field = model.model_fields[name]
    flag = extra_of(field, "option") or f"--{name.replace('_', '-')}"
    (kind, *more) = _choices(field.annotation)
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    default = default_of(field)
    help_text = f"{field.description}{f' Default: {default}.' if default else ''}"
    how: dict[str, Any] = {"help": help_text, "group": extra_of(field, "group"), "cls": Option}
    how |= {"required": True} if field.is_required() else {"default": field.default}
    if extra_of(field, "metavar"):
        how["metavar"] = extra_of(field, "metavar")
    if kind is bool and field.default is None:
        flag = f"{flag}/--no-{flag[2:]}"
    elif kind is bool:
        how["is_flag"] = True
    elif get_origin(kind) is Literal and not more:
        how |= {
            "type": click.Choice(get_args(kind), case_sensitive=False),
            "metavar": f"[{'|'.join(get_args(kind))}]",
        }
    elif get_origin(kind) is tuple:
        how |= {"nargs": len(get_args(kind)), "type": int}
    elif extra_of(field, "metavar") == "FILE":
        how["type"] = click.Path(path_type=Path)
    else:
        how["type"] = Checked(field, extra_of(field, "metavar"))
    return click.option(flag, name, **(how | words))
