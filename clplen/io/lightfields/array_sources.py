"""Arrays in files as light fields: read whole, block by block onto a device, or in parts."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cla
from tqdm import tqdm

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError, argument
from clplen.io.formats.untrusted import Bound, listed, reading
from clplen.io.lightfields.layout import Array, Layout, View, axes_of, in_order
from clplen.io.lightfields.view_positions import positions_of
from clplen.io.store import attributes
from clplen.lightfield.arrays.stored_samples import C_TYPE, lit_views
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sample_checks import (
    checked_positions,
    checked_spacing,
    checked_weights,
    require_finite,
)
from clplen.lightfield.model.stored_light_field import StoredLightField

Selection = tuple[slice, ...]
_VIEWS_LAST = {4: "yxvu", 5: "yxvuc"}

_BLOCK = 4 << 20  # bytes read at a time: they stay in the cache while axes are exchanged


@dataclass(frozen=True)
class Source:
    """A light field in a file, before it is read."""

    path: Path
    what: str  # as the subject of a sentence: "the dataset 'LF'"
    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # of what read gives
    axes: str  # A letter of "vuyxc" for each dimension
    known: str  # the axes and how they are known, for the sentence on what was taken
    read: Callable[[Selection], Array]  # A slice for each dimension -> the samples there
    bound: Bound  # what the file can hold of it
    chunks: tuple[int, ...] | None = None  # best read as a whole
    weighted: bool = False  # whether the last channel is a weight

    @property
    def views(self) -> View:
        """(V, U) in the file."""
        return self.shape[self.axes.index("v")], self.shape[self.axes.index("u")]

    @property
    def colours(self) -> tuple[int, ...]:
        """(c,), or () for grey; without the weight."""
        if "c" not in self.axes:
            return ()
        count = self.shape[self.axes.index("c")] - self.weighted
        return () if self.weighted and count == 1 else (count,)


def axes_known(
    path: Path, what: str, shape: tuple[int, ...], *, order: str | None, own: str | None = None
) -> tuple[str, str]:
    """The axes of an array, and how they are known."""
    if len(shape) not in (4, 5):
        raise FormatError(
            f"{path}: {what} has shape {shape}; a light field has 4 or 5 dimensions, v, u, y, x "
            "and perhaps c."
        )
    default = "vuyxc"[: len(shape)]
    try:
        axes = axes_of(order or own or default, len(shape))
    except FormatError as error:
        raise FormatError(f"{path}: {what} has shape {shape}. {error}") from error
    size = dict(zip(axes, shape, strict=True))
    if not (order or own) and size["v"] * size["u"] > size["y"] * size["x"]:
        raise FormatError(
            f"{path}: {what} of shape {shape} would be {size['v']} x {size['u']} views of "
            f"{size['y']} x {size['x']} pixels, more views than pixels: say which axis is which by "
            f"{argument('order', default)} (as it would be read), "
            f"{argument('order', _VIEWS_LAST[len(shape)])} (views last), or another one; a series "
            "of pictures is no light field."
        )
    how = "as given" if order else "as the file says" if own else "guessed"
    return axes, f"axes {':'.join(axes)} ({how})"


def chosen(
    path: Path,
    noun: str,
    name: str | None,
    usual: Sequence[str],
    held: dict[str, tuple[tuple[int, ...], Any]],
) -> str:
    """The array of a file that is read: that of a name, a usual one, else the only fitting one.

    ``held`` are shapes and types of the arrays, None for a type that is no real number.
    """
    for one in usual if name is None else [name.strip("/")]:
        if held.get(one, ((), None))[1] is not None:
            return one
    texts = [f"{key} {shape} {kind or 'no real numbers'}" for key, (shape, kind) in held.items()]
    said = listed(texts) or f"no {noun}"
    if name is not None:
        raise FormatError(f"{path} has no {noun} {name!r} of real numbers; it holds {said}.")
    fitting = [key for key, (shape, kind) in held.items() if len(shape) in (4, 5) and kind]
    if len(fitting) == 1:
        return fitting[0]
    raise FormatError(
        f"{path} has {f'several {noun}s' if fitting else f'no {noun}'} of real numbers in 4 or 5 "
        f"dimensions and none named {', '.join(usual)}; it holds {said}; name one by "
        f"{argument('dataset')}."
    )


@contextmanager
def as_format_error(path: Path) -> Iterator[None]:
    """Make a FormatError of values in a file that make no light field."""
    try:
        yield
    except (TypeError, ValueError, ShapeError) as error:
        raise FormatError(f"{path}: {error}") from error


def samples(source: Source, *, device: Device, layout: Layout, progress: bool) -> cla.Array:
    """The samples of a source on a device, without a second copy of all on the host."""
    require_samples(source, layout)
    shape = shape_of(source, layout)
    array = device.empty(shape, device_dtype(source.dtype))
    whole = math.prod(shape) * source.dtype.itemsize
    bar = tqdm(total=whole, desc="reading", unit="B", unit_scale=True, disable=not progress)
    everything = tuple(slice(0, n) for n in shape[:4])
    with device.on_host(array) as host, bar:
        for nbytes in _filled(source, layout, everything, host):
            bar.update(nbytes)
    return array


def shape_of(source: Source, layout: Layout) -> tuple[int, ...]:
    """Of the final light field."""
    inside = tuple(source.shape[source.axes.index(letter)] for letter in "yx")
    return (*layout.shape(source.views), *inside, *source.colours)


def _filled(source: Source, layout: Layout, wanted: Selection, out: Array) -> Iterator[int]:
    """Write a block (v, u, y, x) of the final light field into an array; bytes read, by and by."""
    target = _as_stored(layout.stored(out), source)
    views = layout.selected((wanted[0], wanted[1]), source.views)
    places = dict(zip("vuyx", (*views, *wanted[2:]), strict=True)) | {"c": slice(0, None)}
    first = [places[letter].start for letter in source.axes]
    for block in blocks(target.shape, source.chunks, source.dtype.itemsize, first=first):
        there = tuple(slice(b.start + a, b.stop + a) for a, b in zip(first, block, strict=True))
        with reading(source.path), np.errstate(all="ignore"):
            values = source.read(there)
            target[block] = values
        yield values.nbytes


def fill_checked(source: Source, layout: Layout, wanted: Selection, out: Array) -> None:
    """`_filled`, refusing NaN and infinite samples."""
    for _ in _filled(source, layout, wanted, out):
        pass
    if out.dtype.kind == "f":
        bad = sum(view.size - np.count_nonzero(np.isfinite(view)) for row in out for view in row)
        with as_format_error(source.path):
            require_finite(bad)


def require_samples(source: Source, layout: Layout) -> None:
    """Refuse samples that are no real numbers, none at all, or more than the file can hold."""
    if source.dtype.kind not in "buif":
        raise FormatError(
            f"{source.path}: {source.what} holds {source.dtype}, no real numbers: convert it."
        )
    if 0 in source.shape:
        raise FormatError(f"{source.path}: {source.what} of shape {source.shape} is empty.")
    wider = max(device_dtype(source.dtype).itemsize / source.dtype.itemsize, 1)
    replace(source.bound, max_bytes=layout.max_bytes).wider(wider).require(
        int(math.prod(source.shape) * source.dtype.itemsize * wider), source.what
    )


def device_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type on the device."""
    native = dtype.newbyteorder("=")
    return native if native in C_TYPE else np.dtype(np.float32)


def _as_stored(views: Array, source: Source) -> Array:
    """The final array, its (v, u) being the file's, with the axes of the file."""
    if "c" in source.axes and not source.colours:
        views = views[..., None]
    return views.transpose(["vuyxc".index(letter) for letter in source.axes])


def blocks(
    shape: tuple[int, ...],
    chunks: tuple[int, ...] | None,
    itemsize: int,
    *,
    first: Sequence[int] | None = None,
) -> Iterator[Selection]:
    """Cut an array into blocks of whole chunks, as near to `_BLOCK` bytes as they get."""
    whole = chunks or (1,) * len(shape)
    over = [a % c for a, c in zip(first or (0,) * len(shape), whole, strict=True)]
    sizes = [n + o for n, o in zip(shape, over, strict=True)]
    step = [min(c, n) for c, n in zip(whole, sizes, strict=True)]
    for axis in reversed(range(len(shape))):
        more = max(_BLOCK // (math.prod(step) * itemsize), 1)
        step[axis] = min(step[axis] * more, sizes[axis])
    starts = (range(-o, n, s) for o, n, s in zip(over, shape, step, strict=True))
    for start in itertools.product(*starts):
        ends = (min(a + s, n) for a, s, n in zip(start, step, shape, strict=True))
        yield tuple(slice(max(a, 0), b) for a, b in zip(start, ends, strict=True))


@dataclass(frozen=True)
class OpenSource:
    """A light field in a file that is open."""

    source: Source
    device: Device
    layout: Layout
    # What `LightField.from_array` takes beside the samples; weights and positions for the views of
    # the file.
    known: dict[str, Any] = field(default_factory=dict)
    # decode and parametrisation, where the file says them.
    words: dict[str, Any] = field(default_factory=dict)
    whole: bool = False  # whether it is read as a whole in any case

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read the samples and make them a light field."""
        source, layout, device = self.source, self.layout, self.device
        known = _known(self)
        data = samples(source, device=device, layout=layout, progress=progress)
        if source.weighted:
            lit = lit_views(data, device)
            known["weights"] = layout.oriented(_mean_weights(source)) * (lit if lit.any() else 1)
        with as_format_error(source.path):
            lf = LightField.from_array(data, device=device, **known)
        return replace(lf, **self.words), _sentence(source, lf, layout)

    def stored(self) -> tuple[StoredLightField, str]:
        """A light field that is read part by part."""
        if self.whole:
            lf, took = self.load()
            return StoredLightField.from_light_field(lf), took
        source, layout = self.source, self.layout
        known = _known(self)
        # it is not read as a whole
        require_samples(source, replace(layout, max_bytes=sys.maxsize))
        at_once = dict(zip(source.axes, source.chunks or (1,) * len(source.shape), strict=True))
        whole = math.prod(source.shape) * source.dtype.itemsize
        copies = (
            1 if source.bound.ratio == 1 else 4
        )  # packed, unpacked and turned, with what is left
        stored = StoredLightField(
            shape_of(source, layout),
            device_dtype(source.dtype),
            lambda block, out: fill_checked(source, layout, block, out),
            np.ones(layout.shape(source.views), np.float32),
            (at_once["y"], at_once["x"] if source.chunks else source.shape[source.axes.index("x")]),
            layout.shape((at_once["v"], at_once["u"])),
            copies * max(min(_BLOCK, whole), math.prod(at_once.values()) * source.dtype.itemsize),
        )
        with as_format_error(source.path):
            places = checked_positions(known.get("positions"), stored)
            spacing = checked_spacing(known.get("spacing"))
            stored = replace(stored, spacing=spacing, positions=places, camera=known.get("camera"))
            weights = _stored_weights(source, layout, stored, known.get("weights"))
            stored = replace(stored, weights=checked_weights(weights, stored), **self.words)
        return stored, _sentence(source, stored, layout)


def own_source(
    source: Source,
    device: Device,
    layout: Layout,
    found: dict[str, Any],
    beside: dict[str, Array],
    camera: Any,
) -> OpenSource:
    """A source with the attributes, arrays and camera of a file of `write_lightfield`."""
    known: dict[str, Any] = {**beside, "camera": camera}
    placed = "positions" in known or layout.positions is not None
    spacing = attributes.spacing_in(found, source.path)
    if spacing is not None:  # positions stay where they are, and so does their unit
        known["spacing"] = spacing if placed else layout.oriented_spacing(spacing)
    return OpenSource(source, device, layout, known, attributes.choices_in(found, source.path))


def _stored_weights(source: Source, layout: Layout, stored: StoredLightField, known: Any) -> Array:
    if not source.weighted:
        return stored.lit_weights() if known is None else np.asarray(known)
    return layout.oriented(_mean_weights(source)) * stored.lit_weights()


def _known(found: OpenSource) -> dict[str, Any]:
    """What is known beside the samples, for the final order of views."""
    known, layout = dict(found.known), found.layout
    for name in ("weights", "positions"):
        if known.get(name) is not None:
            known[name] = _fitting(np.asarray(known[name]), name, found.source, layout)
    places = positions_of(layout, found.source.views)
    if places is not None:
        known["positions"] = places
    return known


def _fitting(values: Array, name: str, source: Source, layout: Layout) -> Array:
    if values.shape[:2] != source.views:
        raise FormatError(
            f"{source.path}: the {name} have shape {values.shape}, the views {source.views}."
        )
    return layout.oriented(values)


def _mean_weights(source: Source) -> Array:
    """Mean of the last channel over each view of the file, of its type's range if integer."""
    axis = source.axes.index("c")
    last = source.shape[axis] - 1
    shape = (*source.shape[:axis], 1, *source.shape[axis + 1 :])
    total = np.zeros(source.views, np.float64)
    for block in blocks(shape, source.chunks, source.dtype.itemsize):
        chosen = (*block[:axis], slice(last, last + 1), *block[axis + 1 :])
        with reading(source.path), np.errstate(all="ignore"):
            values = in_order(source.read(chosen), source.axes)
            v, u = (block[source.axes.index(letter)] for letter in "vu")
            total[v, u] += values.sum(axis=(2, 3, 4), dtype=np.float64)
    full = np.iinfo(source.dtype).max if source.dtype.kind in "ui" else 1
    return np.asarray(total * total.size / math.prod(shape) / full)


def _sentence(source: Source, lf: LightField | StoredLightField, layout: Layout) -> str:
    size = " x ".join(str(n) for n in lf.shape[2:])
    stored = "" if lf.dtype == source.dtype.newbyteorder("=") else f" (stored as {source.dtype})"
    parts = [
        f"{lf.shape[0]} x {lf.shape[1]} views (V x U) of {size} {lf.dtype}{stored} "
        f"from {source.path}",
        f"{source.what} with {source.known}",
        *layout.said(),
    ]
    if source.weighted:
        parts.append("its last channel taken for weights, their mean for each view")
    return ", ".join(parts)
