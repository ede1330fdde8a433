"""Views that are pictures with names, of a folder or an archive, put together on the device."""

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
_CAUSES = 10  # how many a message tells
_KEPT = (np.dtype(np.uint8), np.dtype(np.uint16))


@dataclass(frozen=True)
class ViewSet:
    """Which picture is which view, and how it is read."""

    where: Path  # the folder, or the folder in an archive, for messages
    pattern: Pattern
    shape: View  # (V, U) as the names count them
    files: dict[View, str]  # the name of each (v, u) that is there
    # where / name -> picture (y, x) or (y, x, 3); called by several threads.
    picture: Callable[[Path], Array]
    device: Device
    layout: Layout

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read all views straight into the memory of the device."""
        missing = _missing(self)
        places = positions_of(self.layout, self.shape, names=self.files)
        data = _decode(self, missing, progress)
        took = _sentence(data, self, len(missing))
        with naming(self.where):
            return LightField.from_array(data, device=self.device, positions=places), took

    def stored(self) -> tuple[StoredLightField, str]:
        """The same views read when they are asked for, each unpacked as a whole."""
        missing, layout = _missing(self), self.layout
        places = positions_of(layout, self.shape, names=self.files)
        first = _first_readable(self)[1]
        form, dtype = (first.shape, first.dtype), _kept(first.dtype, layout)
        V, U = layout.shape(self.shape)
        stored = StoredLightField(
            (V, U, *first.shape),
            dtype,
            lambda block, out: _fill_part(self, form, block, out),
            np.ones((V, U), np.float32),
            (first.shape[0], first.shape[1]),
            overhead=2 * _threads() * first.size * max(dtype.itemsize, first.itemsize),
        )
        took = _sentence(stored, self, len(missing))
        with naming(self.where):
            places = checked_positions(places, stored)
            return replace(stored, positions=places, weights=stored.lit_weights()), took


def _threads() -> int:
    return min(_THREADS, os.cpu_count() or 1)


def _fill_part(views: ViewSet, form: tuple[Any, ...], block: Selection, out: Array) -> None:
    """Some rows and columns of some views, unpacked by several threads."""
    layout = views.layout
    v, u = layout.selected((block[0], block[1]), views.shape)
    target = layout.stored(out)
    places = {(v.start + i, u.start + k): (i, k) for i, k in np.ndindex(*target.shape[:2])}
    wrong: dict[str, str] = {}

    def take(view: View, picture: Array) -> None:
        if (picture.shape, picture.dtype) != form:
            found = form_of(picture.shape, picture.dtype)
            wrong[views.files[view]] = f"is {found}, most are {form_of(*form)}."
            return
        part = picture[block[2], block[3]]
        with np.errstate(all="ignore"):
            target[places[view]] = linear(part) if layout.srgb else part

    for view, place in places.items():
        if view not in views.files:
            target[place] = 0
    problems = _read_each(views, [view for view in places if view in views.files], take) | wrong
    if problems:
        raise _unusable(views, problems, len(views.files))
    if out.dtype.kind == "f":
        with naming(views.where):
            require_finite(out.size - int(np.count_nonzero(np.isfinite(out))))


def _missing(views: ViewSet) -> list[View]:
    """The views without a file."""
    missing = [view for view in np.ndindex(*views.shape) if view not in views.files]
    if missing and not views.layout.allow_missing:
        names = listed([f"(v={v}, u={u})" for v, u in missing])
        raise FormatError(
            f"{len(missing)} of {views.shape[0]} x {views.shape[1]} views are missing in "
            f"{views.where} (pattern {views.pattern.text!r}, counted from 0): {names}; "
            f"{argument('allow_missing', True)} gives them weight 0."
        )
    return missing


def _decode(views: ViewSet, missing: list[View], progress: bool) -> cla.Array:
    """All pictures in one array on the device; views that are missing are black."""
    known, first = _first_readable(views)

    def fill(stored: Array) -> None:
        for view in missing:
            stored[view] = 0
        _fill(stored, views, known, first, progress)

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
    """A new light field on a device whose samples a function writes, on a CPU without a copy."""
    kept = _kept(dtype, layout)
    nbytes = math.prod(shape) * kept.itemsize
    device.require_memory(nbytes, "This light field")
    require_room(nbytes, path=where, what="the light field", max_bytes=layout.max_bytes)
    final = layout.shape((shape[0], shape[1])) + shape[2:]
    if not device.is_cpu:
        host = np.empty(final, kept)
        fill(layout.stored(host))
        return device.upload(host)
    data = device.empty(final, kept)
    with device.on_host(data) as mapped:
        fill(layout.stored(mapped))
    return data


def _kept(dtype: Any, layout: Layout) -> np.dtype[Any]:
    """The type on the device."""
    return np.dtype(dtype) if dtype in _KEPT and not layout.srgb else np.dtype(np.float32)


def _fill(stored: Array, views: ViewSet, known: View, first: Array, progress: bool) -> None:
    """Decode all pictures by several threads; ``first`` is that of ``known``."""
    forms: dict[View, tuple[Any, ...]] = {}

    def take(view: View, picture: Array) -> None:
        forms[view] = (picture.shape, picture.dtype)
        if forms[view] == (first.shape, first.dtype):
            stored[view] = linear(picture) if views.layout.srgb else picture

    take(known, first)
    others = [view for view in views.files if view != known]
    problems = _read_each(views, others, take, progress=progress)
    problems |= _differing(forms, views.files)
    if problems:
        raise _unusable(views, problems, len(views.files))


def _read_each(
    views: ViewSet,
    wanted: list[View],
    take: Callable[[View, Array], None],
    *,
    progress: bool = False,
) -> dict[str, str]:
    """Read pictures by several threads and hand each over; return what is wrong with others."""
    problems: dict[str, str] = {}

    def read(view: View) -> None:
        name = views.files[view]
        try:
            picture = views.picture(views.where / name)
        except FormatError as error:
            problems[name] = _cause(error, views.where / name)
        else:
            take(view, picture)

    bar = progress_bar(total=len(wanted), desc="reading", unit="view", disable=not progress)
    with ThreadPoolExecutor(_threads()) as pool, bar:
        for _ in pool.map(read, wanted):
            bar.update()
    return problems


def _first_readable(views: ViewSet) -> tuple[View, Array]:
    """The first picture that can be read: it sets the size until the others are known."""
    problems = {}
    for view, name in views.files.items():
        try:
            return view, views.picture(views.where / name)
        except FormatError as error:
            problems[name] = _cause(error, views.where / name)
    raise _unusable(views, problems, len(problems))


def _cause(error: FormatError, file: Path) -> str:
    """What is wrong with a picture, without its name."""
    said = str(error).removeprefix(f"The picture {file} ")
    return said.removeprefix(f"{file}: the picture ")


def _unusable(views: ViewSet, problems: dict[str, str], count: int) -> FormatError:
    """Which pictures cannot be used, together where they have one cause."""
    together: dict[str, list[str]] = {}
    for name, cause in sorted(problems.items()):
        together.setdefault(cause, []).append(name)
    said = []
    plural = {"is": "are", "has": "have", "declares": "declare", "needs": "need"}
    for cause, names in together.items():
        verb, rest = cause.split(" ", 1)
        said.append(f"{listed(names)} {plural.get(verb, verb) if len(names) > 1 else verb} {rest}")
    more = len(said) - _CAUSES
    text = " ".join(said[:_CAUSES]) + (f" And {more} other causes." if more > 0 else "")
    return FormatError(f"{len(problems)} of {count} views in {views.where} cannot be used: {text}")


def _differing(forms: dict[View, tuple[Any, ...]], files: dict[View, str]) -> dict[str, str]:
    """The pictures of another size or type than most."""
    if not forms:
        return {}
    (shape, dtype), _ = Counter(forms.values()).most_common(1)[0]
    return {
        files[view]: f"is {form_of(*form)}, most are {form_of(shape, dtype)}."
        for view, form in forms.items()
        if form != (shape, dtype)
    }


def form_of(shape: tuple[int, ...], dtype: Any) -> str:
    """Size and type in words."""
    return f"{' x '.join(str(n) for n in shape)} {dtype}"


def _sentence(data: Any, views: ViewSet, missing: int) -> str:
    layout = views.layout
    parts = [
        f"{data.shape[0]} x {data.shape[1]} views (V x U) of {form_of(data.shape[2:], data.dtype)} "
        f"from {views.where}",
        f"pattern {views.pattern.text!r}" + ("" if layout.pattern else " (guessed from the names)"),
        *([layout.order] if layout.order else []),
        *layout.said(),
    ]
    if missing:
        parts.append(f"{missing} missing views with weight 0")
    return ", ".join(parts)
