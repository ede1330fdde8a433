"""Light fields from arrays in files: read at once, block by block onto a device, or in parts."""

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
from clplen.progress import progress_bar

Selection = tuple[slice, ...]
_VIEWS_LAST = {4: "yxvu", 5: "yxvuc"}

_BLOCK_BYTES = 4 << 20  # read at a time; fits the cache during transposition


@dataclass(frozen=True)
class Source:
    """Light field in a file, before it is read."""

    path: Path
    what: str  # subject of messages, such as "the dataset 'LF'"
    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # of the samples that read returns
    axes: str  # letter of "vuyxc" for each dimension
    axes_text: str  # axes and their origin, for the log
    read: Callable[[Selection], Array]  # from slices to samples
    bound: Bound  # largest size of the decoded samples
    chunks: tuple[int, ...] | None = None  # best read as a unit
    weighted: bool = False  # True if the last channel is a weight

    @property
    def views(self) -> View:
        """Number of views (V, U) in the file."""
        return self.shape[self.axes.index("v")], self.shape[self.axes.index("u")]

    @property
    def colours(self) -> tuple[int, ...]:
        """Colour channels (c,), without the weight; () for grey."""
        if "c" not in self.axes:
            return ()
        count = self.shape[self.axes.index("c")] - self.weighted
        return () if self.weighted and count == 1 else (count,)


def resolve_axes(
    path: Path, what: str, shape: tuple[int, ...], *, order: str | None, stored: str | None = None
) -> tuple[str, str]:
    """Return the axes of an array and a text with their origin."""
    if len(shape) not in (4, 5):
        raise FormatError(
            f"{path}: {what} must have 4 or 5 dimensions (v, u, y, x[, c]) for a light field, got "
            f"shape {shape}."
        )
    default = "vuyxc"[: len(shape)]
    try:
        axes = axes_of(order or stored or default, len(shape))
    except FormatError as error:
        raise FormatError(f"{path}: {what} has shape {shape}. {error}") from error
    size = dict(zip(axes, shape, strict=True))
    if not (order or stored) and size["v"] * size["u"] > size["y"] * size["x"]:
        raise FormatError(
            f"{path}: {what} of shape {shape} would be {size['v']} x {size['u']} views of "
            f"{size['y']} x {size['x']} pixels, more views than pixels: name the axes by "
            f"{argument('order', default)} (the default), "
            f"{argument('order', _VIEWS_LAST[len(shape)])} (views last), or another order; a "
            "series of pictures is not a light field."
        )
    origin = "as given" if order else "as stored" if stored else "guessed"
    return axes, f"axes {':'.join(axes)} ({origin})"


def select_array(
    path: Path,
    noun: str,
    name: str | None,
    default_names: Sequence[str],
    arrays: dict[str, tuple[tuple[int, ...], Any]],
) -> str:
    """Return the name of the array to read: by name, a usual name, or the only fitting array.

    ``arrays`` has shapes and dtypes; the dtype is None unless samples are real numbers.
    """
    for candidate in default_names if name is None else [name.strip("/")]:
        if arrays.get(candidate, ((), None))[1] is not None:
            return candidate
    texts = [f"{key} {shape} {kind or 'no real numbers'}" for key, (shape, kind) in arrays.items()]
    contents = listed(texts) or f"no {noun}"
    if name is not None:
        raise FormatError(f"{path} has no {noun} {name!r} of real numbers; it has {contents}.")
    fitting = [key for key, (shape, kind) in arrays.items() if len(shape) in (4, 5) and kind]
    if len(fitting) == 1:
        return fitting[0]
    raise FormatError(
        f"{path} has {f'several {noun}s' if fitting else f'no {noun}'} of real numbers in 4 or 5 "
        f"dimensions and none named {', '.join(default_names)}; it has {contents}: choose a {noun} "
        f"by {argument('dataset')}."
    )


@contextmanager
def as_format_error(path: Path) -> Iterator[None]:
    """Turn errors on invalid values of a light field into a FormatError of the file."""
    try:
        yield
    except (TypeError, ValueError, ShapeError) as error:
        raise FormatError(f"{path}: {error}") from error


def samples(source: Source, *, device: Device, layout: Layout, progress: bool) -> cla.Array:
    """Read the samples of a source onto a device without a second host copy."""
    require_samples(source, layout)
    shape = shape_of(source, layout)
    array = device.empty(shape, device_dtype(source.dtype))
    nbytes_total = math.prod(shape) * source.dtype.itemsize
    bar = progress_bar(
        total=nbytes_total, desc="reading", unit="B", unit_scale=True, disable=not progress
    )
    everything = tuple(slice(0, n) for n in shape[:4])
    with device.on_host(array) as host, bar:
        for nbytes in _fill_blocks(source, layout, everything, host):
            bar.update(nbytes)
    return array


def shape_of(source: Source, layout: Layout) -> tuple[int, ...]:
    """Return the shape of the final light field."""
    inside = tuple(source.shape[source.axes.index(letter)] for letter in "yx")
    return (*layout.shape(source.views), *inside, *source.colours)


def _fill_blocks(source: Source, layout: Layout, selection: Selection, out: Array) -> Iterator[int]:
    """Write a block (v, u, y, x) of the final light field into an array; yield the bytes read."""
    target = _as_stored(layout.stored(out), source)
    views = layout.selected((selection[0], selection[1]), source.views)
    slices = dict(zip("vuyx", (*views, *selection[2:]), strict=True)) | {"c": slice(0, None)}
    first = [slices[letter].start for letter in source.axes]
    for block in blocks(target.shape, source.chunks, source.dtype.itemsize, first=first):
        region = tuple(slice(b.start + a, b.stop + a) for a, b in zip(first, block, strict=True))
        with reading(source.path), np.errstate(all="ignore"):
            values = source.read(region)
            target[block] = values
        yield values.nbytes


def fill_checked(source: Source, layout: Layout, selection: Selection, out: Array) -> None:
    """Fill an array as `_fill_blocks` does, and reject NaN and infinite samples."""
    for _ in _fill_blocks(source, layout, selection, out):
        pass
    if out.dtype.kind == "f":
        invalid = sum(
            view.size - np.count_nonzero(np.isfinite(view)) for row in out for view in row
        )
        with as_format_error(source.path):
            require_finite(invalid)


def require_samples(source: Source, layout: Layout) -> None:
    """Raise FormatError for samples that are not real, empty, or larger than the file."""
    if source.dtype.kind not in "buif":
        raise FormatError(
            f"{source.path}: {source.what} must hold real numbers, got {source.dtype}: convert it."
        )
    if 0 in source.shape:
        raise FormatError(f"{source.path}: {source.what} of shape {source.shape} is empty.")
    wider = max(device_dtype(source.dtype).itemsize / source.dtype.itemsize, 1)
    replace(source.bound, max_bytes=layout.max_bytes).wider(wider).require(
        int(math.prod(source.shape) * source.dtype.itemsize * wider), source.what
    )


def device_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the dtype of the samples on the device."""
    native = dtype.newbyteorder("=")
    return native if native in C_TYPE else np.dtype(np.float32)


def _as_stored(views: Array, source: Source) -> Array:
    """Return the final array, with views in file order, with the axes of the file."""
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
    """Yield blocks of whole chunks that cover an array, of about `_BLOCK_BYTES`."""
    chunk = chunks or (1,) * len(shape)
    offsets = [a % c for a, c in zip(first or (0,) * len(shape), chunk, strict=True)]
    sizes = [n + o for n, o in zip(shape, offsets, strict=True)]
    step = [min(c, n) for c, n in zip(chunk, sizes, strict=True)]
    for axis in reversed(range(len(shape))):
        factor = max(_BLOCK_BYTES // (math.prod(step) * itemsize), 1)
        step[axis] = min(step[axis] * factor, sizes[axis])
    starts = (range(-o, n, s) for o, n, s in zip(offsets, shape, step, strict=True))
    for start in itertools.product(*starts):
        ends = (min(a + s, n) for a, s, n in zip(start, step, shape, strict=True))
        yield tuple(slice(max(a, 0), b) for a, b in zip(start, ends, strict=True))


@dataclass(frozen=True)
class OpenSource:
    """Light field in an open file."""

    source: Source
    device: Device
    layout: Layout
    # Arguments of `LightField.from_array` besides the samples; weights and positions have the view
    # order of the file.
    properties: dict[str, Any] = field(default_factory=dict)
    # Stored decode method and parametrisation.
    choices: dict[str, Any] = field(default_factory=dict)
    read_at_once: bool = False  # True if it cannot be read in parts

    def load(self, *, progress: bool = False) -> tuple[LightField, str]:
        """Read the samples and build a light field."""
        source, layout, device = self.source, self.layout, self.device
        properties = _final_properties(self)
        data = samples(source, device=device, layout=layout, progress=progress)
        if source.weighted:
            lit_mask = lit_views(data, device)
            properties["weights"] = layout.oriented(_mean_weights(source)) * (
                lit_mask if lit_mask.any() else 1
            )
        with as_format_error(source.path):
            lf = LightField.from_array(data, device=device, **properties)
        return replace(lf, **self.choices), _summary(source, lf, layout)

    def stored(self) -> tuple[StoredLightField, str]:
        """Return a light field that is read part by part."""
        if self.read_at_once:
            lf, summary = self.load()
            return StoredLightField.from_light_field(lf), summary
        source, layout = self.source, self.layout
        properties = _final_properties(self)
        # no limit on the total size, because it is read in parts
        require_samples(source, replace(layout, max_bytes=sys.maxsize))
        chunk_sizes = dict(zip(source.axes, source.chunks or (1,) * len(source.shape), strict=True))
        nbytes_total = math.prod(source.shape) * source.dtype.itemsize
        copies = (
            1 if source.bound.ratio == 1 else 4
        )  # packed, unpacked and transposed copies, with a remainder
        stored = StoredLightField(
            shape_of(source, layout),
            device_dtype(source.dtype),
            lambda block, out: fill_checked(source, layout, block, out),
            np.ones(layout.shape(source.views), np.float32),
            (
                chunk_sizes["y"],
                chunk_sizes["x"] if source.chunks else source.shape[source.axes.index("x")],
            ),
            layout.shape((chunk_sizes["v"], chunk_sizes["u"])),
            copies
            * max(
                min(_BLOCK_BYTES, nbytes_total),
                math.prod(chunk_sizes.values()) * source.dtype.itemsize,
            ),
        )
        with as_format_error(source.path):
            positions = checked_positions(properties.get("positions"), stored)
            spacing = checked_spacing(properties.get("spacing"))
            stored = replace(
                stored, spacing=spacing, positions=positions, camera=properties.get("camera")
            )
            weights = _stored_weights(source, layout, stored, properties.get("weights"))
            stored = replace(stored, weights=checked_weights(weights, stored), **self.choices)
        return stored, _summary(source, stored, layout)


def container_source(
    source: Source,
    device: Device,
    layout: Layout,
    stored_attributes: dict[str, Any],
    companions: dict[str, Array],
    camera: Any,
) -> OpenSource:
    """Return a source with the attributes, arrays and camera of `write_lightfield`."""
    properties: dict[str, Any] = {**companions, "camera": camera}
    has_positions = "positions" in properties or layout.positions is not None
    spacing = attributes.spacing_in(stored_attributes, source.path)
    if spacing is not None:  # positions and their unit are independent of the view order
        properties["spacing"] = spacing if has_positions else layout.oriented_spacing(spacing)
    choices = attributes.choices_in(stored_attributes, source.path)
    return OpenSource(source, device, layout, properties, choices)


def _stored_weights(
    source: Source, layout: Layout, stored: StoredLightField, weights: Any
) -> Array:
    if not source.weighted:
        return stored.lit_weights() if weights is None else np.asarray(weights)
    return layout.oriented(_mean_weights(source)) * stored.lit_weights()


def _final_properties(opened: OpenSource) -> dict[str, Any]:
    """Return the properties of a source for the final view order."""
    properties, layout = dict(opened.properties), opened.layout
    for name in ("weights", "positions"):
        if properties.get(name) is not None:
            values = np.asarray(properties[name])
            properties[name] = _oriented_views(values, name, opened.source, layout)
    positions = positions_of(layout, opened.source.views)
    if positions is not None:
        properties["positions"] = positions
    return properties


def _oriented_views(values: Array, name: str, source: Source, layout: Layout) -> Array:
    if values.shape[:2] != source.views:
        raise FormatError(
            f"{source.path}: the {name} must have the shape {source.views} of the views, got "
            f"{values.shape}."
        )
    return layout.oriented(values)


def _mean_weights(source: Source) -> Array:
    """Return the mean of the last channel over each view, relative to an integer's range."""
    axis = source.axes.index("c")
    last = source.shape[axis] - 1
    shape = (*source.shape[:axis], 1, *source.shape[axis + 1 :])
    total = np.zeros(source.views, np.float64)
    for block in blocks(shape, source.chunks, source.dtype.itemsize):
        selection = (*block[:axis], slice(last, last + 1), *block[axis + 1 :])
        with reading(source.path), np.errstate(all="ignore"):
            values = in_order(source.read(selection), source.axes)
            v, u = (block[source.axes.index(letter)] for letter in "vu")
            total[v, u] += values.sum(axis=(2, 3, 4), dtype=np.float64)
    full = np.iinfo(source.dtype).max if source.dtype.kind in "ui" else 1
    return np.asarray(total * total.size / math.prod(shape) / full)


def _summary(source: Source, lf: LightField | StoredLightField, layout: Layout) -> str:
    size = " x ".join(str(n) for n in lf.shape[2:])
    stored = "" if lf.dtype == source.dtype.newbyteorder("=") else f" (stored as {source.dtype})"
    parts = [
        f"{lf.shape[0]} x {lf.shape[1]} views (V x U) of {size} {lf.dtype}{stored} "
        f"from {source.path}",
        f"{source.what} with {source.axes_text}",
        *layout.view_changes(),
    ]
    if source.weighted:
        parts.append("last channel used as weights, averaged over each view")
    return ", ".join(parts)
