"""Volumetric focus: select a depth range of a light field by a filter of its 4-D spectrum."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.compute.device import DeviceLike
from clplen.lightfield.model.alpha_law import require_overlap, row_ratio, unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.refocusing.phase_ramps import (
    channels_of,
    fourier_matrix,
    keep_real,
    shift_spectra,
    take_views,
    transform_views,
)


def hyperfan(
    lf: LightField | ArrayLike,
    low: float,
    high: float,
    *,
    bandwidth: float = 0.05,
    device: DeviceLike | None = None,
) -> LightField:
    """Keep a range of disparities in every view (Dansereau et al. 2013, hyperfan).

    The spectrum of a light field of disparity d lies on (fv, fu) = d (fy, fx). The filter passes
    2^(-(s/bandwidth)^2/2) at the distance s from this set for low <= d <= high (modulo one cycle a
    view). Objects in the range stay sharp in all views; others are blurred, and noise is reduced.
    Detail coarser than bandwidth over the distance in disparity passes at any depth.

    The aperture is mirrored at its edges, after shifting the views so that the middle disparity is
    at rest; a view of weight 0 is first replaced by the nearest weighted view. Edges of the
    pictures are periodic.

    Parameters
    ----------
    lf : LightField or array_like
        Light field with views on the regular grid (no ``positions``); weights count as 0 or 1.
    low, high : float
        Disparities in pixels a view step along x, low <= high, less than 2 apart. Near 2 the finest
        detail passes at any depth, since its spectrum fills a whole cycle a view.
    bandwidth : float
        Frequency in cycles a view at which the amplitude is 1/sqrt(2); above 0, below 1/4. Each
        view becomes a mean over about 0.13/bandwidth views to each side.
    device : Device or str, optional
        Device for an array; default ``Device.open()``. A light field stays on its device.

    Returns
    -------
    LightField
        Light field, float32, of unchanged shape; every view has weight 1.

    Raises
    ------
    ValueError
        If the disparities or the bandwidth are out of range, or the views are off the grid.
    DeviceError
        If the spectrum of a channel, four times its samples, exceeds the device's memory.

    Examples
    --------
    >>> L = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> clplen.lightfield.hyperfan(L, -0.5, 0.5).shape
    (5, 5, 32, 32)
    """
    lf = as_lightfield(lf, device=device)
    _check(lf, low, high, bandwidth)
    require_overlap(lf, lf.weights, [low, high])
    V, U, ny, nx = lf.shape[:4]
    nbytes = 8 * ny * nx * (4 + 2 + 1) * V * U + 4 * lf.data.size + lf.data.nbytes
    lf.device.require_memory(nbytes, "The spectrum of a channel for a hyperfan")
    out = lf.device.empty(lf.shape, np.float32)
    source = _nearest_lit(lf)
    shift = unit_steps(lf).reshape(-1, 2) * ((low + high) / 2)
    for channel in range(channels_of(lf)):
        views = take_views(lf, np.ones(V * U), source, channel)
        lf.device.fft.forward(views, lf.device)
        shift_spectra(lf, views, *shift[source].T)
        views = _filtered(lf, views, (high - low) / 2, bandwidth)
        shift_spectra(lf, views, *-shift.T)
        lf.device.fft.inverse(views, lf.device)
        keep_real(out, views, np.ones(V * U), channel, lf)
    return replace(lf, data=out, weights=np.ones((V, U), np.float32), raw=None)


def _check(lf: LightField, low: float, high: float, bandwidth: float) -> None:
    if not 0 < bandwidth < 0.25:
        raise ValueError(
            f"bandwidth must be above 0 and below 0.25 cycles a view, got {bandwidth!r}."
        )
    if not (np.isfinite([low, high]).all() and 0 <= high - low < 2):
        raise ValueError(
            "low and high must be finite disparities, high >= low and less than 2 apart, got "
            f"{low!r} and {high!r}."
        )
    if lf.positions is not None:
        raise ValueError(
            "A hyperfan needs views on a regular grid, and this light field has positions; "
            "use flatten or refocus."
        )


def _nearest_lit(lf: LightField) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the nearest weighted view for every view, shape (V U,)."""
    lit = np.argwhere(lf.weights != 0)
    views = np.argwhere(np.ones_like(lf.weights))
    nearest = ((views[:, None] - lit[None]) ** 2).sum(axis=-1).argmin(axis=1)
    return np.ravel_multi_index(tuple(lit[nearest].T), lf.weights.shape)


def _filtered(lf: LightField, views: cla.Array, reach: float, bandwidth: float) -> cla.Array:
    """Filter spectra (V U, y, x) over the mirrored aperture."""
    V, U, ny, nx = lf.shape[:4]
    n = ny * nx
    forward, back = zip(*(_mirrored(count) for count in (V, U)), strict=True)
    views = transform_views(views, forward[1], batch=V, n=n, device=lf.device)
    views = transform_views(views, forward[0], batch=1, n=2 * U * n, device=lf.device)
    frequencies = [np.fft.fftfreq(m) for m in (2 * V, 2 * U, ny, nx)]
    frequencies[2] = frequencies[2] * row_ratio(lf.spacing)
    lf.device.launch_rows(
        lf.device.kernel("hyperfan.cl", "hyperfan"),
        (4 * V * U, ny, nx),
        views,
        *(lf.device.upload(f.astype(np.float32)) for f in frequencies),
        *(np.float32(value) for value in (reach, np.log(2) / (2 * bandwidth**2))),
        *(np.int32(m) for m in (2 * U, ny, nx)),
    )
    views = transform_views(views, back[0], batch=1, n=2 * U * n, device=lf.device)
    return transform_views(views, back[1], batch=V, n=n, device=lf.device).reshape(V * U, ny, nx)


def _mirrored(count: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return the DFT (2 n, n) of n views and their mirror image, and the inverse to n views."""
    first, mirror = np.arange(count), np.arange(2 * count - 1, count - 1, -1)
    forward = fourier_matrix(2 * count, first) + fourier_matrix(2 * count, mirror)
    return forward, fourier_matrix(2 * count, first, inverse=True)
