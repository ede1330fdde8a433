"""Conversion of raw frames to counts and sensitivities with a whole number of pixels per lenslet.

The white frame gives the lattice and the sensitivity of each pixel: its level over the mean of the
corresponding pixels of all lenslets. This mean is the image of the pupil, which the point images
already contain. The dark frame is subtracted from both. Saturated and non-finite pixels, and pixels
that are dark in the white frame, are excluded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.ndimage import binary_dilation

from clplen.checks import host_array, positive_integer, real_array, require
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.lightfield.calibration.lattice_trust import lattice_of_white
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.nominal_lattice import check_lattice
from clplen.microscopy.frames.outliers import MAX_HOT_SHARE, hot_pixels, uneven_pixels
from clplen.microscopy.model.cells import voxel_grid
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

MIN_PIXELS_PER_PITCH = 0.9  # below it the energy of a spot depends on its position
REACH_PIXELS = 2  # support of cubic interpolation on either side


def rectify(
    frame: Any,
    lattice: Lattice,
    *,
    device: DeviceLike | None = None,
    pixels: int | None = None,
    complete: bool = True,
) -> Vector:
    """Resample a frame onto the lattice of its lenslets, n x n pixels each, for `Projector`.

    The new pixels follow the lattice vectors, which corrects a rotation, an aspect ratio and a
    fractional pitch at once. Interpolation is separable cubic convolution (Keys 1981, eq. 15,
    a = -1/2). Values are multiplied by the area of a pixel, which preserves the sum; negative
    values are set to 0. Subtract the dark frame first; rectify white frames in the same way.

    Parameters
    ----------
    frame : array_like
        Counts, shape (ny, nx), finite.
    lattice : Lattice
        Rectangular lattice, such as `estimate_lattice` returns for the white frame.
    device : Device or str, optional
        OpenCL device; None is ``Device.open()``.
    pixels : int, optional
        Number n of pixels per lenslet along an axis, at least 0.9 of the pitch, to lose no light;
        default the pitch, rounded up.
    complete : bool
        True to exclude lenslets that are not entirely on the frame and to repeat border pixels
        outside it; False to treat the outside as dark.

    Returns
    -------
    numpy.ndarray
        Counts, not negative, float32, shape (rows n, columns n).

    Raises
    ------
    ShapeError
        If the shapes of frame and lattice differ, or the frame contains no lenslet.
    ValueError
        If the lattice is hexagonal, ``pixels`` is not a positive integer or too small, or a pixel
        is NaN.
    TypeError
        If the frame is not an array of real numbers, or the lattice not a Lattice.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> lattice = clplen.lightfield.estimate_lattice(white, kind="square", pitch=10)
    >>> f"{lattice.pitch[0]:.1f} pixels", clplen.microscopy.rectify(white, lattice).shape
    ('9.6 pixels', (50, 50))
    """
    device = as_device(device)
    require(Lattice, lattice, "lattice", "estimate_lattice")
    values = real_array(frame, "A frame")
    if values.ndim != 2:
        raise ShapeError(
            f"A frame must have shape (ny, nx), got {values.shape}: rectify each frame separately."
        )
    if lattice.shape is not None and values.shape != lattice.shape:
        raise ShapeError(
            f"The frame must have the shape {lattice.shape} of the lattice, got {values.shape}."
        )
    if lattice.kind == "hexagonal":
        raise ValueError(
            "The lattice must be square, got a hexagonal one: use FrameProjector with raw frames."
        )
    n = max(map(math.ceil, lattice.pitch)) if pixels is None else positive_integer(pixels, "pixels")
    min_pixels = math.ceil(MIN_PIXELS_PER_PITCH * max(lattice.pitch))
    if n < min_pixels:
        raise ValueError(
            f"pixels must be at least {min_pixels} for a lenslet pitch of "
            f"{max(lattice.pitch):.5g} pixels, got {n}: fewer would lose light."
        )
    grid = lattice.grid((n, n), complete=complete)
    if complete:
        values = np.pad(values, REACH_PIXELS, mode="edge")
        first_y, first_x = grid.first
        grid = replace(grid, first=(first_y + REACH_PIXELS, first_x + REACH_PIXELS))
    views = device.download(resample(device.upload(values), grid, device))
    rows, columns = views.shape[2:]
    cells = np.maximum(views, 0).transpose(2, 0, 3, 1) * np.float32(area(lattice, n))
    return np.ascontiguousarray(cells.reshape(rows * n, columns * n))


def area(lattice: Lattice, pixels: int) -> float:
    """Return the area of a rectified pixel in camera pixels."""
    return math.prod(lattice.pitch) / pixels**2


def variance(lattice: Lattice, pixels: int) -> float:
    """Return the variance of a rectified pixel over its mean, if counts are photons.

    It is the area times the mean sum of the squared interpolation weights: (57/70)^2 for pixels
    distributed evenly between those of the camera, 1 for coincident pixels.
    """
    grid = lattice.grid((pixels, pixels))
    v, power = np.arange(pixels) - (pixels - 1) / 2, np.ones(())
    for axis in (0, 1):
        across = np.add.outer(np.arange(grid.count[1]) * grid.column_step[axis],
                              v * grid.column_view_step[axis])  # fmt: skip
        down = np.add.outer(np.arange(grid.count[0]) * grid.row_step[axis],
                            v * grid.row_view_step[axis])  # fmt: skip
        t = (grid.first[axis] + np.add.outer(down.ravel(), across.ravel())) % 1
        weights = (
            ((1 - t / 2) * t - 1 / 2) * t,
            (1.5 * t - 2.5) * t**2 + 1,
            ((2 - 1.5 * t) * t + 1 / 2) * t,
            (t / 2 - 1 / 2) * t**2,
        )
        power = power * sum(np.square(weight) for weight in weights)
    return area(lattice, pixels) * float(power.mean())


MIN_WHITE_LEVEL = 0.01  # over the mean level of the white frame; darker pixels are excluded
HAZE_PERCENTILE = 5  # of the lenslets; the darkest lenslets show the haze
MIN_SEARCH_PITCH = 3  # pixels, smallest pitch that the lattice search accepts
MAX_NEGATIVE_SHARE = 0.75  # of the pixels below the dark frame; noise alone gives a half
NEGATIVE_SIGMAS = 5 * math.sqrt(2)  # five sigma of the difference of two dark frames


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(OneLine):
    """Prepared frame, the input of `deconvolve`.

    Attributes
    ----------
    counts, white : numpy.ndarray
        Counts and sensitivity, float32, shape (rows n, columns n); white is 0 at excluded pixels.
    negative, left_out : int
        Number of raw pixels below 0, which are set to 0, and of saturated or non-finite pixels.
    deep : int
        Number of raw pixels below 0 by more than the noise of the dark frame.
    size : int
        Number of raw pixels.
    hot : int
        Number of excluded hot pixels; see `hot_pixels`.
    masked : int
        Number of pixels excluded by the mask.
    doubtful : int
        Number of outliers, if they are too many to be hot pixels; none of them is excluded.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> frame = (0.5 * white).astype(np.uint16)
    >>> frame[30, 30] = 65535  # saturated
    >>> prepared = clplen.microscopy.preparation(10, white=white)(frame)
    >>> prepared.counts.shape, prepared.left_out, prepared.negative
    ((50, 50), 1, 0)
    """

    counts: Vector
    white: Vector
    negative: int
    left_out: int
    deep: int = 0
    size: int = 0
    hot: int = 0
    masked: int = 0
    doubtful: int = 0


def unknown(values: Vector, saturation: float | None) -> Vector:
    """Return the mask of the saturated or non-finite pixels."""
    if saturation is None and values.dtype.kind in "ui":
        saturation = np.iinfo(values.dtype).max
    bad = ~np.isfinite(values)
    return bad if saturation is None else bad | (values >= saturation)


def mask_of(mask: Any, shape: tuple[int, ...] | None) -> Vector:
    """Check a mask; return its nonzero pixels, which are excluded."""
    values = host_array(mask, "A mask")
    if values.ndim != 2 or (shape is not None and values.shape != shape):
        expected = "(ny, nx)" if shape is None else str(shape)
        raise ShapeError(
            f"The mask must have the shape {expected} of the frames, got {values.shape}."
        )
    if values.dtype.kind not in "biuf" or not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError(
            "A mask must be 0 at valid pixels and positive at excluded pixels, without negative or "
            "non-finite values."
        )
    excluded = np.asarray(values > 0)
    if excluded.all():
        raise ValueError("The mask excludes every pixel: is it inverted? Valid pixels are 0.")
    return excluded


@dataclass(frozen=True, eq=False, repr=False)
class Preparation(OneLine):
    """Preparation shared by all frames of a camera. Made by `preparation`.

    Attributes
    ----------
    pixels : int
        Number n of pixels per lenslet along an axis.
    device : Device
        Device that rectifies the frames.
    dark : numpy.ndarray or None
        Dark frame, float32, shape (ny, nx).
    lattice : Lattice or None
        Lattice of raw frames; None if frames are already rectified.
    sensitivity : numpy.ndarray or None
        Rectified pixel sensitivity, float32; 1 in a lenslet of mean brightness.
    level : numpy.ndarray or None
        Rectified white frame.
    mask : numpy.ndarray or None
        Pixels excluded from every frame, bool, shape (ny, nx).
    sharpest : tuple of float or None
        Bounds from `sharpness`, above which pixels are hot; None disables their detection.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> prepare = clplen.microscopy.preparation(10, white=white)
    >>> f"{prepare.lattice.pitch[0]:.1f} pixels per lenslet become {prepare.pixels}"
    '9.6 pixels per lenslet become 10'
    >>> prepare(0.5 * white).counts.shape
    (50, 50)
    """

    pixels: int
    device: Device
    dark: Vector | None
    lattice: Lattice | None
    sensitivity: Vector | None
    level: Vector | None = None
    mask: Vector | None = None
    sharpest: tuple[float, float, float] | None = None

    _MIN_LIGHT: ClassVar[float] = 0.0  # over the brightest lenslet, for the estimate of haze

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    @property
    def area(self) -> float:
        """Area of a rectified pixel in camera pixels."""
        return 1.0 if self.lattice is None else area(self.lattice, self.pixels)

    @cached_property
    def noise(self) -> float:
        """Robust standard deviation of the dark frame in counts; 0 without a dark frame."""
        if self.dark is None:
            return 0.0
        return 1.4826 * float(np.median(abs(self.dark - np.median(self.dark))))

    @property
    def variance(self) -> float:
        """Variance of a rectified pixel over its mean, if counts are photons."""
        return 1.0 if self.lattice is None else variance(self.lattice, self.pixels)

    def __call__(self, frame: Any, *, saturation: float | None = None) -> Prepared:
        """Subtract the dark frame, rectify the frame and exclude invalid pixels.

        Pixels at or above ``saturation`` are excluded, by default at the maximum of an integer
        type. Raise `ShapeError` for a frame of another size than the white or dark frame, or
        without a whole number of lenslets; raise ValueError if the dark frame is brighter than the
        frame.
        """
        values = host_array(frame, "A frame")
        self._check(values.shape)
        bad = unknown(values, saturation)
        light = np.where(bad, 0, values.astype(np.float32))
        if self.dark is not None:
            light = np.where(bad, 0, light - self.dark)
        negative = int(np.count_nonzero(light < 0))
        is_darker = negative > MAX_NEGATIVE_SHARE * light.size and light.mean(dtype=np.float64) < 0
        if self.dark is not None and is_darker:
            raise ValueError(
                f"The dark frame with mean {self.dark.mean():.4g} is brighter than the frame with "
                f"mean {values[~bad].mean():.4g}: give a dark frame of the same camera, exposure "
                "and bit depth."
            )
        deep = int(np.count_nonzero(light < -NEGATIVE_SIGMAS * self.noise)) if self.noise else 0
        light = np.maximum(light, 0)
        left_out = int(np.count_nonzero(bad))
        hot = np.zeros(light.shape, bool) if self.sharpest is None else self._hot(light, bad)
        outliers = int(np.count_nonzero(hot))
        doubtful = outliers if outliers > MAX_HOT_SHARE * light.size else 0
        bad = bad | hot if outliers and not doubtful else bad
        masked = 0
        if self.mask is not None:
            masked = int(np.count_nonzero(self.mask & ~bad))
            bad = bad | self.mask
        light = np.where(bad, np.float32(0), light)
        light = self._resampled(light)
        white = np.ones(light.shape, np.float32) if self.sensitivity is None else self.sensitivity
        if bad.any():
            white = np.where(self._reached(bad), np.float32(0), white)
        return Prepared(
            light, white, negative, left_out, deep, values.size,
            outliers - doubtful, masked, doubtful,
        )  # fmt: skip

    def voxel_grid(self, voxels: int) -> dict[str, tuple[float, float]]:
        """Return the voxel grid on the raw frame, as (y, x) in pixels.

        "first" is the position of voxel (0, 0) of any plane; "down" and "right" are the steps to
        (1, 0) and (0, 1). Pixel centres have integer coordinates; ``voxels`` is the number of
        voxels per lenslet along an axis.
        """
        n = self.pixels
        first, row, column = ((n - 1) / 2,) * 2, (float(n), 0.0), (0.0, float(n))
        if self.lattice is not None:
            grid = self.lattice.grid((n, n))
            first, row, column = grid.first, grid.row_step, grid.column_step
        down, right = np.array(row) / voxels, np.array(column) / voxels
        start = np.array(first) - (voxels - 1) / 2 * (down + right)
        return voxel_grid(start, down, right)

    def haze(self, counts: Vector, white: Vector) -> Vector:
        """Estimate the light from far beyond the volume in a rectified frame, float32.

        Such light fills the pupil evenly: the estimate is the white frame, scaled to the darkest
        lenslets. Subtract other background from ``counts`` first; ``white`` is `Prepared.white`.
        """
        if self.level is None:
            raise ValueError("haze needs a white frame, got none: give the white frame.")
        cells = (self._cells(np.where(white > 0, f, 0)) for f in (counts, self.level))
        light, reference = (cell.sum(axis=(1, 3), dtype=np.float64) for cell in cells)
        lit = reference > self._MIN_LIGHT * reference.max()
        share = np.percentile(light[lit] / reference[lit], HAZE_PERCENTILE) if lit.any() else 0.0
        return np.asarray(self.level * np.float32(max(share, 0)))

    def _cells(self, frame: Vector) -> Vector:
        """Reshape a prepared frame by lenslet, to (rows, n, columns, n)."""
        n = self.pixels
        return frame.reshape(frame.shape[0] // n, n, frame.shape[1] // n, n)

    def _check(self, shape: tuple[int, ...]) -> None:
        if len(shape) != 2:
            raise ShapeError(f"A raw frame must have shape (ny, nx), got {shape}.")
        references = {
            "white frame" if self.level is not None else "lattice": self.lattice,
            "dark frame": self.dark,
            "mask": self.mask,
        }
        for name, reference in references.items():
            expected = None if reference is None else reference.shape
            if expected is not None and expected != shape:
                raise ShapeError(
                    f"The frame has shape {shape} and the {name} {expected}: give the {name} of "
                    "the same camera and crop."
                )
        if self.lattice is None and any(n % self.pixels for n in shape):
            raise ShapeError(
                f"The frame must be a whole number of lenslets of {self.pixels} x {self.pixels} "
                f"pixels, got shape {shape}: give the white frame or the lattice to rectify it."
            )

    def _resampled(self, light: Vector) -> Vector:
        """Return the frame with a whole number of pixels per lenslet."""
        if self.lattice is None:
            return light
        return rectify(light, self.lattice, device=self.device, pixels=self.pixels)

    def _hot(self, light: Vector, bad: Vector) -> Vector:
        """Return the mask of the hot pixels."""
        assert self.sharpest is not None
        rectified = self.pixels if self.pixels > 1 else None  # 1 marks a Fourier microscope
        return hot_pixels(light, self.sharpest, self.lattice or rectified) & ~bad

    def _reached(self, bad: Vector) -> Vector:
        """Return the rectified pixels to which a bad pixel contributes."""
        if self.lattice is None:
            return bad
        wide = binary_dilation(bad, np.ones((2 * REACH_PIXELS + 1,) * 2, bool)).astype(np.float32)
        return rectify(wide, self.lattice, device=self.device, pixels=self.pixels) > self.area / 2


def preparation(
    pixels: int,
    *,
    device: DeviceLike | None = None,
    white: Any = None,
    dark: Any = None,
    saturation: float | None = None,
    force: bool = False,
    lattice: Lattice | None = None,
    mask: Any = None,
    sharpest: tuple[float, float, float] | None = None,
) -> Preparation:
    """Estimate the lattice and the pixel sensitivity from a white frame.

    Parameters
    ----------
    pixels : int
        Number n of pixels per lenslet of the point images along an axis; frames with another or a
        fractional pitch, or a rotated lattice, are rectified.
    device : Device or str, optional
        OpenCL device; None is ``Device.open()``.
    white : array_like, optional
        White frame, shape (ny, nx); without it, frames must have n x n pixels per lenslet.
    dark : array_like, optional
        Dark frame, shape (ny, nx).
    saturation : float, optional
        Saturation level as in `Preparation`; also excludes pixels of the white frame.
    force : bool
        True to continue with an unreliable lattice of the white frame.
    lattice : Lattice, optional
        Lattice with the shape of the frames, used without a white frame.
    mask : array_like, optional
        Mask, shape (ny, nx), with nonzero values at excluded pixels.
    sharpest : tuple of float, optional
        Bounds from `sharpness` of the point images, to exclude hot pixels of frames, and hot or
        dead pixels of the white frame. Default: no detection.

    Returns
    -------
    Preparation
        Preparation to be called with each raw frame of the camera.

    Raises
    ------
    ShapeError
        If the sizes of white and dark frame differ, or the frame contains no lenslet.
    ValueError
        If the white frame is dark, mostly saturated or without lenslets of about ``pixels``
        pixels; if its lattice is unreliable and ``force`` is False; if a lattice is invalid or
        given with a white frame; if a mask has invalid values or excludes every pixel.

    Warns
    -----
    SamplingWarning
        If ``force`` is needed.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> sensitivity = clplen.microscopy.preparation(10, white=white).sensitivity
    >>> sensitivity.shape, f"{sensitivity[sensitivity > 0].mean():.2f}"
    ((50, 50), '1.00')
    """
    device = as_device(device)
    pixels = positive_integer(pixels, "pixels")
    black = dark_frame(dark)
    if white is None:
        if lattice is not None:
            check_lattice(lattice)
        excluded = None if mask is None else mask_of(mask, None)
        return Preparation(pixels, device, black, lattice, None, None, excluded, sharpest)
    if lattice is not None:
        raise ValueError("The white frame defines the lattice: leave out the lattice.")
    reference = white_frame(
        white, dark, saturation, kind="square", pitch=max(pixels, MIN_SEARCH_PITCH), mask=mask,
        find_hot=sharpest is not None, force=force,
    )  # fmt: skip
    prepare = Preparation(pixels, device, black, reference.lattice, None)
    level = rectify(reference.light, reference.lattice, device=device, pixels=pixels)
    if reference.bad.any():
        level[prepare._reached(reference.bad)] = 0
    sensitivity = _sensitivity(level, pixels)
    return replace(
        prepare, sensitivity=sensitivity, level=level, mask=reference.mask, sharpest=sharpest
    )


@dataclass(frozen=True, eq=False)
class WhiteFrame:
    """White frame minus dark frame, with its lattice, its invalid pixels and the mask."""

    light: Vector
    lattice: Lattice
    bad: Vector
    mask: Vector | None


def white_frame(
    white: Any,
    dark: Any,
    saturation: float | None,
    *,
    kind: Literal["square", "hexagonal"],
    pitch: float,
    mask: Any,
    find_hot: bool,
    force: bool,
) -> WhiteFrame:
    """Estimate the lattice of a white frame and detect its invalid pixels; reject other frames."""
    light, bad = _white_light(white, dark_frame(dark), saturation)
    excluded = None if mask is None else mask_of(mask, light.shape)
    lattice = lattice_of_white(light, "The white frame", kind=kind, pitch=pitch, force=force)
    if find_hot:
        uneven = uneven_pixels(light, lattice)
        bad = bad | uneven if np.count_nonzero(uneven) <= MAX_HOT_SHARE * light.size else bad
    return WhiteFrame(light, lattice, bad if excluded is None else bad | excluded, excluded)


def dark_frame(dark: Any) -> Vector | None:
    """Return the dark frame as float32, or None."""
    return None if dark is None else np.asarray(host_array(dark, "A dark frame"), np.float32)


def _white_light(
    white: Any, black: Vector | None, saturation: float | None
) -> tuple[Vector, Vector]:
    """Return the white frame minus the dark frame, and its invalid pixels."""
    values = host_array(white, "A white frame")
    if black is not None and black.shape != values.shape:
        raise ShapeError(
            f"The white frame has shape {values.shape} and the dark frame {black.shape}: give "
            "frames of the same camera and crop."
        )
    bad = unknown(values, saturation)
    if 2 * np.count_nonzero(bad) > bad.size:
        raise ValueError(
            f"{np.count_nonzero(bad):,} of {bad.size:,} pixels of the white frame are saturated "
            f"{'' if saturation is None else f'({saturation:g} or more) '}or not finite: give a "
            "higher saturation, or a white frame of a shorter exposure."
        )
    light = np.where(bad, 0, values.astype(np.float32) - (0 if black is None else black))
    light = np.maximum(light, 0)
    if not light.any():
        raise ValueError("The white frame is no brighter than the dark frame: are they exchanged?")
    return light, bad


def _sensitivity(level: Vector, n: int) -> Vector:
    """Divide the levels by the mean lenslet, pixel by pixel; dark pixels become 0."""
    cells = level.reshape(level.shape[0] // n, n, level.shape[1] // n, n)
    bright = cells > MIN_WHITE_LEVEL * level.mean(dtype=np.float64)
    counted = np.maximum(bright.sum(axis=(0, 2), keepdims=True), 1)
    mean = (cells * bright).sum(axis=(0, 2), keepdims=True, dtype=np.float64) / counted
    ratio = np.divide(cells, mean, out=np.zeros(cells.shape), where=bright)
    return ratio.reshape(level.shape).astype(np.float32)
