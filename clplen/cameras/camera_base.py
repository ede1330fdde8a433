"""Base class of the plenoptic cameras: raw images of scenes by waves or rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, TypeVar, cast

import pyopencl.array as cla

from clplen import units
from clplen.cameras.description import Described
from clplen.cameras.exposure.ray_exposure import check_rays, expose_rays
from clplen.cameras.exposure.wave_exposure import Light, Method, expose_waves
from clplen.cameras.optics.camera_aberrations import Aberrations
from clplen.cameras.optics.lenslet_camera import (
    Kind,
    check_lenslets,
    lenslet_pixels,
    require_lengths,
    sensor_grid,
)
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.ray_optics import (
    LensModel,
    RayOptics,
    check_in_view,
    is_sampled,
    raw_image,
    thin_spherical,
)
from clplen.cameras.optics.tilted_sensor import tilt_reach
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.occluders import Occluder
from clplen.cameras.scenes.scene_sources import (
    PointSources,
    Source,
    as_occluders,
    as_sources,
)
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.errors import SamplingWarning, warn_caller
from clplen.lightfield.raw.raw_image import RawImage, Sensor
from clplen.progress import notebook_bar
from clplen.results import Plottable
from clplen.wave.coherence.averaging import Checkpoint, Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import row_powers
from clplen.wave.field.intensity import Region
from clplen.wave.spectrum.spectrum_tables import check_wavelength

Scene = SurfaceScene | Source | Sequence[Source | Occluder]
Self = TypeVar("Self", bound="Plenoptic")

MAX_THIN_LENS_WAVES = 0.25  # aberration in waves below which a thin lens suffices (Rayleigh)
MAX_SCALAR_NA = 0.4  # NA above which polarisation matters (Stamnes 1986, section 16.3)
LENS_LAW_TOLERANCE = 1e-6  # maximum relative error of 1/f = 1/object + 1/image


@dataclass(frozen=True, repr=False)
class Plenoptic(Described, Plottable, RayOptics):
    """Plenoptic camera that takes raw images: `Plenoptic1` or `Plenoptic2`."""

    kind: ClassVar[Kind]
    _figure: ClassVar[str] = "camera"

    def with_aberrations(self: Self, aberrations: Aberrations) -> Self:
        """Return a copy of the camera with other aberrations.

        Parameters
        ----------
        aberrations : Aberrations
            Aberrations that replace the camera's own.

        Returns
        -------
        Plenoptic1 or Plenoptic2

        Raises
        ------
        ValueError
            If Zernike terms of lenslets reach beyond their circle, or the sensor would not lie
            behind the array.
        TypeError
            If ``aberrations`` is not an `Aberrations`.
        """
        if not isinstance(aberrations, Aberrations):
            kind = type(aberrations).__name__
            raise TypeError(f"aberrations must be Aberrations(...), got an object of type {kind}.")
        camera = replace(self, aberrations=aberrations)
        aberrations.check_lenslets(self.mla)
        if not camera.sensor_distance > 0:
            raise ValueError(
                f"sensor_shift must keep the sensor behind the array, got "
                f"{aberrations.sensor_shift:g} m: the sensor would be {camera.sensor_distance:g} m "
                "behind it."
            )
        approach = tilt_reach(camera.grid, aberrations.sensor_tilt)
        if not camera.sensor_distance > approach:
            raise ValueError(
                f"sensor_tilt = {aberrations.sensor_tilt} moves pixels {approach:g} m towards the "
                f"array, {camera.sensor_distance:g} m away: use smaller slopes."
            )
        on_axis = max(1.0, self.array_distance / self.image_distance)
        if self.pixels is None and not is_sampled(camera, 0.0, on_axis):
            camera = replace(camera, pixels=PixelArray())
        return camera

    @notebook_bar("exposing")
    def expose(
        self,
        scene: Scene,
        *,
        model: Literal["waves", "rays"] = "waves",
        coherence: Coherence | None = None,
        sensor: Sensor | None = None,
        progress: Progress | None = None,
        method: Method = "auto",
        koehler: bool = True,
        snapshots: int | None = None,
        rtol: float | None = None,
        region: Region | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> RawImage:
        """Take a raw image of a scene: the sum of the intensities of its points and pictures.

        Parameters
        ----------
        scene : PointSources, PicturePlane, list of them and of Occluder, or SurfaceScene
            Light of all members of a list adds up. An `Occluder`, or a picture with ``opacity``,
            attenuates the light from behind it. A `SurfaceScene` needs ``model="rays"``: Y and X
            count lenslets from the middle of the array, d is the disparity of the decoded light
            field, and 1 is the raw image of white.
        model : {"waves", "rays"}
            Wave optics or geometrical rays. Rays have no diffraction and use ``sensor`` only, none
            of the other options below.
        coherence : Coherence, optional
            Its spectrum applies to all sources without their own; its spatial model to slides
            (``mode="transmission"``), which require it. Points and self-luminous pictures are
            incoherent from point to point. ``wavelengths`` is the number of wavelengths for a
            source with a spectrum; by default enough for a relative error of 1e-3.
        sensor : Sensor, optional
            Model of photons, noise and bits; None keeps units of energy.
        progress : callable, optional
            Function called as ``progress(done, total)`` after each batch of fields and each
            snapshot. It starts at 0 for each part of the scene.
        method : {"auto", "points", "local", "isoplanatic"}
            "points": one field of the sensor's size for each point; the pixels must sample its
            waves. "local": a window about each point's chief ray, sampled as finely as its waves
            need. "isoplanatic": a picture composed of shifted patterns of a few positions of X
            under one lenslet (the array's rows along x). "auto": "local" for pixels that integrate,
            else "points"; for a picture "isoplanatic" if these would cost too much.
        koehler : bool
            True to make the light behind a slide converge on the main lens, so that the whole slide
            is visible (Goodman 2005, section 5.3.2). False: it stays parallel to the axis.
        snapshots, rtol, region, checkpoint
            Options for slides, as in `Coherence.average`; the region is a region of the sensor.

        Returns
        -------
        RawImage
            float32, shape of ``grid``. n sources of power 1 add up to n (1 - 1e-3 .. 1), times the
            sensitivities of colour filters, whose names are in ``mosaic``. A clear sample of a
            slide sends the energy 1 towards the lens. ``exposure`` reports the method and its
            accuracy; by rays, ``truth`` is the ground truth of a `SurfaceScene`.

        Raises
        ------
        SamplingError
            If light reaches the sensor at angles that the pixels do not sample, a point is imaged
            beyond the array, or the grid does not carry the light on a slide.
        ValueError
            If a point lies behind the lens, a slide has no light, a spatial model has no slide,
            ``model`` or ``method`` do not fit the scene or the camera, or no colour filter
            transmits a source's light.
        FormatError
            If the checkpoint is damaged or belongs to other settings.
        DeviceError
            If the fields do not fit the device.
        """
        slides = {"snapshots": snapshots, "rtol": rtol, "region": region, "checkpoint": checkpoint}
        averaging = {name: value for name, value in slides.items() if value is not None}
        optics = self.optics
        if _uses_rays(model, scene, coherence, averaging):
            if isinstance(scene, SurfaceScene):
                check_rays(optics, ())
                raw = expose_rays(optics, scene)
            else:
                check_rays(optics, as_occluders(scene))
                raw = expose_rays(optics, as_sources(scene))
        else:
            light = Light(coherence, koehler, averaging)
            sources, occluded = as_sources(scene), replace(optics, occluders=as_occluders(scene))
            raw = expose_waves(occluded, sources, light, method=method, progress=progress)
        raw = replace(raw, camera=self)
        return raw if sensor is None else sensor.record(raw)

    @property
    def optics(self) -> WaveOptics:
        """Wave optics of the camera: fields of points at each of its planes."""
        return WaveOptics(**{field.name: getattr(self, field.name) for field in fields(RayOptics)})

    def raw_image(self, data: cla.Array) -> RawImage:
        """Return a RawImage of intensities on the sensor with the positions of its sub-images."""
        return replace(raw_image(self, data), camera=self)

    def check_scene(self, scene: PointSources) -> None:
        """Raise if the camera cannot image these sources; see `expose`."""
        if self.pixels is None:
            self.optics.check_positions(scene.positions)
        else:
            check_in_view(self, scene.positions)


def scene_energy(camera: Plenoptic, scene: PointSources) -> Sequence[tuple[float, float, float]]:
    """Compute the fraction of each source's energy that reaches the array and the sensor.

    Parameters
    ----------
    camera : Plenoptic1 or Plenoptic2
        Camera whose grid, with one sample a pixel, holds the fields.
    scene : PointSources
        Sources; only their positions and diameter are used.

    Returns
    -------
    list of tuple of float
        (1.0, at the array, at the sensor) for each source: fractions of its energy at the aperture.
    """
    rows = []
    optics = camera.optics
    to_array, to_sensor = optics.padding(scene.positions)
    for position in scene.positions:
        pupil, energy = optics.pupil_and_energy(position[None], scene.diameter, full_grid=False)
        at_array = optics.array_field(pupil, pad=to_array)
        at_sensor = optics.sensor_field(at_array, pad=to_sensor)
        energies = [float(row_powers(f).sum()) for f in (at_array, at_sensor)]
        rows.append((1.0, energies[0] / float(energy[0]), energies[1] / float(energy[0])))
    return rows


def _uses_rays(
    model: str, scene: Any, coherence: Coherence | None, averaging: dict[str, Any]
) -> bool:
    """Return True if rays expose the scene; raise if the arguments contradict the model."""
    if model not in ("waves", "rays"):
        raise ValueError(f"model must be 'waves' or 'rays', got {model!r}.")
    if model == "waves" and isinstance(scene, SurfaceScene):
        raise ValueError(
            "model must be 'rays' for a SurfaceScene, got 'waves'. Waves expose PointSources, "
            "PicturePlanes and Occluders."
        )
    if model == "rays" and (coherence is not None or averaging):
        raise ValueError(
            "coherence, snapshots, rtol, region and checkpoint require model='waves': leave them "
            "out, because rays are incoherent and need no averages."
        )
    return model == "rays"


def main_lens_distances(
    mla: MicrolensArray,
    wavelength: float,
    focal_length: float,
    object_distance: float | None,
    image_distance: float | None,
    aperture_diameter: float | None,
) -> tuple[float, float]:
    """Return object and image distance in metres, after checks of the arguments of all cameras."""
    require_lengths(
        focal_length=focal_length,
        wavelength=wavelength,
        object_distance=object_distance,
        image_distance=image_distance,
        aperture_diameter=aperture_diameter,
    )
    check_wavelength(wavelength)
    check_lenslets(mla, wavelength)
    if min(mla.focal_lengths) <= 0:
        raise ValueError(
            f"Focal lengths of a camera's lenslets must be > 0, got {min(mla.focal_lengths)!r}."
        )
    distances = _lens_law(focal_length, object_distance, image_distance)
    longest = max(mla.focal_lengths)
    if longest >= distances[1]:
        hint = units.LENSLET_FOCAL_LENGTH.suggestion(longest)
        raise ValueError(
            f"The lenslets' focal length must be shorter than the image distance of the main lens, "
            f"{distances[1]:g} m, got {longest:g} m{hint}"
        )
    return distances


def build(
    kind: type[Self],
    *,
    distances: tuple[float, float],
    aperture_diameter: float,
    focal_length: float,
    wavelength: float,
    mla: MicrolensArray,
    pixels_per_lenslet: float | None,
    pixels: PixelArray | None,
    lens_model: str,
    aberrations: Aberrations,
    **extra_fields: Any,
) -> Self:
    """Build a camera of checked distances: its aperture, lens model, sensor and aberrations."""
    z_obj, F = distances
    D = float(aperture_diameter)
    _check_aperture(D, F)
    across = lenslet_pixels(mla, pixels_per_lenslet, pixels)
    if pixels is not None:
        mla = pixels.turned(mla)
    grid = sensor_grid(mla, across, pixels)
    camera = kind(
        focal_length=float(focal_length),
        object_distance=z_obj,
        image_distance=F,
        aperture_diameter=D,
        mla=mla,
        wavelength=float(wavelength),
        pixels_per_lenslet=float(across),
        pixel_pitch=grid.pitch[1],
        grid=grid,
        lens_model=_choose_lens_model(lens_model, D, z_obj, F, wavelength),
        pixels=pixels,
        **extra_fields,
    )
    return camera.with_aberrations(aberrations)


def _check_aperture(D: float, F: float) -> None:
    """Raise for NA = D/(2 F) >= 1, impossible by the sine condition; warn above MAX_SCALAR_NA."""
    na = D / (2 * F)
    if na >= 1:
        hint = units.CAMERA_DIAMETER.suggestion(D).rstrip(".") if D > 1 else ""
        raise ValueError(
            f"The aperture must be below {2 * F:g} m for an image {F:g} m away, because a lens has "
            f"NA < 1; got {D:g} m, NA {na:.3g}{hint or '.'}"
        )
    if na > MAX_SCALAR_NA:
        warn_caller(
            f"The main lens has NA {na:.3g} at its image, D/(2 F) above {MAX_SCALAR_NA:g}. Scalar "
            f"waves neglect polarisation: use D <= {2 * F * MAX_SCALAR_NA:.3g} m.",
            SamplingWarning,
        )


def _choose_lens_model(
    lens_model: str, D: float, object_distance: float, image_distance: float, wavelength: float
) -> LensModel:
    """Return the model of the main lens; "auto" depends on its spherical aberration."""
    if lens_model not in ("auto", "thin", "corrected"):
        raise ValueError(f"lens_model must be 'auto', 'thin' or 'corrected', got {lens_model!r}.")
    if lens_model != "auto":
        return cast(LensModel, lens_model)
    spherical = thin_spherical(D, object_distance, image_distance)
    return "thin" if spherical < MAX_THIN_LENS_WAVES * wavelength else "corrected"


def _lens_law(
    f: float, object_distance: float | None, image_distance: float | None
) -> tuple[float, float]:
    """Return object and image distance in metres that satisfy 1/f = 1/object + 1/image.

    Without any distance both are 2f.
    """
    for name, distance in (("object", object_distance), ("image", image_distance)):
        if distance is not None and distance <= f:
            raise ValueError(
                f"{name}_distance must be larger than the focal length of {f:g} m to form a real "
                f"image, got {distance:g} m."
            )
    if object_distance is None:
        if image_distance is None:
            return (2 * f, 2 * f)
        return (1 / (1 / f - 1 / image_distance), float(image_distance))
    if image_distance is None:
        return (float(object_distance), 1 / (1 / f - 1 / object_distance))
    if abs(f / object_distance + f / image_distance - 1) > LENS_LAW_TOLERANCE:
        fitting = 1 / (1 / f - 1 / object_distance)
        raise ValueError(
            f"object_distance = {object_distance:g} m and image_distance = {image_distance:g} m "
            f"contradict the lens law for f = {f:g} m: the image of this object is at "
            f"{fitting:.6g} m. Give only one of the two."
        )
    return (float(object_distance), float(image_distance))
