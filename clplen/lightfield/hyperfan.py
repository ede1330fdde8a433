"""Volumetric focus: keep a range of depths of a light field by a filter of its 4-D spectrum."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.shifts import row_ratio
from clplen.lightfield.spectra import (
    channels_of,
    fourier_matrix,
    keep_real,
    mix,
    take_views,
)

if TYPE_CHECKING:
    from clplen.lightfield.lightfield import LightField

_PADDING = 2.0  # standard deviations of the filter's extent over the views


def hyperfan(lf: LightField, low: float, high: float, *, bandwidth: float = 0.05) -> LightField:
    """Keep what lies between two disparities, in every view (Dansereau et al. 2013, hyperfan).

    The spectrum of a light field of disparity d lies on (fv, fu) = d (fy, fx). The filter passes
    2^(-(s/bandwidth)^2/2) at distance s from these places for low <= d <= high (taken modulo one
    cycle a view): what lies there stays sharp in all views, the rest is blurred and noise is
    lowered. Refocused or rendered, the result has an extended depth of field.

    Views are padded with nothing, and the result is divided by what the filter makes of the
    weights, so that edges of the aperture and missing views are filled from their neighbours; the
    edges of pictures are periodic.

    Parameters
    ----------
    lf : LightField
        Its views on the regular grid (no ``positions``).
    low, high : float
        Disparities, pixels a view step along x, low <= high, less than 2 apart. Near 2 the finest
        detail passes whatever its depth: its spectrum then fills a whole cycle a view.
    bandwidth : float
        In cycles a view, where the amplitude has fallen to 1/sqrt(2); above 0, below 1/4. The
        filter averages about 0.13/bandwidth views to each side.

    Returns
    -------
    LightField
        float32, the same shape; every view has weight 1.

    Raises
    ------
    ValueError
        If the disparities or the bandwidth are out of range, or the views lie on no grid.
    DeviceError
        If a padded channel is larger than the device's memory.
    """
    _check(lf, low, high, bandwidth)
    V, U, ny, nx = lf.shape[:4]
    sigma = bandwidth / np.sqrt(np.log(2))
    extra = int(np.ceil(_PADDING / (2 * np.pi * sigma)))
    padded = tuple(n + (extra if n > 1 else 0) for n in (V, U))
    channel_bytes = 8 * ny * nx * padded[1] * (2 * padded[0] + V)
    lf.device.require_memory(
        channel_bytes + 4 * lf.data.size + lf.data.nbytes, "This hyperfan of a light field"
    )
    out = lf.device.empty(lf.shape, np.float32)
    scale = 1 / _response(lf.weights, padded, sigma).ravel()
    forward = [fourier_matrix(K, np.arange(n)) for n, K in zip((V, U), padded, strict=True)]
    back = [
        fourier_matrix(K, np.arange(n), inverse=True) for n, K in zip((V, U), padded, strict=True)
    ]
    n = ny * nx
    for channel in range(channels_of(lf)):
        views = take_views(lf, lf.weights.ravel(), np.arange(V * U), channel)
        lf.device.fft.forward(views, lf.device)
        views = mix(views, forward[1], batch=V, n=n, device=lf.device)
        views = mix(views, forward[0], batch=1, n=padded[1] * n, device=lf.device)
        _apply(lf, views, padded, (low, high), sigma)
        views = mix(views, back[0], batch=1, n=padded[1] * n, device=lf.device)
        views = mix(views, back[1], batch=V, n=n, device=lf.device).reshape(V * U, ny, nx)
        lf.device.fft.inverse(views, lf.device)
        keep_real(out, views, scale, channel, lf)
    return replace(lf, data=out, weights=np.ones((V, U), np.float32), raw=None)


def _check(lf: LightField, low: float, high: float, bandwidth: float) -> None:
    if not 0 < bandwidth < 0.25:
        raise ValueError(f"bandwidth is above 0 and below 0.25 cycles a view, not {bandwidth!r}.")
    if not (np.isfinite([low, high]).all() and 0 <= high - low < 2):
        raise ValueError(
            "A hyperfan keeps disparities from low to high >= low, less than 2 apart, not "
            f"{low!r} to {high!r}."
        )
    if lf.positions is not None:
        raise ValueError(
            "A hyperfan needs views on a regular grid, and this light field has positions: "
            "use flatten or refocus."
        )


def _response(weights: Any, padded: tuple[int, ...], sigma: float) -> Any:
    """What the filter makes of the weights of views without any detail, shape (V, U)."""
    whole = np.zeros(padded)
    whole[: weights.shape[0], : weights.shape[1]] = weights
    fv, fu = (np.fft.fftfreq(n) for n in padded)
    gain = np.exp(-(fv[:, None] ** 2 + fu[None, :] ** 2) / (2 * sigma**2))
    found = np.fft.ifft2(np.fft.fft2(whole) * gain).real[: weights.shape[0], : weights.shape[1]]
    return np.maximum(found, 1e-3 * found.max())


def _apply(
    lf: LightField, spectrum: Any, padded: tuple[int, ...], ends: tuple[float, float], sigma: float
) -> None:
    ny, nx = lf.shape[2:4]
    frequencies = [np.fft.fftfreq(m) for m in (*padded, ny, nx)]
    frequencies[2] = frequencies[2] * row_ratio(lf.spacing)
    lf.device.launch_rows(
        lf.device.kernel("hyperfan.cl", "hyperfan"),
        (padded[0] * padded[1], ny, nx),
        spectrum,
        *(lf.device.upload(f.astype(np.float32)) for f in frequencies),
        *(np.float32(value) for value in (*ends, 1 / (2 * sigma**2))),
        *(np.int32(m) for m in (padded[1], ny, nx)),
    )
