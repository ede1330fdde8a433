"""Lengths and rays of the plenoptic cameras: a main lens, an array of lenslets, a sensor.

They differ in two distances: z2, main lens to array, and z3, array to sensor. With the
magnification m of the lenslets, 0 where the array lies on the main lens' image at F, they are
z2 = F + f (1 + 1/m) and z3 = f (1 + m). A point at dz whose image through the main lens lies at F'
puts a ray from u on the lens to

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

NEARLY_PARAXIAL = 1e-3  # of the size of the pupil's image, which no depth is as exact as
_RADII, _ANGLES = 5, 10  # of points on lenslets and pupils
Positions = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, repr=False)
class RayOptics(LensletCamera):
    """A plenoptic camera as lengths and rays; `Plenoptic1` and `Plenoptic2` document its fields."""

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
        """From the main lens' image to the array in metres, f (1 + 1/m); < 0: Galilean."""
        return self.mla.focal_length * (1 + 1 / self.m) if self.m else 0.0

    @property
    def b(self) -> float:
        """From the array to the sensor in metres, f (1 + m), unless the sensor is moved."""
        return self.mla.focal_length * (1 + self.m)

    @property
    def array_distance(self) -> float:
        """z2 = F + a in metres, from the main lens to the array."""
        return self.image_distance + self.a

    @property
    def sensor_distance(self) -> float:
        """z3 = b in metres, from the array to the sensor, and what the sensor is moved by."""
        return self.b + self.aberrations.sensor_shift

    def alpha(self, dz: Any) -> Any:
        """alpha = F/F' = F (1/f - 1/(object distance + dz)) of an object at dz.

        Parameters
        ----------
        dz : float or array_like
            In metres, > 0 farther from the lens than the focused plane.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            If the object does not lie in front of the lens.
        """
        z = self.object_distance + real_array(dz, "dz", np.float64)
        if not (z > 0).all():
            raise ValueError(
                f"dz = {np.min(dz):g} m lies behind the lens, {self.object_distance:g} m from the "
                "plane."
            )
        alpha = self.image_distance * (1 / self.focal_length - 1 / z)
        return float(alpha) if alpha.ndim == 0 else alpha

    def dz(self, alpha: Any) -> Any:
        """The inverse of `alpha`, in metres; infinite at F/f, NaN beyond."""
        rest = 1 / self.focal_length - real_array(alpha, "alpha", np.float64) / self.image_distance
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(rest >= 0, 1 / np.maximum(rest, 0), np.nan) - self.object_distance
        return float(z) if z.ndim == 0 else z

    def array_alpha(self, dz: Any) -> Any:
        """beta = z2/F', the ratio `alpha` of an object at dz on the array's plane in place of F."""
        return self.alpha(dz) * (self.array_distance / self.image_distance)

    def image_of(self, positions: Any) -> np.ndarray[Any, Any]:
        """Where points are imaged on the plane F, along their chief rays.

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
        """Where chief rays of points meet the array, as `image_of` with z2 in place of F."""
        places = np.atleast_2d(real_array(positions, "positions", np.float64))
        return np.asarray(places[:, :2] * self.array_scale(places[:, 2])[:, None])

    def array_scale(self, dz: Any) -> Any:
        """-z2/(object distance + dz): a place on the array over that of its object."""
        return -self.array_distance / (self.object_distance + real_array(dz, "dz", np.float64))

    @property
    def spot_variance(self) -> float:
        """As of every camera with lenslets, and by the aberrations of the lenslets."""
        return super().spot_variance + pupil_image(self)[1] / self.pixel_pitch**2

    @property
    def sub_image_scale(self) -> float:
        """1 + z3/z2, how much farther apart than the lenslets their sub-images lie."""
        return 1.0 if self.field_lens else 1 + self.sensor_distance / self.array_distance

    def spread(self, dz: Any) -> Any:
        """How far a point's light reaches on the sensor from X `sub_image_scale`, in metres.

        s - X (1 + z3/z2) = u (1 - beta (1 + z3/z2)) - z3 (x - c)/f, u up to D/2 and x - c to d/2;
        with a field lens u (1 - beta - z3/z2) in the first place. A wavefront of slope w on the
        main lens adds up to w (z2 + z3), one on the lenslets w z3.
        """
        behind = self.sensor_distance / self.array_distance
        beta = self.array_alpha(dz)
        moved = np.abs(1 - beta - behind * (1 if self.field_lens else beta))
        steepest = self.mla.steepest_slope(self.wavelength)
        steepest += self.aberrations.lenslet_slope(self.mla)
        bent = self.main_slope() * (self.array_distance + self.sensor_distance)
        return moved * self.lit_diameter / 2 + bent + self.sensor_distance * steepest

    def main_slope(self, reach: float | None = None) -> float:
        """At least the steepest slope of the main lens' wavefront, in radians.

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
        """Of the circle about the axis that all light passes at the main lens, in metres.

        The aperture's, or more where OPD maps shift the pupil.
        """
        return self.aperture_diameter * self.aberrations.pupil_reach

    def ray_matrix(self, dz: float = 0.0, *, lens_type: int = 0) -> np.ndarray[Any, Any]:
        """ABCD matrix of a lenslet, from the image of the plane dz to the sensor.

        Of (place from the lenslet's axis in metres, slope): free space b after a thin lens after
        free space a' (Georgiev and Lumsdaine 2010, "Focused plenoptic camera and rendering"),

            [[1 - b/f, a' + b - a' b/f], [-1/f, 1 - a'/f]],    a' = z2 - F', b = z3.

        In focus (1/a' + 1/b = 1/f) it is [[-m, 0], [-1/f, -1/m]], m = b/a'; a 1.0 camera in focus
        has [[0, f], [-1/f, 1]]. The determinant is 1.

        Parameters
        ----------
        dz : float
            Of the object in metres from the focused plane.
        lens_type : int
            Which of the array's focal lengths.

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
            raise ValueError(f"The array has lens types 0 to {len(kinds) - 1}, not {lens_type!r}.")
        alpha = self.alpha(dz)
        if abs(alpha) < 1e-12:
            raise ValueError(f"An object at dz = {dz:g} m is imaged at infinity: move it.")
        f, b = kinds[lens_type], self.sensor_distance
        a = self.array_distance - self.image_distance / alpha
        return np.array([[1 - b / f, a + b - a * b / f], [-1 / f, 1 - a / f]])


def is_sampled(optics: RayOptics, reach: float, alpha: float) -> bool:
    """Whether the pixels sample the light and hold the main lens' aperture: `check_sampling`."""
    try:
        check_sampling(optics, reach, alpha)
    except SamplingError:
        return False
    return True


def check_sampling(optics: RayOptics, reach: float, alpha: float) -> None:
    """Refuse light that the pixels cannot sample.

    [(beta D/2 + abs(X))/z2 + d/(2 f)]/lam < 1/(2 dx). A ray from u on the lens to X + u (1 - beta)
    on the array has the slope (X - beta u)/z2, and a lenslet adds -(x - c)/f, x - c up to d/2.
    For a 2.0 camera with its image in focus, beta = z2/F, this is (X/z2 + D/(2 F)) + d/(2 f):
    about the chief ray of a lenslet, slope (c - X)/a, light converges within d/(2 b) only, but
    lenslets at the rim of the blur, abs(c - X) up to a D/(2 F) + d/2, bring that to d/(2 f),
    1/f = 1/a + 1/b. The steepest of several f counts, and aberrations add the slopes of their
    wavefronts. And the window holds the main lens' aperture.
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
            f"{optics.pixel_pitch:.4g} m sample {1 / (2 * optics.pixel_pitch):.4g}: pixels below "
            f"{fitting:.4g} m would do (pixels_per_lenslet = {optics.mla.pitch / fitting:.4g}), or "
            f"a longer f_mu, {'smaller aberrations, ' if bent else ''}or a smaller aperture; "
            "points and self-luminous pictures need none of these with method='local'."
        )
    if min(optics.grid.extent) < D:
        raise SamplingError(
            f"The window of {min(optics.grid.extent):.4g} m does not hold the main lens' aperture "
            f"of {D:.4g} m: use more lenslets or give a smaller aperture_diameter; points and "
            "self-luminous pictures need neither with method='local'."
        )


def check_in_view(optics: RayOptics, positions: Positions) -> None:
    """Refuse points behind the lens, whose chief ray misses the array, or beyond OPD maps."""
    behind = optics.object_distance + positions[:, 2] <= 0
    if behind.any():
        x, y, dz = positions[behind][0]
        near = optics.object_distance + dz / 1e3 > 0 and abs(dz) >= 1
        meant = f"; positions are in metres, did you mean dz = {dz / 1e3:g}?" if near else "."
        raise ValueError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m lies behind the main lens, which "
            f"is {optics.object_distance:g} m from the focused plane{meant}"
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
        place, (X, Y) = positions[outside][0], images[outside][0]
        x, y, dz = place
        # the image is upside down
        scale = float(optics.array_scale(dz))
        (left, top), (right, bottom) = (middle + half) / scale, (middle - half) / scale
        meant = ""
        if (np.abs(images[outside][0] / 1e3 - middle) <= half).all() and np.abs(
            place[:2]
        ).max() >= 1:
            meant = f"; positions are in metres, did you mean ({x / 1e3:g}, {y / 1e3:g})?"
        raise SamplingError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is imaged at ({X:g}, {Y:g}) m, "
            f"beyond the array of {2 * half[0]:g} x {2 * half[1]:g} m. At this dz the field of "
            f"view is x from {left:.4g} to {right:.4g} m, y from {top:.4g} to {bottom:.4g} m: "
            f"move the point or use more lenslets{meant or '.'}"
        )
    maps = optics.aberrations.main_lens_opd
    if maps is not None:
        maps.check(optics.image_of(positions)[:, ::-1], optics.wavelength)


def thin_spherical(D: float, object_distance: float, image_distance: float) -> float:
    """Path at the rim of a thin lens beyond that of a corrected one, in metres.

    rho^4/8 (1/object^3 + 1/image^3), rho = D/2: what exact spherical waves differ by from a
    quadratic phase (Goodman 2005, eq. 5-10, carried one order further).
    """
    return (D / 2) ** 4 / 8 * (object_distance**-3 + image_distance**-3)


def view_step(optics: RayOptics) -> float:
    """du = dx z2/z3: how far apart on the main lens two pixels of a lenslet look, in metres."""
    return optics.pixel_pitch * optics.array_distance / optics.sensor_distance


def pupil_image(optics: RayOptics) -> tuple[float, float]:
    """How the lenslets image the main lens, by rays at their true angles.

    A ray from u on the main lens through x on a lenslet reaches the sensor at
    s = x + z3 l/sqrt(1 - l^2 - m^2), with the direction cosines (l, m) that the lenslet's phase
    leaves. What this differs by from paraxial rays is a line in u, by which the image of the pupil
    is larger, 1 + d^2/(8 f^2) to first order for a round parabolic lenslet and a small pupil, and
    scatter about it: aberrations of the lenslet. Rays that fall into another lenslet's sub-image do
    not count.
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
    """(y, x) of points that share a disc evenly."""
    r = radius * np.sqrt((np.arange(_RADII) + 0.5) / _RADII)[:, None]
    angles = 2 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    return (r * np.sin(angles)).ravel(), (r * np.cos(angles)).ravel()


def raw_image(optics: RayOptics, data: cla.Array, *, paraxial: bool = False) -> RawImage:
    """Intensity on the sensor with the positions of sub-images and cells, without its camera.

    Where the array does not lie on the main lens' image there is no spacing: what a lenslet sees
    is a picture, and alpha is not that of the light field on the array.
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
    """Where the lenslets of each focal length have their sub-images, and what they see sharply.

    A type is in focus at the virtual depth a/b, 1/a = 1/f - 1/b. Its range ends where the next
    one is as sharp: blur on the sensor is d abs(b/a' - b/a), so in the middle between their b/a;
    the outermost go as far beyond.
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
    found = []
    for number, sharp in enumerate(focus):
        side = (0, math.inf) if sharp > 0 else (-math.inf, 0)
        ends = np.clip((low[number], high[number]), *side)
        depths = sorted(float(1 / end) if end else math.copysign(math.inf, sharp) for end in ends)
        vectors = np.array([(0, number), (1, -mla.type_step), (0, len(focus))]) @ base
        offset, *steps_of = ((float(y), float(x)) for y, x in vectors)
        found.append(LensType(offset, (depths[0], depths[1]), (steps_of[0], steps_of[1])))
    return tuple(found)
