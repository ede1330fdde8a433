"""Representations of one line, whatever a data class or the name of a file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

LONGEST = 200  # characters
_FEW = 6  # numbers of an array or a tuple that are shown


class OneLine:
    """Base of data classes (with ``repr=False``): fields by name, arrays by type and shape.

    Where that passes 200 characters the longest fields become dots.
    """

    def __repr__(self) -> str:
        shown = [f.name for f in fields(self) if f.repr]  # type: ignore[arg-type]
        return one_line(self, {name: getattr(self, name) for name in shown})


def one_line(thing: object, values: dict[str, Any]) -> str:
    """An object's representation by some of its values, at most 200 characters."""
    texts = {name: _text(value) for name, value in values.items()}
    for name in sorted(texts, key=lambda name: -len(texts[name])):
        if len(_line(thing, texts)) <= LONGEST:
            break
        texts[name] = "..."
    line = _line(thing, texts)
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 4]}...)"


def printable(text: str) -> str:
    """Return a text of a file's name or metadata with escapes for what cannot be printed.

    Line breaks, control characters, marks of direction and bytes that are not UTF-8 are replaced.
    """
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)


def columns(rows: Sequence[Sequence[str]], sides: str) -> list[str]:
    """Return lines whose cells stand below each other, each column at its side, "<" or ">"."""
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
    if isinstance(value, np.ndarray) and (value.ndim != 1 or value.size > _FEW):
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, tuple | list) and len(value) > _FEW:
        return f"<{len(value)} of {type(value[0]).__name__}>"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))}{',' * (len(value) == 1)})"
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    return " ".join(repr(value).split())
