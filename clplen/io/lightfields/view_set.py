"""Light fields assembled on the device from named pictures of a folder or archive."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.files import naming
from clplen.io.formats.picture import linear
from clplen.io.formats.untrusted import listed, require_room
from clplen.io.lightfields.layout import Layout, View
from clplen.io.lightfields.view_names import Pattern
from clplen.io.lightfields.view_positions import positions_of
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sample_checks import checked_positions, require_finite
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.progress import progress_bar

Array = np.ndarray[Any, Any]
Selection = tuple[slice, ...]

_THREADS = 16
_MAX_CAUSES = 10  # listed in a message
_NATIVE_DTYPES = (np.dtype(np.uint8), np.dtype(np.uint16))


@dataclass(frozen=True)
class ViewSet:
    """Named pictures of the views and their reader."""

    where: Path  # folder, or folder in an archive, for messages
    pattern: Pattern
    shape: View  # (V, U) of the names
    files: dict[View, str]  # name of each existing view (v, u)
    # Function from where / name to a picture (y, x) or (y, x, 3); called by several threads.
    picture: Callable[[Path], Array]
    device: Device
    layout: Layout

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read all views directly into the memory of the device."""
        missing = _missing(self)
        positions = positions_of(self.layout, self.shape, names=self.files)
        data = _decode(self, missing, progress)
        summary = _summary(data, self, len(missing))
        with naming(self.where):
            return LightField.from_array(data, device=self.device, positions=positions), summary

    def stored(self) -> tuple[StoredLightField, str]:
        """Return the views for reading on demand; each picture is decoded completely."""
        missing, layout = _missing(self), self.layout
        positions = positions_of(layout, self.shape, names=self.files)
        first = _first_readable(self)[1]
        form, dtype = (first.shape, first.dtype), _device_dtype(first.dtype, layout)
        V, U = layout.shape(self.shape)
        stored = StoredLightField(
            (V, U, *first.shape),
            dtype,
            lambda block, out: _fill_part(self, form, block, out),
            np.ones((V, U), np.float32),
            (first.shape[0], first.shape[1]),
            overhead=2 * _threads() * first.size * max(dtype.itemsize, first.itemsize),
        )
        summary = _summary(stored, self, len(missing))
        with naming(self.where):
            positions = checked_positions(positions, stored)
            return replace(stored, positions=positions, weights=stored.lit_weights()), summary


def _threads() -> int:
    return min(_THREADS, os.cpu_count() or 1)


def _fill_part(views: ViewSet, form: tuple[Any, ...], block: Selection, out: Array) -> None:
    """Read some rows and columns of some views with several threads."""
    layout = views.layout
    v, u = layout.selected((block[0], block[1]), views.shape)
    target = layout.stored(out)
    indices = {(v.start + i, u.start + k): (i, k) for i, k in np.ndindex(*target.shape[:2])}
    mismatches: dict[str, str] = {}

    def store(view: View, picture: Array) -> None:
        if (picture.shape, picture.dtype) != form:
            actual = form_of(picture.shape, picture.dtype)
            mismatches[views.files[view]] = f"is {actual}, most are {form_of(*form)}."
            return
        part = picture[block[2], block[3]]
        with np.errstate(all="ignore"):
            target[indices[view]] = linear(part) if layout.srgb else part

    for view, index in indices.items():
        if view not in views.files:
            target[index] = 0
    problems = (
        _read_each(views, [view for view in indices if view in views.files], store) | mismatches
    )
    if problems:
        raise _unusable(views, problems, len(views.files))
    if out.dtype.kind == "f":
        with naming(views.where):
            require_finite(out.size - int(np.count_nonzero(np.isfinite(out))))


def _missing(views: ViewSet) -> list[View]:
    """Return the views without a file; raise FormatError unless they are allowed."""
    missing = [view for view in np.ndindex(*views.shape) if view not in views.files]
    if missing and not views.layout.allow_missing:
        names = listed([f"(v={v}, u={u})" for v, u in missing])
        raise FormatError(
            f"{len(missing)} of {views.shape[0]} x {views.shape[1]} views are missing in "
            f"{views.where} (pattern {views.pattern.text!r}, counted from 0): {names}. Give them "
            f"weight 0 by {argument('allow_missing', True)}."
        )
    return missing


def _decode(views: ViewSet, missing: list[View], progress: bool) -> cla.Array:
    """Decode all pictures into an array on the device; missing views are black."""
    first_view, first = _first_readable(views)

    def fill(stored: Array) -> None:
        for view in missing:
            stored[view] = 0
        _fill(stored, views, first_view, first, progress)

    shape = (*views.shape, *first.shape)
    return new_samples(
        shape, first.dtype, views.where, device=views.device, layout=views.layout, fill=fill
    )


def new_samples(
    shape: tuple[int, ...],
    dtype: Any,
    where: Path,
    *,
    device: Device,
    layout: Layout,
    fill: Callable[[Array], None],
) -> cla.Array:
    """Return a new light field on a device, filled by a function, on a CPU without a copy."""
    device_type = _device_dtype(dtype, layout)
    nbytes = math.prod(shape) * device_type.itemsize
    device.require_memory(nbytes, "This light field")
    require_room(nbytes, path=where, what="the light field", max_bytes=layout.max_bytes)
    final = layout.shape((shape[0], shape[1])) + shape[2:]
    if not device.is_cpu:
        host = np.empty(final, device_type)
        fill(layout.stored(host))
        return device.upload(host)
    data = device.empty(final, device_type)
    with device.on_host(data) as mapped:
        fill(layout.stored(mapped))
    return data


def _device_dtype(dtype: Any, layout: Layout) -> np.dtype[Any]:
    """Return the dtype of the samples on the device."""
    return np.dtype(dtype) if dtype in _NATIVE_DTYPES and not layout.srgb else np.dtype(np.float32)


def _fill(stored: Array, views: ViewSet, first_view: View, first: Array, progress: bool) -> None:
    """Decode all pictures with several threads; ``first`` is that of ``first_view``."""
    forms: dict[View, tuple[Any, ...]] = {}

    def store(view: View, picture: Array) -> None:
        forms[view] = (picture.shape, picture.dtype)
        if forms[view] == (first.shape, first.dtype):
            stored[view] = linear(picture) if views.layout.srgb else picture

    store(first_view, first)
    others = [view for view in views.files if view != first_view]
    problems = _read_each(views, others, store, progress=progress)
    problems |= _differing(forms, views.files)
    if problems:
        raise _unusable(views, problems, len(views.files))


def _read_each(
    views: ViewSet,
    selection: list[View],
    store: Callable[[View, Array], None],
    *,
    progress: bool = False,
) -> dict[str, str]:
    """Read pictures with several threads and pass each on; return the errors of others."""
    problems: dict[str, str] = {}

    def read(view: View) -> None:
        name = views.files[view]
        try:
            picture = views.picture(views.where / name)
        except FormatError as error:
            problems[name] = _cause(error, views.where / name)
        else:
            store(view, picture)

    bar = progress_bar(total=len(selection), desc="reading", unit="view", disable=not progress)
    with ThreadPoolExecutor(_threads()) as pool, bar:
        for _ in pool.map(read, selection):
            bar.update()
    return problems


def _first_readable(views: ViewSet) -> tuple[View, Array]:
    """Return the first readable view and picture, whose size applies to all."""
    problems = {}
    for view, name in views.files.items():
        try:
            return view, views.picture(views.where / name)
        except FormatError as error:
            problems[name] = _cause(error, views.where / name)
    raise _unusable(views, problems, len(problems))


def _cause(error: FormatError, file: Path) -> str:
    """Return the reason in an error message, without the name of the picture."""
    reason = str(error).removeprefix(f"The picture {file} ")
    return reason.removeprefix(f"{file}: the picture ")


def _unusable(views: ViewSet, problems: dict[str, str], count: int) -> FormatError:
    """Return the error for unusable pictures, grouped by cause."""
    by_cause: dict[str, list[str]] = {}
    for name, cause in sorted(problems.items()):
        by_cause.setdefault(cause, []).append(name)
    reasons = []
    plural = {"is": "are", "has": "have", "declares": "declare", "needs": "need"}
    for cause, names in by_cause.items():
        verb, rest = cause.split(" ", 1)
        reasons.append(
            f"{listed(names)} {plural.get(verb, verb) if len(names) > 1 else verb} {rest}"
        )
    more = len(reasons) - _MAX_CAUSES
    text = " ".join(reasons[:_MAX_CAUSES]) + (f" And {more} other causes." if more > 0 else "")
    return FormatError(f"{len(problems)} of {count} views in {views.where} cannot be used: {text}")


def _differing(forms: dict[View, tuple[Any, ...]], files: dict[View, str]) -> dict[str, str]:
    """Return the pictures whose size or dtype differs from the majority."""
    if not forms:
        return {}
    (shape, dtype), _ = Counter(forms.values()).most_common(1)[0]
    return {
        files[view]: f"is {form_of(*form)}, most are {form_of(shape, dtype)}."
        for view, form in forms.items()
        if form != (shape, dtype)
    }


def form_of(shape: tuple[int, ...], dtype: Any) -> str:
    """Return size and dtype as text."""
    return f"{' x '.join(str(n) for n in shape)} {dtype}"


def _summary(data: Any, views: ViewSet, missing: int) -> str:
    layout = views.layout
    parts = [
        f"{data.shape[0]} x {data.shape[1]} views (V x U) of {form_of(data.shape[2:], data.dtype)} "
        f"from {views.where}",
        f"pattern {views.pattern.text!r}" + ("" if layout.pattern else " (guessed from the names)"),
        *([layout.order] if layout.order else []),
        *layout.view_changes(),
    ]
    if missing:
        parts.append(f"{missing} missing views with weight 0")
    return ", ".join(parts)
