"""Raw images by wave optics: energies of points, pictures and slides added on the sensor.

Self-luminous sources are incoherent from point to point, and have three methods. "points": one
field for each point, four Fourier transforms each. "local": a window for each point
(local_exposure.py). "isoplanatic": a picture from patterns simulated at a few positions
(pattern_lattice.py, isoplanatic.py). Their number does not depend on the number of samples; a few
samples, exposed singly, measure the error. Slides are illuminated by coherent light, one field for
each snapshot (slides.py).
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
MAX_PATTERN_ERROR = 0.01  # relative error of patterns above which a SamplingWarning is issued
MAX_EXACT_OPERATIONS = 5e11  # operations below which "auto" is exact: half a minute on two cores
MIN_SAVING = 2  # minimum saving of operations for which "auto" gives up exactness above it
MAX_BATCH_BYTES = 2**28  # maximum bytes of fields that pass the camera together
SEED_STRIDE = 2**40  # difference of the seeds of two slides of a scene


@dataclass(frozen=True)
class Light:
    """Light that illuminates a camera's scene."""

    # source of the spectrum of every source and of the spatial model of slides; None stands for
    # the camera's wavelength
    coherence: Coherence | None
    koehler: bool  # True if the light behind a slide converges on the main lens
    averaging: dict[str, Any]  # given options of `Coherence.average` for slides

    def lines(self, wavelength: float) -> Sequence[tuple[float, float]]:
        """Return wavelengths and their fractions of the energy."""
        return [(wavelength, 1.0)] if self.coherence is None else self.coherence.lines(wavelength)

    def on_slide(self, number: int) -> Coherence:
        """Return the light on a slide, independent of the light on other slides."""
        assert self.coherence is not None  # `check` raises for a slide without light
        seed = (self.coherence.seed + number * SEED_STRIDE) % (LARGEST_SEED + 1)
        return replace(self.coherence, seed=seed)

    def check(self, slides: int) -> None:
        """Raise for slides without light, light without a slide, a checkpoint for two slides."""
        coherence = self.coherence
        if slides and coherence is None:
            raise ValueError(
                "coherence must be given for a picture with mode='transmission': use coherence="
                "Coherence() for a plane wave, or mode='emission' for a self-luminous picture."
            )
        if coherence is not None and coherence.spatial is not None and not slides:
            raise ValueError(
                "A spatial model of coherence applies to pictures with mode='transmission' only, "
                "because points and self-luminous pictures are incoherent: leave it out, "
                "Coherence(None, spectrum)."
            )
        if not slides and self.averaging:
            raise ValueError(
                "snapshots, rtol, region and checkpoint apply to pictures with mode='transmission' "
                "only: leave them out for this scene."
            )
        if slides > 1 and "checkpoint" in self.averaging:
            raise ValueError("A checkpoint stores one slide: expose several slides one by one.")


def expose_waves(
    optics: WaveOptics,
    sources: Sequence[Source],
    light: Light,
    *,
    method: Method,
    progress: Progress | None,
) -> RawImage:
    """Compute the raw image of points, self-luminous pictures and slides."""
    if light.coherence is not None:
        average_of(light.coherence)
    if method not in METHODS:
        raise ValueError(
            f"method must be 'auto', 'points', 'local' or 'isoplanatic', got {method!r}."
        )
    slides = [s for s in sources if isinstance(s, PicturePlane) and s.is_slide]
    emitters = [s for s in sources if s not in slides]
    light.check(len(slides))
    # sources with the same spectrum on every pixel, and the others
    plain = [s for s in emitters if optics.filters is None and s.spectra is None]
    spectral = [(s, spectral_lines(optics, s, light.coherence)) for s in emitters if s not in plain]
    lines = light.lines(optics.wavelength) if plain or slides else []
    colours = [replace(optics, wavelength=wavelength) for wavelength, _ in lines]
    if slides and optics.pixels is not None:
        raise ValueError(
            "Slides require pixels that sample the intensity, but these pixels integrate: leave "
            "out pixels= of the camera, with pixels that sample the light, or use "
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
        total = _accumulate(total, mean.intensity.data, 1.0, optics.device)
        reports.append(report)
    if plain:
        for colour, (_, share) in zip(colours, lines, strict=True):
            image, report = _expose_emitters(colour, plain, method, progress)
            total = _accumulate(total, image, share, optics.device)
            reports.append(report)
    if spectral:
        image = optics.device.zeros(optics.grid.shape, optics.device.real)
        for source, parts in spectral:
            for line in parts:
                colour = replace(optics, wavelength=line.wavelength)
                reports.append(_add_line(colour, source, line, image, method, progress))
        total = _accumulate(total, image, 1.0, optics.device)
    assert total is not None  # a scene has a source
    optics.device.finish()
    if optics.pixels is not None and optics.pixels.crosstalk is not None:
        total = optics.device.upload(optics.pixels.read(optics.device.download(total)))
    data = total if total.dtype == np.float32 else total.astype(np.float32)
    wavelengths = max((len(parts) for _, parts in spectral), default=None)
    report = replace(_join_reports(reports), wavelengths=wavelengths)
    return replace(raw_image(optics, data), exposure=report)


def check_occluders(optics: WaveOptics, method: Method, *, has_slides: bool) -> None:
    """Raise for screens behind the main lens, and for methods that do not support screens."""
    if optics.occluders and (has_slides or method not in ("auto", "local")):
        route = "slides" if has_slides else f"method={method!r}"
        raise ValueError(
            f"Occluders require method='local', got {route}: leave them out, or use points and "
            "self-luminous pictures with method='auto'."
        )
    for screen in optics.occluders:
        if screen.z <= -optics.object_distance:
            raise ValueError(
                f"The occluder at z = {screen.z:g} m is behind the main lens, "
                f"{optics.object_distance:g} m from the focused plane: use a larger z."
            )


def check_positions(optics: WaveOptics, source: Source, *, local: bool, slide: bool) -> None:
    """Raise if the camera cannot image a source at its wavelength."""
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
        raise SamplingError(f"{error} method='local' samples as finely as needed.") from error


def _accumulate(
    total: cla.Array | None, picture: cla.Array, share: float, device: Device
) -> cla.Array:
    """Add a picture times its share to a sum; the first picture of share 1 is not copied."""
    if total is None and share == 1:
        return picture
    if total is None:
        total = device.zeros(picture.shape, picture.dtype)
    add_scaled(total, picture, share, device)
    return total


def _expose_emitters(
    optics: WaveOptics, sources: Sequence[Source], method: Method, progress: Progress | None
) -> tuple[cla.Array, Exposure]:
    """Compute the energy of points and pictures at one wavelength, and a report of it."""
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
    return total, _join_reports(reports)


def _add_line(
    optics: WaveOptics,
    source: Source,
    line: SpectralLine,
    total: cla.Array,
    method: Method,
    progress: Progress | None,
) -> Exposure:
    """Add the signal of a source at a wavelength to an image of the sensor."""
    filters = optics.filters
    if isinstance(source, PointSources):
        points, powers = source, source.power[:, None]
    else:
        uniform = PicturePlane(source.energy, source.width, source.z)
        if _layout(optics, uniform, method) is not None:
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
        picture, report = _expose_emitters(optics, [channel], method, progress)
        reports.append(report)
        if filters is None or filters.mosaic is None:
            add_scaled(total, picture, float(weights[0]), device)
            continue
        behind = np.zeros(picture.shape)
        add_by_tile(behind, device.download(picture), weights[filters.index])
        add_scaled(total, device.upload(behind.astype(device.real)), 1.0, device)
    return _join_reports(reports)


def is_local(optics: WaveOptics, method: Method) -> bool:
    """Return True if points are exposed in windows."""
    needs_windows = optics.pixels is not None or bool(optics.occluders)
    local = method == "local" or (method == "auto" and needs_windows)
    if local and any(optics.aberrations.sensor_tilt):
        raise ValueError(
            "method='local' does not support a tilted sensor: use method='points', or leave out "
            "sensor_tilt of the camera's aberrations."
        )
    return local


def _layout(optics: WaveOptics, source: Source, method: Method) -> Layout | None:
    """Return the layout of a picture's patterns, or None for one field for each point."""
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
    exact_cost = _operations(transforms(optics, source.corners(), count))
    is_cheaper = exact_cost > max(
        MAX_EXACT_OPERATIONS, MIN_SAVING * _operations(plan.transforms(optics.grid.shape))
    )
    return plan if is_cheaper or method == "isoplanatic" else None


def _no_isoplanatic(optics: WaveOptics, plane: PicturePlane) -> str:
    """Return why patterns do not repeat along rows of lenslets; empty if they do."""
    mla = optics.mla
    if optics.occluders:
        return "method='isoplanatic' does not support occluders"
    if not optics.samples(plane.corners().positions):
        return "method='isoplanatic' requires pixels that sample the light's waves"
    if mla.rotation != 0:
        angle = f"{mla.rotation:g} rad"
        return f"method='isoplanatic' requires rows along x, but they are rotated by {angle}"
    if len(mla.focal_lengths) > 1:
        return "method='isoplanatic' requires lenslets of one focal length"
    if mla.map is not None and mla.map.is_per_lenslet:
        return "method='isoplanatic' requires equal lenslets, but each has its own map"
    if not optics.aberrations.scatter.is_none:
        return "method='isoplanatic' requires equal lenslets, without scatter"
    if any(optics.aberrations.sensor_tilt):
        return "method='isoplanatic' does not support a tilted sensor"
    if optics.aberrations.varies:
        return "method='isoplanatic' requires a main lens' wavefront constant over the field"
    return ""


def _operations(transforms: Transforms) -> float:
    """Return the cost of Fourier transforms, 5 N log2 N each."""
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
    """Add one field for each point; ``energies`` as in `add_local`."""
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
    return max(1, int(MAX_BATCH_BYTES / (field_bytes * widest)))


def _add_picture(
    optics: WaveOptics,
    plane: PicturePlane,
    plan: Layout,
    total: cla.Array,
    progress: Progress | None,
) -> Exposure:
    """Add a picture from its patterns; its error follows from two images of probes."""
    step = batch_size(optics, max(*plan.padding, plan.finer) ** 2)
    optics.device.require_memory(plan.memory(optics, step), "This exposure")
    chosen = _probes(plane, plan)
    probes = np.zeros(plane.image.shape)
    probes.ravel()[chosen] = 1
    picture, probe_image = raw_patterns(
        optics, plane, plan, probes=probes, batch=step, progress=progress
    )
    add_scaled(total, picture, 1.0, optics.device)
    points = PointSources(plane.positions()[chosen])
    exact = optics.device.zeros(optics.grid.shape, optics.device.real)
    once = _add_points(optics, points, exact, None)
    expected = optics.device.download(exact)
    error = np.abs(optics.device.download(probe_image) - expected).max() / expected.max()
    if error > MAX_PATTERN_ERROR:
        warn_caller(
            f"The picture's patterns differ by {error:.2g} of the maximum from one field for each "
            "sample: its light is undersampled, or changes across the field. Use method='points', "
            f"exact by {np.count_nonzero(plane.image)} fields, or finer pixels.",
            SamplingWarning,
        )
    transforms = plan.transforms(optics.grid.shape) + once.transforms
    return Exposure("isoplanatic", merged(transforms), float(error))


def _probes(plane: PicturePlane, plan: Layout) -> list[int]:
    """Return flat indices of three samples: brightest, outermost, farthest from all patches."""
    lit = np.flatnonzero(plane.image)
    iy, ix = np.unravel_index(lit, plane.image.shape)
    first = plan.patches[0]
    positions = np.stack([first.y[iy], first.x[ix]], axis=-1) + first.centre
    distance = np.min([np.hypot(patch.y[iy], patch.x[ix]) for patch in plan.patches], axis=0)
    indices = [int(plane.image.ravel()[lit].argmax()), int(np.hypot(*positions.T).argmax())]
    for n in indices:
        distance = np.minimum(distance, np.hypot(*(positions - positions[n]).T))
    return [int(lit[n]) for n in sorted({*indices, int(distance.argmax())})]


def _join_reports(reports: list[Exposure]) -> Exposure:
    """Join the reports of parts of a scene, with errors as if independent."""
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
    """Return the standard error of a sum of independent images."""
    if len(errors) < 2:
        return errors[0] if errors else None
    device = errors[0].device
    squares = np.sum([error.to_numpy().astype(np.float64) ** 2 for error in errors], axis=0)
    return Image(device.upload(np.sqrt(squares).astype(errors[0].data.dtype)), device)
