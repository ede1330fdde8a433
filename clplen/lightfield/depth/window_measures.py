"""Windows of lenslets on the host, and the focus measure printed in the thesis.

The thesis' measure (`thesis_curve`) is a baseline for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl

from clplen.compute.drivers.failures import device_errors
from clplen.lightfield.depth.camera_optics import Real
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_grid import LensletGrid

if TYPE_CHECKING:
    import scipy.sparse

THESIS_WINDOW = 31
THESIS_ALPHAS = np.round(0.7 + 0.005 * np.arange(121), 3)

_MIN_FREQUENCY = 0.1  # cycles a lenslet: lowest frequency of the thesis' measure
_MAX_DIFFERENCE = 1e-4  # of the largest sample: tolerance between light field and raw image
_BLUR_DIVISOR = 8  # window over this is the Gaussian blur of the window search


def read_window(
    lf: LightField, at: tuple[int, int], size: int, *, fill: bool = False
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the samples around one lenslet."""
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
    """Return (y, x) of the lenslet whose window of ``size`` lenslets is brightest."""
    from scipy.ndimage import gaussian_filter  # slow import

    picture = lf.render().to_numpy().astype(np.float64)
    if picture.ndim == 3:
        picture = picture.sum(axis=-1)
    smooth = gaussian_filter(picture, size / _BLUR_DIVISOR, mode="constant")
    y, x = np.unravel_index(np.argmax(smooth), smooth.shape)
    return int(y), int(x)


def thesis_curve(window: Real) -> Real:
    """Compute the focus measure of the thesis at `THESIS_ALPHAS`.

    I(x') = sum_u L(x'/alpha + u (1 - 1/alpha), u), x' in lenslets from the centre of the window,
    u in pixels from the centre of the cell, linear, 0 outside; E = sum of |FFT I|^2 over radii
    above 0.1 cycles a lenslet. The lenslets' naive cells are sheared by eq. 3.9 with indices
    instead of lengths, and diffraction is ignored; all three bias alpha towards 1.
    """
    c, V, U, ny, nx = window.shape
    colours = window.transpose(0, 1, 3, 2, 4).reshape(c, V * ny, U * nx)
    radius = np.hypot(np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :])
    energies = np.zeros(THESIS_ALPHAS.size)
    for i, alpha in enumerate(THESIS_ALPHAS):
        down, along = _shear(ny, V, alpha), _shear(nx, U, alpha)
        for rows in colours:
            image = down @ (along @ rows.T).T
            energies[i] += np.sum(np.abs(np.fft.fft2(image)[radius > _MIN_FREQUENCY]) ** 2)
    return energies


def _shear(count: int, views: int, alpha: float) -> scipy.sparse.csr_array:
    """Return the matrix (count, views count) that samples one axis and sums over its views."""
    import scipy.sparse  # slow import

    x = np.arange(count) - (count - 1) / 2
    u = np.arange(views) - (views - 1) / 2
    sampled = x[:, None] / alpha + u * (1 - 1 / alpha)
    weights = np.maximum(1 - np.abs(sampled[:, :, None] - x), 0)
    return scipy.sparse.csr_array(weights.reshape(count, views * count))


@dataclass(frozen=True)
class Lenslets:
    """Samples and positions of the lenslets around one point."""

    samples: Real  # float64, shape (c, v, u, y, x); 0 in views of other lenslets' cells
    # y, x: positions in pixels of the light field, broadcastable to (y, x)
    y: Real
    x: Real


def read_lenslets(lf: LightField, at: tuple[int, int], size: int) -> Lenslets:
    """Read the lenslets of a window at their sensor positions, without hexagonal resampling.

    Views of a hexagonal light field (`clplen.lightfield.raw.decode.resample`) differ from its
    lenslets in two ways. Odd rows are interpolated from two or more lenslets, which creates spots
    without a lenslet; they are read from the raw image if it fits, else omitted. The square of
    views exceeds the hexagonal cell, whose corners hold neighbours' spots; views outside the
    inscribed circle are set to 0.
    """
    samples = read_window(lf, at, size)
    top, left = (max(centre - size // 2, 0) for centre in at)
    y = top + np.arange(samples.shape[3], dtype=float)[:, None]
    x = left + np.arange(samples.shape[4], dtype=float)[None, :]
    grid = _grid_of(lf)
    if grid is None and getattr(lf.camera, "lenslet_lattice", "square") != "hexagonal":
        return Lenslets(samples, y, x)
    samples *= _inscribed_views(lf)[:, :, None, None]
    if grid is not None and grid.columns is not None:
        return Lenslets(samples, y, x)
    exchanged = grid is not None and grid.exchanged
    if exchanged:
        samples, y, x = samples.transpose(0, 2, 1, 4, 3), x.T, y.T
    even = y[:, 0] % 2 == 0
    odd = None if grid is None else _odd_rows(lf, grid, samples, y, x)
    if odd is None:
        samples, y = samples[:, :, :, even], y[even]
    else:
        samples[:, :, :, ~even] = odd
        x = x + np.where(even, 0.0, grid.odd_row_shift)[:, None] if grid is not None else x
    if exchanged:
        samples, y, x = samples.transpose(0, 2, 1, 4, 3), x.T, y.T
    return Lenslets(samples, y, x)


def _grid_of(lf: LightField) -> LensletGrid | None:
    """Return the hexagonal grid of the decoding, if known."""
    if lf.raw is None:
        return None
    grid = lf.raw.sub_images if lf.decode == "calibrated" else lf.raw.cells
    return grid if grid.odd_row_shift and grid.shape == lf.shape[:4] else None


def _inscribed_views(lf: LightField) -> Real:
    """Return 1 for views inside the inscribed circle of a hexagonal cell, else 0.

    The circle has half the diameter of the views, a pitch along the lines of nearest neighbours.
    """
    V, U = lf.shape[:2]
    v, u = (np.arange(n) - (n - 1) / 2 for n in (V, U))
    return (np.hypot(v[:, None] / V, u[None, :] / U) <= 0.5).astype(float)


def _odd_rows(lf: LightField, grid: LensletGrid, samples: Real, y: Real, x: Real) -> Real | None:
    """Return a window's lenslets of odd rows from the raw image; None if it does not fit."""
    raw = lf.raw
    if raw is None or len(raw.data.shape) != 2 or samples.shape[0] != 1:
        return None
    rows, columns = y[:, 0].astype(int), x[0].astype(int)
    weights = (lf.weights.T if grid.exchanged else lf.weights) * _inscribed_views(lf)
    values_of_parity = {}
    for parity in (0, 1):
        parity_rows = rows[rows % 2 == parity]
        if not parity_rows.size:
            continue
        across = columns[0] + parity * grid.odd_row_shift
        steps = np.asarray(grid.row_step), np.asarray(grid.column_step)
        first = np.asarray(grid.first) + parity_rows[0] * steps[0] + across * steps[1]
        part = replace(
            grid,
            count=(parity_rows.size, columns.size),
            first=(float(first[0]), float(first[1])),
            row_step=(2 * grid.row_step[0], 2 * grid.row_step[1]),
            odd_row_shift=0.0,
        )
        values = lf.device.download(resample(raw.data, part, raw.device)).astype(float)
        if grid.exchanged:
            values = values.transpose(1, 0, 3, 2)
        values_of_parity[parity] = values * weights[:, :, None, None]
    stored = samples[0][:, :, rows % 2 == 0]
    matches = (
        0 in values_of_parity
        and np.abs(values_of_parity[0] - stored).max() <= _MAX_DIFFERENCE * np.abs(stored).max()
    )
    return values_of_parity.get(1) if matches else None


def sample_noise(window: Real) -> Real:
    """Estimate the variance of the noise of every sample from neighbouring views.

    The estimate is the squared second difference along both axes of the views, over 36 (Immerkaer
    1996, "Fast noise variance estimation", eq. 4); sum it over many samples. Sub-images are smooth
    over q = lam f_mu/(dx d) views; below about 3, part of the light counts as noise.
    """
    out = np.zeros_like(window)
    if min(window.shape[1:3]) < 3:
        return out
    second = window[:, 2:] - 2 * window[:, 1:-1] + window[:, :-2]
    second = second[:, :, 2:] - 2 * second[:, :, 1:-1] + second[:, :, :-2]
    out[:, 1:-1, 1:-1] = second**2 / 36
    return out


def _download_window(lf: LightField, rows: slice, columns: slice) -> np.ndarray[Any, Any]:
    """Download some rows and columns of every view."""
    V, U, ny, nx = lf.shape[:4]
    sample = lf.data.nbytes // (V * U * ny * nx)  # bytes, all colours
    shape = (V, U, rows.stop - rows.start, columns.stop - columns.start, *lf.shape[4:])
    part = np.empty(shape, lf.dtype)
    copy: Any = cl.enqueue_copy  # its type stubs lack buffer_origin
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
