"""Raw images of what shines by itself: points and pictures, every sample incoherent with the rest.

Two routes. "points": one field for each point, four Fourier transforms each. "isoplanatic": a
picture from patterns simulated at a few places (lattice.py, isoplanatic.py), as many for any number
of samples; its error is measured at a few of the picture's samples, exposed one by one.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.isoplanatic import Layout, layout, padded, raw_patterns
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources, parts
from clplen.compute.image import Image
from clplen.errors import SamplingWarning
from clplen.lightfield.raw import Exposure, Transforms
from clplen.wave.average import Progress
from clplen.wave.field import row_powers
from clplen.wave.statistics import accumulate, add_scaled

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic

Vector = np.ndarray[Any, np.dtype[np.float64]]
Method = Literal["auto", "points", "isoplanatic"]
METHODS = ("auto", "points", "isoplanatic")
NOTABLE = 0.01  # measured error that is said aloud
AFFORDABLE = 5e11  # operations that "auto" spends on exactness: half a minute on two cores
WORTH = 2  # times fewer operations, from which "auto" gives up exactness beyond that
BATCH_BYTES = 2**28  # of fields that travel through the camera together


def emit(
    camera: Plenoptic, scene: Any, *, method: Method = "auto", progress: Progress | None = None
) -> tuple[cla.Array, Exposure]:
    """Energy on the sensor of a scene of points and self-luminous pictures, and how it was found.

    Parameters
    ----------
    camera : Plenoptic
    scene : PointSources, PicturePlane or list of them
    method : {"auto", "points", "isoplanatic"}
        Route of the pictures; "auto" leaves the exact one, "points", where it is not affordable and
        the other takes less than half as many operations.
    progress : callable, optional
        Called as ``progress(done, total)`` after each batch of fields, from 0 again for each part
        of the scene.

    Returns
    -------
    tuple
        Device array of the sensor's shape in the device's real dtype, and `Exposure`.

    Raises
    ------
    SamplingError, ValueError, TypeError, DeviceError
        As `Plenoptic.expose`, whose scene has been checked.
    """
    members = parts(scene)
    ways = [_way(camera, part, method) for part in members]
    total = camera.device.zeros(camera.grid.shape, camera.device.real)
    reports = []
    for part, how in zip(members, ways, strict=True):
        if isinstance(part, PicturePlane) and how is not None:
            reports.append(_add_picture(camera, part, how, total, progress))
        else:
            points = part if isinstance(part, PointSources) else part.points()
            reports.append(_add_points(camera, points, total, progress))
    camera.device.finish()
    return total, together(reports)


def _way(camera: Plenoptic, part: PointSources | PicturePlane, method: Method) -> Layout | None:
    """The layout of a picture's patterns, or None for one field a point."""
    if isinstance(part, PointSources) or method == "points":
        return None
    obstacle = _no_isoplanatic(camera)
    if obstacle:
        if method == "isoplanatic":
            raise ValueError(f"{obstacle}: use method='points'.")
        return None
    how = layout(camera, part)
    exact = _operations(
        _point_transforms(camera, part.corners(), int(np.count_nonzero(part.image)))
    )
    saved = exact > max(AFFORDABLE, WORTH * _operations(how.transforms(camera.grid.shape)))
    return how if saved or method == "isoplanatic" else None


def _no_isoplanatic(camera: Plenoptic) -> str:
    """Why patterns do not repeat from lenslet to lenslet along rows; empty where they do."""
    mla = camera.mla
    if mla.rotation != 0:
        return (
            f"The array is turned by {mla.rotation:g} rad; method='isoplanatic' needs rows along x"
        )
    if len(mla.focal_lengths) > 1:
        return "The lenslets differ in focal length; method='isoplanatic' needs equal ones"
    if not camera.aberrations.scatter.is_none:
        return "The lenslets scatter; method='isoplanatic' needs equal ones"
    if camera.aberrations.varies:
        return "The main lens' wavefront changes over the field, as method='isoplanatic' cannot"
    return ""


def _operations(transforms: Transforms) -> float:
    """5 N log2 N for each Fourier transform."""
    return sum(
        count * 5 * math.prod(shape) * math.log2(max(2, math.prod(shape)))
        for count, shape in transforms
    )


def _point_transforms(camera: Plenoptic, points: PointSources, count: int) -> Transforms:
    return tuple((2 * count, padded(camera.grid.shape, pad)) for pad in camera.padding(points))


def _add_points(
    camera: Plenoptic, points: PointSources, total: cla.Array, progress: Progress | None
) -> Exposure:
    """One field a point."""
    to_array, to_sensor = camera.padding(points)
    widest = max(to_array, to_sensor) ** 2
    step = _batch(camera, widest)
    field_bytes = math.prod(camera.grid.shape) * camera.device.complex.itemsize
    camera.device.require_memory(
        (2 * widest + 2) * field_bytes * min(step, len(points)), "This exposure"
    )
    for start in range(0, len(points), step):
        chosen = slice(start, min(start + step, len(points)))
        pupil = camera.pupil(points, chosen, whole=False)
        energy = row_powers(pupil).sum(axis=-1)
        at_array = camera.array_field(pupil, pad=to_array)
        fields = camera.sensor_field(at_array, pad=to_sensor)
        accumulate(total, fields.data, points.power[chosen] / energy, camera.device)
        if progress is not None:
            progress(chosen.stop, len(points))
    return Exposure("points", _point_transforms(camera, points, len(points)), 0.0)


def _batch(camera: Plenoptic, widest: int) -> int:
    field_bytes = math.prod(camera.grid.shape) * camera.device.complex.itemsize
    return max(1, int(BATCH_BYTES / (field_bytes * widest)))


def _add_picture(
    camera: Plenoptic,
    plane: PicturePlane,
    how: Layout,
    total: cla.Array,
    progress: Progress | None,
) -> Exposure:
    """A picture from its patterns, its error from its probes' two images."""
    step = _batch(camera, max(*how.padding, how.finer) ** 2)
    camera.device.require_memory(how.memory(camera, step), "This exposure")
    chosen = _probes(plane, how)
    probes = np.zeros(plane.image.shape)
    probes.ravel()[chosen] = 1
    picture, seen = raw_patterns(camera, plane, how, probes=probes, batch=step, progress=progress)
    add_scaled(total, picture, 1.0, camera.device)
    points = PointSources(plane.positions()[chosen])
    exact = camera.device.zeros(camera.grid.shape, camera.device.real)
    once = _add_points(camera, points, exact, None)
    expected = camera.device.download(exact)
    error = np.abs(camera.device.download(seen) - expected).max() / expected.max()
    if error > NOTABLE:
        warnings.warn(
            f"The picture's patterns depart by {error:.2g} of the maximum from one field a sample: "
            "its light is hardly sampled, or changes across the field. method='points' is exact, "
            f"{np.count_nonzero(plane.image)} fields; finer pixels make both better.",
            SamplingWarning,
            stacklevel=6,
        )
    transforms = how.transforms(camera.grid.shape) + once.transforms
    return Exposure("isoplanatic", _merged(transforms), float(error))


def _probes(plane: PicturePlane, how: Layout) -> list[int]:
    """Flat indices of samples: the brightest, the one farthest out, one far from all patches."""
    lit = np.flatnonzero(plane.image)
    iy, ix = np.unravel_index(lit, plane.image.shape)
    first = how.patches[0]
    places = np.stack([first.y[iy], first.x[ix]], axis=-1) + first.centre
    apart = np.min([np.hypot(patch.y[iy], patch.x[ix]) for patch in how.patches], axis=0)
    found = [int(plane.image.ravel()[lit].argmax()), int(np.hypot(*places.T).argmax())]
    for n in found:
        apart = np.minimum(apart, np.hypot(*(places - places[n]).T))
    return [int(lit[n]) for n in sorted({*found, int(apart.argmax())})]


def _merged(transforms: Transforms) -> Transforms:
    """One entry for each shape."""
    counts: dict[tuple[int, int], int] = {}
    for n, shape in transforms:
        counts[shape] = counts.get(shape, 0) + n
    return tuple((n, shape) for shape, n in counts.items())


def together(reports: list[Exposure]) -> Exposure:
    """What several parts of a scene were exposed by; their errors as if they were independent."""
    routes = sorted({report.route for report in reports})
    transforms = _merged(tuple(pair for report in reports for pair in report.transforms))
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
