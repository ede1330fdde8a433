"""Pictures put together from the sub-images of a focused camera, their grid, and maps on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla

from clplen.checks import fits_float64, require
from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device
from clplen.lightfield.focused.focused_geometry import FocusedGeometry, Pair, Values
from clplen.results import Savable

_MOST = 2**24  # samples along an axis
_EDGE = 1e-3  # pixels of a sub-image off the sensor that do not matter


@dataclass(frozen=True)
class PictureGrid:
    """Where the samples of a picture lie on the sensor, by their chief rays.

    Attributes
    ----------
    first : tuple of float
        (y, x) of sample (0, 0) in pixels of the sensor.
    step : float
        Pixels of the sensor from sample to sample, both ways.
    shape : tuple of int
        (height, width) in samples.
    """

    first: Pair
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, geometry: FocusedGeometry, patch: float, step: float | None) -> PictureGrid:
        """The cells of all lenslets, by default with ``round(patch)`` samples a lenslet.

        Raises
        ------
        ValueError
            If the step is not positive and finite, or so small that no array counts the samples.
        """
        if step is None:
            step = geometry.pitch / max(1, round(patch))
        if not (fits_float64(step) and step > 0):
            raise ValueError(
                f"step, pixels of the sensor from sample to sample, is positive, not {step!r}."
            )
        centres = geometry.centres[geometry.kinds >= 0]
        half = np.array(geometry.cell) / 2
        low, high = centres.min(0) - half, centres.max(0) + half
        wanted = np.maximum(1, np.round((high - low) / step))
        if not wanted.max() < _MOST:
            raise ValueError(
                f"A step of {step:g} px makes a picture of {wanted[0]:.3g} x {wanted[1]:.3g} "
                "samples: give a larger one."
            )
        count = wanted.astype(int)
        first = (low + high) / 2 - (count - 1) / 2 * step
        return cls((float(first[0]), float(first[1])), float(step), (int(count[0]), int(count[1])))

    def axes(self) -> tuple[Values, Values]:
        """Places y of the rows and x of the columns, in pixels of the sensor."""
        (first_y, first_x), (height, width) = self.first, self.shape
        y = np.asarray(first_y + self.step * np.arange(height), np.float64)
        x = np.asarray(first_x + self.step * np.arange(width), np.float64)
        return y, x


@dataclass(frozen=True, eq=False, repr=False)
class FocusedImage(Image):
    """A picture of a focused camera with its scale; inverted like the main lens' own picture.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (y, x) or (y, x, c).
    device : Device
    grid : PictureGrid
    m : float
        b/a of the plane that was asked for (the reference plane where depth varied).
    geometry : FocusedGeometry
    ratio : float
        Patch over pitch that was taken: ``geometry.ratio(m)``, or what a given patch amounts to.

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
        """Metres from sample to sample on the main lens' image plane of ``m``.

        NaN where the pixel pitch is not known.
        """
        return abs(self.grid.step * self._scale)

    def positions(self) -> tuple[Values, Values]:
        """Positions (y of rows, x of columns) on the image plane of ``m``, metres from the axis."""
        y, x = self.grid.axes()
        return (y - self.geometry.axis[0]) * self._scale, (x - self.geometry.axis[1]) * self._scale

    places = property(attrgetter("positions"), doc="Alias of `positions`.")

    @property
    def _scale(self) -> float:
        """Metres on the image plane a pixel of the sensor: X = Y ratio/m."""
        return self.geometry.pixel_pitch * float(self.geometry.ratio(self.m)) / self.m


@dataclass(frozen=True, eq=False, repr=False)
class FocusedStack(Savable, OnDevice):
    """Pictures of one raw image focused on several planes, on one grid. By `focused_stack`.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (n, y, x) or (n, y, x, c), registered to the main lens' middle: a point lies
        at the same sample in each.
    device : Device
    grid : PictureGrid
    ms : numpy.ndarray
        float64, shape (n,): b/a of each plane.
    geometry : FocusedGeometry
    alphas : numpy.ndarray
        float64, shape (n,): F/F' of each plane; NaN without a camera.
    zs : numpy.ndarray
        float64, shape (n,): dz of each plane in metres from the focused one, farther positive; NaN
        without a camera.

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
    """How far patches fail to join: 1 where their borders do not show.

    A step between neighbouring samples is compared with the mean of the two steps beside it; the
    result is the mean deviation of the steps across borders of patches over that of the steps
    inside, whose neighbours do not cross either. A patch that is too large repeats what the next
    one shows, one too small leaves some out: both make the result deviate from 1.

    Nearly always it is above 1. Below 1 patches are too large: the step across is then shorter
    than those inside, and so the smoother one in textures of less than some eight samples a
    period. Only lenslets count whose whole sub-image lies on the sensor.

    Parameters
    ----------
    picture : FocusedImage
        Rendered by ``method="basic"``, with at least five samples a patch.

    Returns
    -------
    float
        inf where patches are flat and their borders are not; NaN where all is flat, patches have
        fewer samples, or no two neighbouring sub-images lie whole on the sensor.

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
    values, (owner, whole) = np.asarray(picture.to_numpy(), np.float64), _owner(picture)
    inside, across = [], []
    for axis in (0, 1):
        steps = np.moveaxis(np.diff(values, axis=axis), axis, 0)
        border = np.moveaxis(np.diff(owner, axis=axis) != 0, axis, 0)
        whole_along = np.moveaxis(whole, axis, 0)
        size = np.abs(steps[1:-1] - (steps[:-2] + steps[2:]) / 2)
        size = size.mean(2) if size.ndim == 3 else size
        counts = whole_along[1:-2] & whole_along[2:-1] & ~(border[:-2] | border[2:])
        across.append(size[border[1:-1] & counts])
        inside.append(size[~border[1:-1] & counts])
    found = [np.concatenate(sizes) for sizes in (across, inside)]
    if min(map(len, found)) == 0:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(found[0].mean() / found[1].mean())


def _owner(picture: FocusedImage) -> tuple[Values, np.ndarray[Any, np.dtype[np.bool_]]]:
    """A number of the lenslet nearest to each sample, and whether its sub-image is whole."""
    geometry = picture.geometry
    y, x = picture.grid.axes()
    place = np.stack(np.meshgrid(y, x, indexing="ij"), -1) - np.array(geometry.origin)
    base = np.array([geometry.first, geometry.second])
    low = np.floor(place @ np.linalg.inv(base))
    best, owner = np.full(place.shape[:2], np.inf), np.zeros(place.shape[:2])
    centre = np.zeros_like(place)
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        index = low + corner
        at = index @ base
        far = ((place - at) ** 2).sum(-1)
        closer = far < best
        best[closer] = far[closer]
        owner[closer] = (index[..., 0] * 65536 + index[..., 1])[closer]
        centre[closer] = at[closer]
    room = geometry.pitch / 2 - _EDGE
    low, high = room - 0.5, np.array(geometry.shape) - 0.5 - room
    centre += geometry.origin
    return owner, ((centre >= low) & (centre <= high)).all(-1)


_WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # pitches, of the Gaussians that fill gaps
_ENOUGH = 0.15  # weight from which on a Gaussian's mean is taken
_NEIGHBOURS = 1.8  # pitches
_COUNTING = 0.3  # weight from which on a neighbour counts for the median


def median_of_neighbours(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Median over the neighbours within 1.8 pitches, the lenslet itself left out."""
    known = np.where((weights >= _COUNTING) & (geometry.kinds >= 0), values, np.nan)
    lines, lenses = known.shape
    margin = 3
    padded = np.pad(known, margin, constant_values=np.nan)
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    near = []
    for i, j in product(range(-margin, margin + 1), repeat=2):
        far = np.linalg.norm(np.array([i, j]) @ base)
        if 0 < far < _NEIGHBOURS:
            near.append(padded[margin + i :, margin + j :][:lines, :lenses])
    stack = np.array(near)
    some = np.isfinite(stack).any(0)
    stack[:, ~some] = 0
    return np.where(some, np.nanmedian(stack, axis=0), np.nan)


def fill_lenslets(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Values smoothed where they are known, and carried on where they are not.

    Normalised convolution (Knutsson & Westin 1993) with the narrowest of some Gaussians that finds
    enough weight.
    """
    from scipy.ndimage import convolve

    out = np.full(values.shape, float(np.average(values, weights=weights)))
    missing = np.ones(values.shape, bool)
    for width in _WIDTHS:
        kernel = _gaussian(width, geometry)
        level = convolve(weights, kernel, mode="constant")
        mean = convolve(weights * values, kernel, mode="constant")
        now = missing & (level > _ENOUGH)
        out[now] = mean[now] / level[now]
        missing &= ~now
    return out


def interpolate_lenslets(values: Values, geometry: FocusedGeometry, grid: PictureGrid) -> Values:
    """Values at the samples of a picture, bilinear along the lattice's vectors."""
    from scipy.ndimage import map_coordinates

    y, x = (axis - start for axis, start in zip(grid.axes(), geometry.origin, strict=True))
    inverse = np.linalg.inv(np.array([geometry.first, geometry.second]))
    at = [y[:, None] * inverse[0, n] + x[None, :] * inverse[1, n] for n in (0, 1)]
    return np.asarray(map_coordinates(values, at, order=1, mode="nearest"))


def _gaussian(width: float, geometry: FocusedGeometry) -> Values:
    """A Gaussian over the lattice, sum 1; ``width`` in pitches."""
    reach = int(np.ceil(3 * width)) + 1
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    square = ((np.stack([i, j], -1) @ base) ** 2).sum(-1)
    kernel = np.exp(-square / (2 * width**2))
    return np.asarray(kernel / kernel.sum())
