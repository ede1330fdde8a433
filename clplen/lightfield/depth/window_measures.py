"""Windows of lenslets on the host, and measures of their depth beside the spectral ones.

The slope of a point in phase space (`fit_slope`), and the focus measure as the thesis prints it
(`thesis_curve`), a baseline to compare with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl

from clplen.compute.drivers.failures import device_errors
from clplen.lightfield.arrays.spectral_sharpness import Real
from clplen.lightfield.model.light_field import LightField

if TYPE_CHECKING:
    import scipy.sparse

THESIS_WINDOW = 31
THESIS_ALPHAS = np.round(0.7 + 0.005 * np.arange(121), 3)

_LOWEST = 0.1  # cycles a lenslet, of the thesis' measure
_SPOT = 0.5  # of a sub-image's maximum: what is above is the spot, not a neighbour's tail
_FAINTEST = 0.03  # of the brightest sub-image: fainter ones are diffraction
_POWER = 0.75  # of a sub-image's energy, its weight: between light and energy
_SMOOTHING = 8  # windows are found in a picture smoothed by a Gaussian of window/8


def read_window(
    lf: LightField, at: tuple[int, int], size: int, *, fill: bool = False
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The samples round one lenslet.

    Parameters
    ----------
    lf : LightField
    at : tuple of int
        (y, x) of the central lenslet.
    size : int
        Lenslets across, odd.
    fill : bool
        Zeros for the lenslets beyond the border of the light field; otherwise they are left out.

    Returns
    -------
    numpy.ndarray
        float64, shape (c, v, u, y, x), c = 1 without colour; multiplied by the weights of the
        views.
    """
    colours = lf.shape[4] if len(lf.shape) == 5 else 1
    ranges = [
        (max(centre - size // 2, 0), min(centre + size // 2 + 1, n))
        for centre, n in zip(at, lf.shape[2:4], strict=True)
    ]
    rows, columns = (slice(*ends) for ends in ranges)
    part = _download_window(lf, rows, columns).astype(np.float64)
    part = part.reshape(*part.shape[:4], colours) * lf.weights[:, :, None, None, None]
    window = np.moveaxis(part, -1, 0)
    if not fill:
        return window
    missing = [
        (first - centre + size // 2, centre + size // 2 + 1 - end)
        for centre, (first, end) in zip(at, ranges, strict=True)
    ]
    return np.pad(window, [(0, 0)] * 3 + missing)


def brightest(lf: LightField, size: int) -> tuple[int, int]:
    """(y, x) of the lenslet where a window of ``size`` lenslets holds the brightest region."""
    from scipy.ndimage import gaussian_filter  # here: slow to import, and nothing else needs it

    picture = lf.render().to_numpy().astype(np.float64)
    if picture.ndim == 3:
        picture = picture.sum(axis=-1)
    smooth = gaussian_filter(picture, size / _SMOOTHING, mode="constant")
    y, x = np.unravel_index(np.argmax(smooth), smooth.shape)
    return int(y), int(x)


def thesis_curve(window: Real) -> Real:
    """Focus measure of the thesis at `THESIS_ALPHAS`.

    I(x') = sum_u L(x'/alpha + u (1 - 1/alpha), u), x' in lenslets from the centre of the window,
    u in pixels from the centre of the cell, linear, 0 outside; E = sum of |FFT I|^2 over radii
    above 0.1 cycles a lenslet. It shears the lenslets' own cells by eq. 3.9, with indices of
    lenslets and pixels in the place of lengths, and knows nothing of diffraction: all three pull
    alpha towards 1.

    Parameters
    ----------
    window : numpy.ndarray
        float64, shape (c, v, u, y, x): naive cells in raw pixel order.

    Returns
    -------
    numpy.ndarray
        float64, shape (121,).
    """
    c, V, U, ny, nx = window.shape
    colours = window.transpose(0, 1, 3, 2, 4).reshape(c, V * ny, U * nx)
    radius = np.hypot(np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :])
    energies = np.zeros(THESIS_ALPHAS.size)
    for i, alpha in enumerate(THESIS_ALPHAS):
        down, along = _shear(ny, V, alpha), _shear(nx, U, alpha)
        for rows in colours:
            image = down @ (along @ rows.T).T
            energies[i] += np.sum(np.abs(np.fft.fft2(image)[radius > _LOWEST]) ** 2)
    return energies


def _shear(count: int, views: int, alpha: float) -> scipy.sparse.csr_array:
    """Matrix (count, views count) that samples one axis linearly and sums over its views."""
    import scipy.sparse  # here: slow to import, and only this baseline needs it

    x = np.arange(count) - (count - 1) / 2
    u = np.arange(views) - (views - 1) / 2
    sampled = x[:, None] / alpha + u * (1 - 1 / alpha)
    weights = np.maximum(1 - np.abs(sampled[:, :, None] - x), 0)
    return scipy.sparse.csr_array(weights.reshape(count, views * count))


@dataclass(frozen=True)
class PhaseSlope:
    """A line fitted to the spots of one point. Made by `fit_slope`.

    Attributes
    ----------
    disparity : float
        Pixels a view step along x, nearer positive; 0 where all light lies in one lenslet, or the
        spots show no slope.
    confidence : float
        0 to 1: share of the spots' scatter in u that the line explains (R squared).
    spots : int
        Sub-images that were used.
    """

    disparity: float
    confidence: float
    spots: int


def fit_slope(window: Real, *, aspect: float = 1.0) -> PhaseSlope:
    """Regress the position of the spot in a sub-image on the position of its lenslet.

    A point lies on x = X - d u in pixels and views (thesis, section 3.4: the slope tells depth,
    its sign nearer or farther). Each lenslet sees one spot, whose centroid in (v, u), of what
    exceeds half of the sub-image's maximum, is free of the tails of its neighbours. Diffraction
    scatters u and hardly x, so u is regressed on x, which is unbiased (errors in variables), by
    least squares weighted with E^(3/4), E the sum of I^2 over the sub-image; along x and y
    together.

    Parameters
    ----------
    window : numpy.ndarray
        float64, shape (c, v, u, y, x): about one point that lies alone in it.
    aspect : float
        Disparity along y over that along x.

    Returns
    -------
    PhaseSlope
    """
    light = np.maximum(window.sum(axis=0), 0)
    energy = (light**2).sum(axis=(0, 1))
    weight = np.where(energy >= _FAINTEST * energy.max(), energy**_POWER, 0)
    spot = np.maximum(light - _SPOT * light.max(axis=(0, 1)), 0)
    cross = spread = scatter = 0.0
    for axis, unit in ((0, aspect), (1, 1.0)):
        views = unit * (np.arange(light.shape[axis]) - (light.shape[axis] - 1) / 2)
        pixels = np.arange(light.shape[2 + axis], dtype=float)
        total = np.maximum(spot.sum(axis=(0, 1)), 1e-300)
        u = np.tensordot(views, spot.sum(axis=1 - axis), 1) / total
        x = np.broadcast_to(pixels[:, None] if axis == 0 else pixels, u.shape)
        u, x = (a - np.average(a, weights=weight) for a in (u, x))
        cross += float((weight * x * u).sum())
        spread += float((weight * x * x).sum())
        scatter += float((weight * u * u).sum())
    spots = int(np.count_nonzero(weight))
    if spread == 0 or cross == 0:
        return PhaseSlope(0.0, 0.0, spots)
    confidence = cross**2 / (spread * scatter)
    return PhaseSlope(-spread / cross, float(np.clip(confidence, 0, 1)), spots)


def _download_window(lf: LightField, rows: slice, columns: slice) -> np.ndarray[Any, Any]:
    """Some rows and columns of every view; no other sample leaves the device."""
    V, U, ny, nx = lf.shape[:4]
    sample = lf.data.nbytes // (V * U * ny * nx)  # bytes, of all colours
    shape = (V, U, rows.stop - rows.start, columns.stop - columns.start, *lf.shape[4:])
    part = np.empty(shape, lf.dtype)
    copy: Any = cl.enqueue_copy  # its types leave out buffer_origin
    with device_errors(lf.device.cl_device, "A copy to the host"):
        copy(
            lf.device.queue,
            part,
            lf.data.base_data,
            buffer_origin=(lf.data.offset + columns.start * sample, rows.start, 0),
            host_origin=(0, 0, 0),
            region=(shape[3] * sample, shape[2], V * U),
            buffer_pitches=(nx * sample, ny * nx * sample),
            host_pitches=(shape[3] * sample, shape[2] * shape[3] * sample),
            is_blocking=True,
        )
    return part
