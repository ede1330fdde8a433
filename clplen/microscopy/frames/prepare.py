"""Raw frames of a real microscope to counts and sensitivities on whole pixels a lenslet.

The white frame gives the lattice, once, and the sensitivity of every pixel: its level over the mean
of the same pixel of all lenslets, because what they have in common, the image of the pupil, is part
of the point images. The dark frame is subtracted from both. Pixels that say nothing are left out:
saturated, not finite, or dark in the white frame.
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
from clplen.microscopy.frames.given_lattice import check_given
from clplen.microscopy.frames.outliers import MANY, hot_pixels, uneven_pixels
from clplen.microscopy.model.cells import place_of
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

LEAST = 0.9  # of the pitch: with fewer pixels the energy of a spot depends on its place
REACH = 2  # pixels that cubic interpolation mixes, on either side


def rectify(
    frame: Any,
    lattice: Lattice,
    *,
    device: DeviceLike | None = None,
    pixels: int | None = None,
    complete: bool = True,
) -> Vector:
    """Resample a frame onto the lattice of its lenslets, n x n pixels each, for `Projector`.

    Pixels lie along the lattice's own vectors, so that turning, a stretch of x against y and a
    fractional pitch go at once, by separable cubic convolution (Keys 1981, eq. 15, a = -1/2), and
    carry the light of their area: the sum is kept. What interpolation leaves below 0 is 0, and so
    is what was below it. Dark and white frames are rectified alike, after the dark frame was
    subtracted.

    Parameters
    ----------
    frame : array_like
        Counts, shape (ny, nx), finite.
    lattice : Lattice
        Rectangular, as `estimate_lattice` finds it on the white frame.
    device : Device or str, optional
        None is ``Device.open()``.
    pixels : int, optional
        Number n along an axis of a lenslet, at least 0.9 of the pitch: fewer would step over light;
        default the pitch, rounded up.
    complete : bool
        Whether to leave out lenslets that do not lie on the frame with all their pixels; pixels at
        the rim of a frame are then repeated beyond it. Else it is dark there.

    Returns
    -------
    numpy.ndarray
        Counts, not negative, float32, shape (rows n, columns n).

    Raises
    ------
    ShapeError
        If the frame has another shape than the lattice's picture, or no lenslet lies on it.
    ValueError
        If the lattice is hexagonal, ``pixels`` is no positive whole number or too small, or a pixel
        is NaN.
    TypeError
        If the frame is no array of real numbers, or the lattice none.

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
        raise ShapeError(f"A frame has shape (ny, nx), not {values.shape}: rectify each by itself.")
    if lattice.shape is not None and values.shape != lattice.shape:
        raise ShapeError(f"The lattice is that of a frame of {lattice.shape}, not {values.shape}.")
    if lattice.kind == "hexagonal":
        raise ValueError("Frames of hexagonal lattices are not rectified: the lattice is square.")
    n = max(map(math.ceil, lattice.pitch)) if pixels is None else positive_integer(pixels, "pixels")
    least = math.ceil(LEAST * max(lattice.pitch))
    if n < least:
        raise ValueError(
            f"The lenslets of the frame lie {max(lattice.pitch):.5g} pixels apart, and {n} pixels "
            f"a lenslet would step over light: give at least {least}."
        )
    grid = lattice.grid((n, n), complete=complete)
    if complete:
        values = np.pad(values, REACH, mode="edge")
        grid = replace(grid, first=(grid.first[0] + REACH, grid.first[1] + REACH))
    views = device.download(resample(device.upload(values), grid, device))
    rows, columns = views.shape[2:]
    cells = np.maximum(views, 0).transpose(2, 0, 3, 1) * np.float32(area(lattice, n))
    return np.ascontiguousarray(cells.reshape(rows * n, columns * n))


def area(lattice: Lattice, pixels: int) -> float:
    """Pixels of the camera that a rectified pixel holds the light of."""
    return math.prod(lattice.pitch) / pixels**2


def variance(lattice: Lattice, pixels: int) -> float:
    """Variance of a rectified pixel over its mean, where counts are photons.

    The area times the sum of the squared weights, mean of all pixels: (57/70)^2 where they lie
    evenly between those of the camera, 1 where they lie on them.
    """
    grid = lattice.grid((pixels, pixels))
    v, kept = np.arange(pixels) - (pixels - 1) / 2, np.ones(())
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
        kept = kept * sum(np.square(weight) for weight in weights)
    return area(lattice, pixels) * float(kept.mean())


DARKEST = 0.01  # of the mean level of the white frame: darker pixels are left out
DIMMEST = 5  # per cent of the lenslets, as dark as which haze is
LEAST_PITCH = 3  # pixels that a lattice is looked for with
DARKER = 0.75  # of the pixels below the dark frame, of which noise alone puts a half
RARE = 5 * math.sqrt(2)  # times the noise of a dark frame: beyond that of two of them


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(OneLine):
    """A frame as `deconvolve` takes it.

    Attributes
    ----------
    counts, white : numpy.ndarray
        float32, shape (rows n, columns n); white 0 where pixels are left out.
    negative, left_out : int
        How many pixels of the raw frame were below 0 and are 0; how many were saturated or not
        finite.
    deep : int
        How many were further below 0 than the noise of the dark frame explains.
    size : int
        Pixels of the raw frame.
    hot : int
        How many stood out as no light does, and were left out; see `hot_pixels`.
    masked : int
        How many the mask left out.
    doubtful : int
        How many stood out where they were too many to be hot pixels: none was left out.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> frame = (0.5 * white).astype(np.uint16)
    >>> frame[30, 30] = 65535  # saturated
    >>> found = clplen.microscopy.preparation(10, white=white)(frame)
    >>> found.counts.shape, found.left_out, found.negative
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
    """Pixels that are saturated or not finite."""
    if saturation is None and values.dtype.kind in "ui":
        saturation = np.iinfo(values.dtype).max
    bad = ~np.isfinite(values)
    return bad if saturation is None else bad | (values >= saturation)


def mask_of(mask: Any, shape: tuple[int, ...] | None) -> Vector:
    """Pixels that a mask leaves out: those that are not 0."""
    values = host_array(mask, "A mask")
    if values.ndim != 2 or (shape is not None and values.shape != shape):
        wanted = "(ny, nx)" if shape is None else str(shape)
        raise ShapeError(f"The mask has shape {values.shape}, frames have {wanted}: give theirs.")
    if values.dtype.kind not in "biuf" or not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError(
            "A mask holds 0 where a pixel counts and positive numbers where it is left out, "
            "and this one holds others."
        )
    out = np.asarray(values > 0)
    if out.all():
        raise ValueError(
            "The mask leaves out every pixel: it is 0 where a pixel counts, is it inverted?"
        )
    return out


@dataclass(frozen=True, eq=False, repr=False)
class Preparation(OneLine):
    """What frames of one camera share. Made by `preparation`.

    Attributes
    ----------
    pixels : int
        n, of a lenslet along an axis.
    device : Device
        Where frames are rectified.
    dark : numpy.ndarray or None
        Dark frame, float32, shape (ny, nx).
    lattice : Lattice or None
        None where frames have n x n pixels a lenslet already.
    sensitivity : numpy.ndarray or None
        float32, rectified; 1 where a lenslet is as bright as the mean one.
    level : numpy.ndarray or None
        The white frame itself, rectified.
    mask : numpy.ndarray or None
        bool, shape (ny, nx): pixels that are left out of every frame.
    sharpest : tuple of float or None
        Of `sharpness`: pixels that stand out more are left out; None looks for none.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> found = clplen.microscopy.preparation(10, white=white)
    >>> f"{found.lattice.pitch[0]:.1f} pixels a lenslet become {found.pixels}"
    '9.6 pixels a lenslet become 10'
    >>> found(0.5 * white).counts.shape
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

    _MIN_LIGHT: ClassVar[float] = 0.0  # of the brightest lenslet: dimmer ones tell no haze

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    @property
    def area(self) -> float:
        """Pixels of the camera that a rectified pixel holds the light of."""
        return 1.0 if self.lattice is None else area(self.lattice, self.pixels)

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the dark frame, by the median of the deviations; 0 without one."""
        if self.dark is None:
            return 0.0
        return 1.4826 * float(np.median(abs(self.dark - np.median(self.dark))))

    @property
    def variance(self) -> float:
        """Of a rectified pixel over its mean, where counts are photons."""
        return 1.0 if self.lattice is None else variance(self.lattice, self.pixels)

    def __call__(self, frame: Any, *, saturation: float | None = None) -> Prepared:
        """Subtract the dark frame, rectify the frame and find the pixels that count.

        ``saturation`` is the level from which on pixels are left out, by default the largest
        integer of the frame's type. Raise `ShapeError` for a frame of another size than the white
        or dark frame, or without a whole number of lenslets, and ValueError where the dark frame is
        brighter than the frame.
        """
        values = host_array(frame, "A frame")
        self._check(values.shape)
        bad = unknown(values, saturation)
        light = np.where(bad, 0, values.astype(np.float32))
        if self.dark is not None:
            light = np.where(bad, 0, light - self.dark)
        negative = int(np.count_nonzero(light < 0))
        is_darker = negative > DARKER * light.size and light.mean(dtype=np.float64) < 0
        if self.dark is not None and is_darker:
            raise ValueError(
                f"The dark frame, {self.dark.mean():.4g} in the mean, is brighter than the frame, "
                f"{values[~bad].mean():.4g}: give that of the same camera, exposure and bits."
            )
        deep = int(np.count_nonzero(light < -RARE * self.noise)) if self.noise else 0
        light = np.maximum(light, 0)
        left_out = int(np.count_nonzero(bad))
        hot = np.zeros(light.shape, bool) if self.sharpest is None else self._hot(light, bad)
        found = int(np.count_nonzero(hot))
        doubtful = found if found > MANY * light.size else 0
        bad = bad | hot if found and not doubtful else bad
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
            found - doubtful, masked, doubtful,
        )  # fmt: skip

    def place(self, voxels: int) -> dict[str, tuple[float, float]]:
        """Return where columns of voxels lie on the raw frame, as (y, x) in pixels.

        "first" is voxel (0, 0); "down" and "right" are the steps to (1, 0) and (0, 1), of all
        planes. Centres of pixels are integers; ``voxels`` is their number along an axis of a
        lenslet.
        """
        n = self.pixels
        first, row, column = ((n - 1) / 2,) * 2, (float(n), 0.0), (0.0, float(n))
        if self.lattice is not None:
            grid = self.lattice.grid((n, n))
            first, row, column = grid.first, grid.row_step, grid.column_step
        down, right = np.array(row) / voxels, np.array(column) / voxels
        start = np.array(first) - (voxels - 1) / 2 * (down + right)
        return place_of(start, down, right)

    def haze(self, counts: Vector, white: Vector) -> Vector:
        """Return the light in a rectified frame from far beyond the volume, float32.

        It fills the pupil evenly, so that it looks like the white frame, and is as bright as in the
        darkest lenslets. ``counts`` are without other background; ``white`` is that of `Prepared`.
        """
        if self.level is None:
            raise ValueError("Haze looks like the white frame, and there is none: give it.")
        light = (self._cells(np.where(white > 0, one, 0)) for one in (counts, self.level))
        seen, full = (one.sum(axis=(1, 3), dtype=np.float64) for one in light)
        whole = full > self._MIN_LIGHT * full.max()
        share = np.percentile(seen[whole] / full[whole], DIMMEST) if whole.any() else 0.0
        return np.asarray(self.level * np.float32(max(share, 0)))

    def _cells(self, frame: Vector) -> Vector:
        """Pixels of a prepared frame by lenslet, shape (rows, n, columns, n)."""
        n = self.pixels
        return frame.reshape(frame.shape[0] // n, n, frame.shape[1] // n, n)

    def _check(self, shape: tuple[int, ...]) -> None:
        if len(shape) != 2:
            raise ShapeError(f"A raw frame has shape (ny, nx), not {shape}.")
        beside = {
            "white frame" if self.level is not None else "lattice": self.lattice,
            "dark frame": self.dark,
            "mask": self.mask,
        }
        for name, one in beside.items():
            known = None if one is None else one.shape
            if known is not None and known != shape:
                raise ShapeError(
                    f"The frame has shape {shape} and the {name} {known}: give the {name} of the "
                    "same camera and crop."
                )
        if self.lattice is None and any(n % self.pixels for n in shape):
            raise ShapeError(
                f"The frame of shape {shape} has no whole number of lenslets of {self.pixels} x "
                f"{self.pixels} pixels: give the white frame, with which it is rectified, or its "
                "lattice."
            )

    def _resampled(self, light: Vector) -> Vector:
        """A frame on whole pixels a lenslet."""
        if self.lattice is None:
            return light
        return rectify(light, self.lattice, device=self.device, pixels=self.pixels)

    def _hot(self, light: Vector, bad: Vector) -> Vector:
        """Pixels that stand out as no light does."""
        assert self.sharpest is not None
        rectified = self.pixels if self.pixels > 1 else None  # 1: of a Fourier microscope
        return hot_pixels(light, self.sharpest, self.lattice or rectified) & ~bad

    def _reached(self, bad: Vector) -> Vector:
        """Rectified pixels that a bad one has a part in."""
        if self.lattice is None:
            return bad
        wide = binary_dilation(bad, np.ones((2 * REACH + 1,) * 2, bool)).astype(np.float32)
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
    """Find the lattice and the sensitivity of the pixels.

    Parameters
    ----------
    pixels : int
        Number n of the point images along an axis of a lenslet; another pitch, a fractional one or
        a turned lattice is rectified.
    device : Device or str, optional
        None is ``Device.open()``.
    white : array_like, optional
        White frame, shape (ny, nx); without it frames are n x n pixels a lenslet already.
    dark : array_like, optional
        Dark frame, shape (ny, nx).
    saturation : float, optional
        As in `Preparation`; saturated pixels of the white frame are left out.
    force : bool
        Whether to go on where the lattice of the white frame is not to be trusted.
    lattice : Lattice, optional
        In place of that of a white frame, for frames that have none; with the shape of frames.
    mask : array_like, optional
        Shape (ny, nx), not 0 where pixels are left out.
    sharpest : tuple of float, optional
        `sharpness` of the point images: hot pixels of frames, and hot or dead ones of the white
        frame, are left out. Default: they are not looked for.

    Returns
    -------
    Preparation
        To be called with each raw frame of the same camera.

    Raises
    ------
    ShapeError
        If the white and the dark frame are of different sizes, or no lenslet lies on the frame.
    ValueError
        If the white frame is dark or mostly saturated, has no lenslets of about so many pixels, or
        a lattice that is not to be trusted and ``force`` is False; if a lattice is given beside it,
        or one that is none of a frame; if a mask holds other numbers or leaves out every pixel.

    Warns
    -----
    SamplingWarning
        If ``force`` is needed.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> found = clplen.microscopy.preparation(10, white=white)
    >>> found.sensitivity.shape, f"{found.sensitivity[found.sensitivity > 0].mean():.2f}"
    ((50, 50), '1.00')
    """
    device = as_device(device)
    pixels = positive_integer(pixels, "pixels")
    black = dark_frame(dark)
    if white is None:
        if lattice is not None:
            check_given(lattice)
        out = None if mask is None else mask_of(mask, None)
        return Preparation(pixels, device, black, lattice, None, None, out, sharpest)
    if lattice is not None:
        raise ValueError("The white frame tells its own lattice: leave the other one out.")
    seen = white_frame(
        white, dark, saturation, kind="square", pitch=max(pixels, LEAST_PITCH), mask=mask,
        find_hot=sharpest is not None, force=force,
    )  # fmt: skip
    found = Preparation(pixels, device, black, seen.lattice, None)
    level = rectify(seen.light, seen.lattice, device=device, pixels=pixels)
    if seen.bad.any():
        level[found._reached(seen.bad)] = 0
    even = _sensitivity(level, pixels)
    return replace(found, sensitivity=even, level=level, mask=seen.mask, sharpest=sharpest)


@dataclass(frozen=True, eq=False)
class WhiteFrame:
    """A white frame without its dark one, its lattice, and which of its pixels do not count."""

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
    """Find the lattice of a white frame and the pixels that do not count; refuse what is none."""
    light, bad = _white_light(white, dark_frame(dark), saturation)
    out = None if mask is None else mask_of(mask, light.shape)
    lattice = lattice_of_white(light, "The white frame", kind=kind, pitch=pitch, force=force)
    if find_hot:
        uneven = uneven_pixels(light, lattice)
        bad = bad | uneven if np.count_nonzero(uneven) <= MANY * light.size else bad
    return WhiteFrame(light, lattice, bad if out is None else bad | out, out)


def dark_frame(dark: Any) -> Vector | None:
    """A dark frame as float32, if there is one."""
    return None if dark is None else np.asarray(host_array(dark, "A dark frame"), np.float32)


def _white_light(
    white: Any, black: Vector | None, saturation: float | None
) -> tuple[Vector, Vector]:
    """A white frame without its dark one, and which of its pixels are unknown."""
    values = host_array(white, "A white frame")
    if black is not None and black.shape != values.shape:
        raise ShapeError(
            f"The white frame has shape {values.shape} and the dark frame {black.shape}: give "
            "those of the same camera and crop."
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
        raise ValueError("The white frame is no brighter than the dark one: are they exchanged?")
    return light, bad


def _sensitivity(level: Vector, n: int) -> Vector:
    """Levels over the mean of the lenslets, pixel by pixel; 0 where there is no light."""
    cells = level.reshape(level.shape[0] // n, n, level.shape[1] // n, n)
    bright = cells > DARKEST * level.mean(dtype=np.float64)
    counted = np.maximum(bright.sum(axis=(0, 2), keepdims=True), 1)
    mean = (cells * bright).sum(axis=(0, 2), keepdims=True, dtype=np.float64) / counted
    found = np.divide(cells, mean, out=np.zeros(cells.shape), where=bright)
    return found.reshape(level.shape).astype(np.float32)
