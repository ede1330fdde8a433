"""Point images of a Fourier light-field microscope from frames of a bead that moves along z.

A bead at (x, y, z) lies in sub-image j at c_j + M_T ((x, y) + z tan(theta_j)): what all sub-images
share tells (x, y), what grows with tan(theta_j) tells z. Images are moved so that the bead lies on
the axis, and cut to where they rise above the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from clplen.cameras.fourier_microscope import MIN_LIT_FRACTION as LIT
from clplen.cameras.fourier_microscope import MIN_WHOLE_FRACTION as WHOLE
from clplen.cameras.fourier_microscope import FourierMicroscope
from clplen.checks import is_finite, real_array
from clplen.errors import SamplingWarning, ShapeError, warn_caller
from clplen.microscopy.fourier.fourier_psf import centres_of, checked_planes, described
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.psf import check_cut
from clplen.microscopy.objects.points import level_and_noise
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

SEARCH = 3.0  # times the lateral resolution, within which a bead is looked for at first
ROUNDS = 4  # of places and their fit
SMOOTH = 1.0  # pixels, of the picture that tells the support
FEWEST = 3  # whole lenslets that tell z


@dataclass(frozen=True, eq=False, repr=False)
class BeadCalibration(OneLine):
    """Point images that were measured, and how well. Made by `measure_point_images`.

    Attributes
    ----------
    images : FourierPointImages
        On the planes as registered: z of the frames less ``offset``.
    offset : float
        By how much the given z lie beyond the true ones, in metres.
    places : numpy.ndarray
        (y, x) of the bead from the axis in each frame in metres, float64, shape (planes, 2).
    depths : numpy.ndarray
        z of each frame by itself, in metres, float64, shape (planes,).
    error : float
        Of places in sub-images against those of rays, rms in pixels.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=5e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> z = np.array([-15e-6, 0, 15e-6])
    >>> stack = [camera.expose(clplen.PointSources((0, 0, one + 2e-6))) for one in z]
    >>> found = clplen.microscopy.measure_point_images(camera, np.stack(stack), z)
    >>> f"{found.offset * 1e6:.1f} um"
    '-2.0 um'
    """

    images: FourierPointImages
    offset: float
    places: Vector
    depths: Vector
    error: float


def measure_point_images(
    camera: FourierMicroscope,
    stack: Any,
    planes: Sequence[float] | Vector,
    *,
    threshold: float = 3.0,
    cut: float = 0.01,
) -> BeadCalibration:
    """Find point images in a stack of raw frames of one bead.

    Each sub-image has its background, the median about the bead, taken off. What rises above the
    noise, in a smoothed picture and together, is kept, and all of it is cut to the smallest
    squares.

    Parameters
    ----------
    camera : FourierMicroscope
        Says where sub-images lie, and how beads move in them.
    stack : array_like
        Counts, shape (planes, ny, nx) with the shape of the camera's sensor.
    planes : sequence of float
        z of the bead in each frame in metres, farther positive, rising; a common offset is found.
    threshold : float
        Standard deviations of the noise above which pixels belong to an image.
    cut : float
        Share of what was kept that may be left out around it.

    Returns
    -------
    BeadCalibration
        Its images have the energy 1 in the mean of the planes: that of a voxel is the light on
        the sensor.

    Raises
    ------
    ShapeError
        If the stack has not the shape of planes and sensor.
    ValueError
        If planes do not rise, a pixel is not finite, a number is out of range, the camera has less
        than three whole lenslets, or no bead is found.
    TypeError
        If the camera is no Fourier microscope, or the stack no array of real numbers.

    Warns
    -----
    SamplingWarning
        If pixels above lam s/(2 d) do not sample the light: images that are moved by parts of a
        pixel are some per cent off then.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=5e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> stack = np.stack([camera.expose(clplen.PointSources((0, 0, 0)))])
    >>> found = clplen.microscopy.measure_point_images(camera, stack, [0.0])
    >>> projector = clplen.microscopy.FourierProjector(found.images)
    """
    z = checked_planes(camera, planes)
    frames = _checked(camera, stack, z, threshold, cut)
    places, depths, offset, error = _registered(camera, frames, z)
    stored, corners = [], []
    for frame, depth, place in zip(frames, z - offset, places, strict=True):
        cut_out, corner = _cut_out(camera, frame, float(depth), place / camera.side, threshold)
        stored.append(cut_out)
        corners.append(corner)
    scale = len(stored) / sum(float(one.sum(dtype=np.float64)) for one in stored)
    half = _enough(stored, cut)
    middle = stored[0].shape[-1] // 2
    inside = slice(middle - half, middle + half + 1)
    images = FourierPointImages(
        described(camera, z - offset, 1) | {"source": "measured", "cut": float(cut)},
        z - offset,
        1,
        camera.side,
        camera.grid.shape,
        centres_of(camera),
        camera.sub_image / (2 * camera.pixel_pitch),
        tuple(np.float32(one[None, :, inside, inside] * scale) for one in stored),
        np.array(corners, np.int32) + (middle - half),
    )
    return BeadCalibration(images, offset, places, depths, error)


def _checked(
    camera: FourierMicroscope, stack: Any, z: Vector, threshold: float, cut: float
) -> Vector:
    """The frames as float64, after the checks."""
    frames = real_array(stack, "A stack of a bead", np.float64)
    if frames.shape != (len(z), *camera.grid.shape):
        raise ShapeError(
            f"A stack of a bead has a frame for each of the {len(z)} planes, as large as the "
            f"sensor, shape {(len(z), *camera.grid.shape)}, not {frames.shape}."
        )
    if not np.isfinite(frames).all():
        raise ValueError("The stack of a bead has pixels that are not finite.")
    if not (is_finite(threshold) and threshold >= 0):
        raise ValueError(f"threshold is a number from 0 on, not {threshold!r}.")
    check_cut(cut)
    whole = int((camera.lit >= WHOLE).sum())
    if whole < FEWEST:
        raise ValueError(
            f"{whole} lenslets have their whole aperture in the pupil, at least {FEWEST} are "
            "needed to tell the z of a bead."
        )
    coarsest = camera.wavelength * camera.sensor_distance / (2 * camera.lenslets.diameter)
    if camera.pixel_pitch > coarsest:
        warn_caller(
            f"Pixels of {camera.pixel_pitch:.3g} m do not sample the light of lenslets, which "
            f"takes {coarsest:.3g} m or less: measured point images are some per cent off.",
            SamplingWarning,
        )
    return frames


def _registered(
    camera: FourierMicroscope, frames: Vector, z: Vector
) -> tuple[Vector, Vector, float, float]:
    """Places, depths, their common offset, and the error of sub-images in pixels."""
    chosen = np.flatnonzero(camera.lit >= LIT)
    whole = camera.lit[chosen] >= WHOLE
    centres = centres_of(camera)[whole]
    slopes = camera.displacement(1e-6)[chosen][whole] / camera.pixel_pitch / 1e-6  # pixels a metre
    wide = SEARCH * max(1.0, camera.lateral_resolution / camera.side)
    shifts = _first_shifts(frames, centres, slopes, z, wide)
    offset, depths = 0.0, z
    found = np.zeros((len(z), len(centres), 2))
    slopes0 = slopes - slopes.mean(axis=0)
    spread = float(np.square(slopes0).sum())
    for turn in range(ROUNDS):
        for number, frame in enumerate(frames):
            expected = centres + shifts[number] + slopes * (z[number] - offset)
            sigma = wide / 2 if turn == 0 else wide / SEARCH
            found[number] = [_place(frame, one, sigma) for one in expected]
        moved = found - centres
        depths = (moved * slopes0).sum(axis=(1, 2)) / spread
        offset = float(np.mean(z - depths))
        shifts = (moved - slopes * (z - offset)[:, None, None]).mean(axis=1)
    rest = moved - shifts[:, None] - slopes * (z - offset)[:, None, None]
    return shifts * camera.side, depths, offset, float(np.sqrt(np.square(rest).sum(axis=2).mean()))


def _first_shifts(
    frames: Vector, centres: Vector, slopes: Vector, z: Vector, wide: float
) -> Vector:
    """(y, x) in pixels of the bead in each frame, by the sub-image that moves least."""
    still = int(np.hypot(*slopes.T).argmin())
    shifts = np.zeros((len(z), 2))
    for number, frame in enumerate(frames):
        about = centres[still] + slopes[still] * z[number]
        half = int(np.ceil(3 * wide))
        corner = np.rint(about).astype(int) - half
        part = ndimage.gaussian_filter(_window(frame, corner, 2 * half + 1), SMOOTH)
        level, noise = level_and_noise(part)
        if not part.max() > level + 3 * noise:
            raise ValueError(
                f"No bead is seen in frame {number} (from 0) within {half} pixels of (y, x) = "
                f"({about[0]:.1f}, {about[1]:.1f}): is it near the axis, and the camera right?"
            )
        shifts[number] = np.unravel_index(part.argmax(), part.shape) + corner - about
    return shifts


def _place(frame: Vector, about: Vector, sigma: float) -> Vector:
    """(y, x) of a spot, by a centroid under a Gaussian that follows it."""
    half = int(np.ceil(3 * sigma))
    corner = np.rint(about).astype(int) - half
    part = _window(frame, corner, 2 * half + 1)
    light = np.maximum(part - np.median(part), 0)
    place = about - corner
    axis = np.arange(2 * half + 1)
    for _ in range(30):
        y, x = (np.exp(-0.5 * ((axis - p) / sigma) ** 2) for p in place)
        weight = light * y[:, None] * x
        total = weight.sum()
        if total <= 0:
            break
        mean = np.array([weight.sum(axis=1) @ axis, weight.sum(axis=0) @ axis]) / total
        step = 2 * (mean - place)  # the Gaussian pulls back by half of a spot of its own width
        place = np.clip(place + step, 0, 2 * half)
        if np.abs(step).max() < 1e-4:
            break
    return np.asarray(place + corner)


def _cut_out(
    camera: FourierMicroscope, frame: Vector, z: float, shift: Vector, threshold: float
) -> tuple[Vector, Vector]:
    """Images of all lenslets with the bead moved to the axis, and their corners."""
    chosen = np.flatnonzero(camera.lit >= LIT)
    centres = centres_of(camera)
    far = camera.displacement(z)[chosen] / camera.pixel_pitch
    half = int(np.ceil(camera.sub_image / (2 * camera.pixel_pitch)))
    size = 2 * half + 1
    whole, part = np.floor(shift + 0.5).astype(int), shift - np.floor(shift + 0.5)
    corners = np.rint(centres + far).astype(int) - half
    images = np.empty((len(chosen), size, size))
    for number, corner in enumerate(corners):
        window = _window(frame, corner + whole, size)
        level, _ = level_and_noise(window)
        moved = np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(window - level), -part)).real
        images[number] = _supported(moved, threshold)
    return images, corners


def _supported(image: Vector, threshold: float) -> Vector:
    """An image where it rises above the noise, connected with its brightest pixel."""
    smooth = ndimage.gaussian_filter(image, SMOOTH)
    _, noise = level_and_noise(smooth)
    above = smooth > threshold * noise
    labels, count = ndimage.label(above, np.ones((3, 3)))
    if count == 0:
        return np.zeros_like(image)
    lit = labels == labels.flat[smooth.argmax()]
    return np.where(ndimage.binary_dilation(lit), np.maximum(image, 0), 0.0)


def _window(frame: Vector, corner: Vector, size: int) -> Vector:
    """A square of a frame, its border repeated beyond it."""
    rows, columns = (
        np.clip(first + np.arange(size), 0, n - 1)
        for first, n in zip(corner, frame.shape, strict=True)
    )
    return np.asarray(frame[np.ix_(rows, columns)])


def _enough(stored: list[Vector], cut: float) -> int:
    """Half the side of the squares that hold all but ``cut`` of every plane."""
    middle = stored[0].shape[-1] // 2
    for half in range(middle + 1):
        inside = slice(middle - half, middle + half + 1)
        if all(one[:, inside, inside].sum() >= (1 - cut) * one.sum() for one in stored):
            return half
    return middle
