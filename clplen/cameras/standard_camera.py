"""Standard plenoptic camera (1.0): the array lies on the main lens' image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from clplen.cameras.camera_base import Plenoptic, build, main_lens_distances
from clplen.cameras.description import Description, Row, optics_rows
from clplen.cameras.optics.camera_aberrations import NONE, Aberrations
from clplen.cameras.optics.lenslet_camera import Kind, independent_views, views
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.ray_optics import view_step
from clplen.compute.device import DeviceLike
from clplen.units import metres
from clplen.wave.elements.lenslets import MicrolensArray


@dataclass(frozen=True, repr=False)
class Plenoptic1(Plenoptic):
    """Plenoptic 1.0 camera, built by `PlenopticCamera.type1`.

    The array lies at F, the sensor f_mu behind it.

    Attributes
    ----------
    kind : str
        "standard".
    focal_length, object_distance, image_distance, aperture_diameter : float
        Main lens: f, distance to the focused object plane, F (distance to the array), D; in metres.
    mla : MicrolensArray
        Lenslets with pitch, focal lengths, count, lattice, fill, offset and rotation.
    wavelength : float
        Wavelength in metres.
    pixels_per_lenslet : float
        Lenslet pitch over pixel pitch; may be fractional.
    pixel_pitch : float
        Pitch of the pixels in metres.
    grid : Grid
        Grid of the sensor and of every plane of the simulation.
    field_lens : bool
        True if a lens of focal length F lies at the array (exit pupil at infinity).
    device : Device
        Device of the simulation.
    aberrations : Aberrations
        Departures from the design; `with_aberrations` sets them.
    lens_model : {"thin", "corrected"}
        Model of the main lens: a quadratic phase, or a lens that images every point without
        aberrations and obeys the sine condition.
    pixels : PixelArray or None
        Pixels that integrate; None if each pixel samples the intensity in its middle.
    m : float
        Magnification of the lenslets of a focused camera, here always 0.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=30, aperture_diameter=0.5e-3)
    >>> f"F = {camera.array_distance:.3f} m, f_mu = {camera.sensor_distance:.3f} m"
    'F = 0.240 m, f_mu = 0.010 m'
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> raw.shape, raw.camera is camera
    ((150, 150), True)
    """

    kind: ClassVar[Kind] = "standard"

    def describe(self) -> Description:
        """Return the derived parameters as a `Description`."""
        p, f_mu, lam = self.mla.pitch, self.mla.focal_length, self.wavelength
        D, F = self.aperture_diameter, self.image_distance
        ny, nx = self.grid.shape
        limit = math.sqrt(2.44 * lam * f_mu)
        met = "met" if self.mla.diameter > limit else "not met"
        rows = (
            Row("focal length", self.focal_length, "m", "main lens"),
            Row("object distance", self.object_distance, "m", "focused plane to main lens"),
            Row("image distance", F, "m", "F, main lens to array"),
            Row("aperture", D, "m", "D, main lens"),
            Row("f-number", self.focal_length / D, "", "f/D"),
            Row("working f-number", F / D, "", f"F/D; a lenslet has {f_mu / p:.6g}"),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", p, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            Row("lenslet focal length", f_mu, "m", "f_mu, array to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row(
                "angle a pixel", self.pixel_pitch / self.sensor_distance, "rad", "angular sampling"
            ),
            Row("aperture a pixel", view_step(self), "m", "du on the main lens"),
            Row("views", views(self), "", "across, one a pixel of a lenslet"),
            Row(
                "independent views",
                independent_views(self.mla.diameter, f_mu, lam, self.pixels_per_lenslet),
                "",
                "across, d^2/(lam f_mu), at most the pixels: diffraction blurs the sub-image",
            ),
            Row("Airy limit", limit, "m", f"lenslet diameter > sqrt(2.44 lam f_mu): {met}"),
            Row(
                "focus tolerance",
                p / D,
                "",
                f"|1 - alpha| below p/D blurs less than a lenslet: {focus_range(self)}",
            ),
            Row(
                "disparity",
                F / (f_mu * self.pixels_per_lenslet),
                "",
                "pixels a view step for 1 - alpha = 1",
            ),
            *optics_rows(self.optics),
        )
        return Description("Plenoptic 1.0 camera", rows)


def focus_range(camera: Plenoptic1) -> str:
    """Describe the dz whose abs(1 - alpha) is below p/D, in metres."""
    tolerance = camera.mla.pitch / camera.aperture_diameter
    near, far = (camera.dz(1 + sign * tolerance) for sign in (-1, 1))
    end = metres(far, 3) if math.isfinite(far) else "infinity"
    return f"dz from -{metres(-near, 3)} to {end}"


def type1(
    *,
    focal_length: float,
    mla: MicrolensArray,
    wavelength: float,
    pixels_per_lenslet: float | None = None,
    device: DeviceLike | None = None,
    object_distance: float | None = None,
    image_distance: float | None = None,
    aperture_diameter: float | None = None,
    field_lens: bool = False,
    aberrations: Aberrations = NONE,
    pixels: PixelArray | None = None,
    lens_model: Literal["auto", "thin", "corrected"] = "auto",
) -> Plenoptic1:
    """Build a standard plenoptic camera: array on the main lens' image, sensor f_mu behind it.

    Parameters
    ----------
    focal_length : float
        Focal length of the main lens in metres.
    mla : MicrolensArray
        Lenslets with pitch, f_mu, count, lattice, fill, offset and rotation.
    wavelength : float
        Wavelength in metres.
    pixels_per_lenslet : float, optional
        Lenslet pitch over pixel pitch, at least 2; may be fractional. Not needed if ``pixels`` has
        a pitch.
    device : Device or str, optional
        Device of the simulation; None is ``Device.open()``.
    object_distance, image_distance : float, optional
        Distances from the main lens to the focused object plane and to the array, in metres. The
        lens law gives a missing distance; by default both are 2f.
    aperture_diameter : float, optional
        Diameter of the main lens in metres; None matches the f-numbers: pitch F/f_mu.
    field_lens : bool
        True to put a lens of focal length F at the array (exit pupil at infinity).
    aberrations : Aberrations
        Departures from the design: wavefronts, displaced lenslets, a moved sensor.
    pixels : PixelArray, optional
        Position of pixels that integrate the light over their area. None: pixels that cover the
        array. They sample the intensity in their middle if they resolve the light's waves, else
        they are a ``PixelArray()``.
    lens_model : {"auto", "thin", "corrected"}
        "thin": a quadratic phase. "corrected": a lens that images every point without aberrations
        and obeys the sine condition. "auto": "thin" if its spherical aberration is below a quarter
        of a wave.

    Returns
    -------
    Plenoptic1

    Raises
    ------
    ValueError
        If a length is not positive, distances contradict the lens law, lenslets have several focal
        lengths, or aberrations do not fit.
    SamplingError
        If a lenslet has less than 2 pixels.

    Warns
    -----
    SamplingWarning
        If NA = D/(2 F) of the main lens is above 0.4, because waves are scalar.
    """
    distances = main_lens_distances(
        mla, wavelength, focal_length, object_distance, image_distance, aperture_diameter
    )
    if len(mla.focal_lengths) > 1:
        raise ValueError(
            "The lenslets of a 1.0 camera must have one focal length, its distance to the sensor, "
            f"got {len(mla.focal_lengths)}: use one, or PlenopticCamera.type2."
        )
    matched = mla.pitch * distances[1] / mla.focal_length
    return build(
        Plenoptic1,
        distances=distances,
        aperture_diameter=matched if aperture_diameter is None else aperture_diameter,
        focal_length=focal_length,
        wavelength=wavelength,
        mla=mla,
        pixels_per_lenslet=pixels_per_lenslet,
        pixels=pixels,
        lens_model=lens_model,
        aberrations=aberrations,
        device=device,
        field_lens=bool(field_lens),
    )
