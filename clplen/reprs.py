"""One-line representations of data classes and safe printing of file names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

MAX_LENGTH = 200  # characters of a representation
_MAX_ITEMS = 6  # items of an array or a tuple


class OneLine:
    """Base class of data classes (with ``repr=False``): fields by name, arrays by type and shape.

    The longest fields become dots in a representation of more than 200 characters.
    """

    def __repr__(self) -> str:
        names = [f.name for f in fields(self) if f.repr]  # type: ignore[arg-type]
        return one_line(self, {name: getattr(self, name) for name in names})


def one_line(thing: object, values: dict[str, Any]) -> str:
    """Return the representation of an object by some of its values, at most 200 characters."""
    texts = {name: _text(value) for name, value in values.items()}
    for name in sorted(texts, key=lambda name: -len(texts[name])):
        if len(_line(thing, texts)) <= MAX_LENGTH:
            break
        texts[name] = "..."
    line = _line(thing, texts)
    return line if len(line) <= MAX_LENGTH else f"{line[: MAX_LENGTH - 4]}...)"


def printable(text: str) -> str:
    """Escape unprintable characters of a file name or of metadata.

    Line breaks, control characters, direction marks and bytes outside UTF-8 are replaced.
    """
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in text
    )


def columns(rows: Sequence[Sequence[str]], sides: str) -> list[str]:
    """Align cells in columns, each at its side, "<" or ">", and return the lines."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    forms = list(zip(sides, widths, strict=True))
    return [
        "  ".join(f"{cell:{side}{w}}" for cell, (side, w) in zip(row, forms, strict=True)).rstrip()
        for row in rows
    ]


def _line(thing: object, texts: dict[str, str]) -> str:
    inside = ", ".join(f"{name}={text}" for name, text in texts.items())
    return f"{type(thing).__name__}({inside})"


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and (value.ndim != 1 or value.size > _MAX_ITEMS):
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, tuple | list) and len(value) > _MAX_ITEMS:
        return f"<{len(value)} of {type(value[0]).__name__}>"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))}{',' * (len(value) == 1)})"
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    return " ".join(repr(value).split())
