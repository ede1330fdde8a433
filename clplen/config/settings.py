"""Keys of TOML files with their help sentences, and commented example files."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Collection, Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BeforeValidator, Field
from pydantic.fields import FieldInfo

from clplen.config.tables import Count, Table, model_in
from clplen.units import bytes_of

_COLUMN, _WIDTH = 32, 100  # column of the comments in a commented file, and width of its lines


def setting(default: Any, help: str, *, default_text: str = "", example: Any = None) -> Any:
    """Declare a key of a table; the default ``...`` makes it required.

    ``help`` is a sentence. ``default_text`` describes a default of None; ``example`` is the value
    in commented files.
    """
    extra: Any = {"default_text": default_text}
    return Field(default, description=help, examples=[example], json_schema_extra=extra)


def default_of(field: FieldInfo) -> str:
    """Return the default as text; empty for required fields and for False."""
    if field.is_required() or field.default is False:
        return ""
    if field.default is None:
        extra = field.json_schema_extra
        return str(extra.get("default_text", "")) if isinstance(extra, dict) else ""
    value = field.default
    return value if isinstance(value, str) else json.dumps(value)


def commented(
    model: type[Table],
    *,
    active: dict[str, Any],
    examples: dict[str, Any],
    hidden: Collection[str] = (),
) -> Iterator[str]:
    """Yield the lines of a commented file with all keys of a model, except ``hidden`` keys.

    Keys in ``active`` have their values there. Other keys are commented out, with the value from
    ``examples`` or of the field.
    """
    for name, field in model.model_fields.items():
        value = active.get(name, examples.get(name, (field.examples or [None])[0]))
        if name in hidden or model_in(field.annotation) is not None:
            continue  # nested tables have their own section
        text = json.dumps(field.default if value is None else value)
        sentences = [field.description or ""]
        choices = choices_of(field.annotation)
        if len(choices) > 1 and not _names_all(sentences[0], choices):
            sentences.append(f"One of {', '.join(choices)}.")
        default = default_of(field)
        if field.is_required():
            sentences.insert(0, "Required.")
        elif default and default != text.strip('"'):
            sentences.append(f"Default: {default}.")
        line = f"{'' if name in active else '# '}{name} = {text}"
        notes = textwrap.wrap(" ".join(sentences), _WIDTH - _COLUMN - 2)
        yield f"{line:<{_COLUMN - 1}} # {notes[0]}"
        yield from (f"{'':<{_COLUMN}}# {note}" for note in notes[1:])


def _names_all(sentence: str, choices: Collection[str]) -> bool:
    """Return True if a description already lists all choices, in quotes or before a colon."""
    return all(f'"{choice}"' in sentence or f"{choice}:" in sentence for choice in choices)


def choices_of(annotation: Any) -> list[str]:
    """Return the values of all `Literal` types in an annotation."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [text for part in get_args(annotation) for text in choices_of(part)]


Pair = tuple[Count, Count]
Size = Annotated[int, BeforeValidator(bytes_of), Field(ge=1)]
