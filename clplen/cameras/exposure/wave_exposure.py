"""Raw images by wave optics: energies of points, pictures and slides added on the sensor.

Sources that shine by themselves are incoherent from point to point, and have two routes. "points":
one field for each point, four Fourier transforms each. "isoplanatic": a picture from patterns
simulated at a few positions (pattern_lattice.py, isoplanatic.py), as many for any number of
samples; its error is measured at a few of the picture's samples, exposed one by one. Slides are lit
by coherent light, one field a snapshot (slides.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.isoplanatic import Layout, layout, raw_patterns
from clplen.cameras.exposure.local_exposure import (
    add_integrated,
    add_local,
    check_windows,
    local_transforms,
)
from clplen.cameras.exposure.slides import light_slide
from clplen.cameras.exposure.spectral_exposure import (
    SpectralLine,
    add_by_tile,
    energies_by_pixel,
    spectral_lines,
)
from clplen.cameras.optics.ray_optics import check_in_view, raw_image
from clplen.cameras.optics.wave_optics import WaveOptics, padded_shape
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources, Source
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import SamplingError, SamplingWarning, warn_caller
from clplen.lightfield.raw.raw_image import Exposure, RawImage, Transforms, merged
from clplen.wave.coherence.averaging import Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.spatial_models import LARGEST_SEED
from clplen.wave.field.intensity import accumulate, add_scaled, average_of

Method = Literal["auto", "points", "local", "isoplanatic"]
METHODS = ("auto", "points", "local", "isoplanatic")
NOTABLE = 0.01  # measured error that is said aloud
AFFORDABLE = 5e11  # operations that "auto" spends on exactness: half a minute on two cores
WORTH = 2  # times fewer operations, from which "auto" gives up exactness beyond that
BATCH_BYTES = 2**28  # of fields that travel through the camera together
APART = 2**40  # seeds of the light on two slides of a scene


@dataclass(frozen=True)
class Light:
    """The light that a camera exposes by."""

    # its spectrum holds for every source, its spatial model for slides; None is the camera's
    # wavelength
    coherence: Coherence | None
    koehler: bool  # whether the light behind a slide converges on the main lens
    averaging: dict[str, Any]  # options of `Coherence.average` for slides, those that were given

    def lines(self, wavelength: float) -> Sequence[tuple[float, float]]:
        """Wavelengths and their shares of the energy."""
        return [(wavelength, 1.0)] if self.coherence is None else self.coherence.lines(wavelength)

    def on_slide(self, number: int) -> Coherence:
        """The light on one of the slides, independent of that on the others."""
        assert self.coherence is not None  # `check` refuses a slide without
        seed = (self.coherence.seed + number * APART) % (LARGEST_SEED + 1)
        return replace(self.coherence, seed=seed)

    def check(self, slides: int) -> None:
        """Refuse slides without light, light without a slide, one checkpoint for two slides."""
        coherence = self.coherence
        if slides and coherence is None:
            raise ValueError(
                "A picture with mode='transmission' needs light that falls on it: give "
                "coherence=, such as Coherence() for a plane wave, or use mode='emission' for a "
                "self-luminous one."
            )
        if coherence is not None and coherence.spatial is not None and not slides:
            raise ValueError(
                "Point sources and self-luminous pictures are incoherent already; a spatial model "
                "of coherence lights pictures with mode='transmission'. Leave it out: "
                "Coherence(None, spectrum)."
            )
        if not slides and self.averaging:
            raise ValueError(
                "snapshots, rtol, region and checkpoint are for pictures with mode='transmission'; "
                "this scene has none."
            )
        if slides > 1 and "checkpoint" in self.averaging:
            raise ValueError("A checkpoint serves one slide: expose several one by one.")


def expose_waves(
    optics: WaveOptics,
    sources: Sequence[Source],
    light: Light,
    *,
    method: Method,
    progress: Progress | None,
) -> RawImage:
    """The raw image of points, self-luminous pictures and slides."""
    if light.coherence is not None:
        average_of(light.coherence)
    if method not in METHODS:
        raise ValueError(f"method is 'auto', 'points', 'local' or 'isoplanatic', not {method!r}.")
    slides = [s for s in sources if isinstance(s, PicturePlane) and s.is_slide]
    emitters = [s for s in sources if s not in slides]
    light.check(len(slides))
    # sources whose light is shared by wavelength, whatever pixel it falls on, and the others
    plain = [s for s in emitters if optics.filters is None and s.spectra is None]
    spectral = [(s, spectral_lines(optics, s, light.coherence)) for s in emitters if s not in plain]
    lines = light.lines(optics.wavelength) if plain or slides else []
    colours = [replace(optics, wavelength=wavelength) for wavelength, _ in lines]
    if slides and optics.pixels is not None:
        raise ValueError(
            "Slides are exposed by fields in the middles of pixels, and these pixels integrate: "
            "leave pixels= of the camera out, with pixels that sample the light, or use "
            "mode='emission'."
        )
    check_occluders(optics, method, has_slides=bool(slides))
    local = is_local(optics, method)
    for source in (*slides, *plain):
        for colour in colours:
            check_positions(colour, source, local=local, slide=source in slides)
    for source, parts in spectral:
        for end in (parts[0], parts[-1]):  # the longest and the shortest wavelength
            colour = replace(optics, wavelength=end.wavelength)
            check_positions(colour, source, local=local, slide=False)
    total: cla.Array | None = None
    reports = []
    for number, slide in enumerate(slides):
        mean, report = light_slide(
            optics, slide, light.on_slide(number), light.koehler, light.averaging, progress
        )
        total = _added(total, mean.intensity.data, 1.0, optics.device)
        reports.append(report)
    if plain:
        for colour, (_, share) in zip(colours, lines, strict=True):
            image, report = _emit(colour, plain, method, progress)
            total = _added(total, image, share, optics.device)
            reports.append(report)
    if spectral:
        image = optics.device.zeros(optics.grid.shape, optics.device.real)
        for source, parts in spectral:
            for line in parts:
                colour = replace(optics, wavelength=line.wavelength)
                reports.append(_add_line(colour, source, line, image, method, progress))
        total = _added(total, image, 1.0, optics.device)
    assert total is not None  # a scene has a source
    optics.device.finish()
    if optics.pixels is not None and optics.pixels.crosstalk is not None:
        total = optics.device.upload(optics.pixels.read(optics.device.download(total)))
    data = total if total.dtype == np.float32 else total.astype(np.float32)
    wavelengths = max((len(parts) for _, parts in spectral), default=None)
    report = replace(_joined(reports), wavelengths=wavelengths)
    return replace(raw_image(optics, data), exposure=report)


def check_occluders(optics: WaveOptics, method: Method, *, has_slides: bool) -> None:
    """Refuse screens that no lens sees, and ways of the light that know none."""
    if optics.occluders and (has_slides or method not in ("auto", "local")):
        way = "slides" if has_slides else f"method={method!r}"
        raise ValueError(
            f"Occluders are known to windows of single points, method='local', not to {way}: leave "
            "them out, or use points and self-luminous pictures with method='auto'."
        )
    for screen in optics.occluders:
        if screen.z <= -optics.object_distance:
            raise ValueError(
                f"The occluder at z = {screen.z:g} m lies behind the main lens, which is "
                f"{optics.object_distance:g} m from the focused plane."
            )


def check_positions(optics: WaveOptics, source: Source, *, local: bool, slide: bool) -> None:
    """Refuse points that the camera cannot show at its wavelength."""
    points = source if isinstance(source, PointSources) else source.corners()
    check_in_view(optics, points.positions)
    if local and not slide:
        check_windows(optics, points)
        return
    try:
        optics.check_positions(points.positions)
    except SamplingError as error:
        if slide:
            raise
        raise SamplingError(f"{error} method='local' samples as finely as it needs.") from error


def _added(total: cla.Array | None, picture: cla.Array, share: float, device: Device) -> cla.Array:
    """A sum of pictures times their shares with one more; the first is taken as it is if whole."""
    if total is None and share == 1:
        return picture
    if total is None:
        total = device.zeros(picture.shape, picture.dtype)
    add_scaled(total, picture, share, device)
    return total


def _emit(
    optics: WaveOptics, sources: Sequence[Source], method: Method, progress: Progress | None
) -> tuple[cla.Array, Exposure]:
    """Energy of points and self-luminous pictures at one wavelength, and how it was found."""
    layouts = [_layout(optics, source, method) for source in sources]
    total = optics.device.zeros(optics.grid.shape, optics.device.real)
    reports = []
    for source, plan in zip(sources, layouts, strict=True):
        if isinstance(source, PicturePlane) and plan is not None:
            reports.append(_add_picture(optics, source, plan, total, progress))
        else:
            points = source if isinstance(source, PointSources) else source.points()
            add = add_local if is_local(optics, method) else _add_points
            reports.append(add(optics, points, total, progress))
    optics.device.finish()
    return total, _joined(reports)


def _add_line(
    optics: WaveOptics,
    source: Source,
    line: SpectralLine,
    total: cla.Array,
    method: Method,
    progress: Progress | None,
) -> Exposure:
    """Add the signal of a source at one of its wavelengths to an image of the sensor."""
    filters = optics.filters
    if isinstance(source, PointSources):
        points, powers = source, source.power[:, None]
    else:
        even = PicturePlane(source.energy, source.width, source.z)
        if _layout(optics, even, method) is not None:
            return _add_channels(optics, source, line, total, method, progress)
        points = source.points()
        powers = source.image.reshape(source.energy.size, -1)[source.energy.ravel() > 0]
    add = add_local if is_local(optics, method) else _add_points
    return add(optics, points, total, progress, energies_by_pixel(filters, powers, line))


def _add_channels(
    optics: WaveOptics,
    plane: PicturePlane,
    line: SpectralLine,
    total: cla.Array,
    method: Method,
    progress: Progress | None,
) -> Exposure:
    """Add the channels of a picture, each from its patterns."""
    device, filters, reports = optics.device, optics.filters, []
    for number, weights in enumerate(line.weights):
        image = plane.image.reshape(*plane.energy.shape, -1)[..., number]
        if not image.any():
            continue
        channel = PicturePlane(image, plane.width, plane.z)
        picture, report = _emit(optics, [channel], method, progress)
        reports.append(report)
        if filters is None or filters.mosaic is None:
            add_scaled(total, picture, float(weights[0]), device)
            continue
        behind = np.zeros(picture.shape)
        add_by_tile(behind, device.download(picture), weights[filters.index])
        add_scaled(total, device.upload(behind.astype(device.real)), 1.0, device)
    return _joined(reports)


def is_local(optics: WaveOptics, method: Method) -> bool:
    """Whether points have windows of their own."""
    own = optics.pixels is not None or bool(optics.occluders)
    local = method == "local" or (method == "auto" and own)
    if local and any(optics.aberrations.sensor_tilt):
        raise ValueError(
            "Windows of single points know no tilted sensor: use method='points', or leave out "
            "sensor_tilt of the camera's aberrations."
        )
    return local


def _layout(optics: WaveOptics, source: Source, method: Method) -> Layout | None:
    """The layout of a picture's patterns, or None for one field a point."""
    if isinstance(source, PointSources) or method in ("points", "local"):
        return None
    obstacle = _no_isoplanatic(optics, source)
    if obstacle:
        if method == "isoplanatic":
            raise ValueError(f"{obstacle}: use method='points'.")
        return None
    plan = layout(optics, source)
    count = int(np.count_nonzero(source.image))
    transforms = local_transforms if is_local(optics, method) else _point_transforms
    exact = _operations(transforms(optics, source.corners(), count))
    saved = exact > max(AFFORDABLE, WORTH * _operations(plan.transforms(optics.grid.shape)))
    return plan if saved or method == "isoplanatic" else None


def _no_isoplanatic(optics: WaveOptics, plane: PicturePlane) -> str:
    """Why patterns do not repeat from lenslet to lenslet along rows; empty where they do."""
    mla = optics.mla
    if optics.occluders:
        return "Occluders stop other light of each point"
    if not optics.samples(plane.corners().positions):
        return "The pixels do not sample the light's waves, as method='isoplanatic' needs"
    if mla.rotation != 0:
        return (
            f"The array is turned by {mla.rotation:g} rad; method='isoplanatic' needs rows along x"
        )
    if len(mla.focal_lengths) > 1:
        return "The lenslets differ in focal length; method='isoplanatic' needs equal ones"
    if mla.map is not None and mla.map.is_per_lenslet:
        return "The lenslets have a map each; method='isoplanatic' needs equal ones"
    if not optics.aberrations.scatter.is_none:
        return "The lenslets scatter; method='isoplanatic' needs equal ones"
    if any(optics.aberrations.sensor_tilt):
        return "The sensor is tilted, as method='isoplanatic' cannot know"
    if optics.aberrations.varies:
        return "The main lens' wavefront changes over the field, as method='isoplanatic' cannot"
    return ""


def _operations(transforms: Transforms) -> float:
    """5 N log2 N for each Fourier transform."""
    return sum(
        count * 5 * math.prod(shape) * math.log2(max(2, math.prod(shape)))
        for count, shape in transforms
    )


def _point_transforms(optics: WaveOptics, points: PointSources, count: int) -> Transforms:
    pads = optics.padding(points.positions)
    return tuple((2 * count, padded_shape(optics.grid.shape, pad)) for pad in pads)


def _add_points(
    optics: WaveOptics,
    points: PointSources,
    total: cla.Array,
    progress: Progress | None,
    energies: Any = None,
) -> Exposure:
    """One field a point; ``energies`` as for `add_local`."""
    energies = points.power if energies is None else energies
    to_array, to_sensor = optics.padding(points.positions)
    widest = max(to_array, to_sensor) ** 2
    step = batch_size(optics, widest)
    field_bytes = math.prod(optics.grid.shape) * optics.device.complex.itemsize
    optics.device.require_memory(
        (2 * widest + 2) * field_bytes * min(step, len(points)), "This exposure"
    )
    for start in range(0, len(points), step):
        chosen = slice(start, min(start + step, len(points)))
        pupil, energy = optics.pupil_and_energy(
            points.positions[chosen], points.diameter, full_grid=False
        )
        at_array = optics.array_field(pupil, pad=to_array)
        fields = optics.sensor_field(at_array, pad=to_sensor)
        weights = (energies[chosen].T / energy).T
        if optics.pixels is None or (optics.pixels.active == 0 and weights.ndim == 1):
            accumulate(total, fields.data, weights, optics.device)
        else:
            add_integrated(total, fields, weights, optics.pixels.active)
        if progress is not None:
            progress(chosen.stop, len(points))
    return Exposure("points", _point_transforms(optics, points, len(points)), 0.0)


def batch_size(optics: WaveOptics, widest: int) -> int:
    field_bytes = math.prod(optics.grid.shape) * optics.device.complex.itemsize
    return max(1, int(BATCH_BYTES / (field_bytes * widest)))


def _add_picture(
    optics: WaveOptics,
    plane: PicturePlane,
    plan: Layout,
    total: cla.Array,
    progress: Progress | None,
) -> Exposure:
    """A picture from its patterns, its error from its probes' two images."""
    step = batch_size(optics, max(*plan.padding, plan.finer) ** 2)
    optics.device.require_memory(plan.memory(optics, step), "This exposure")
    chosen = _probes(plane, plan)
    probes = np.zeros(plane.image.shape)
    probes.ravel()[chosen] = 1
    picture, seen = raw_patterns(optics, plane, plan, probes=probes, batch=step, progress=progress)
    add_scaled(total, picture, 1.0, optics.device)
    points = PointSources(plane.positions()[chosen])
    exact = optics.device.zeros(optics.grid.shape, optics.device.real)
    once = _add_points(optics, points, exact, None)
    expected = optics.device.download(exact)
    error = np.abs(optics.device.download(seen) - expected).max() / expected.max()
    if error > NOTABLE:
        warn_caller(
            f"The picture's patterns depart by {error:.2g} of the maximum from one field a sample: "
            "its light is hardly sampled, or changes across the field. method='points' is exact, "
            f"{np.count_nonzero(plane.image)} fields; finer pixels make both better.",
            SamplingWarning,
        )
    transforms = plan.transforms(optics.grid.shape) + once.transforms
    return Exposure("isoplanatic", merged(transforms), float(error))


def _probes(plane: PicturePlane, plan: Layout) -> list[int]:
    """Flat indices of samples: the brightest, the one farthest out, one far from all patches."""
    lit = np.flatnonzero(plane.image)
    iy, ix = np.unravel_index(lit, plane.image.shape)
    first = plan.patches[0]
    places = np.stack([first.y[iy], first.x[ix]], axis=-1) + first.centre
    apart = np.min([np.hypot(patch.y[iy], patch.x[ix]) for patch in plan.patches], axis=0)
    found = [int(plane.image.ravel()[lit].argmax()), int(np.hypot(*places.T).argmax())]
    for n in found:
        apart = np.minimum(apart, np.hypot(*(places - places[n]).T))
    return [int(lit[n]) for n in sorted({*found, int(apart.argmax())})]


def _joined(reports: list[Exposure]) -> Exposure:
    """What several parts of a scene were exposed by; their errors as if they were independent."""
    routes = sorted({report.route for report in reports})
    transforms = merged([pair for report in reports for pair in report.transforms])
    numbers = [report.snapshots for report in reports if report.snapshots is not None]
    relative = [report.relative_error for report in reports if report.relative_error is not None]
    errors = [report.standard_error for report in reports if report.standard_error is not None]
    return Exposure(
        " + ".join(routes),
        transforms,
        max(report.error for report in reports),
        max(numbers, default=None),
        _joint_error(errors),
        max(relative, default=None),
    )


def _joint_error(errors: list[Image]) -> Image | None:
    """Standard error of a sum of independent images."""
    if len(errors) < 2:
        return errors[0] if errors else None
    device = errors[0].device
    squares = np.sum([error.to_numpy().astype(np.float64) ** 2 for error in errors], axis=0)
    return Image(device.upload(np.sqrt(squares).astype(errors[0].data.dtype)), device)
