"""Folders of views: one picture a view."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, filling, naming
from clplen.io.layout import Layout, View
from clplen.io.names import DEFAULT_PATTERN, Pattern, arrange, guess, listed
from clplen.io.picture import SUFFIXES, read_picture, write_picture
from clplen.lightfield.lightfield import LightField

_THREADS = 16
_CAUSES = 10  # how many a message tells


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a folder of views.

    Parameters
    ----------
    path : path-like
        The folder.
    device : Device
    layout : Layout
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        Listing the views that are missing, and the pictures that cannot be read or have another
        size than most.
    ValueError
        If a sample is NaN or infinite.
    """
    folder = Path(path)
    pattern, shape, found = find_views(folder, layout)
    missing = _missing(shape, found, pattern, folder, layout.allow_missing)
    data = _decode(folder, shape, found, device, progress)
    weights = np.ones(shape, np.float32)
    for view in missing:
        weights[view] = 0
    data, weights = (layout.oriented(array) for array in (data, weights))
    took = _sentence(data, folder, pattern, layout, len(missing))
    with naming(folder):
        return LightField.from_array(data, device=device, weights=weights), took


def find_views(folder: Path, layout: Layout) -> tuple[Pattern, View, dict[View, str]]:
    """Which file of a folder is which view, from the names alone.

    Parameters
    ----------
    folder : pathlib.Path
    layout : Layout

    Returns
    -------
    Pattern, (V, U), files
        As `arrange`, with the pattern that was given or guessed.

    Raises
    ------
    FormatError
        If the names do not show what is what.
    """
    deep = layout.pattern is not None and "/" in layout.pattern
    files = [file for file in (folder.rglob("*") if deep else folder.iterdir()) if file.is_file()]
    names = sorted(f.relative_to(folder).as_posix() for f in files if f.name[0] != ".")
    if layout.pattern is None:
        pictures = [name for name in names if name.lower().endswith(SUFFIXES)]
        pattern = guess(pictures, where=str(folder))
    else:
        pattern = Pattern(layout.pattern)
    return pattern, *arrange(pattern, names, views=layout.views, where=str(folder))


def _missing(
    shape: View, found: dict[View, str], pattern: Pattern, folder: Path, allowed: bool
) -> list[View]:
    """The views without a file."""
    missing = [view for view in np.ndindex(*shape) if view not in found]
    if missing and not allowed:
        names = listed([f"(v={v}, u={u})" for v, u in missing])
        raise FormatError(
            f"{len(missing)} of {shape[0]} x {shape[1]} views are missing in {folder} (pattern "
            f"{pattern.text!r}, counted from 0): {names}; allow_missing=True gives them weight 0."
        )
    return missing


def _decode(
    folder: Path, shape: View, found: dict[View, str], device: Device, progress: bool
) -> np.ndarray[Any, Any]:
    """All pictures in one array (v, u, y, x[, c]), decoded by several threads."""
    forms: dict[View, tuple[Any, ...]] = {}
    problems: dict[str, str] = {}
    first = _first_readable(folder, found.values())
    like = np.empty(shape + first.shape, first.dtype)
    device.require_memory(like.nbytes, "This light field")
    like[...] = 0

    def read(view: View) -> None:
        try:
            picture = read_picture(folder / found[view])
        except FormatError as error:
            problems[found[view]] = _cause(error, folder / found[view])
            return
        forms[view] = (picture.shape, picture.dtype)
        if forms[view] == (first.shape, first.dtype):
            like[view] = picture

    with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
        bar = tqdm(total=len(found), desc="reading", unit="view", disable=not progress)
        for _ in pool.map(read, found):
            bar.update()
        bar.close()
    problems |= _differing(forms, found)
    if problems:
        raise _unusable(folder, problems, len(found))
    return like


def _first_readable(folder: Path, names: Iterable[str]) -> np.ndarray[Any, Any]:
    """The first picture that can be read: it sets the size until the others are known."""
    problems = {}
    for name in names:
        try:
            return read_picture(folder / name)
        except FormatError as error:
            problems[name] = _cause(error, folder / name)
    raise _unusable(folder, problems, len(problems))


def _cause(error: FormatError, file: Path) -> str:
    """What is wrong with a picture, without its name."""
    return str(error).removeprefix(f"The picture {file} ")


def _unusable(folder: Path, problems: dict[str, str], count: int) -> FormatError:
    """Which pictures cannot be used, together where they have one cause."""
    together: dict[str, list[str]] = {}
    for name, cause in sorted(problems.items()):
        together.setdefault(cause, []).append(name)
    said = []
    for cause, names in together.items():
        verb, rest = cause.split(" ", 1)
        if len(names) > 1:
            verb = {"is": "are", "has": "have"}.get(verb, verb)
        said.append(f"{listed(names)} {verb} {rest}")
    more = len(said) - _CAUSES
    text = " ".join(said[:_CAUSES]) + (f" And {more} other causes." if more > 0 else "")
    return FormatError(f"{len(problems)} of {count} views in {folder} cannot be used: {text}")


def _differing(forms: dict[View, tuple[Any, ...]], found: dict[View, str]) -> dict[str, str]:
    """The pictures of another size or type than most."""
    if not forms:
        return {}
    (shape, dtype), _ = Counter(forms.values()).most_common(1)[0]
    return {
        found[view]: f"is {_form(*form)}, most are {_form(shape, dtype)}."
        for view, form in forms.items()
        if form != (shape, dtype)
    }


def _form(shape: tuple[int, ...], dtype: Any) -> str:
    return f"{' x '.join(str(n) for n in shape)} {dtype}"


def _sentence(
    data: np.ndarray[Any, Any], folder: Path, pattern: Pattern, layout: Layout, missing: int
) -> str:
    parts = [
        f"{data.shape[0]} x {data.shape[1]} views (V x U) of {_form(data.shape[2:], data.dtype)} "
        f"from {folder}",
        f"pattern {pattern.text!r}" + ("" if layout.pattern else " (guessed from the names)"),
        *layout.said(),
    ]
    if missing:
        parts.append(f"{missing} missing views with weight 0")
    return ", ".join(parts)


def write_views(path: PathLike, lf: LightField) -> None:
    """Write a light field as a new folder of pictures ``view_{v:02d}_{u:02d}``.

    uint8 becomes PNG; uint16 and float32 become TIFF, which keeps them. Spacing, weights and
    camera have no place in pictures: HDF5 keeps them.

    Parameters
    ----------
    path : path-like
        A folder that does not exist yet, or is empty.
    lf : LightField

    Raises
    ------
    FileExistsError
        If the folder holds something.
    ShapeError
        If the views have other than 1 or 3 channels.
    """
    values = lf.to_numpy()
    if values.ndim == 5 and values.shape[4] == 1:
        values = values[..., 0]
    if values.ndim == 5 and values.shape[4] != 3:
        raise ShapeError(
            f"Pictures have 1 or 3 channels, this light field {values.shape[4]}: write .h5 instead."
        )
    suffix = ".png" if lf.dtype == np.uint8 else ".tif"
    with filling(path) as folder:
        for v, u in np.ndindex(*values.shape[:2]):
            write_picture(folder / (DEFAULT_PATTERN.format(v=v, u=u) + suffix), values[v, u])
