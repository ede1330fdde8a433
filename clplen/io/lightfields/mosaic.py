"""Mosaics: pictures with all views, lenslet by lenslet or side by side.

    lenslet images   I[y V + v, x U + u]   order "yvxu"; ESLF has V = U = 14
    views            I[v H + y, u W + x]   order "vyux"

A picture with one channel and unknown views is a raw lenslet image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.files import PathLike, naming
from clplen.io.formats.picture import (
    NOTES,
    linear,
    pixels_of,
    read_channels,
    with_channel_axis,
    without_alpha,
    write_picture,
)
from clplen.io.lightfields.layout import RAW_OPTIONS, Layout, View
from clplen.io.lightfields.lenslet_frames import decode_frame
from clplen.io.lightfields.view_folders import as_pictures
from clplen.io.lightfields.view_positions import positions_of
from clplen.io.lightfields.view_set import form_of, new_samples
from clplen.io.raw.raw_files import require_decoding
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

Array = np.ndarray[Any, Any]

_ESLF = (14, 14)
_ORDERS = ("yvxu", "vyux")  # lenslet images, views side by side
_MIN_COST_RATIO = 1.1  # of the two orders for an unambiguous guess
_MAX_COMPARED = 1 << 22  # samples compared along each axis for a guess


def read_mosaic(
    path: Path, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a picture with all views."""
    if _is_raw((), path, layout):  # checked before decoding
        require_decoding(pixels_of(path), path, layout.max_bytes)
    picture = read_channels(path, max_bytes=layout.max_bytes)
    if _is_raw(picture.shape[2:], path, layout):
        frame = without_alpha(picture, path)
        if frame.ndim == 3:
            raise FormatError(
                f"A raw lenslet image must have one channel, got {frame.shape[2]} from {path}: "
                "give the unprocessed frame of the sensor."
            )
        return decode_frame(frame, path, device=device, layout=layout, progress=progress)
    return _read_mosaic(picture, path, device, layout)


def _is_raw(channels: tuple[int, ...], path: Path, layout: Layout) -> bool:
    if any(name in layout.user_options() for name in RAW_OPTIONS if name != "views"):
        return True
    has_views = layout.views is not None or layout.order is not None or _named_eslf(path)
    return not has_views and channels in ((), (2,))


def _named_eslf(path: Path) -> bool:
    return "eslf" in path.name.lower()


def _read_mosaic(
    picture: Array, path: Path, device: Device, layout: Layout
) -> tuple[LightField, str]:
    order, views = _order(layout.order), _views(path, layout)
    alpha = picture[..., -1] if picture.shape[2:] in ((2,), (4,)) else None
    colours = picture if alpha is None else picture[..., :-1]
    if colours.shape[2:] == (1,):
        colours = colours[..., 0]
    with path.open("rb") as file:
        colours = with_channel_axis(colours, file.read(NOTES))
    if tuple(views) == _ESLF and order != "vyux":
        colours, alpha = _padded(colours, views), None if alpha is None else _padded(alpha, views)
    _require_multiple(colours.shape[:2], views, path)
    origin = "as given" if order else "guessed from the content"
    if order is None and _named_eslf(path):
        order, origin = "yvxu", "by its name"
    order = order or _guess(colours, views, path)
    all_views = as_views(colours, views, order)

    def fill(stored: Array) -> None:
        for view in np.ndindex(*views):
            stored[view] = linear(all_views[view]) if layout.srgb else all_views[view]

    data = new_samples(
        all_views.shape, all_views.dtype, path, device=device, layout=layout, fill=fill
    )
    weights = None
    if alpha is not None:
        weights = layout.oriented(_weights(as_views(alpha, views, order), all_views, path))
    with naming(path):
        lf = LightField.from_array(
            data,
            device=device,
            weights=weights,
            positions=positions_of(layout, views),
        )
    return lf, _summary(lf, path, f"order {order!r} ({origin})", alpha is not None, layout)


def _summary(lf: LightField, path: Path, order: str, weighted: bool, layout: Layout) -> str:
    parts = [
        f"{lf.shape[0]} x {lf.shape[1]} views (V x U) of {form_of(lf.shape[2:], lf.dtype)} from "
        f"{path}",
        f"a mosaic in {order}",
        *(["alpha channel used as weights of the views"] if weighted else []),
        *layout.view_changes(),
    ]
    return ", ".join(parts)


def _order(order: str | None) -> str | None:
    """Return the normalised order of a mosaic, or None."""
    plain = None if order is None else order.replace(":", "").lower().removesuffix("c")
    if plain not in (None, *_ORDERS):
        raise ValueError(
            f"order must be {' or '.join(map(repr, _ORDERS))} for a mosaic, got {order!r}."
        )
    return plain


def _views(path: Path, layout: Layout) -> View:
    if layout.views is None:
        if _named_eslf(path):
            return _ESLF
        raise FormatError(
            f"The number of views in the mosaic {path} is unknown: give "
            f"{argument('views', ('V', 'U'))}, rows and columns; or {argument('white')} or "
            f"{argument('grid')} for a raw lenslet image."
        )
    return layout.views


def _padded(values: Array, views: View) -> Array:
    """Pad with zeros below and to the right to whole lenslets, like LFToolbox's LFReadESLF."""
    padding = [(0, -size % count) for size, count in zip(values.shape, views, strict=False)]
    if padding == [(0, 0), (0, 0)]:
        return values
    return np.pad(values, padding + [(0, 0)] * (values.ndim - 2))


def _require_multiple(size: tuple[int, ...], views: View, path: Path) -> None:
    if all(n % count == 0 for n, count in zip(size, views, strict=True)):
        return
    rows, columns = (_nearest(n, count) for n, count in zip(size, views, strict=True))
    raise FormatError(
        f"The size of {path} must be a multiple of {argument('views', tuple(views))}, got "
        f"{size[0]} x {size[1]} pixels: crop it to {rows} rows and {columns} columns, or give "
        "other views."
    )


def _nearest(size: int, count: int) -> str:
    below = size - size % count
    return " or ".join(str(n) for n in sorted({below, -(-size // count) * count}) if n)


def as_views(picture: Array, views: View, order: str) -> Array:
    """Return the views of a picture without a copy."""
    (V, U), (rows, columns) = views, picture.shape[:2]
    rest = tuple(range(4, picture.ndim + 2))
    if order == "yvxu":
        split = picture.reshape(rows // V, V, columns // U, U, *picture.shape[2:])
        return split.transpose(1, 3, 0, 2, *rest)
    split = picture.reshape(V, rows // V, U, columns // U, *picture.shape[2:])
    return split.transpose(0, 2, 1, 3, *rest)


def _guess(picture: Array, views: View, path: Path) -> str:
    """Return the order with smaller differences of neighbouring pixels and views."""
    costs = {order: _roughness(as_views(picture, views, order)) for order in _ORDERS}
    best, other = sorted(costs, key=lambda order: costs[order])
    if costs[other] <= _MIN_COST_RATIO * costs[best]:
        raise FormatError(
            f"{path} fits equally well as a mosaic of lenslet images and of views: give "
            f"{argument('order', 'yvxu')} or {argument('order', 'vyux')}."
        )
    return best


def _roughness(views: Array) -> float:
    """Return the sum of mean square differences along v, u, y and x."""
    values = views if views.ndim == 4 else views[..., views.shape[4] // 2]
    total = 0.0
    for axis in range(4):
        if values.shape[axis] == 1:
            continue
        across = 3 - axis if axis in (1, 2) else (2 if axis == 3 else 3)
        skip = [slice(None)] * 4
        skip[across] = slice(None, None, 1 + values.size // _MAX_COMPARED)
        difference = np.diff(values[tuple(skip)].astype(np.float32), axis=axis)
        total += float(np.mean(difference * difference, dtype=np.float64))
    return total


def _weights(alpha: Array, all_views: Array, path: Path) -> Array:
    """Return the mean alpha of each view, from 0 to 1; 0 for black views."""
    full = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    lit = np.array([[view.any() for view in row] for row in all_views])
    weights = np.asarray(
        alpha.mean(axis=(2, 3), dtype=np.float64) / full * (lit if lit.any() else 1)
    )
    if not weights.any():
        raise FormatError(
            f"{path} is transparent at all nonblack pixels: remove its alpha channel."
        )
    return weights


def write_mosaic(path: PathLike, lf: LightField | ArrayLike, *, order: str = "yvxu") -> None:
    """Write a light field as one picture.

    Parameters
    ----------
    path : path-like
        ``.png`` for uint8 and grey uint16, ``.tif`` for any dtype.
    lf : LightField or array_like
        Views (v, u, y, x), or (v, u, y, x, c) with 1 or 3 channels.
    order : {"yvxu", "vyux"}
        Arrangement of the picture: "yvxu" for lenslet images, "vyux" for views side by side.

    Raises
    ------
    ValueError, ShapeError
        If the order or the suffix is unknown, or a PNG cannot hold the samples; if the views do
        not have 1 or 3 channels.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.zeros((3, 5, 16, 24), np.uint8))
    >>> clplen.io.write_mosaic("views.png", lf, order="vyux")
    >>> clplen.io.read_picture("views.png").shape  # 3 x 16 rows, 5 x 24 columns
    (48, 120)
    """
    plain = _order(order)
    values, description = as_pictures(as_lightfield(lf))
    V, U, ny, nx = values.shape[:4]
    picture = np.empty((V * ny, U * nx, *values.shape[4:]), values.dtype)
    as_views(picture, (V, U), plain or "yvxu")[...] = values
    write_picture(path, picture, description=description)
