"""The words of layout: how what lies in files becomes L[v, u, y, x(, c)], and who takes which."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clplen.errors import FormatError, argument
from clplen.io.formats.untrusted import ZIP
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.settings.reading import ReadingSettings

View = tuple[int, int]
Array = np.ndarray[Any, Any]

VIEW_WORDS = ("flip_v", "flip_u", "swap_uv", "positions", "max_bytes")
NAME_WORDS = (*VIEW_WORDS, "pattern", "views", "order", "allow_missing", "srgb")
ARRAY_WORDS = (*VIEW_WORDS, "order", "dataset")
RAW_WORDS = (
    *("white", "dark", "grid", "views", "step", "lattice", "trust_lattice"),
    *("bayer", "demosaic", "devignette"),
)


@dataclass(frozen=True)
class Layout(ReadingSettings):
    """Settings of `clplen.read_lightfield`, of which each kind of file takes some."""

    def given(self) -> dict[str, Any]:
        """The words that were given."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in found.items() if value not in (None, False)} | (
            {"devignette": False} if self.devignette is False else {}
        )

    def require(self, words: Iterable[str], kind: str) -> None:
        """Refuse words that do not apply to a kind of file; ``force`` applies to all."""
        taken = set(words)
        extra = [argument(name) for name in self.given() if name not in taken | {"force"}]
        if extra:
            raise ValueError(
                f"{', '.join(extra)} does not apply to {kind}, which takes "
                f"{', '.join(argument(word) for word in sorted(taken)) or 'no words of layout'}."
            )

    def oriented(self, array: Array) -> Array:
        """A view of an array (v, u, ...) with its view axes swapped first, then reversed."""
        if self.swap_uv:
            array = array.swapaxes(0, 1)
        return array[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1]

    def stored(self, array: Array) -> Array:
        """The inverse of `oriented`: a view of the final array in which the file's (v, u) hold."""
        array = array[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1]
        return array.swapaxes(0, 1) if self.swap_uv else array

    def selected(self, wanted: tuple[slice, slice], views: View) -> tuple[slice, slice]:
        """Where views (v, u) of the final light field lie in the file, whose (V, U) is `views`."""
        flips = (self.flip_v, self.flip_u)
        v, u = (
            slice(n - part.stop, n - part.start) if flip else part
            for part, n, flip in zip(wanted, self.shape(views), flips, strict=True)
        )
        return (u, v) if self.swap_uv else (v, u)

    def oriented_spacing(
        self, spacing: tuple[float, float, float, float]
    ) -> tuple[float, float, float, float]:
        """Signed (dv, du, dy, dx): a view axis that is swapped or reversed takes its own along."""
        dv, du, dy, dx = spacing
        if self.swap_uv:
            dv, du = du, dv
        return (-dv if self.flip_v else dv, -du if self.flip_u else du, dy, dx)

    def shape(self, views: View) -> View:
        """(V, U) of the light field whose file has these."""
        return (views[1], views[0]) if self.swap_uv else views

    def said(self) -> list[str]:
        """What was done to the view axes, for the sentence on what was taken."""
        words = ("swap_uv", "flip_v", "flip_u", "srgb")
        return [word for word in words if getattr(self, word)]


class LightFieldSource(Protocol):
    """A light field in a file that is open; the texts say in one sentence what was taken."""

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read all of it onto the device."""

    def stored(self) -> tuple[StoredLightField, str]:
        """A light field that is read part by part while the file is open."""


@dataclass(frozen=True)
class Whole:
    """A light field that is read as a whole: ``read`` is called with ``progress``."""

    read: Callable[..., tuple[LightField, str]]

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read it."""
        return self.read(progress=progress)

    def stored(self) -> tuple[StoredLightField, str]:
        """Read it, for functions that read part by part."""
        lf, took = self.load()
        return StoredLightField.from_light_field(lf), took


@dataclass(frozen=True)
class Kind:
    """One kind of light-field file."""

    name: str  # as messages call it
    words: tuple[str, ...]  # words of layout that apply
    # (path, *, device, layout) -> the source while a file is open
    open: Callable[..., AbstractContextManager[LightFieldSource]]
    magic: bytes = b""  # with which its files begin
    suffixes: tuple[str, ...] = ()  # of its files, in lower case; any if there are none
    marks: tuple[str, ...] = ()  # files of which its folders and zip archives hold one
    folder: bool = False  # whether any folder is of this kind
    # (path, first bytes) -> bool, where the above does not tell; the bytes are empty for a folder.
    recognises: Callable[[Path, bytes], bool] | None = None

    def fits(self, path: Path, head: bytes) -> bool:
        """Whether a file or folder is of this kind; ``head`` is empty for a folder."""
        if self.recognises is not None:
            return self.recognises(path, head)
        if self.marks:
            return _holds(path, head, self.marks)
        if self.folder or not head:
            return self.folder and not head
        named = not self.suffixes or path.suffix.lower() in self.suffixes
        return named and head.startswith(self.magic)


def _holds(path: Path, head: bytes, names: tuple[str, ...]) -> bool:
    """Whether a folder or a zip archive has a file of one of these names."""
    if not head:
        return any((path / name).is_file() for name in names)
    if not head.startswith(ZIP):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name in archive.NameToInfo for name in names)
    except (OSError, ValueError, RuntimeError, zipfile.BadZipFile):
        return False  # an archive of views says what is wrong with it


def axes_of(order: str, ndim: int, *, letters: str = "vuyxc") -> str:
    """An order of axes such as "vuyxc" or "v:u:y:x", checked."""
    axes = order.replace(":", "").replace(",", "").replace(" ", "").lower()
    needed = letters.replace("c", "")
    if sorted(axes) not in (sorted(needed), sorted(letters)) or len(axes) != ndim:
        raise FormatError(
            f"The order {order!r} does not fit an array of {ndim} dimensions: it names "
            f"{', '.join(needed)} and perhaps c, each once, one letter for each dimension."
        )
    return axes


def in_order(array: Array, axes: str) -> Array:
    """A view of an array as (v, u, y, x[, c]), its axes being ``axes``."""
    return array.transpose([axes.index(letter) for letter in "vuyxc"[: len(axes)]])
