"""Pictures composed of the sub-images of a focused camera, their grid, and maps on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla

from clplen.checks import fits_float64, require
from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device
from clplen.lightfield.focused.focused_geometry import FocusedGeometry, Pair, Values
from clplen.results import Savable

_MAX_SAMPLES = 2**24  # samples along an axis
_EDGE = 1e-3  # pixels by which a sub-image may leave the sensor


@dataclass(frozen=True)
class PictureGrid:
    """Grid of a picture's samples on the sensor, by their chief rays.

    Attributes
    ----------
    first : tuple of float
        Position (y, x) of sample (0, 0) in pixels of the sensor.
    step : float
        Pixels of the sensor between samples, along both axes.
    shape : tuple of int
        Size (height, width) in samples.
    """

    first: Pair
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, geometry: FocusedGeometry, patch: float, step: float | None) -> PictureGrid:
        """Return the grid over all lenslets, by default with ``round(patch)`` samples a lenslet.

        Raises
        ------
        ValueError
            If the step is not positive and finite, or too small for an array.
        """
        if step is None:
            step = geometry.pitch / max(1, round(patch))
        if not (fits_float64(step) and step > 0):
            raise ValueError(
                f"step must be a positive number of sensor pixels per sample, got {step!r}."
            )
        centres = geometry.centres[geometry.kinds >= 0]
        half = np.array(geometry.cell) / 2
        low, high = centres.min(0) - half, centres.max(0) + half
        counts_needed = np.maximum(1, np.round((high - low) / step))
        if not counts_needed.max() < _MAX_SAMPLES:
            raise ValueError(
                f"A step of {step:g} px makes a picture of {counts_needed[0]:.3g} x "
                f"{counts_needed[1]:.3g} samples; pass a larger step."
            )
        count = counts_needed.astype(int)
        first = (low + high) / 2 - (count - 1) / 2 * step
        return cls((float(first[0]), float(first[1])), float(step), (int(count[0]), int(count[1])))

    def axes(self) -> tuple[Values, Values]:
        """Return y of the rows and x of the columns, in pixels of the sensor."""
        (first_y, first_x), (height, width) = self.first, self.shape
        y = np.asarray(first_y + self.step * np.arange(height), np.float64)
        x = np.asarray(first_x + self.step * np.arange(width), np.float64)
        return y, x


@dataclass(frozen=True, eq=False, repr=False)
class FocusedImage(Image):
    """Picture of a focused camera with its scale, inverted like the main lens' picture.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (y, x) or (y, x, c).
    device : Device
    grid : PictureGrid
    m : float
        Ratio b/a of the plane in focus (of the reference plane if depth varies).
    geometry : FocusedGeometry
    ratio : float
        Patch over pitch: ``geometry.ratio(m)``, or the ratio of a given patch.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> picture = clplen.render_focused(camera.expose(clplen.PointSources((0, 0, 0)), model="rays"))
    >>> picture.m, picture.to_numpy().ndim
    (0.25, 2)
    """

    _writer: ClassVar[str] = "write_focused"

    grid: PictureGrid
    m: float
    geometry: FocusedGeometry
    ratio: float

    @property
    def pitch(self) -> float:
        """Sample distance in metres on the main lens' image plane of ``m``.

        NaN if the pixel pitch is unknown.
        """
        return abs(self.grid.step * self._scale)

    def positions(self) -> tuple[Values, Values]:
        """Return y of rows and x of columns on the image plane of ``m``, in metres."""
        y, x = self.grid.axes()
        return (y - self.geometry.axis[0]) * self._scale, (x - self.geometry.axis[1]) * self._scale

    @property
    def _scale(self) -> float:
        """Metres on the image plane per pixel of the sensor: X = Y ratio/m."""
        return self.geometry.pixel_pitch * float(self.geometry.ratio(self.m)) / self.m


@dataclass(frozen=True, eq=False, repr=False)
class FocusedStack(Savable, OnDevice):
    """Pictures of one raw image focused on several planes, on one grid.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (n, y, x) or (n, y, x, c), registered to the main lens' middle: a point has
        one position in all pictures.
    device : Device
    grid : PictureGrid
    ms : numpy.ndarray
        Ratio b/a of each plane, float64, shape (n,).
    geometry : FocusedGeometry
    alphas : numpy.ndarray
        Ratio F/F' of each plane, float64, shape (n,); NaN without a camera.
    zs : numpy.ndarray
        Distance dz of each plane in metres from the focused plane, float64, shape (n,), farther
        positive; NaN without a camera.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)), model="rays")
    >>> stack = clplen.lightfield.focused_stack(raw, ms=[0.2, 0.25])
    >>> stack.ms.tolist()
    [0.2, 0.25]
    """

    _writer: ClassVar[str] = "write_focused"

    data: cla.Array
    device: Device
    grid: PictureGrid
    ms: Values
    geometry: FocusedGeometry
    alphas: Values
    zs: Values

    def __repr__(self) -> str:
        planes = f"{len(self.ms)} planes"
        return f"<FocusedStack {self.shape} {self.data.dtype}, {planes}, {self.device.name}>"


def seam(picture: FocusedImage) -> float:
    """Measure the mismatch of patches at their borders, 1 for invisible borders.

    A step between neighbouring samples is compared with the mean of the two steps next to it. The
    result is the mean deviation across borders of patches over the mean deviation inside. A patch
    that is too large repeats parts of the next patch, and one that is too small omits parts; both
    move the result away from 1.

    The result is nearly always above 1. It falls below 1 for patches that are too large in textures
    of less than about eight samples a period, where the step across is the smoother one. Only
    lenslets with a complete sub-image on the sensor are used.

    Parameters
    ----------
    picture : FocusedImage
        Picture rendered by ``method="basic"``, with at least five samples a patch.

    Returns
    -------
    float
        Mismatch; inf if patches are flat and borders are not, NaN if everything is flat, patches
        have fewer samples, or no two neighbouring sub-images are complete.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> scene = clplen.SurfaceScene(clplen.cameras.Plane(-0.5, texture=clplen.cameras.noise(1)))
    >>> raw = camera.expose(scene, model="rays")
    >>> clplen.lightfield.seam(clplen.render_focused(raw, method="basic")) > 0
    True
    """
    require(FocusedImage, picture, "picture", "render_focused")
    values, (owner, complete) = np.asarray(picture.to_numpy(), np.float64), _owner(picture)
    inside, across = [], []
    for axis in (0, 1):
        steps = np.moveaxis(np.diff(values, axis=axis), axis, 0)
        border = np.moveaxis(np.diff(owner, axis=axis) != 0, axis, 0)
        complete_along = np.moveaxis(complete, axis, 0)
        size = np.abs(steps[1:-1] - (steps[:-2] + steps[2:]) / 2)
        size = size.mean(2) if size.ndim == 3 else size
        counts = complete_along[1:-2] & complete_along[2:-1] & ~(border[:-2] | border[2:])
        across.append(size[border[1:-1] & counts])
        inside.append(size[~border[1:-1] & counts])
    sizes_of_steps = [np.concatenate(sizes) for sizes in (across, inside)]
    if min(map(len, sizes_of_steps)) == 0:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(sizes_of_steps[0].mean() / sizes_of_steps[1].mean())


def _owner(picture: FocusedImage) -> tuple[Values, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return the nearest lenslet of each sample, and a mask of complete sub-images."""
    geometry = picture.geometry
    y, x = picture.grid.axes()
    positions = np.stack(np.meshgrid(y, x, indexing="ij"), -1) - np.array(geometry.origin)
    base = np.array([geometry.first, geometry.second])
    low = np.floor(positions @ np.linalg.inv(base))
    best, owner = np.full(positions.shape[:2], np.inf), np.zeros(positions.shape[:2])
    centre = np.zeros_like(positions)
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        index = low + corner
        candidates = index @ base
        distance = ((positions - candidates) ** 2).sum(-1)
        closer = distance < best
        best[closer] = distance[closer]
        owner[closer] = (index[..., 0] * 65536 + index[..., 1])[closer]
        centre[closer] = candidates[closer]
    margin = geometry.pitch / 2 - _EDGE
    low, high = margin - 0.5, np.array(geometry.shape) - 0.5 - margin
    centre += geometry.origin
    return owner, ((centre >= low) & (centre <= high)).all(-1)


_WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # pitches: widths of the Gaussians that fill gaps
_MIN_WEIGHT = 0.15  # minimum weight under a Gaussian
_NEIGHBOUR_RADIUS = 1.8  # pitches
_MIN_NEIGHBOUR_WEIGHT = 0.3  # minimum weight of a neighbour in the median


def median_of_neighbours(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Return the median over the neighbours within 1.8 pitches, without the lenslet itself."""
    valid = np.where((weights >= _MIN_NEIGHBOUR_WEIGHT) & (geometry.kinds >= 0), values, np.nan)
    lines, lenses = valid.shape
    margin = 3
    padded = np.pad(valid, margin, constant_values=np.nan)
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    near = []
    for i, j in product(range(-margin, margin + 1), repeat=2):
        distance = np.linalg.norm(np.array([i, j]) @ base)
        if 0 < distance < _NEIGHBOUR_RADIUS:
            near.append(padded[margin + i :, margin + j :][:lines, :lenses])
    stack = np.array(near)
    has_neighbours = np.isfinite(stack).any(0)
    stack[:, ~has_neighbours] = 0
    return np.where(has_neighbours, np.nanmedian(stack, axis=0), np.nan)


def fill_lenslets(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Smooth valid values and extrapolate them to the others.

    Normalised convolution (Knutsson & Westin 1993) with the narrowest Gaussian of enough weight.
    """
    from scipy.ndimage import convolve

    out = np.full(values.shape, float(np.average(values, weights=weights)))
    missing = np.ones(values.shape, bool)
    for width in _WIDTHS:
        kernel = _gaussian(width, geometry)
        level = convolve(weights, kernel, mode="constant")
        mean = convolve(weights * values, kernel, mode="constant")
        selected = missing & (level > _MIN_WEIGHT)
        out[selected] = mean[selected] / level[selected]
        missing &= ~selected
    return out


def interpolate_lenslets(values: Values, geometry: FocusedGeometry, grid: PictureGrid) -> Values:
    """Interpolate lenslet values to the samples of a picture, bilinearly along the lattice."""
    from scipy.ndimage import map_coordinates

    y, x = (axis - start for axis, start in zip(grid.axes(), geometry.origin, strict=True))
    inverse = np.linalg.inv(np.array([geometry.first, geometry.second]))
    at = [y[:, None] * inverse[0, n] + x[None, :] * inverse[1, n] for n in (0, 1)]
    return np.asarray(map_coordinates(values, at, order=1, mode="nearest"))


def _gaussian(width: float, geometry: FocusedGeometry) -> Values:
    """Return a Gaussian over the lattice, sum 1; ``width`` in pitches."""
    reach = int(np.ceil(3 * width)) + 1
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    square = ((np.stack([i, j], -1) @ base) ** 2).sum(-1)
    kernel = np.exp(-square / (2 * width**2))
    return np.asarray(kernel / kernel.sum())
