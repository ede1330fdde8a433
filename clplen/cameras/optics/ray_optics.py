"""Lengths and rays of the plenoptic cameras: a main lens, an array of lenslets, a sensor.

Cameras differ in two distances: z2, main lens to array, and z3, array to sensor. With the
magnification m of the lenslets, 0 if the array lies on the main lens' image at F, they are
z2 = F + f (1 + 1/m) and z3 = f (1 + m). A point at dz, imaged through the main lens at F', sends a
ray from u on the lens to

    x = X + u (1 - beta),   beta = z2/F' = alpha z2/F,   X = -(x, y) z2/(object distance + dz)

on the array, with the slope (X - beta u)/z2; X is where the chief ray, u = 0, meets the array. The
lenslet centred at c sends the ray on to s = x + z3 ((x - u)/z2 - (x - c)/f) on the sensor, and the
chief ray of a lenslet (x = c, u = 0) to c (1 + z3/z2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.camera_aberrations import NONE, Aberrations
from clplen.cameras.optics.color_filters import ColorFilterArray
from clplen.cameras.optics.lenslet_camera import LensletCamera, lenslet_grid
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.checks import real_array
from clplen.compute.device import Device
from clplen.errors import SamplingError
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.raw.raw_image import RawImage
from clplen.units import metres
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid

LensModel = Literal["thin", "corrected"]

NEARLY_PARAXIAL = 1e-3  # relative change of the pupil image's size below which spacing is paraxial
_RADII, _ANGLES = 5, 10  # points on lenslets and pupils, along radius and angle
Positions = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, repr=False)
class RayOptics(LensletCamera):
    """Lengths and rays of a plenoptic camera; `Plenoptic1` and `Plenoptic2` document its fields."""

    focal_length: float
    object_distance: float
    image_distance: float
    aperture_diameter: float
    mla: MicrolensArray
    wavelength: float
    pixels_per_lenslet: float
    pixel_pitch: float
    grid: Grid
    field_lens: bool
    device: Device
    aberrations: Aberrations = field(default=NONE, kw_only=True)
    lens_model: LensModel = field(default="thin", kw_only=True)
    pixels: PixelArray | None = field(default=None, kw_only=True)
    m: float = field(default=0.0, kw_only=True)

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} f = {metres(self.focal_length)}, {self._sensor}, "
            f"{metres(self.wavelength)}, {self.device.name}>"
        )

    @property
    def filters(self) -> ColorFilterArray | None:
        """Colour filters of the pixels."""
        return None if self.pixels is None else self.pixels.filters

    @property
    def a(self) -> float:
        """Distance f (1 + 1/m) from the main lens' image to the array in metres; < 0: Galilean."""
        return self.mla.focal_length * (1 + 1 / self.m) if self.m else 0.0

    @property
    def b(self) -> float:
        """Distance f (1 + m) from the array to the sensor in metres, without its shift."""
        return self.mla.focal_length * (1 + self.m)

    @property
    def array_distance(self) -> float:
        """Distance z2 = F + a from the main lens to the array in metres."""
        return self.image_distance + self.a

    @property
    def sensor_distance(self) -> float:
        """Distance z3 = b from the array to the sensor plus the sensor's shift, in metres."""
        return self.b + self.aberrations.sensor_shift

    def alpha(self, dz: Any) -> Any:
        """Compute alpha = F/F' = F (1/f - 1/(object distance + dz)) of an object at dz.

        Parameters
        ----------
        dz : float or array_like
            Distance from the focused plane in metres, > 0 farther from the lens.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            If the object is not in front of the lens.
        """
        z = self.object_distance + real_array(dz, "dz", np.float64)
        if not (z > 0).all():
            raise ValueError(
                f"dz must be above {-self.object_distance:g} m, in front of the lens, got "
                f"{np.min(dz):g} m."
            )
        alpha = self.image_distance * (1 / self.focal_length - 1 / z)
        return float(alpha) if alpha.ndim == 0 else alpha

    def dz(self, alpha: Any) -> Any:
        """Compute the inverse of `alpha` in metres; infinite at F/f, NaN beyond."""
        rest = 1 / self.focal_length - real_array(alpha, "alpha", np.float64) / self.image_distance
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(rest >= 0, 1 / np.maximum(rest, 0), np.nan) - self.object_distance
        return float(z) if z.ndim == 0 else z

    def array_alpha(self, dz: Any) -> Any:
        """Compute beta = z2/F': `alpha` of an object at dz for the array's plane instead of F."""
        return self.alpha(dz) * (self.array_distance / self.image_distance)

    def image_of(self, positions: Any) -> np.ndarray[Any, Any]:
        """Compute the image positions of points on the plane F, along their chief rays.

        Parameters
        ----------
        positions : array_like
            (x, y, dz) in metres, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            (x, y) = -(x, y) F/(object distance + dz) in metres, shape (n, 2).
        """
        return self.on_array(positions) * (self.image_distance / self.array_distance)

    def on_array(self, positions: Any) -> np.ndarray[Any, Any]:
        """Compute the positions of points' chief rays on the array: `image_of` with z2 for F."""
        points = np.atleast_2d(real_array(positions, "positions", np.float64))
        return np.asarray(points[:, :2] * self.array_scale(points[:, 2])[:, None])

    def array_scale(self, dz: Any) -> Any:
        """Compute -z2/(object distance + dz): a position on the array over that of its object."""
        return -self.array_distance / (self.object_distance + real_array(dz, "dz", np.float64))

    @property
    def spot_variance(self) -> float:
        """Variance of a point's image by pixels and lenslet aberrations, in square pixels."""
        return super().spot_variance + pupil_image(self)[1] / self.pixel_pitch**2

    @property
    def sub_image_scale(self) -> float:
        """Distance of sub-images over distance of lenslets, 1 + z3/z2."""
        return 1.0 if self.field_lens else 1 + self.sensor_distance / self.array_distance

    def spread(self, dz: Any) -> Any:
        """Compute the reach of a point's light on the sensor from X `sub_image_scale`, in metres.

        s - X (1 + z3/z2) = u (1 - beta (1 + z3/z2)) - z3 (x - c)/f, u up to D/2 and x - c to d/2;
        with a field lens the first term is u (1 - beta - z3/z2). A wavefront of slope w on the main
        lens adds up to w (z2 + z3), a wavefront on the lenslets w z3.
        """
        behind = self.sensor_distance / self.array_distance
        beta = self.array_alpha(dz)
        moved = np.abs(1 - beta - behind * (1 if self.field_lens else beta))
        steepest = self.mla.steepest_slope(self.wavelength)
        steepest += self.aberrations.lenslet_slope(self.mla)
        bent = self.main_slope() * (self.array_distance + self.sensor_distance)
        return moved * self.lit_diameter / 2 + bent + self.sensor_distance * steepest

    def main_slope(self, reach: float | None = None) -> float:
        """Return an upper bound of the slope of the main lens' wavefront in radians.

        For points imaged up to ``reach`` from the axis along y and x; None: up to the sensor's rim.
        """
        at_rim = max(self.grid.extent) / 2 * self.image_distance / self.array_distance
        farthest = at_rim if reach is None else reach
        return self.aberrations.main_slope(
            farthest,
            self.aperture_diameter / 2,
            image_distance=self.image_distance,
            wavelength=self.wavelength,
        )

    @property
    def lit_diameter(self) -> float:
        """Diameter in metres of the circle about the axis that contains all light at the main lens.

        It is larger than the aperture if OPD maps shift the pupil.
        """
        return self.aperture_diameter * self.aberrations.pupil_reach

    def ray_matrix(self, dz: float = 0.0, *, lens_type: int = 0) -> np.ndarray[Any, Any]:
        """Compute the ABCD matrix of a lenslet, from the image of the plane dz to the sensor.

        It maps (distance from the lenslet's axis in metres, slope): free space b after a thin lens
        after free space a' (Georgiev and Lumsdaine 2010, "Focused plenoptic camera and rendering"),

            [[1 - b/f, a' + b - a' b/f], [-1/f, 1 - a'/f]],    a' = z2 - F', b = z3.

        In focus (1/a' + 1/b = 1/f) it is [[-m, 0], [-1/f, -1/m]], m = b/a'; a 1.0 camera in focus
        has [[0, f], [-1/f, 1]]. The determinant is 1.

        Parameters
        ----------
        dz : float
            Distance of the object from the focused plane in metres.
        lens_type : int
            Index among the array's focal lengths.

        Returns
        -------
        numpy.ndarray
            float64, shape (2, 2).

        Raises
        ------
        ValueError
            If the array has no such lens type, or dz lies behind the main lens or at its focus.
        """
        kinds = self.mla.focal_lengths
        if not 0 <= lens_type < len(kinds):
            raise ValueError(f"lens_type must be 0 to {len(kinds) - 1}, got {lens_type!r}.")
        alpha = self.alpha(dz)
        if abs(alpha) < 1e-12:
            raise ValueError(f"An object at dz = {dz:g} m is imaged at infinity: use another dz.")
        f, b = kinds[lens_type], self.sensor_distance
        a = self.array_distance - self.image_distance / alpha
        return np.array([[1 - b / f, a + b - a * b / f], [-1 / f, 1 - a / f]])


def is_sampled(optics: RayOptics, reach: float, alpha: float) -> bool:
    """Return True if pixels sample the light and hold the main lens' aperture: `check_sampling`."""
    try:
        check_sampling(optics, reach, alpha)
    except SamplingError:
        return False
    return True


def check_sampling(optics: RayOptics, reach: float, alpha: float) -> None:
    """Raise for light that the pixels cannot sample, or an aperture wider than the window.

    [(beta D/2 + abs(X))/z2 + d/(2 f)]/lam < 1/(2 dx). A ray from u on the lens to X + u (1 - beta)
    on the array has the slope (X - beta u)/z2, and a lenslet adds -(x - c)/f, x - c up to d/2.
    For a 2.0 camera with its image in focus, beta = z2/F, this is (X/z2 + D/(2 F)) + d/(2 f).
    Light converges within d/(2 b) about the chief ray of a lenslet, slope (c - X)/a. Lenslets at
    the rim of the blur, abs(c - X) up to a D/(2 F) + d/2, raise that to d/(2 f), 1/f = 1/a + 1/b.
    The smallest of several f counts, and aberrations add the slopes of their wavefronts.
    """
    D, z2 = optics.lit_diameter, optics.array_distance
    bent = optics.main_slope(reach * optics.image_distance / z2)
    bent += optics.aberrations.lenslet_slope(optics.mla)
    slope = (alpha * D / 2 + reach) / z2 + optics.mla.steepest_slope(optics.wavelength) + bent
    if 2 * optics.pixel_pitch * slope >= optics.wavelength:
        fitting = optics.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / optics.wavelength:.4g} cycles/m "
            f"((alpha D/2 + |X|)/z2 + d/(2 f_mu), |X| = {reach:.4g} m"
            f"{f', aberrations {bent:.4g} rad' if bent else ''}), but pixels of "
            f"{optics.pixel_pitch:.4g} m sample {1 / (2 * optics.pixel_pitch):.4g}: use pixels "
            f"below {fitting:.4g} m (pixels_per_lenslet = {optics.mla.pitch / fitting:.4g}), "
            f"a longer f_mu, {'smaller aberrations, ' if bent else ''}a smaller aperture, or "
            "method='local' for points and self-luminous pictures."
        )
    if min(optics.grid.extent) < D:
        raise SamplingError(
            f"The window must hold the main lens' aperture of {D:.4g} m, but is "
            f"{min(optics.grid.extent):.4g} m wide: use more lenslets, a smaller "
            "aperture_diameter, or method='local' for points and self-luminous pictures."
        )


def check_in_view(optics: RayOptics, positions: Positions) -> None:
    """Raise for points behind the lens, with a chief ray beyond the array, or beyond OPD maps."""
    behind = optics.object_distance + positions[:, 2] <= 0
    if behind.any():
        x, y, dz = positions[behind][0]
        near = optics.object_distance + dz / 1e3 > 0 and abs(dz) >= 1
        hint = f"; positions are in metres, did you mean dz = {dz / 1e3:g}?" if near else "."
        raise ValueError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is behind the main lens, "
            f"{optics.object_distance:g} m from the focused plane{hint}"
        )
    grid = optics.grid
    images, half = optics.on_array(positions), np.asarray(grid.extent)[::-1] / 2
    middle = np.array(
        [
            o + ((n - 1) / 2 - n // 2) * d
            for o, n, d in zip(grid.origin, grid.shape, grid.pitch, strict=True)
        ]
    )[::-1]  # (x, y)
    outside = (np.abs(images - middle) > half).any(axis=1)
    if outside.any():
        point, (X, Y) = positions[outside][0], images[outside][0]
        x, y, dz = point
        # the image is upside down
        scale = float(optics.array_scale(dz))
        (left, top), (right, bottom) = (middle + half) / scale, (middle - half) / scale
        hint = ""
        if (np.abs(images[outside][0] / 1e3 - middle) <= half).all() and np.abs(
            point[:2]
        ).max() >= 1:
            hint = f"; positions are in metres, did you mean ({x / 1e3:g}, {y / 1e3:g})?"
        raise SamplingError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is imaged at ({X:g}, {Y:g}) m, "
            f"beyond the array of {2 * half[0]:g} x {2 * half[1]:g} m. At this dz the field of "
            f"view is x from {left:.4g} to {right:.4g} m, y from {top:.4g} to {bottom:.4g} m: "
            f"move the point or use more lenslets{hint or '.'}"
        )
    maps = optics.aberrations.main_lens_opd
    if maps is not None:
        maps.check(optics.image_of(positions)[:, ::-1], optics.wavelength)


def thin_spherical(D: float, object_distance: float, image_distance: float) -> float:
    """Return the path at the rim of a thin lens relative to a corrected lens, in metres.

    rho^4/8 (1/object^3 + 1/image^3), rho = D/2: the difference of exact spherical waves from a
    quadratic phase (Goodman 2005, eq. 5-10, with one more order).
    """
    return (D / 2) ** 4 / 8 * (object_distance**-3 + image_distance**-3)


def view_step(optics: RayOptics) -> float:
    """Return du = dx z2/z3: distance on the main lens of adjacent pixels' views, in metres."""
    return optics.pixel_pitch * optics.array_distance / optics.sensor_distance


def pupil_image(optics: RayOptics) -> tuple[float, float]:
    """Compute size and variance of the lenslets' image of the main lens, by exact rays.

    A ray from u on the main lens through x on a lenslet reaches the sensor at
    s = x + z3 l/sqrt(1 - l^2 - m^2), with the direction cosines (l, m) behind the lenslet. Its
    difference from paraxial rays is a line in u plus scatter. The line enlarges the image of the
    pupil, by 1 + d^2/(8 f^2) to first order for a round parabolic lenslet and a small pupil; the
    scatter is the aberration of the lenslet. Rays that fall into another lenslet's sub-image are
    ignored.
    """
    mla, z2, z3 = optics.mla, optics.array_distance, optics.sensor_distance
    cell = math.sqrt(mla.pitch * mla.row_pitch / math.pi)
    y, x = _disc(cell if mla.fill == "full" else mla.diameter / 2)
    v, u = (a[:, None] for a in _disc(optics.aperture_diameter / 2))
    down, right = mla.bend(np.zeros(y.size, int), y, x, optics.wavelength)
    to_y, to_x = (-v, -u) if optics.field_lens else (y - v, x - u)
    away = np.sqrt(z2**2 + to_y**2 + to_x**2)
    cos_y, cos_x = to_y / away + down, to_x / away + right
    squares = cos_y**2 + cos_x**2
    scale = z3 / np.sqrt(np.where(squares < 1, 1 - squares, np.nan))
    within = np.hypot(y + scale * cos_y, x + scale * cos_x) < optics.sub_image_scale * cell
    beyond = np.where(within, scale * cos_x - z3 * (to_x / z2 + right), 0)
    u = np.where(within, u, 0)
    slope = float((beyond * u).sum() / (u * u).sum())
    variance = float(((beyond - slope * u) ** 2).sum() / within.sum())
    return 1 - slope * z2 / z3, variance


def _disc(radius: float) -> tuple[Positions, Positions]:
    """Return (y, x) of points that divide a disc evenly."""
    r = radius * np.sqrt((np.arange(_RADII) + 0.5) / _RADII)[:, None]
    angles = 2 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    return (r * np.sin(angles)).ravel(), (r * np.cos(angles)).ravel()


def raw_image(optics: RayOptics, data: cla.Array, *, paraxial: bool = False) -> RawImage:
    """Return a RawImage with the positions of sub-images and cells, without its camera.

    It has no spacing if the array is not on the main lens' image: each sub-image is then a picture,
    and alpha is not that of the light field on the array.
    """
    step = view_step(optics)
    on_image = optics.array_distance == optics.image_distance
    larger = 1.0 if paraxial or not on_image else pupil_image(optics)[0]
    if abs(larger - 1) > NEARLY_PARAXIAL:
        step /= larger
    filters = optics.filters
    return RawImage(
        data,
        optics.device,
        optics.pixel_pitch,
        lenslet_grid(optics, optics.sub_image_scale),
        lenslet_grid(optics, 1.0),
        (-step, -step, optics.mla.row_pitch, optics.mla.pitch) if on_image else None,
        lens_types=lens_types(optics),
        mosaic=None if filters is None else filters.mosaic,
    )


def lens_types(optics: RayOptics) -> tuple[LensType, ...]:
    """Return the sub-image positions and the range of sharp depths for each focal length.

    A type is in focus at the virtual depth a/b, 1/a = 1/f - 1/b. The blur on the sensor is
    d abs(b/a' - b/a), so that ranges of neighbouring types meet in the middle between their b/a.
    The outermost ranges are symmetric.
    """
    mla, b = optics.mla, optics.sensor_distance
    if len(mla.focal_lengths) == 1:
        return ()
    focus = np.array([b / f - 1 for f in mla.focal_lengths])  # b/a
    order = np.argsort(focus)
    steps = np.diff(focus[order]) / 2
    low, high = np.empty_like(focus), np.empty_like(focus)
    low[order] = focus[order] - np.concatenate([steps[:1], steps])
    high[order] = focus[order] + np.concatenate([steps, steps[-1:]])
    grid = lenslet_grid(optics, optics.sub_image_scale)
    shift = np.array(grid.row_step) + grid.odd_row_shift * np.array(grid.column_step)
    base = np.array([shift, grid.column_step])
    types = []
    for number, sharp in enumerate(focus):
        side = (0, math.inf) if sharp > 0 else (-math.inf, 0)
        ends = np.clip((low[number], high[number]), *side)
        depths = sorted(float(1 / end) if end else math.copysign(math.inf, sharp) for end in ends)
        vectors = np.array([(0, number), (1, -mla.type_step), (0, len(focus))]) @ base
        offset, *steps_of = ((float(y), float(x)) for y, x in vectors)
        types.append(LensType(offset, (depths[0], depths[1]), (steps_of[0], steps_of[1])))
    return tuple(types)
