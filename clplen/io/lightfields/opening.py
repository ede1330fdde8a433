"""Light fields found in files: read as a whole, or opened to be read part by part."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.lightfields.array_sources import (
    _BLOCK,
    Source,
    blocks,
    fill_checked,
    kept,
    making,
    reading,
    require_samples,
    samples,
    shape_of,
)
from clplen.io.lightfields.layout import Array, Layout, in_order
from clplen.io.lightfields.view_positions import positions_of
from clplen.lightfield.checks import checked_positions, checked_spacing, checked_weights
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.samples import lit_views
from clplen.lightfield.stored import StoredLightField


@dataclass(frozen=True)
class Found:
    """A light field found in a file that is open.

    Attributes
    ----------
    source : Source
    known : dict
        What `LightField.from_array` takes beside the samples; weights and positions for the views
        of the file.
    words : dict
        ``decode`` and ``parametrisation``, where the file says them.
    """

    source: Source
    known: dict[str, Any] = field(default_factory=dict)
    words: dict[str, Any] = field(default_factory=dict)


def light_field(
    found: Found, *, device: Device, layout: Layout, progress: bool
) -> tuple[LightField, str]:
    """Read the samples of a source and make them a light field.

    Parameters
    ----------
    found : Found
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
        If the file cannot hold what it declares, is damaged, or holds values that make no light
        field.
    """
    source = found.source
    known = _known(found, layout)
    data = samples(source, device=device, layout=layout, progress=progress)
    if source.weighted:
        lit = lit_views(data, device)
        known["weights"] = layout.oriented(_mean_weights(source)) * (lit if lit.any() else 1)
    with making(source.path):
        lf = LightField.from_array(data, device=device, **known)
    return replace(lf, **found.words), _sentence(source, lf, layout)


def stored_light_field(found: Found, layout: Layout) -> tuple[StoredLightField, str]:
    """A source as a light field that is read part by part.

    Parameters
    ----------
    found : Found
    layout : Layout

    Returns
    -------
    StoredLightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        As `light_field`; what is damaged or NaN, when it is read.
    """
    source = found.source
    known = _known(found, layout)
    require_samples(source, replace(layout, max_bytes=sys.maxsize))  # it is not read as a whole
    at_once = dict(zip(source.axes, source.chunks or (1,) * len(source.shape), strict=True))
    dtype = kept(source.dtype)
    whole = math.prod(source.shape) * source.dtype.itemsize
    copies = 1 if source.ratio == 1 else 4  # packed, unpacked and turned, with what is left over
    stored = StoredLightField(
        shape_of(source, layout),
        dtype,
        lambda block, out: fill_checked(source, layout, block, out),
        np.ones(layout.shape(source.views), np.float32),
        (at_once["y"], at_once["x"] if source.chunks else source.shape[source.axes.index("x")]),
        layout.shape((at_once["v"], at_once["u"])),
        copies * max(min(_BLOCK, whole), math.prod(at_once.values()) * source.dtype.itemsize),
    )
    with making(source.path):
        places = checked_positions(known.get("positions"), stored)
        spacing = checked_spacing(known.get("spacing"))
        stored = replace(stored, spacing=spacing, positions=places, camera=known.get("camera"))
        weights = _stored_weights(source, layout, stored, known.get("weights"))
        stored = replace(stored, weights=checked_weights(weights, stored), **found.words)
    return stored, _sentence(source, stored, layout)


def _stored_weights(source: Source, layout: Layout, stored: StoredLightField, known: Any) -> Array:
    if not source.weighted:
        return stored.lit_weights() if known is None else np.asarray(known)
    return layout.oriented(_mean_weights(source)) * stored.lit_weights()


def _known(found: Found, layout: Layout) -> dict[str, Any]:
    """What is known beside the samples, for the final order of views."""
    known = dict(found.known)
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
