"""Geometry that plenoptic cameras share: lens law, sensor grid, sub-images, sampling rule."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

from clplen.errors import SamplingError
from clplen.lightfield.raw import LensletGrid, RawImage
from clplen.wave.field import Grid
from clplen.wave.lenslets import SMALLEST_PITCH, MicrolensArray

if TYPE_CHECKING:
    from clplen.cameras.plenoptic1 import Plenoptic1
    from clplen.cameras.scene import PointSources

LENS_LAW_TOLERANCE = 1e-6  # relative, of 1/f = 1/object + 1/image


def require_lengths(**lengths: float | None) -> None:
    """Refuse lengths that are not positive and finite; None is left out.

    Raises
    ------
    ValueError
        With the name of the length.
    """
    for name, value in lengths.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")


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
    if not (math.isfinite(pixels_per_lenslet) and pixels_per_lenslet >= SMALLEST_PITCH):
        raise SamplingError(
            f"A lenslet has {pixels_per_lenslet!r} pixels; at least {SMALLEST_PITCH} are needed."
        )
    pitch = mla.pitch / pixels_per_lenslet
    ny, nx = (math.ceil(length / pitch - 1e-6) for length in mla.extent)
    origin = (pitch / 2 if ny % 2 == 0 else 0.0, pitch / 2 if nx % 2 == 0 else 0.0)
    return Grid((ny, nx), pitch, origin=origin)


def views(camera: Plenoptic1) -> int:
    """Views across: the pixels of a lenslet, rounded."""
    return max(1, round(camera.pixels_per_lenslet))


def check_sampling(camera: Plenoptic1, reach: float, alpha: float) -> None:
    """Refuse light that the pixels cannot sample.

    [(alpha D/2 + abs(X))/F + d/(2 f_mu)]/lam < 1/(2 dx): a ray from u on the lens to a point's
    image X, at F' = F/alpha, has the slope (X - alpha u)/F; and the window holds the main lens'
    aperture.

    Parameters
    ----------
    camera : Plenoptic1
    reach : float
        abs(X), largest along x or y, in metres.
    alpha : float
        F/F' of the point, at least 1.

    Raises
    ------
    SamplingError
        With both sides of the rule and what would do.
    """
    D, F, d, f_mu = (
        camera.aperture_diameter,
        camera.image_distance,
        camera.mla.diameter,
        camera.mla.f,
    )
    slope = (alpha * D / 2 + reach) / F + d / (2 * f_mu)
    if 2 * camera.pixel_pitch * slope >= camera.wavelength:
        fitting = camera.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / camera.wavelength:.4g} cycles/m "
            f"((alpha D/2 + |X|)/F + d/(2 f_mu), |X| = {reach:.4g} m), but pixels of "
            f"{camera.pixel_pitch:.4g} m sample {1 / (2 * camera.pixel_pitch):.4g}: pixels below "
            f"{fitting:.4g} m would do (pixels_per_lenslet = {camera.mla.pitch / fitting:.4g}), or "
            "a longer f_mu, or a smaller aperture."
        )
    if min(camera.grid.extent) < D:
        raise SamplingError(
            f"The window of {min(camera.grid.extent):.4g} m does not hold the main lens' aperture "
            f"of {D:.4g} m: use more lenslets or give a smaller aperture_diameter."
        )


def check_place(camera: Plenoptic1, scene: PointSources) -> None:
    """Refuse sources behind the lens, or imaged beyond the array.

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
    images, extent = camera.image_of(scene.positions), camera.grid.extent
    outside = (np.abs(images) > np.asarray(extent)[::-1] / 2).any(axis=1)
    if outside.any():
        (x, y, dz), (X, Y) = scene.positions[outside][0], images[outside][0]
        raise SamplingError(
            f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is imaged at ({X:g}, {Y:g}) m, "
            f"beyond the array of {extent[1]:g} x {extent[0]:g} m: move it or use more lenslets."
        )


def raw_image(camera: Plenoptic1, data: cla.Array) -> RawImage:
    """Intensity on the sensor with the places of sub-images and cells on it."""
    magnification = 1.0 if camera.field_lens else 1 + camera.mla.f / camera.image_distance
    step = camera.pixel_pitch * camera.image_distance / camera.mla.f
    spacing = (-step, -step, camera.mla.row_pitch, camera.mla.pitch)
    return RawImage(
        data,
        camera.device,
        camera.pixel_pitch,
        lenslet_grid(camera, magnification),
        lenslet_grid(camera, 1.0),
        spacing,
        camera,
    )


def lenslet_grid(camera: Plenoptic1, magnification: float) -> LensletGrid:
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
