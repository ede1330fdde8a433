"""A transparent picture before a camera: lit by partially coherent light, one field a snapshot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from clplen.cameras.optics import wave_optics
from clplen.cameras.scenes.scene_sources import PicturePlane
from clplen.wave.elements import thin_lens, transparency
from clplen.wave.field import Field

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic


@dataclass(frozen=True)
class SlideWay:
    """From a slide to the sensor of a camera, as a system for `Coherence.average`.

    Attributes
    ----------
    camera : Plenoptic
    dz : float
        Of the slide, in metres from the focused plane.
    koehler : bool
        Whether the light converges on the main lens.
    padding : tuple of int
        Of the ways to the array and to the sensor; to the lens 1 with ``koehler``, whose light
        stays in the window, else 2.
    """

    camera: Plenoptic
    dz: float
    koehler: bool
    padding: tuple[int, int]

    @property
    def z(self) -> float:
        """From the slide to the main lens in metres."""
        return self.camera.object_distance + self.dz

    def __call__(self, lit: Field) -> Field:
        """The field on the sensor of a slide that is lit, at the field's wavelength."""
        camera = replace(self.camera, wavelength=lit.wavelength)
        if self.koehler:
            lit = thin_lens(lit, self.z)
        at_lens = camera.propagator(self.z, "blas", 1 if self.koehler else 2)(lit)
        pupil = thin_lens(at_lens, camera.focal_length, diameter=camera.aperture_diameter)
        pupil = wave_optics.behind_main_lens(camera, pupil)
        at_array = camera.array_field(pupil, pad=self.padding[0])
        return camera.sensor_field(at_array, pad=self.padding[1])


def slide_way(camera: Plenoptic, plane: PicturePlane, koehler: bool) -> SlideWay:
    """The way of a slide's light, padded where it would leave the window.

    Raises
    ------
    ValueError
        If the main lens' wavefront changes over the field.
    """
    if camera.aberrations.varies:
        raise ValueError(
            "The light of a slide is one field, whose points have no wavefronts of their own: "
            "leave main_lens_field out, or use mode='emission'."
        )
    return SlideWay(camera, plane.dz, koehler, camera.padding(plane.corners()))


def slide_field(camera: Plenoptic, plane: PicturePlane) -> Field:
    """The amplitude transmission of a slide on the grid of a camera.

    Its square root is scaled so that a clear sample of the slide, lit by unit intensity, has the
    energy 1.

    Parameters
    ----------
    camera : Plenoptic
    plane : PicturePlane

    Returns
    -------
    Field
        Shape of the camera's grid.
    """
    grid, device = camera.grid, camera.device
    unit = np.full(grid.shape, grid.pitch[1] / plane.pitch)
    clear = Field.from_array(unit, grid, wavelength=camera.wavelength, device=device)
    return transparency(clear, np.sqrt(plane.image), pitch=plane.pitch)
