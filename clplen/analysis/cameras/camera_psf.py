"""The image of a point in the picture that a camera gives, and how contrast falls with detail."""

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
from clplen.analysis.point.samples import Values, between
from clplen.cameras.camera_base import Plenoptic
from clplen.checks import is_integer
from clplen.lightfield.raw.raw_image import RawImage
from clplen.reprs import OneLine

PLACES = 9  # of a point under a lenslet, along each axis
PIXEL_PLACES = 4  # of a point on a focused camera's pixel, along its diagonal
UNITS = 30  # of a focused camera's blur lam a/d, from the point to the border of its window

Done = Callable[[int], Any]
Place = tuple[int, int]


def camera_psf(camera: Plenoptic, *, places: int = PLACES, done: Done | None = None) -> PSF:
    """Simulate the image of a point of the focused plane, on the main lens' image.

    A 1.0 camera gives one sample a lenslet. The point is moved below the middle lenslet by
    pitch/places along both axes, and the samples of all pictures are put side by side: what a
    lenslet shows of a point at each distance from its centre (the odd rows of a hexagonal array as
    `LightField.from_raw` interpolates them to the columns of the others). A 2.0 camera's picture is
    blended on a fine grid, and the mean taken over four places of the point on a pixel, dx/(4 m)
    apart along both axes, by the middle lenslet. Both are means over where a point falls on the
    samples (Park, Schowengerdt and Kaczynski 1984).

    Parameters
    ----------
    camera : Plenoptic
        `PlenopticCamera.type1` or `type2`, with its device.
    places : int
        Odd; of a 1.0 camera's point, along each axis. It takes places^2 exposures, about an eighth
        of that where the array is its own mirror image.
    done : callable, optional
        Called as ``done(1)`` after each exposure.

    Returns
    -------
    PSF
        About the point, in metres.

    Raises
    ------
    ValueError
        If ``places`` is not odd and positive.
    SamplingError, DeviceError
        As `Plenoptic.expose`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> psf = clplen.analysis.camera_psf(camera, places=3)
    >>> psf.values.shape, f"{psf.fwhm(1) * 1e6:.0f} um"
    ((21, 21), '101 um')
    """
    check_places(places)
    tell = done or (lambda _: None)
    return _focused(camera, tell) if is_focused(camera) else _standard(camera, places, tell)


def check_places(places: int) -> None:
    """Refuse a number of places that is not odd and positive."""
    if not is_integer(places) or places < 1 or places % 2 == 0:
        raise ValueError(f"places is an odd number of at least 1, not {places!r}.")


def psf_exposures(camera: Plenoptic, places: int = PLACES) -> int:
    """How many exposures `camera_psf` makes."""
    if is_focused(camera):
        return PIXEL_PLACES
    return len({_alike(camera, place, places) for place in np.ndindex(places, places)})


def _focused(camera: Any, done: Done) -> PSF:
    """The mean of pictures of a point at places on a pixel, each about its own place."""
    to_image = camera.image_distance / camera.array_distance
    total, pitch = np.zeros((1, 1)), (1.0, 1.0)
    for offset in sample_offsets(camera.pixel_pitch / abs(local_m(camera, 0.0)), PIXEL_PLACES):
        point = point_at_lenslet(camera, (offset / to_image, offset / to_image), 0.0)
        found = blended_picture(camera.expose(point), 0.0)
        x, y = camera.image_of(point.positions)[0]
        psf, pitch = PSF(found.values, found.pitch, found.origin), found.pitch
        total = total + _about(psf, (float(y), float(x)), _half(camera, psf))
        done(1)
    return PSF(total / PIXEL_PLACES, pitch)


def _half(camera: Any, psf: PSF) -> list[int]:
    """Samples from the middle to the border of the window about a point by the middle lenslet."""
    unit = camera.wavelength * abs(camera.a) / camera.mla.diameter
    beside = camera.pixel_pitch / abs(local_m(camera, 0.0)) + 2 * camera.mla.pitch
    room = [n * d / 2 - beside for n, d in zip(psf.values.shape, psf.pitch, strict=True)]
    return [round(min(UNITS * unit, r) / d) for r, d in zip(room, psf.pitch, strict=True)]


def _about(psf: PSF, place: tuple[float, float], half: list[int]) -> Values:
    """The picture about a place, by Fourier interpolation."""
    first = (psf.grid.y[0], psf.grid.x[0])
    rows, columns = (
        (at - start) / d + np.arange(-n, n + 1)
        for at, start, d, n in zip(place, first, psf.pitch, half, strict=True)
    )
    return np.asarray(between(psf.values, rows, columns), np.float64)


def _standard(camera: Plenoptic, places: int, done: Done) -> PSF:
    """Pictures of one point at all places below a lenslet, sample beside sample."""
    count, steps = camera.mla.count, (camera.mla.row_pitch, camera.mla.pitch)
    known: dict[Place, Values] = {}
    fine = np.empty((count[0], places, count[1], places))
    for i, k in np.ndindex(places, places):
        near = _alike(camera, (i, k), places)
        if near not in known:
            down, right = (
                sample_offsets(step, places)[n] for step, n in zip(steps, near, strict=True)
            )
            known[near] = refocused_picture(
                camera.expose(point_at_lenslet(camera, (down, right), 0.0)), 0.0
            )
            done(1)
        fine[:, places - 1 - i, :, places - 1 - k] = _mirrored(known[near], near, (i, k), places)
    values = fine.reshape(count[0] * places, count[1] * places)
    pitch = (steps[0] / places, steps[1] / places)
    first = [-n * places - places // 2 for n in central_lenslet(camera)]
    origin = [(n // 2 + at) * d for n, at, d in zip(values.shape, first, pitch, strict=True)]
    return PSF(values, pitch, (origin[0], origin[1]))


def _alike(camera: Plenoptic, place: Place, places: int) -> Place:
    """The place whose picture is that of another one but for a mirror."""
    if not is_symmetric(camera):
        return place
    i, k = (min(n, places - 1 - n) for n in place)
    is_square = camera.mla.count[0] == camera.mla.count[1]
    return (min(i, k), max(i, k)) if is_square else (i, k)


def _mirrored(picture: Values, near: Place, place: Place, places: int) -> Values:
    """The picture of a point at a place from that of `_alike`."""
    folded = (min(place[0], places - 1 - place[0]), min(place[1], places - 1 - place[1]))
    if near == place:
        return picture
    turned = picture if near == folded else picture.T
    rows, columns = (-1 if at != n else 1 for at, n in zip(place, folded, strict=True))
    return turned[::rows, ::columns]


@dataclass(frozen=True, eq=False, repr=False)
class DepthTransfer(OneLine):
    """Contrast of a camera's refocused pictures over depth.

    Attributes
    ----------
    dz : numpy.ndarray
        Metres from the focused plane, farther positive, float64, shape (n,).
    curves : tuple of Curve or None
        Along x, in cycles a metre of the object; None where no picture can be made.
    notes : tuple of str
        Why not; empty where there is one.

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
        """Frequency at which each curve falls to a contrast, as `Curve.at`; NaN without a curve."""
        found = [np.nan if curve is None else curve.at(contrast) for curve in self.curves]
        return np.array(found, np.float64)

    @property
    def mtf50(self) -> Values:
        """``at(0.5)``."""
        return self.at(0.5)

    @property
    def best(self) -> tuple[float, float]:
        """dz of the highest MTF50, and that; NaN where there is none."""
        found = self.mtf50
        if np.isnan(found).all():
            return float("nan"), float("nan")
        k = int(np.nanargmax(found))
        return float(self.dz[k]), float(found[k])

    @property
    def best_at_end(self) -> bool:
        """Whether that dz is the first or last of all, so that the true one may lie beyond."""
        return self.best[0] in (self.dz.min(), self.dz.max())


def line_curve(line: Values, pitch: float) -> Curve:
    """Modulus of the transfer function of a line's image (Bracewell 1956)."""
    length = 2 * len(line)
    spectrum = np.abs(np.fft.rfft(line, length))
    frequency = np.asarray(np.fft.rfftfreq(length, pitch), np.float64)
    return Curve(frequency, np.asarray(spectrum / spectrum[0], np.float64))


def transfer_of(raws: Sequence[RawImage], dz: float) -> Curve:
    """Contrast along x of the pictures of one point, focused on its depth."""
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
    """Half the samples a metre of the object at dz that the camera's picture has.

    A lenslet's pitch each (1.0), or a pixel over abs(m) of that depth (2.0).
    """
    if is_focused(camera):
        off = abs(camera.array_alpha(dz) - 1)  # m F' = z3/(z2/F' - 1)
        from_object = camera.object_distance + dz
        seen = 2 * camera.pixel_pitch * from_object * off / camera.sensor_distance
        return float(1 / seen) if seen else math.inf
    return float(abs(camera.array_scale(dz)) / (2 * camera.mla.pitch))
