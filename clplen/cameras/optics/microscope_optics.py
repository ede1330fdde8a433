"""A light-field microscope as lengths: what follows from its parameters without any wave.

A ray from z meets the array at x = M x0 + (M^2 z/n) theta (Levoy, Ng, Adams, Footer and Horowitz
2006, "Light field microscopy"): there is no F and no alpha, but a plane has the disparity
d = -M^2 z dx/(n f_mu p).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.lenslet_camera import Described, Description, LensletCamera, Row
from clplen.cameras.optics.objective import APODISATION, CoverGlass, Objective
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.checks import real_array
from clplen.compute.device import Device
from clplen.errors import SamplingError
from clplen.lightfield.depth.best_focus import focus_ratio, focus_ratio_of_disparity
from clplen.units import metres
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid

Vector = np.ndarray[Any, Any]

Law = Literal["paraxial", "sharpest", "marginal"]
LAWS = get_args(Law)
MISMATCH = 0.1  # of the two f-numbers that is said aloud
SPARROW = 0.47  # lam/NA, resolution of the objective
DEEPEST = 0.1  # metres; no objective has an image from farther away


@dataclass(frozen=True, repr=False)
class MicroscopeOptics(Described, LensletCamera):
    """A light-field microscope as lengths; `Microscope` takes its raw images.

    Attributes
    ----------
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    mla : MicrolensArray
    wavelength : float
        In vacuum, in metres.
    pixels_per_lenslet : float
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor, and of the native plane.
    device : Device
    cover : CoverGlass or None
        Where it is not the one that the objective is made for.
    apodisation : float
        e, of the amplitude cos(theta)^e over the pupil.
    pixels : PixelArray or None
        None: each pixel takes the intensity in its middle.
    pupil : PupilAberration or None
        Aberrations of objective and sample; None: there are none.
    """

    magnification: float
    na: float
    medium_index: float
    tube_lens: float
    mla: MicrolensArray
    wavelength: float
    pixels_per_lenslet: float
    pixel_pitch: float
    grid: Grid
    device: Device
    cover: CoverGlass | None = None
    apodisation: float = APODISATION
    pixels: PixelArray | None = None
    pupil: PupilAberration | None = None

    telecentric = True

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} {self.magnification:g}x/{self.na:g}, {self._sensor}, "
            f"{metres(self.wavelength)}, {self.device.name}>"
        )

    @property
    def sensor_distance(self) -> float:
        """f_mu in metres, from the array to the sensor."""
        return self.mla.focal_length

    def array_transmission(
        self, grid: Grid, *, rim: tuple[float, float] | None = None
    ) -> cla.Array:
        """Transmission of the array on a grid of any origin, shape of the grid."""
        return self.mla.transmission(grid, self.wavelength, self.device, rim=rim)

    @property
    def objective(self) -> Objective:
        """The optics before the array."""
        return Objective(
            self.magnification,
            self.na,
            self.medium_index,
            self.wavelength,
            self.cover,
            self.apodisation,
            self.pupil,
        )

    @property
    def focal_length(self) -> float:
        """Of the objective in metres, tube lens over magnification."""
        return self.tube_lens / self.magnification

    @property
    def object_distance(self) -> float:
        """Front principal plane of the objective to the native plane, n f, in metres."""
        return self.medium_index * self.focal_length

    @property
    def image_distance(self) -> float:
        """Pupil (front focal plane of the tube lens) to tube lens to array: its f, in metres."""
        return self.tube_lens

    @property
    def aperture_diameter(self) -> float:
        """2 NA f of the objective, its back pupil by the sine condition, in metres."""
        return 2 * self.na * self.focal_length

    @property
    def matched(self) -> float:
        """Image-side f-number of the objective over that of a lenslet, M/(2 NA) d/f_mu."""
        return self.magnification / (2 * self.na) * self.mla.diameter / self.mla.focal_length

    def alpha(self, dz: Any) -> Any:
        """NaN: the exit pupil is at infinity; see `disparity`."""
        return _as_given(np.full(np.shape(dz), np.nan))

    def dz(self, alpha: Any) -> Any:
        """NaN: see `z`."""
        return _as_given(np.full(np.shape(alpha), np.nan))

    def disparity(self, dz: Any, *, law: Law = "paraxial") -> Any:
        """d = -M^2 dz dx/(n f_mu p), in lenslets a pixel of a sub-image; nearer is larger.

        Parameters
        ----------
        dz : float or array_like
            In metres from the native plane, farther positive.
        law : {"paraxial", "sharpest", "marginal"}
            "paraxial": as above (Levoy et al. 2006). "marginal": that of the rays of the rim, n/
            sqrt(n^2 - NA^2) as much, since a ray at theta meets the array at M z tan(theta) and
            leaves it by the sine condition. "sharpest": where a point is in best focus by all rays,
            `clplen.lightfield.focus_ratio` as much, which lies between the two.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            For another law.
        """
        given = real_array(dz, "dz", np.float64)
        return _as_given(-given * self._ratio(law, given, focus_ratio) / self._depth_of_disparity)

    def z(self, disparity: Any, *, law: Law = "paraxial") -> Any:
        """The inverse of `disparity`, in metres.

        Parameters
        ----------
        disparity : float or array_like
            In lenslets a pixel of a sub-image.
        law : {"paraxial", "sharpest", "marginal"}
            As of `disparity`: "sharpest" of a d at which something was found to be sharpest,
            "marginal" of one by the outermost views.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            For another law.
        """
        given = real_array(disparity, "disparity", np.float64)
        ratio = self._ratio(law, given, focus_ratio_of_disparity)
        return _as_given(-given * self._depth_of_disparity / ratio)

    def _ratio(self, law: str, given: Vector, of_each: Callable[[Any, float], float]) -> Vector:
        """Disparity over that of the paraxial law, for each number."""
        if law not in LAWS:
            raise ValueError(f"law is one of {', '.join(map(repr, LAWS))}, not {law!r}.")
        if law == "paraxial":
            return np.ones(given.shape)
        if law == "marginal":
            cosine = math.sqrt(1 - (self.na / self.medium_index) ** 2)
            return np.full(given.shape, 1 / cosine)
        found = [of_each(self, float(one)) if np.isfinite(one) else 1.0 for one in given.ravel()]
        return np.array(found).reshape(given.shape)

    @property
    def _depth_of_disparity(self) -> float:
        """n f_mu p/(M^2 dx): abs(z) of d = 1."""
        scale = self.medium_index / (self.magnification * self.magnification)
        return scale * self.mla.focal_length * self.mla.pitch / self.pixel_pitch

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        M, n, lam, d = self.magnification, self.medium_index, self.wavelength, self.mla.diameter
        sparrow, views = self.sparrow, self.resolvable
        depth = lam * n / self.na**2
        ny, nx = self.grid.shape
        close = abs(self.matched - 1) <= MISMATCH
        rows = (
            Row("magnification", M, "", f"tube lens {self.tube_lens * 1e3:g} mm"),
            Row("numerical aperture", self.na, "", f"in a medium of index {n:g}"),
            Row("objective focal length", self.focal_length, "m", "tube lens/M"),
            Row("pupil", self.aperture_diameter, "m", "2 NA f, back pupil of the objective"),
            Row("image f-number", M / (2 * self.na), "", "M/(2 NA)"),
            Row("lenslet f-number", self.mla.focal_length / d, "", "f_mu/d; matched: the same"),
            Row("match", self.matched, "", "matched" if close else "not matched: sub-images "
                + ("overlap" if self.matched < 1 else "are smaller than their cells")),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", self.mla.pitch, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            Row("lenslet focal length", self.mla.focal_length, "m", "f_mu, array to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("field of view", nx * self.pixel_pitch / M, "m", "across, in the medium"),
            Row("lateral resolution", d / M, "m", "d/M, of one lenslet at the native plane"),
            Row("Sparrow limit", sparrow, "m", ".47 lam/NA, of the objective"),
            Row("resolvable views", views, "", "N_u = d/(M .47 lam/NA), across"),
            Row("depth of field", depth, "m", "lam n/NA^2, of the objective"),
            Row("light-field range", self.depth_range, "m",
                "(2 + N_u^2) lam n/(2 NA^2), depth of field of one view"),
            Row("band limit from", self.native_zone, "m",
                "abs(z) from which nu(z) = d/(.94 lam M abs(z)) is the finest detail"),
            Row("disparity", self.disparity(-1e-6), "", "lenslets a pixel at z = -1 um"),
        )  # fmt: skip
        return Description("Light-field microscope", rows)

    @property
    def sparrow(self) -> float:
        """.47 lam/NA in metres."""
        return SPARROW * self.wavelength / self.na

    @property
    def resolvable(self) -> float:
        """N_u = d/(M .47 lam/NA), independent views across (Levoy et al. 2006, eq. 3)."""
        return self.mla.diameter / (self.magnification * self.sparrow)

    @property
    def depth_range(self) -> float:
        """(2 + N_u^2) lam n/(2 NA^2) in metres, about the native plane (Levoy et al. 2006)."""
        return (2 + self.resolvable**2) * self.wavelength * self.medium_index / (2 * self.na**2)

    @property
    def native_zone(self) -> float:
        """d^2/(2 M^2 lam) in metres: nearer to the native plane detail is lost between lenslets."""
        return self.mla.diameter**2 / (2 * self.magnification**2 * self.wavelength)

    def band_limit(self, z: Any) -> Any:
        """nu(z) = d/(.94 lam M abs(z)), cycles a metre in the medium (Broxton et al. 2013, eq. 5).

        Parameters
        ----------
        z : float or array_like
            In metres from the native plane.

        Returns
        -------
        float or numpy.ndarray
            NaN nearer to the native plane than `native_zone`.
        """
        distance = np.abs(np.asarray(z, np.float64))
        with np.errstate(divide="ignore"):
            found = self.mla.diameter / (
                2 * SPARROW * self.wavelength * self.magnification * distance
            )
        return _as_given(np.where(distance >= self.native_zone, found, np.nan))


def check_sampling(camera: MicroscopeOptics) -> None:
    """Refuse light that the pixels cannot sample: NA/(M lam) + d/(2 f_mu lam) < 1/(2 dx)."""
    shortest = min(camera.mla.focal_lengths)
    slope = camera.na / camera.magnification + camera.mla.diameter / (2 * shortest)
    if 2 * camera.pixel_pitch * slope >= camera.wavelength:
        fitting = camera.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / camera.wavelength:.4g} cycles/m "
            f"((NA/M + d/(2 f_mu))/lam), but pixels of {camera.pixel_pitch:.4g} m sample "
            f"{1 / (2 * camera.pixel_pitch):.4g}: pixels below {fitting:.4g} m would do "
            f"(pixels_per_lenslet = {math.floor(camera.mla.pitch / fitting) + 1}), a smaller NA, "
            "or pixels that integrate, pixels=PixelArray()."
        )


def check_positions(places: Any) -> None:
    """Refuse places about the native plane that are no metres, or of no microscope."""
    values = real_array(places, "places", np.float64)
    beyond = values[np.abs(values) > DEEPEST]
    if beyond.size:
        raise ValueError(
            f"A place {beyond[0]:g} m from the native plane or the axis is beyond every objective: "
            f"places are in metres, did you mean {beyond[0]:g}e-6?"
        )


def _as_given(values: Vector) -> Any:
    """A float for a number, an array for an array."""
    return float(values) if np.ndim(values) == 0 else values
