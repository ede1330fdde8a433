"""A camera's raw image of a whole scene: what shines by itself, and slides that light falls on."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pyopencl.array as cla

from clplen.cameras.exposure.emission import METHODS, Method, emit, together
from clplen.cameras.exposure.isoplanatic import padded
from clplen.cameras.exposure.slides import SlideWay, slide_field, slide_way
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources, parts
from clplen.lightfield.raw import Exposure
from clplen.wave.average import Averaging, MeanIntensity, Progress
from clplen.wave.checks import average_of
from clplen.wave.coherence import Coherence
from clplen.wave.random import LARGEST_SEED
from clplen.wave.reach import Opening, check_opening
from clplen.wave.statistics import add_scaled

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic
    from clplen.compute.device import Device

APART = 2**40  # seeds of the light on two slides of a scene
MASK_TRANSFORMS = 2  # of the field of a random source


def expose_scene(
    camera: Plenoptic,
    scene: Any,
    *,
    coherence: Coherence | None,
    koehler: bool,
    method: Method,
    how: Averaging,
    progress: Progress | None,
) -> tuple[cla.Array, Exposure]:
    """Energy on the sensor, and how it was found; see `Plenoptic.expose`.

    Parameters
    ----------
    camera : Plenoptic
    scene : PointSources, PicturePlane or list of them
    coherence : Coherence or None
    koehler : bool
    method : {"auto", "points", "isoplanatic"}
    how : Averaging
        Of the slides' snapshots.
    progress : callable or None

    Returns
    -------
    tuple
        Device array of the sensor's shape in the device's real dtype, and `Exposure`.
    """
    if coherence is not None:
        average_of(coherence)
    if method not in METHODS:
        raise ValueError(f"method is 'auto', 'points' or 'isoplanatic', not {method!r}.")
    members = parts(scene)
    slides = [one for one in members if isinstance(one, PicturePlane) and one.is_slide]
    shining = [one for one in members if one not in slides]
    _check_light(coherence, slides, how)
    lines = [(camera.wavelength, 1.0)]
    if coherence is not None:
        lines = coherence.lines(camera.wavelength)
    cameras = [replace(camera, wavelength=wavelength) for wavelength, _ in lines]
    for part in members:
        for one in cameras:
            one.check_scene(part if isinstance(part, PointSources) else part.corners())
    total: cla.Array | None = None
    reports = []
    for number, slide in enumerate(slides):
        assert coherence is not None
        light = replace(coherence, seed=(coherence.seed + number * APART) % (LARGEST_SEED + 1))
        found, report = _light_slide(camera, slide, light, koehler, how, progress)
        total = _added(total, found.intensity.data, 1.0, camera.device)
        reports.append(report)
    if shining:
        for one, (_, share) in zip(cameras, lines, strict=True):
            image, report = emit(one, shining, method=method, progress=progress)
            total = _added(total, image, share, camera.device)
            reports.append(report)
    assert total is not None  # `parts` refuses an empty scene
    camera.device.finish()
    return total, together(reports)


def _added(total: cla.Array | None, picture: cla.Array, share: float, device: Device) -> cla.Array:
    """A sum of pictures times their shares with one more; the first is taken as it is if whole."""
    if total is None and share == 1:
        return picture
    if total is None:
        total = device.zeros(picture.shape, picture.dtype)
    add_scaled(total, picture, share, device)
    return total


def _check_light(coherence: Coherence | None, slides: list[Any], how: Averaging) -> None:
    """Refuse a slide without light, light without a slide, one checkpoint for two slides."""
    if slides and coherence is None:
        raise ValueError(
            "A picture with mode='transmission' needs light that falls on it: give coherence=, "
            "such as Coherence() for a plane wave, or use mode='emission' for a self-luminous one."
        )
    if coherence is not None and coherence.spatial is not None and not slides:
        raise ValueError(
            "Point sources and self-luminous pictures are incoherent already; a spatial model of "
            "coherence lights pictures with mode='transmission'. Leave it out: "
            "Coherence(None, spectrum)."
        )
    averaging = (how.snapshots, how.rtol, how.region, how.checkpoint)
    if not slides and any(option is not None for option in averaging):
        raise ValueError(
            "snapshots, rtol, region and checkpoint are for pictures with mode='transmission'; "
            "this scene has none."
        )
    if len(slides) > 1 and how.checkpoint is not None:
        raise ValueError("A checkpoint serves one slide: expose several one by one.")


def _light_slide(
    camera: Plenoptic,
    slide: PicturePlane,
    light: Coherence,
    koehler: bool,
    how: Averaging,
    progress: Progress | None,
) -> tuple[MeanIntensity, Exposure]:
    """The raw image of one slide, and how it was found."""
    way, field = slide_way(camera, slide, koehler), slide_field(camera, slide)
    if light.spatial is not None:
        focus = way.z if koehler else math.inf
        check_opening(field, light.spatial, Opening(way.z, camera.aperture_diameter, focus))
    found = light.average(
        way, field, snapshots=how.snapshots, rtol=how.rtol, region=how.region,
        checkpoint=how.checkpoint, progress=progress, method="monte-carlo",
    )  # fmt: skip
    return found, _report(way, found, light, len(light.lines(camera.wavelength)))


def _report(way: SlideWay, found: MeanIntensity, coherence: Coherence, lines: int) -> Exposure:
    """How a slide was exposed."""
    fields = found.snapshots * lines if coherence.is_random else lines
    shape = way.camera.grid.shape
    counts: dict[tuple[int, int], int] = {}
    for pad in (1 if way.koehler else 2, *way.padding):
        size = padded(shape, pad)
        counts[size] = counts.get(size, 0) + 2 * fields
    if coherence.is_random:
        counts[shape] = counts.get(shape, 0) + MASK_TRANSFORMS * fields
    transforms = tuple((count, size) for size, count in counts.items())
    error = found.standard_error if coherence.is_random else None
    number = found.snapshots if coherence.is_random else None
    route = "snapshots" if coherence.is_random else "coherent"
    return Exposure(route, transforms, 0.0, number, error, found.relative_error if number else None)
