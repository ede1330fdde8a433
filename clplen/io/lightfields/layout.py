"""Layout options, which map the contents of files to L[v, u, y, x(, c)], and kinds of files."""

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

VIEW_OPTIONS = ("flip_v", "flip_u", "swap_uv", "positions", "max_bytes")
NAME_OPTIONS = (*VIEW_OPTIONS, "pattern", "views", "order", "allow_missing", "srgb")
ARRAY_OPTIONS = (*VIEW_OPTIONS, "order", "dataset")
RAW_OPTIONS = (
    *("white", "dark", "grid", "views", "step", "lattice", "trust_lattice"),
    *("bayer", "demosaic", "devignette"),
)


@dataclass(frozen=True)
class Layout(ReadingSettings):
    """Layout options of `clplen.read_lightfield`; each kind of file supports some of them."""

    def user_options(self) -> dict[str, Any]:
        """Return the options that differ from their defaults."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value not in (None, False)} | (
            {"devignette": False} if self.devignette is False else {}
        )

    def require(self, options: Iterable[str], kind: str) -> None:
        """Raise ValueError for options that do not apply to a kind of file, except ``force``."""
        supported = set(options)
        extra = [
            argument(name) for name in self.user_options() if name not in supported | {"force"}
        ]
        if extra:
            raise ValueError(
                f"{', '.join(extra)} does not apply to {kind}; supported options are "
                f"{', '.join(argument(name) for name in sorted(supported)) or 'none'}."
            )

    def oriented(self, array: Array) -> Array:
        """Return a view of an array (v, u, ...) with view axes swapped first, then reversed."""
        if self.swap_uv:
            array = array.swapaxes(0, 1)
        return array[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1]

    def stored(self, array: Array) -> Array:
        """Return a view of the final array in file order; the inverse of `oriented`."""
        array = array[:: -1 if self.flip_v else 1, :: -1 if self.flip_u else 1]
        return array.swapaxes(0, 1) if self.swap_uv else array

    def selected(self, selection: tuple[slice, slice], views: View) -> tuple[slice, slice]:
        """Return the slices in the file, of (V, U) ``views``, of final views (v, u)."""
        flips = (self.flip_v, self.flip_u)
        v, u = (
            slice(n - part.stop, n - part.start) if flip else part
            for part, n, flip in zip(selection, self.shape(views), flips, strict=True)
        )
        return (u, v) if self.swap_uv else (v, u)

    def oriented_spacing(
        self, spacing: tuple[float, float, float, float]
    ) -> tuple[float, float, float, float]:
        """Return the spacing after view axes are swapped and reversed."""
        dv, du, dy, dx = spacing
        if self.swap_uv:
            dv, du = du, dv
        return (-dv if self.flip_v else dv, -du if self.flip_u else du, dy, dx)

    def shape(self, views: View) -> View:
        """Return (V, U) of the light field for (V, U) of the file."""
        return (views[1], views[0]) if self.swap_uv else views

    def view_changes(self) -> list[str]:
        """Return the names of the applied view changes, for the log."""
        names = ("swap_uv", "flip_v", "flip_u", "srgb")
        return [name for name in names if getattr(self, name)]


class LightFieldSource(Protocol):
    """Light field in an open file; its methods also return a summary for the log."""

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read the whole light field onto the device."""

    def stored(self) -> tuple[StoredLightField, str]:
        """Return a light field that is read in parts while the file is open."""


@dataclass(frozen=True)
class UndividedSource:
    """Light field that cannot be read in parts; ``read`` is called with ``progress``."""

    read: Callable[..., tuple[LightField, str]]

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read the light field."""
        return self.read(progress=progress)

    def stored(self) -> tuple[StoredLightField, str]:
        """Read the light field, for functions that read in parts."""
        lf, summary = self.load()
        return StoredLightField.from_light_field(lf), summary


@dataclass(frozen=True)
class Kind:
    """Kind of light-field files."""

    name: str  # name in messages
    options: tuple[str, ...]  # supported layout options
    # Open (path, *, device, layout) and yield the source.
    open: Callable[..., AbstractContextManager[LightFieldSource]]
    magic: bytes = b""  # first bytes of its files
    suffixes: tuple[str, ...] = ()  # lower-case suffixes of its files; empty for any
    marks: tuple[str, ...] = ()  # names of files that identify its folders and zip archives
    folder: bool = False  # True if any folder is of this kind
    # Custom test of (path, first bytes); the bytes are empty for a folder.
    recognises: Callable[[Path, bytes], bool] | None = None

    def fits(self, path: Path, head: bytes) -> bool:
        """Return True if a file or folder is of this kind; ``head`` is empty for a folder."""
        if self.recognises is not None:
            return self.recognises(path, head)
        if self.marks:
            return _holds(path, head, self.marks)
        if self.folder or not head:
            return self.folder and not head
        named = not self.suffixes or path.suffix.lower() in self.suffixes
        return named and head.startswith(self.magic)


def _holds(path: Path, head: bytes, names: tuple[str, ...]) -> bool:
    """Return True if a folder or zip archive has a file of one of these names."""
    if not head:
        return any((path / name).is_file() for name in names)
    if not head.startswith(ZIP):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name in archive.NameToInfo for name in names)
    except (OSError, ValueError, RuntimeError, zipfile.BadZipFile):
        return False  # the reader of view archives reports the error


def axes_of(order: str, ndim: int, *, letters: str = "vuyxc") -> str:
    """Parse and check an order of axes such as "vuyxc" or "v:u:y:x"."""
    axes = order.replace(":", "").replace(",", "").replace(" ", "").lower()
    needed = letters.replace("c", "")
    if sorted(axes) not in (sorted(needed), sorted(letters)) or len(axes) != ndim:
        raise FormatError(
            f"order must have one letter for each of {ndim} dimensions, {', '.join(needed)} and "
            f"optionally c, got {order!r}."
        )
    return axes


def in_order(array: Array, axes: str) -> Array:
    """Return a view of an array with axes ``axes`` as (v, u, y, x[, c])."""
    return array.transpose([axes.index(letter) for letter in "vuyxc"[: len(axes)]])
