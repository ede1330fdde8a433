"""Exposure of transparent pictures by partially coherent light, one field for each snapshot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.optics.wave_optics import WaveOptics, padded_shape
from clplen.cameras.scenes.scene_sources import PicturePlane
from clplen.lightfield.raw.raw_image import Exposure, merged
from clplen.wave.coherence.averaging import Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.coherence_plan import Opening, check_opening
from clplen.wave.elements.lens import thin_lens
from clplen.wave.elements.transparency import transparency
from clplen.wave.field.field import Field
from clplen.wave.field.intensity import MeanIntensity

MASK_TRANSFORMS = 2  # Fourier transforms of the field of a random source


@dataclass(frozen=True)
class SlidePath:
    """Path from a slide to the sensor of a camera, a system for `Coherence.average`."""

    optics: WaveOptics
    dz: float  # distance of the slide from the focused plane in metres
    koehler: bool  # True if the light converges on the main lens
    # padding factors to the array and to the sensor; the factor to the lens is 1 with ``koehler``,
    # whose light stays in the window, else 2
    padding: tuple[int, int]

    @property
    def z(self) -> float:
        """Distance from the slide to the main lens in metres."""
        return self.optics.object_distance + self.dz

    def __call__(self, lit: Field) -> Field:
        """Propagate the field of an illuminated slide to the sensor, at the field's wavelength."""
        optics = replace(self.optics, wavelength=lit.wavelength)
        if self.koehler:
            lit = thin_lens(lit, self.z)
        at_lens = optics.propagator(self.z, "blas", 1 if self.koehler else 2)(lit)
        pupil = thin_lens(at_lens, optics.focal_length, diameter=optics.aperture_diameter)
        pupil = optics.behind_main_lens(pupil)
        at_array = optics.array_field(pupil, pad=self.padding[0])
        return optics.sensor_field(at_array, pad=self.padding[1])


def _slide_path(optics: WaveOptics, plane: PicturePlane, koehler: bool) -> SlidePath:
    """Return the path of a slide's light, padded if it would leave the window."""
    if optics.aberrations.varies:
        raise ValueError(
            "A slide's light is one field, without a wavefront for each point: leave out "
            "main_lens_field and OPD maps of several fields, or use mode='emission'."
        )
    return SlidePath(optics, plane.z, koehler, optics.padding(plane.corners().positions))


def slide_field(optics: WaveOptics, plane: PicturePlane) -> Field:
    """Return the amplitude transmission of a slide on the grid of a camera.

    It is scaled so that a clear sample, illuminated by unit intensity, has the energy 1.
    """
    grid, device = optics.grid, optics.device
    unit = np.full(grid.shape, grid.pitch[1] / plane.pitch)
    clear = Field.from_array(unit, grid, wavelength=optics.wavelength, device=device)
    return transparency(clear, np.sqrt(plane.image), pitch=plane.pitch)


def light_slide(
    optics: WaveOptics,
    slide: PicturePlane,
    light: Coherence,
    koehler: bool,
    averaging: dict[str, Any],
    progress: Progress | None,
) -> tuple[MeanIntensity, Exposure]:
    """Compute the raw image of one slide, and a report of its exposure."""
    path, field = _slide_path(optics, slide, koehler), slide_field(optics, slide)
    if light.spatial is not None:
        focus = path.z if koehler else math.inf
        check_opening(field, light.spatial, Opening(path.z, optics.aperture_diameter, focus))
    mean = light.average(path, field, **averaging, progress=progress, method="monte-carlo")
    return mean, _report(path, mean, light, len(light.lines(optics.wavelength)))


def _report(path: SlidePath, mean: MeanIntensity, coherence: Coherence, lines: int) -> Exposure:
    """Return the report of a slide's exposure."""
    fields = mean.snapshots * lines if coherence.is_random else lines
    shape = path.optics.grid.shape
    pads = (1 if path.koehler else 2, *path.padding)
    transforms = [(2 * fields, padded_shape(shape, pad)) for pad in pads]
    if not coherence.is_random:
        return Exposure("coherent", merged(transforms), 0.0)
    transforms.append((MASK_TRANSFORMS * fields, shape))
    return Exposure(
        "snapshots", merged(transforms), 0.0, mean.snapshots, mean.standard_error,
        mean.relative_error,
    )  # fmt: skip
