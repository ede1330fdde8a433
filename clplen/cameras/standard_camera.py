"""The standard plenoptic camera (1.0): the array lies on the main lens' image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.optics import camera_aberrations, exposure_rows
from clplen.cameras.optics.lenslet_camera import Description, Kind, Row, views
from clplen.cameras.optics.ray_optics import view_step


@dataclass(frozen=True, repr=False)
class Plenoptic1(Plenoptic):
    """A plenoptic 1.0 camera. Made by `PlenopticCamera.type1`.

    The array lies at F, the sensor f_mu behind it.

    Attributes
    ----------
    focal_length, object_distance, image_distance, aperture_diameter : float
        Of the main lens, in metres.
    mla : MicrolensArray
        The lenslets.
    wavelength, pixel_pitch : float
        In metres.
    pixels_per_lenslet : float
        Along one axis.
    grid : Grid
        Samples at the array.
    field_lens : bool
        Whether a lens at the array centres the sub-images.
    device : Device
        What it computes on.
    aberrations : Aberrations
        Departures from the design.
    pixels : PixelArray or None
        Pixels that integrate; None: they sample.
    lens_model : str
        "thin" or "corrected".

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=5, fill="full")
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.03, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=15
    ... )
    >>> camera.kind, f"{camera.alpha(0.001):.4f}"
    ('standard', '1.0164')
    """

    kind: ClassVar[Kind] = "standard"

    @property
    def array_distance(self) -> float:
        """z2 = F in metres, from the main lens to the array."""
        return self.image_distance

    @property
    def sensor_distance(self) -> float:
        """z3 = f_mu in metres, from the array to the sensor, and what this is moved by."""
        return self.mla.focal_length + self.aberrations.sensor_shift

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
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
                self.mla.diameter**2 / (lam * f_mu),
                "",
                "across, d^2/(lam f_mu): the sub-image is blurred by diffraction",
            ),
            Row("Airy limit", limit, "m", f"lenslet diameter > sqrt(2.44 lam f_mu): {met}"),
            Row("focus tolerance", p / D, "", "|1 - alpha| below p/D blurs less than a lenslet"),
            Row(
                "disparity",
                F / (f_mu * self.pixels_per_lenslet),
                "",
                "pixels a view step for 1 - alpha = 1",
            ),
            *exposure_rows.rows(self.optics),
            *camera_aberrations.rows(self.aberrations, lam),
        )
        return Description("Plenoptic 1.0 camera", rows)
