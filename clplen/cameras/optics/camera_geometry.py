"""Geometry that plenoptic cameras share: lens law, sensor grid, sub-images, sampling rule."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

from clplen.compute import lengths
from clplen.errors import SamplingError
from clplen.lightfield.raw import LensletGrid, LensType, RawImage
from clplen.wave.checks import is_finite
from clplen.wave.field import Grid
from clplen.wave.lenslets import SMALLEST_PITCH, MicrolensArray

if TYPE_CHECKING:
    from clplen.cameras.light_field_microscope import Microscope
    from clplen.cameras.plenoptic import Plenoptic
    from clplen.cameras.scenes.scene_sources import PointSources

LENS_LAW_TOLERANCE = 1e-6  # relative, of 1/f = 1/object + 1/image


_KINDS = {
    "focal_length": lengths.CAMERA_FOCAL_LENGTH,
    "image_distance": lengths.CAMERA_FOCAL_LENGTH,
    "aperture_diameter": lengths.CAMERA_DIAMETER,
    "tube_lens": lengths.TUBE_LENS,
}  # an object may be anywhere, and wavelengths have a check of their own


def require_lengths(**given: float | None) -> None:
    """Refuse lengths that are not positive and finite, or no metres; None is left out.

    Raises
    ------
    ValueError
        With the name of the length.
    """
    for name, value in given.items():
        if value is not None and not (is_finite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")
        if value is not None and name in _KINDS:
            _KINDS[name].check(value, name)


def lens_law(
    f: float, object_distance: float | None, image_distance: float | None
) -> tuple[float, float]:
    """Object and image distance that satisfy 1/f = 1/object + 1/image, in metres.

    Neither given: 2f and 2f. One given: the other follows.

    Raises
    ------
    ValueError
        If both are given and contradict the law, or one lies within the focal length.
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


def sensor_grid(mla: MicrolensArray, pixels_per_lenslet: float) -> Grid:
    """The sensor behind an array: as many pixels as cover it, the axis in its middle.

    Raises
    ------
    SamplingError
        If a lenslet has less than two pixels.
    """
    if not (is_finite(pixels_per_lenslet) and pixels_per_lenslet >= SMALLEST_PITCH):
        raise SamplingError(
            f"A lenslet has {pixels_per_lenslet!r} pixels; at least {SMALLEST_PITCH} are needed."
        )
    pitch = mla.pitch / pixels_per_lenslet
    ny, nx = (math.ceil(length / pitch - 1e-6) for length in mla.extent)
    origin = (pitch / 2 if ny % 2 == 0 else 0.0, pitch / 2 if nx % 2 == 0 else 0.0)
    return Grid((ny, nx), pitch, origin=origin)


def views(camera: Plenoptic | Microscope) -> int:
    """Views across: the pixels of a lenslet, rounded."""
    return max(1, round(camera.pixels_per_lenslet))


def check_sampling(camera: Plenoptic, reach: float, alpha: float) -> None:
    """Refuse light that the pixels cannot sample.

    [(beta D/2 + abs(X))/z2 + d/(2 f)]/lam < 1/(2 dx). A ray from u on the lens to X + u (1 - beta)
    on the array has the slope (X - beta u)/z2, and a lenslet adds -(x - c)/f, x - c up to d/2.
    For a 2.0 camera with its image in focus, beta = z2/F, this is (X/z2 + D/(2 F)) + d/(2 f):
    about the chief ray of a lenslet, slope (c - X)/a, light converges within d/(2 b) only, but
    lenslets at the rim of the blur, abs(c - X) up to a D/(2 F) + d/2, bring that to d/(2 f),
    1/f = 1/a + 1/b. The steepest of several f counts, and aberrations add the slopes of their
    wavefronts. And the window holds the main lens' aperture.

    Parameters
    ----------
    camera : Plenoptic
    reach : float
        abs(X) on the array, largest along x or y, in metres.
    alpha : float
        beta = z2/F' of the point (for a 1.0 camera alpha = F/F'), at least 1.

    Raises
    ------
    SamplingError
        With both sides of the rule and what would do.
    """
    D, z2, d, f_mu = (
        camera.aperture_diameter,
        camera.array_distance,
        camera.mla.diameter,
        min(camera.mla.focal_lengths),
    )
    bent = camera.main_slope(reach * camera.image_distance / z2)
    bent += camera.aberrations.lenslet_slope(camera.mla)
    slope = (alpha * D / 2 + reach) / z2 + d / (2 * f_mu) + bent
    if 2 * camera.pixel_pitch * slope >= camera.wavelength:
        fitting = camera.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / camera.wavelength:.4g} cycles/m "
            f"((alpha D/2 + |X|)/z2 + d/(2 f_mu), |X| = {reach:.4g} m"
            f"{f', aberrations {bent:.4g} rad' if bent else ''}), but pixels of "
            f"{camera.pixel_pitch:.4g} m sample {1 / (2 * camera.pixel_pitch):.4g}: pixels below "
            f"{fitting:.4g} m would do (pixels_per_lenslet = {camera.mla.pitch / fitting:.4g}), or "
            f"a longer f_mu, {'smaller aberrations, ' if bent else ''}or a smaller aperture."
        )
    if min(camera.grid.extent) < D:
        raise SamplingError(
            f"The window of {min(camera.grid.extent):.4g} m does not hold the main lens' aperture "
            f"of {D:.4g} m: use more lenslets or give a smaller aperture_diameter."
        )


def check_place(camera: Plenoptic, scene: PointSources) -> None:
    """Refuse sources behind the lens, or whose chief ray misses the array.

    Raises
    ------
    ValueError, SamplingError
        Naming the first such point.
    """
    behind = camera.object_distance + scene.positions[:, 2] <= 0
    if behind.any():
        x, y, dz = scene.positions[behind][0]
        raise ValueError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m lies behind the main lens, which "
            f"is {camera.object_distance:g} m from the focused plane."
        )
    images, extent = camera.on_array(scene.positions), camera.grid.extent
    outside = (np.abs(images) > np.asarray(extent)[::-1] / 2).any(axis=1)
    if outside.any():
        (x, y, dz), (X, Y) = scene.positions[outside][0], images[outside][0]
        raise SamplingError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is imaged at ({X:g}, {Y:g}) m, "
            f"beyond the array of {extent[1]:g} x {extent[0]:g} m: move it or use more lenslets."
        )


def view_step(camera: Plenoptic) -> float:
    """du = dx z2/z3: how far apart on the main lens two pixels of a lenslet look, in metres."""
    return camera.pixel_pitch * camera.array_distance / camera.sensor_distance


def raw_image(camera: Plenoptic, data: cla.Array) -> RawImage:
    """Intensity on the sensor with the places of sub-images and cells on it.

    Where the array does not lie on the main lens' image there is no spacing: what a lenslet sees
    is a picture, and alpha is not that of the light field on the array.
    """
    step = view_step(camera)
    on_image = camera.array_distance == camera.image_distance
    return RawImage(
        data,
        camera.device,
        camera.pixel_pitch,
        lenslet_grid(camera, camera.sub_image_scale),
        lenslet_grid(camera, 1.0),
        (-step, -step, camera.mla.row_pitch, camera.mla.pitch) if on_image else None,
        camera,
        lens_types=lens_types(camera),
    )


def lens_types(camera: Plenoptic) -> tuple[LensType, ...]:
    """Where the lenslets of each focal length have their sub-images, and what they see sharply.

    A type is in focus at the virtual depth a/b, 1/a = 1/f - 1/b. Its range ends where the next
    one is as sharp: blur on the sensor is d abs(b/a' - b/a), so in the middle between their b/a;
    the outermost go as far beyond.
    """
    mla, b = camera.mla, camera.sensor_distance
    if len(mla.focal_lengths) == 1:
        return ()
    focus = np.array([b / f - 1 for f in mla.focal_lengths])  # b/a
    order = np.argsort(focus)
    steps = np.diff(focus[order]) / 2
    low, high = np.empty_like(focus), np.empty_like(focus)
    low[order] = focus[order] - np.concatenate([steps[:1], steps])
    high[order] = focus[order] + np.concatenate([steps, steps[-1:]])
    grid = lenslet_grid(camera, camera.sub_image_scale)
    shift = np.array(grid.row_step) + grid.odd_row_shift * np.array(grid.column_step)
    base = np.array([shift, grid.column_step])
    found = []
    for number, sharp in enumerate(focus):
        side = (0, math.inf) if sharp > 0 else (-math.inf, 0)
        ends = np.clip((low[number], high[number]), *side)
        depths = sorted(float(1 / end) if end else math.copysign(math.inf, sharp) for end in ends)
        vectors = np.array([(0, number), (1, -mla.type_step), (0, len(focus))]) @ base
        offset, *steps_of = ((float(y), float(x)) for y, x in vectors)
        found.append(LensType(offset, (depths[0], depths[1]), (steps_of[0], steps_of[1])))
    return tuple(found)


def lenslet_grid(camera: Plenoptic | Microscope, magnification: float) -> LensletGrid:
    """Centres of the lenslets, projected by ``magnification`` from the axis, in pixels."""
    mla, n = camera.mla, views(camera)
    first = mla.centres()[0, 0]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    scale = magnification / camera.pixel_pitch
    ny, nx = camera.grid.shape
    oy, ox = camera.grid.origin
    return LensletGrid(
        count=mla.count,
        views=(n, n),
        first=(
            first[0] * scale - oy / camera.pixel_pitch + ny // 2,
            first[1] * scale - ox / camera.pixel_pitch + nx // 2,
        ),
        row_step=(mla.row_pitch * cos * scale, -mla.row_pitch * sin * scale),
        column_step=(mla.pitch * sin * scale, mla.pitch * cos * scale),
        row_view_step=(cos, -sin),
        column_view_step=(sin, cos),
        odd_row_shift=0.5 if mla.lattice == "hexagonal" else 0.0,
    )
