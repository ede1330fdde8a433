"""What both plenoptic cameras do: take raw images of scenes."""

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
from clplen.cameras.optics.tilted_sensor import reach_of
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
from clplen.wave.coherence.averaging import Checkpoint, Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import row_powers
from clplen.wave.field.intensity import Region
from clplen.wave.spectrum.spectrum_tables import check_wavelength

Scene = SurfaceScene | Source | Sequence[Source | Occluder]
Self = TypeVar("Self", bound="Plenoptic")

QUARTER = 0.25  # of a wave, below which a thin lens is as good as a corrected one (Rayleigh)
SCALAR_NA = 0.4  # above which the polarisation of light matters (Stamnes 1986, section 16.3)
LENS_LAW_TOLERANCE = 1e-6  # relative, of 1/f = 1/object + 1/image


@dataclass(frozen=True, repr=False)
class Plenoptic(Described, RayOptics):
    """A plenoptic camera that takes raw images: `Plenoptic1` or `Plenoptic2`."""

    kind: ClassVar[Kind]

    def with_aberrations(self: Self, aberrations: Aberrations) -> Self:
        """The same camera as it is built: with these in place of its aberrations.

        Parameters
        ----------
        aberrations : Aberrations

        Returns
        -------
        Plenoptic1 or Plenoptic2

        Raises
        ------
        ValueError
            If Zernike terms of lenslets reach beyond their circle, or the sensor would not lie
            behind the array.
        TypeError
            If they are something else.
        """
        if not isinstance(aberrations, Aberrations):
            raise TypeError(f"aberrations are Aberrations(...), not {type(aberrations).__name__}.")
        camera = replace(self, aberrations=aberrations)
        aberrations.check_lenslets(self.mla)
        if not camera.sensor_distance > 0:
            raise ValueError(
                f"sensor_shift = {aberrations.sensor_shift:g} m puts the sensor at "
                f"{camera.sensor_distance:g} m, not behind the array."
            )
        nearer = reach_of(camera.grid, aberrations.sensor_tilt)
        if not camera.sensor_distance > nearer:
            raise ValueError(
                f"sensor_tilt = {aberrations.sensor_tilt} brings pixels {nearer:g} m nearer to the "
                f"array, which is {camera.sensor_distance:g} m away: give smaller slopes."
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
        """Take a raw image: intensities of all points and pictures added.

        Parameters
        ----------
        scene : PointSources, PicturePlane, list of them and of Occluder, or SurfaceScene
            The light of a list's members adds up. An `Occluder`, or a picture with ``opacity``,
            attenuates what lies behind it. A `SurfaceScene` has occlusion and needs
            ``model="rays"``: Y and X count lenslets from the middle of the array, d is the
            disparity of the decoded light field, and 1 is the raw image of white.
        model : {"waves", "rays"}
            Wave optics, or geometrical rays: no diffraction, and of what follows only ``sensor``.
        coherence : Coherence, optional
            Its spectrum holds for all sources that have none of their own, its spatial model for
            slides (``mode="transmission"``), which need it. Points and self-luminous pictures are
            incoherent from point to point. ``wavelengths`` says by how many a source with a
            spectrum is exposed, too; by default as many as its image needs to be right to 1e-3.
        sensor : Sensor, optional
            Photons, noise, bits; None keeps units of energy.
        progress : callable, optional
            Called as ``progress(done, total)`` after each batch of fields and each snapshot, from 0
            again for each part of the scene.
        method : {"auto", "points", "local", "isoplanatic"}
            "points": one field as large as the sensor for each point, whose pixels must sample its
            waves. "local": each point in a window of its own about its chief ray, with samples as
            fine as its waves need. "isoplanatic": a picture from patterns at a few places of X
            under one lenslet, moved and added (the array's rows along x). "auto" takes "local" for
            pixels that integrate, else "points", for a picture "isoplanatic" where these are not
            affordable.
        koehler : bool
            Whether the light behind a slide converges on the main lens (Goodman 2005, section
            5.3.2), so that all of the slide is seen; else it goes on parallel to the axis.
        snapshots, rtol, region, checkpoint
            Of slides, as in `Coherence.average`; the region is one of the sensor.

        Returns
        -------
        RawImage
            float32, shape of ``grid``; n sources of power 1 add up to n (1 - 1e-3 .. 1), behind
            colour filters times their sensitivities, with ``mosaic`` the names of these. A clear
            sample of a slide sends the energy 1 towards the lens. ``exposure`` says how the image
            was found and how exact it is; by rays ``truth`` holds that of a `SurfaceScene`.

        Raises
        ------
        SamplingError
            If light reaches the sensor at angles that the pixels do not sample, a point is imaged
            beyond the array, or the grid does not carry the light on a slide.
        ValueError
            If a point lies behind the lens, a slide has no light, a spatial model nothing to light,
            or ``model`` or ``method`` do not fit the scene or the camera, or no colour filter sees
            a source's light.
        FormatError
            If the checkpoint is damaged or of another set-up.
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
            sources, before = as_sources(scene), replace(optics, occluders=as_occluders(scene))
            raw = expose_waves(before, sources, light, method=method, progress=progress)
        raw = replace(raw, camera=self)
        return raw if sensor is None else sensor.record(raw)

    @property
    def optics(self) -> WaveOptics:
        """The waves that go through the camera: fields of positions at each of its planes."""
        return WaveOptics(**{field.name: getattr(self, field.name) for field in fields(RayOptics)})

    def raw_image(self, data: cla.Array) -> RawImage:
        """Intensity on the sensor with the positions of the sub-images on it."""
        return replace(raw_image(self, data), camera=self)

    def check_scene(self, scene: PointSources) -> None:
        """Refuse sources that this camera cannot show; see `expose`."""
        if self.pixels is None:
            self.optics.check_positions(scene.positions)
        else:
            check_in_view(self, scene.positions)


def scene_energy(camera: Plenoptic, scene: PointSources) -> Sequence[tuple[float, float, float]]:
    """Compute the share of each source's energy that reaches the array and the sensor.

    Parameters
    ----------
    camera : Plenoptic1 or Plenoptic2
        Fields are computed on its grid, one sample a pixel.
    scene : PointSources
        Their positions and diameter count.

    Returns
    -------
    list of tuple of float
        For each source (1.0, at the array, at the sensor), fractions of its energy at the aperture.
    """
    rows = []
    optics = camera.optics
    to_array, to_sensor = optics.padding(scene.positions)
    for place in scene.positions:
        pupil, energy = optics.pupil_and_energy(place[None], scene.diameter, full_grid=False)
        at_array = optics.array_field(pupil, pad=to_array)
        at_sensor = optics.sensor_field(at_array, pad=to_sensor)
        energies = [float(row_powers(f).sum()) for f in (at_array, at_sensor)]
        rows.append((1.0, energies[0] / float(energy[0]), energies[1] / float(energy[0])))
    return rows


def _uses_rays(
    model: str, scene: Any, coherence: Coherence | None, averaging: dict[str, Any]
) -> bool:
    """Whether a raw image is to be found by rays."""
    if model not in ("waves", "rays"):
        raise ValueError(f"model is 'waves' or 'rays', not {model!r}.")
    if model == "waves" and isinstance(scene, SurfaceScene):
        raise ValueError(
            "A SurfaceScene is exposed by rays: give model='rays'. Waves take PointSources, "
            "PicturePlanes and Occluders."
        )
    if model == "rays" and (coherence is not None or averaging):
        raise ValueError(
            "coherence, snapshots, rtol, region and checkpoint are for model='waves': rays are "
            "incoherent and exact at once."
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
    """Object and image distance, after a look at everything that both cameras are given."""
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
            f"The lenslets of a camera converge: f > 0, not {min(mla.focal_lengths)!r}."
        )
    distances = _lens_law(focal_length, object_distance, image_distance)
    longest = max(mla.focal_lengths)
    if longest >= distances[1]:
        meant = units.LENSLET_FOCAL_LENGTH.suggestion(longest)
        raise ValueError(
            f"The lenslets' focal length of {longest:g} m is not shorter than the image distance "
            f"of the main lens, {distances[1]:g} m{meant}"
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
    **own: Any,
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
        **own,
    )
    return camera.with_aberrations(aberrations)


def _check_aperture(D: float, F: float) -> None:
    """Refuse an aperture that no lens has; warn of one that scalar waves do not describe well.

    The numerical aperture at the image of a lens that obeys the sine condition is D/(2 F), below 1.
    """
    na = D / (2 * F)
    if na >= 1:
        meant = units.CAMERA_DIAMETER.suggestion(D).rstrip(".") if D > 1 else ""
        raise ValueError(
            f"An aperture of {D:g} m and its image {F:g} m away would be NA {na:.3g}, and no lens "
            f"has 1 or more: below {2 * F:g} m would do{meant or '.'}"
        )
    if na > SCALAR_NA:
        warn_caller(
            f"The main lens has NA {na:.3g} at its image, D/(2 F) above {SCALAR_NA:g}: waves here "
            f"are scalar, without polarisation; D of {2 * F * SCALAR_NA:.3g} m or less would do.",
            SamplingWarning,
        )


def _choose_lens_model(
    given: str, D: float, object_distance: float, image_distance: float, wavelength: float
) -> LensModel:
    """The model of the main lens."""
    if given not in ("auto", "thin", "corrected"):
        raise ValueError(f"lens_model is 'auto', 'thin' or 'corrected', not {given!r}.")
    if given != "auto":
        return cast(LensModel, given)
    spherical = thin_spherical(D, object_distance, image_distance)
    return "thin" if spherical < QUARTER * wavelength else "corrected"


def _lens_law(
    f: float, object_distance: float | None, image_distance: float | None
) -> tuple[float, float]:
    """Object and image distance that satisfy 1/f = 1/object + 1/image, in metres.

    Neither given: 2f and 2f. One given: the other follows.
    """
    for name, distance in (("object", object_distance), ("image", image_distance)):
        if distance is not None and distance <= f:
            raise ValueError(
                f"{name}_distance = {distance:g} m is within the focal length of {f:g} m: there is "
                "no real image."
            )
    if object_distance is None:
        if image_distance is None:
            return (2 * f, 2 * f)
        return (1 / (1 / f - 1 / image_distance), float(image_distance))
    if image_distance is None:
        return (float(object_distance), 1 / (1 / f - 1 / object_distance))
    if abs(f / object_distance + f / image_distance - 1) > LENS_LAW_TOLERANCE:
        fits = 1 / (1 / f - 1 / object_distance)
        raise ValueError(
            f"object_distance = {object_distance:g} m and image_distance = {image_distance:g} m "
            f"contradict the lens law for f = {f:g} m: this object is imaged at {fits:.6g} m. Give "
            "one of the two."
        )
    return (float(object_distance), float(image_distance))
