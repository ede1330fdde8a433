"""Settings of operations: one declaration for job files, the command line and the documentation.

A settings model is a `Table` whose fields are made by `setting`: type, bounds and unit by the
annotation, the default, one sentence of help, and the group of the help text. The command line
takes its options from it (`clplen.cli.shared.table_options`), the commented job file its lines.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Collection, Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from clplen.config.tables import Count, Table, model_in, problem_with
from clplen.units import bytes_of

MAX_PLANES = 10**6
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
_COLUMN, _WIDTH = 32, 100  # of the comments in a commented file, and of its lines


def setting(
    default: Any,
    help: str,
    *,
    group: str = "",
    default_text: str = "",
    example: Any = None,
    option: str = "",
    metavar: str = "",
) -> Any:
    """Declare a field of a settings model; ``...`` as the default makes it required.

    ``help`` is one sentence. ``default_text`` describes a default of None; ``example`` is the value
    that a commented file shows; ``option`` is the flag of the command line where it is not the
    field's name; ``group`` is the heading below which help texts show it.
    """
    extra: Any = {"group": group, "default_text": default_text, "option": option}
    extra["metavar"] = metavar
    return Field(default, description=help, examples=[example], json_schema_extra=extra)


def extra_of(field: FieldInfo, name: str) -> str:
    """Return a word that `setting` was given; empty for other fields."""
    extra = field.json_schema_extra
    return str(extra.get(name, "")) if isinstance(extra, dict) else ""


def default_of(field: FieldInfo) -> str:
    """Return the default in words; empty where the field is required or a switch that is off."""
    if field.is_required() or field.default is False:
        return ""
    if field.default is None:
        return extra_of(field, "default_text")
    value = field.default
    return value if isinstance(value, str) else json.dumps(value)


def checked(field: FieldInfo, value: Any) -> Any:
    """Return a value as a field takes it; raise ValueError in the words of its type."""
    annotation: Any = field.annotation
    for part in field.metadata:
        annotation = Annotated[annotation, part]
    try:
        return TypeAdapter(annotation).validate_python(value)
    except ValidationError as error:
        raise ValueError(problem_with(error)) from error


def commented(
    model: type[Table],
    *,
    shown: dict[str, Any],
    examples: dict[str, Any],
    hidden: Collection[str] = (),
) -> Iterator[str]:
    """Yield the lines of a commented file that show all keys of a model.

    Keys of ``shown`` are given with their values; the others are commented out, with the value of
    ``examples``, else with that of the field. Those of ``hidden`` are left out.
    """
    for name, field in model.model_fields.items():
        value = shown.get(name, examples.get(name, (field.examples or [None])[0]))
        if name in hidden or model_in(field.annotation) is not None:
            continue  # the latter is a table of its own
        text = json.dumps(field.default if value is None else value)
        words = [field.description or ""]
        choices = choices_of(field.annotation)
        if len(choices) > 1:
            words.append(f"One of {', '.join(choices)}.")
        default = default_of(field)
        if field.is_required():
            words.insert(0, "Needed.")
        elif default and default != text.strip('"'):
            words.append(f"Default: {default}.")
        line = f"{'' if name in shown else '# '}{name} = {text}"
        notes = textwrap.wrap(" ".join(words), _WIDTH - _COLUMN - 2)
        yield f"{line:<{_COLUMN - 1}} # {notes[0]}"
        yield from (f"{'':<{_COLUMN}}# {note}" for note in notes[1:])


def choices_of(annotation: Any) -> list[str]:
    """Return the texts that an annotation with a `Literal` allows."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [text for part in get_args(annotation) for text in choices_of(part)]


def planes_of(value: Any) -> list[float]:
    """Return planes given as a list, or as START:STOP:N with both ends included."""
    if isinstance(value, str):
        return _range(value)
    if not isinstance(value, list) or not value:
        raise ValueError('must be a list of numbers or "START:STOP:N", such as "-1:1:41"')
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in value):
        raise ValueError("must hold numbers only")
    planes = [float(one) for one in value]
    if not np.isfinite(planes).all():
        raise ValueError("must hold finite numbers only")
    return planes


def _range(text: str) -> list[float]:
    parts = text.split(":")
    try:
        start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = -1
    if len(parts) != 3 or not 1 <= count <= MAX_PLANES or not np.isfinite([start, stop]).all():
        raise ValueError(f'must be START:STOP:N with 1 to {MAX_PLANES:,} planes, such as "-2:2:33"')
    if (count == 1) != (start == stop):
        raise ValueError(
            "must have at least 2 planes between two different ends, or 1 plane with START equal "
            "to STOP"
        )
    return [float(plane) for plane in np.linspace(start, stop, count)]


def aperture_of(value: Any) -> int | float | str:
    """Return views across, a fraction of the diameter, or an f-number such as "f/66"."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    if is_number or (isinstance(value, str) and re.fullmatch(r"[fF]/\d+(\.\d+)?", value)):
        return value
    raise ValueError('must be views across (9), a fraction of the diameter (0.5) or "f/66"')


Pair = tuple[Count, Count]
Size = Annotated[int, BeforeValidator(bytes_of), Field(ge=1)]
Planes = Annotated[list[float], BeforeValidator(planes_of)]
Aperture = Annotated[Any, BeforeValidator(aperture_of)]
