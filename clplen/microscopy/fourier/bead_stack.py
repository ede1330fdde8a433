"""Point images of a Fourier light-field microscope from frames of a bead that moves along z.

A bead at (x, y, z) appears in sub-image j at c_j + M_T ((x, y) + z tan(theta_j)): the common
displacement of all sub-images gives (x, y), the part proportional to tan(theta_j) gives z. Images
are shifted to put the bead on the axis, and cropped to the pixels above the noise.
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
from clplen.microscopy.fourier.fourier_psf import centres_of, checked_planes, parameters_of
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.psf import check_cut
from clplen.microscopy.objects.points import level_and_noise
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

SEARCH_RADIUS = 3.0  # initial search radius of a bead, in lateral resolutions
ROUNDS = 4  # alternations of measuring the positions and fitting the offset
SMOOTHING_PIXELS = 1.0  # sigma of the smoothing before a threshold finds the support
MIN_LENSLETS = 3  # lenslets with their whole aperture in the pupil: x, y and z are unknown


@dataclass(frozen=True, eq=False, repr=False)
class BeadCalibration(OneLine):
    """Measured point images and their registration. Made by `measure_point_images`.

    Attributes
    ----------
    images : FourierPointImages
        Point images on the registered planes: z of the frames minus ``offset``.
    offset : float
        Given z minus registered z, common to all frames, in metres.
    positions : numpy.ndarray
        (y, x) of the bead from the axis in each frame in metres, float64, shape (planes, 2).
    depths : numpy.ndarray
        z estimated from each frame alone, in metres, float64, shape (planes,).
    error : float
        Distance of the bead in the sub-images from the ray model, rms in pixels.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=5e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> z = np.array([-15e-6, 0, 15e-6])
    >>> stack = [camera.expose(clplen.PointSources((0, 0, depth + 2e-6))) for depth in z]
    >>> calibration = clplen.microscopy.measure_point_images(camera, np.stack(stack), z)
    >>> f"{calibration.offset * 1e6:.1f} um"
    '-2.0 um'
    """

    images: FourierPointImages
    offset: float
    positions: Vector
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
    """Measure point images from a stack of raw frames of a single bead.

    The background of each sub-image, the median about the bead, is subtracted. The connected
    region above the noise in a smoothed picture is the support of the image. All images are
    cropped to the smallest squares that contain their light.

    Parameters
    ----------
    camera : FourierMicroscope
        Camera that defines the sub-images and the motion of beads in them.
    stack : array_like
        Counts, shape (planes, ny, nx) with the shape of the camera's sensor.
    planes : sequence of float
        z of the bead in each frame in metres, farther positive, rising, up to a common offset.
    threshold : float
        Threshold of the support, in standard deviations of the noise.
    cut : float
        Share of the light in the support that may be cropped.

    Returns
    -------
    BeadCalibration
        Point images with a mean energy of 1 over the planes: the energy of a voxel is its light
        on the sensor.

    Raises
    ------
    ShapeError
        If the stack does not have the shape of planes and sensor.
    ValueError
        If planes do not rise, a pixel is not finite, a number is out of range, the camera has fewer
        than three whole lenslets, or no bead is detected.
    TypeError
        If the camera is not a Fourier microscope, or the stack not an array of real numbers.

    Warns
    -----
    SamplingWarning
        If pixels larger than lam s/(2 d) undersample the light: subpixel shifts then change the
        images by a few per cent.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=5e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> stack = np.stack([camera.expose(clplen.PointSources((0, 0, 0)))])
    >>> calibration = clplen.microscopy.measure_point_images(camera, stack, [0.0])
    >>> projector = clplen.microscopy.FourierProjector(calibration.images)
    """
    z = checked_planes(camera, planes)
    frames = _checked(camera, stack, z, threshold, cut)
    positions, depths, offset, error = _registered(camera, frames, z)
    stored, corners = [], []
    for frame, depth, position in zip(frames, z - offset, positions, strict=True):
        shift = position / camera.side
        sub_images, corner = _sub_images(camera, frame, float(depth), shift, threshold)
        stored.append(sub_images)
        corners.append(corner)
    scale = len(stored) / sum(float(plane.sum(dtype=np.float64)) for plane in stored)
    half = _half_side(stored, cut)
    middle = stored[0].shape[-1] // 2
    inside = slice(middle - half, middle + half + 1)
    images = FourierPointImages(
        parameters_of(camera, z - offset, 1) | {"source": "measured", "cut": float(cut)},
        z - offset,
        1,
        camera.side,
        camera.grid.shape,
        centres_of(camera),
        camera.sub_image / (2 * camera.pixel_pitch),
        tuple(np.float32(plane[None, :, inside, inside] * scale) for plane in stored),
        np.array(corners, np.int32) + (middle - half),
    )
    return BeadCalibration(images, offset, positions, depths, error)


def _checked(
    camera: FourierMicroscope, stack: Any, z: Vector, threshold: float, cut: float
) -> Vector:
    """Check the stack and the options; return the frames as float64."""
    frames = real_array(stack, "A stack of a bead", np.float64)
    if frames.shape != (len(z), *camera.grid.shape):
        raise ShapeError(
            f"A stack of a bead must have shape {(len(z), *camera.grid.shape)}, a frame of the "
            f"sensor for each plane, got {frames.shape}."
        )
    if not np.isfinite(frames).all():
        raise ValueError("The stack of a bead has pixels that are not finite.")
    if not (is_finite(threshold) and threshold >= 0):
        raise ValueError(f"threshold must be a number from 0 on, got {threshold!r}.")
    check_cut(cut)
    count = int((camera.lit >= WHOLE).sum())
    if count < MIN_LENSLETS:
        raise ValueError(
            f"At least {MIN_LENSLETS} lenslets must have their whole aperture in the pupil to "
            f"measure z of a bead, got {count}."
        )
    max_pitch = camera.wavelength * camera.sensor_distance / (2 * camera.lenslets.diameter)
    if camera.pixel_pitch > max_pitch:
        warn_caller(
            f"Pixels of {camera.pixel_pitch:.3g} m undersample the light of the lenslets, which "
            f"requires {max_pitch:.3g} m or less: measured point images are wrong by some per "
            "cent.",
            SamplingWarning,
        )
    return frames


def _registered(
    camera: FourierMicroscope, frames: Vector, z: Vector
) -> tuple[Vector, Vector, float, float]:
    """Return positions, depths, their common offset, and the rms error in pixels."""
    lit = np.flatnonzero(camera.lit >= LIT)
    is_whole = camera.lit[lit] >= WHOLE
    centres = centres_of(camera)[is_whole]
    # pixels per metre
    slopes = camera.displacement(1e-6)[lit][is_whole] / camera.pixel_pitch / 1e-6
    radius = SEARCH_RADIUS * max(1.0, camera.lateral_resolution / camera.side)
    shifts = _first_shifts(frames, centres, slopes, z, radius)
    offset, depths = 0.0, z
    spots = np.zeros((len(z), len(centres), 2))
    slopes0 = slopes - slopes.mean(axis=0)
    spread = float(np.square(slopes0).sum())
    for turn in range(ROUNDS):
        for number, frame in enumerate(frames):
            expected = centres + shifts[number] + slopes * (z[number] - offset)
            sigma = radius / 2 if turn == 0 else radius / SEARCH_RADIUS
            spots[number] = [_spot(frame, position, sigma) for position in expected]
        displacements = spots - centres
        depths = (displacements * slopes0).sum(axis=(1, 2)) / spread
        offset = float(np.mean(z - depths))
        shifts = (displacements - slopes * (z - offset)[:, None, None]).mean(axis=1)
    residuals = displacements - shifts[:, None] - slopes * (z - offset)[:, None, None]
    error = float(np.sqrt(np.square(residuals).sum(axis=2).mean()))
    return shifts * camera.side, depths, offset, error


def _first_shifts(
    frames: Vector, centres: Vector, slopes: Vector, z: Vector, radius: float
) -> Vector:
    """Estimate (y, x) of the bead in each frame in pixels, from the sub-image that moves least."""
    slowest = int(np.hypot(*slopes.T).argmin())
    shifts = np.zeros((len(z), 2))
    for number, frame in enumerate(frames):
        centre = centres[slowest] + slopes[slowest] * z[number]
        half = int(np.ceil(3 * radius))
        corner = np.rint(centre).astype(int) - half
        part = ndimage.gaussian_filter(_window(frame, corner, 2 * half + 1), SMOOTHING_PIXELS)
        level, noise = level_and_noise(part)
        if not part.max() > level + 3 * noise:
            raise ValueError(
                f"No bead detected in frame {number} (from 0) within {half} pixels of (y, x) = "
                f"({centre[0]:.1f}, {centre[1]:.1f}): check that the bead is near the axis, and "
                "the parameters of the camera."
            )
        shifts[number] = np.unravel_index(part.argmax(), part.shape) + corner - centre
    return shifts


def _spot(frame: Vector, expected: Vector, sigma: float) -> Vector:
    """Return (y, x) of a spot, the centroid under a Gaussian window that follows the spot."""
    half = int(np.ceil(3 * sigma))
    corner = np.rint(expected).astype(int) - half
    part = _window(frame, corner, 2 * half + 1)
    light = np.maximum(part - np.median(part), 0)
    centre = expected - corner
    axis = np.arange(2 * half + 1)
    for _ in range(30):
        y, x = (np.exp(-0.5 * ((axis - c) / sigma) ** 2) for c in centre)
        weight = light * y[:, None] * x
        total = weight.sum()
        if total <= 0:
            break
        mean = np.array([weight.sum(axis=1) @ axis, weight.sum(axis=0) @ axis]) / total
        step = 2 * (mean - centre)  # the window halves the step for a spot of its own width
        centre = np.clip(centre + step, 0, 2 * half)
        if np.abs(step).max() < 1e-4:
            break
    return np.asarray(centre + corner)


def _sub_images(
    camera: FourierMicroscope, frame: Vector, z: float, shift: Vector, threshold: float
) -> tuple[Vector, Vector]:
    """Return the images of all lenslets with the bead shifted to the axis, and their corners."""
    lit = np.flatnonzero(camera.lit >= LIT)
    centres = centres_of(camera)
    displacements = camera.displacement(z)[lit] / camera.pixel_pitch
    half = int(np.ceil(camera.sub_image / (2 * camera.pixel_pitch)))
    size = 2 * half + 1
    pixels, fraction = np.floor(shift + 0.5).astype(int), shift - np.floor(shift + 0.5)
    corners = np.rint(centres + displacements).astype(int) - half
    images = np.empty((len(lit), size, size))
    for number, corner in enumerate(corners):
        window = _window(frame, corner + pixels, size)
        level, _ = level_and_noise(window)
        spectrum = ndimage.fourier_shift(np.fft.fft2(window - level), -fraction)
        images[number] = _masked(np.fft.ifft2(spectrum).real, threshold)
    return images, corners


def _masked(image: Vector, threshold: float) -> Vector:
    """Set an image to 0 outside the region above the noise that contains its brightest pixel."""
    smooth = ndimage.gaussian_filter(image, SMOOTHING_PIXELS)
    _, noise = level_and_noise(smooth)
    above = smooth > threshold * noise
    labels, count = ndimage.label(above, np.ones((3, 3)))
    if count == 0:
        return np.zeros_like(image)
    lit = labels == labels.flat[smooth.argmax()]
    return np.where(ndimage.binary_dilation(lit), np.maximum(image, 0), 0.0)


def _window(frame: Vector, corner: Vector, size: int) -> Vector:
    """Return a square of a frame, with border pixels repeated outside the frame."""
    rows, columns = (
        np.clip(first + np.arange(size), 0, n - 1)
        for first, n in zip(corner, frame.shape, strict=True)
    )
    return np.asarray(frame[np.ix_(rows, columns)])


def _half_side(stored: list[Vector], cut: float) -> int:
    """Return half the side of the smallest squares that lose at most ``cut`` of any plane."""
    middle = stored[0].shape[-1] // 2
    for half in range(middle + 1):
        inside = slice(middle - half, middle + half + 1)
        if all(p[:, inside, inside].sum() >= (1 - cut) * p.sum() for p in stored):
            return half
    return middle
