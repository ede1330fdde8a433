"""Point spread function of a plenoptic camera, and contrast of its pictures over depth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.imaging import (
    blended_picture,
    central_lenslet,
    is_focused,
    is_symmetric,
    local_m,
    point_at_lenslet,
    refocused_picture,
    sample_offsets,
)
from clplen.analysis.point.otf import Curve
from clplen.analysis.point.psf import PSF
from clplen.analysis.point.samples import Values, interpolated_picture
from clplen.cameras.camera_base import Plenoptic
from clplen.checks import is_integer
from clplen.lightfield.raw.raw_image import RawImage
from clplen.reprs import OneLine

DEFAULT_POSITIONS = 9  # positions of the point under a lenslet, along each axis
PIXEL_POSITIONS = 4  # positions of the point along the diagonal of a focused camera's pixel
MAX_HALF_WINDOW = 30  # half width of a focused camera's PSF window, in units of lam a/d

Done = Callable[[int], Any]
Index = tuple[int, int]


def camera_psf(
    camera: Plenoptic, *, positions: int = DEFAULT_POSITIONS, done: Done | None = None
) -> PSF:
    """Simulate the image of a point of the focused plane, on the main lens' image.

    A 1.0 camera has one sample per lenslet. The point is moved below the middle lenslet in steps of
    pitch/positions along both axes, and the samples of all pictures are interleaved. Odd rows of a
    hexagonal array are interpolated as in `LightField.from_raw`. The picture of a 2.0 camera is
    blended on a fine grid and averaged over four positions of the point on a pixel, dx/(4 m) apart
    along both axes. Both results are means over the position of the point relative to the samples
    (Park, Schowengerdt and Kaczynski 1984).

    Parameters
    ----------
    camera : Plenoptic
        Camera from `PlenopticCamera.type1` or `type2`, with its device.
    positions : int
        Odd number of positions of a 1.0 camera's point along each axis. The number of exposures is
        positions^2, or about an eighth of that for an array with mirror symmetry.
    done : callable, optional
        Function that is called as ``done(1)`` after each exposure.

    Returns
    -------
    PSF
        Point spread function about the point, in metres.

    Raises
    ------
    ValueError
        If ``positions`` is not odd and positive.
    SamplingError, DeviceError
        If `Plenoptic.expose` raises it.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> psf = clplen.analysis.camera_psf(camera, positions=3)
    >>> psf.values.shape, f"{psf.fwhm(1) * 1e6:.0f} um"
    ((21, 21), '101 um')
    """
    check_positions(positions)
    report_progress = done or (lambda _: None)
    return (
        _focused(camera, report_progress)
        if is_focused(camera)
        else _standard(camera, positions, report_progress)
    )


def check_positions(positions: int) -> None:
    """Raise ValueError unless the number of positions is odd and positive."""
    if not is_integer(positions) or positions < 1 or positions % 2 == 0:
        raise ValueError(f"positions must be odd and at least 1, got {positions!r}.")


def psf_exposures(camera: Plenoptic, positions: int = DEFAULT_POSITIONS) -> int:
    """Return the number of exposures that `camera_psf` needs."""
    if is_focused(camera):
        return PIXEL_POSITIONS
    return len(
        {
            _folded_position(camera, position, positions)
            for position in np.ndindex(positions, positions)
        }
    )


def _focused(camera: Any, done: Done) -> PSF:
    """Return the mean picture of a point over its positions on a pixel."""
    to_image = camera.image_distance / camera.array_distance
    total, pitch = np.zeros((1, 1)), (1.0, 1.0)
    for offset in sample_offsets(camera.pixel_pitch / abs(local_m(camera, 0.0)), PIXEL_POSITIONS):
        point = point_at_lenslet(camera, (offset / to_image, offset / to_image), 0.0)
        picture = blended_picture(camera.expose(point), 0.0)
        x, y = camera.image_of(point.positions)[0]
        psf, pitch = PSF(picture.values, picture.pitch, picture.origin), picture.pitch
        total = total + _window_about(psf, (float(y), float(x)), _half_window(camera, psf))
        done(1)
    return PSF(total / PIXEL_POSITIONS, pitch)


def _half_window(camera: Any, psf: PSF) -> list[int]:
    """Return the half width of the window about the point, in samples along y and x."""
    unit = camera.wavelength * abs(camera.a) / camera.mla.diameter
    margin = camera.pixel_pitch / abs(local_m(camera, 0.0)) + 2 * camera.mla.pitch
    distances = [n * d / 2 - margin for n, d in zip(psf.values.shape, psf.pitch, strict=True)]
    return [
        round(min(MAX_HALF_WINDOW * unit, r) / d) for r, d in zip(distances, psf.pitch, strict=True)
    ]


def _window_about(psf: PSF, position: tuple[float, float], half: list[int]) -> Values:
    """Interpolate a PSF on a window about a position, in Fourier space."""
    first = (psf.grid.y[0], psf.grid.x[0])
    rows, columns = (
        (coordinate - start) / d + np.arange(-n, n + 1)
        for coordinate, start, d, n in zip(position, first, psf.pitch, half, strict=True)
    )
    return np.asarray(interpolated_picture(psf.values, rows, columns), np.float64)


def _standard(camera: Plenoptic, positions: int, done: Done) -> PSF:
    """Interleave pictures of a point at all positions below a lenslet."""
    count, steps = camera.mla.count, (camera.mla.row_pitch, camera.mla.pitch)
    pictures: dict[Index, Values] = {}
    fine = np.empty((count[0], positions, count[1], positions))
    for i, k in np.ndindex(positions, positions):
        folded = _folded_position(camera, (i, k), positions)
        if folded not in pictures:
            down, right = (
                sample_offsets(step, positions)[n] for step, n in zip(steps, folded, strict=True)
            )
            pictures[folded] = refocused_picture(
                camera.expose(point_at_lenslet(camera, (down, right), 0.0)), 0.0
            )
            done(1)
        fine[:, positions - 1 - i, :, positions - 1 - k] = _unfolded_picture(
            pictures[folded], folded, (i, k), positions
        )
    values = fine.reshape(count[0] * positions, count[1] * positions)
    pitch = (steps[0] / positions, steps[1] / positions)
    first = [-n * positions - positions // 2 for n in central_lenslet(camera)]
    origin = [(n // 2 + index) * d for n, index, d in zip(values.shape, first, pitch, strict=True)]
    return PSF(values, pitch, (origin[0], origin[1]))


def _folded_position(camera: Plenoptic, position: Index, positions: int) -> Index:
    """Return the equivalent position after folding by the mirror symmetry of the array."""
    if not is_symmetric(camera):
        return position
    i, k = (min(n, positions - 1 - n) for n in position)
    is_square = camera.mla.count[0] == camera.mla.count[1]
    return (min(i, k), max(i, k)) if is_square else (i, k)


def _unfolded_picture(picture: Values, near: Index, position: Index, positions: int) -> Values:
    """Return the picture at a position by mirroring that of its `_folded_position` position."""
    folded = (
        min(position[0], positions - 1 - position[0]),
        min(position[1], positions - 1 - position[1]),
    )
    if near == position:
        return picture
    oriented = picture if near == folded else picture.T
    rows, columns = (-1 if index != n else 1 for index, n in zip(position, folded, strict=True))
    return oriented[::rows, ::columns]


@dataclass(frozen=True, eq=False, repr=False)
class DepthTransfer(OneLine):
    """Contrast of a camera's refocused pictures over depth.

    Attributes
    ----------
    dz : numpy.ndarray
        Distances in metres from the focused plane, farther positive, float64, shape (n,).
    curves : tuple of Curve or None
        Contrast along x, in cycles a metre of the object; None for a depth without a picture.
    notes : tuple of str
        Reasons for missing curves; empty where the curve exists.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> transfer, _ = clplen.analysis.depth_scan(camera, [0.0, 5e-3], errors=False)
    >>> [f"{frequency / 1e3:.0f} cycles/mm" for frequency in transfer.mtf50]
    ['6 cycles/mm', '4 cycles/mm']
    >>> transfer.best[0]
    0.0
    """

    dz: Values
    curves: tuple[Curve | None, ...]
    notes: tuple[str, ...]

    def at(self, contrast: float) -> Values:
        """Return the frequency at which each curve falls to a contrast; NaN without a curve."""
        frequencies = [np.nan if curve is None else curve.at(contrast) for curve in self.curves]
        return np.array(frequencies, np.float64)

    @property
    def mtf50(self) -> Values:
        """Frequencies of contrast 0.5, in cycles a metre of the object."""
        return self.at(0.5)

    @property
    def best(self) -> tuple[float, float]:
        """The dz in metres with the highest MTF50, and this MTF50; NaN without any curve."""
        mtf50 = self.mtf50
        if np.isnan(mtf50).all():
            return float("nan"), float("nan")
        k = int(np.nanargmax(mtf50))
        return float(self.dz[k]), float(mtf50[k])

    @property
    def best_at_end(self) -> bool:
        """Flag that the best dz is the first or last, so that the true best may be outside."""
        return self.best[0] in (self.dz.min(), self.dz.max())


def line_curve(line: Values, pitch: float) -> Curve:
    """Compute the modulus of the transfer function of a line spread (Bracewell 1956)."""
    length = 2 * len(line)
    spectrum = np.abs(np.fft.rfft(line, length))
    frequency = np.asarray(np.fft.rfftfreq(length, pitch), np.float64)
    return Curve(frequency, np.asarray(spectrum / spectrum[0], np.float64))


def transfer_of(raws: Sequence[RawImage], dz: float) -> Curve:
    """Compute the contrast along x of pictures of a point, focused on its depth."""
    camera: Any = raws[0].camera
    if is_focused(camera):
        return _mean([_focused_line(raw, dz) for raw in raws])
    lines = [refocused_picture(raw, dz).sum(axis=0) for raw in raws]
    fine = np.stack(lines[::-1], axis=1).ravel()
    return line_curve(fine, camera.mla.pitch / len(raws) / abs(camera.array_scale(dz)))


def _focused_line(raw: RawImage, dz: float) -> Curve:
    camera: Any = raw.camera
    picture = blended_picture(raw, dz)
    magnified = abs(camera.image_distance / camera.alpha(dz) / (camera.object_distance + dz))
    return line_curve(picture.values.sum(axis=0), picture.pitch[1] / magnified)


def _mean(curves: list[Curve]) -> Curve:
    values = np.mean([curve.value for curve in curves], axis=0)
    return Curve(curves[0].frequency, np.asarray(values, np.float64))


def object_nyquist(camera: Any, dz: float) -> float:
    """Compute the Nyquist frequency of the picture on the object at dz, in cycles a metre.

    The sample is a lenslet's pitch (1.0), or a pixel over abs(m) at that depth (2.0).
    """
    if is_focused(camera):
        inverse_m = abs(camera.array_alpha(dz) - 1)  # m F' = z3/(z2/F' - 1)
        distance = camera.object_distance + dz
        period = 2 * camera.pixel_pitch * distance * inverse_m / camera.sensor_distance
        return float(1 / period) if period else math.inf
    return float(abs(camera.array_scale(dz)) / (2 * camera.mla.pitch))
