"""Raw images of a plenoptic camera by geometrical rays, with occlusion and ground truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.exposure.surface_rays import SurfaceRays, spread_points
from clplen.cameras.optics.camera_aberrations import slopes
from clplen.cameras.optics.ray_optics import RayOptics, check_in_view, raw_image, view_step
from clplen.cameras.scenes.ground_truth import Truth
from clplen.cameras.scenes.occluders import Occluder
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources, Source
from clplen.cameras.scenes.surface_scene import (
    SurfaceScene,
    SurfaceTables,
    centre_truth,
)
from clplen.lightfield.raw.raw_image import RawImage

Vector = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]

MAX_RAYS = 2**16  # maximum rays of one point
MIN_RAYS = 2**8  # minimum rays of one point
SCENE_RAYS = 2**23  # rays of a scene, shared among its points
BATCH_RAYS = 2**20  # rays traced at once


def expose_rays(optics: RayOptics, scene: SurfaceScene | Sequence[Source]) -> RawImage:
    """Compute the raw image of a scene by geometrical optics.

    A ray from u on the main lens through x on the array meets the sensor at z3 (x - u)/z2 -
    (x - c) z3/f from x, c the centre of its lenslet; with a field lens at -z3 u/z2 - (x - c) z3/f.
    Rays have no diffraction and no wavelength. Slopes of the wavefronts are the only aberrations:
    the main lens' shifts x by z2 dW/du, a lenslet's shifts the position on the sensor by z3 dW/dx.
    A `SurfaceScene` supports only a shifted sensor.
    """
    if isinstance(scene, SurfaceScene):
        return _surfaces(optics, scene)
    image = np.zeros(optics.grid.shape)
    for source in scene:
        if isinstance(source, PicturePlane) and source.is_slide:
            raise ValueError(
                "Pictures with mode='transmission' require model='waves', got model='rays': use "
                "model='waves', or mode='emission' for a self-luminous picture."
            )
    points = [s if isinstance(s, PointSources) else s.points() for s in scene]
    for source in points:
        check_in_view(optics, source.positions)
    count = ray_count(sum(len(source) for source in points))
    for source in points:
        for rays in point_rays(optics, source, count):
            energy = source.power[rays.indices, None] * rays.shares
            hit = rays.pixels >= 0
            image += np.bincount(rays.pixels[hit], energy[hit], image.size).reshape(image.shape)
    return raw_image(optics, optics.device.upload(image.astype(np.float32)), paraxial=True)


def check_rays(optics: RayOptics, occluders: Sequence[Occluder]) -> None:
    """Raise for colour filters and screens, which rays of points and pictures do not support."""
    if optics.filters is not None:
        raise ValueError(
            "model='rays' does not support colour filters, because rays have no wavelength: use "
            "model='waves', or pixels without filters=."
        )
    if occluders:
        raise ValueError(
            "Rays of points and pictures do not support occluders: use model='waves', or a "
            "SurfaceScene."
        )


# Surfaces: rays start at every pixel and run back through its lenslets


def _surfaces(optics: RayOptics, scene: SurfaceScene) -> RawImage:
    """Compute the raw image and the ground truth of a scene of surfaces."""
    rays = SurfaceRays.of(optics, scene)
    raw = raw_image(optics, optics.device.empty(optics.grid.shape, np.float32), paraxial=True)
    rays.expose(raw.data, rays.tables.texels)
    return replace(raw, truth=_truth(optics, rays.tables))


def _truth(optics: RayOptics, tables: SurfaceTables) -> Truth:
    """Compute the ground truth on the lattice of the lenslets, with z by the optics."""
    truth = centre_truth(tables, optics.mla.count)
    beta = 1 - truth.disparity * (optics.mla.pitch / view_step(optics))
    alpha = beta * (optics.image_distance / optics.array_distance)
    return replace(truth, z=np.asarray(optics.dz(alpha), np.float32))


# Points: rays start at each point and run to the sensor


def ray_count(points: int) -> int:
    """Return the number of rays for each point of a scene."""
    return min(MAX_RAYS, max(MIN_RAYS, SCENE_RAYS // max(1, points)))


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of points and the pixels that they meet."""

    indices: Counts  # indices of the points, int64, shape (n,)
    pixels: Counts  # pixel of each ray, row by row, -1 for none, int64, shape (n, count)
    shares: Vector  # fraction of the point's energy that each ray carries, shape (n, count)


def point_rays(optics: RayOptics, source: PointSources, count: int) -> Iterator[Rays]:
    """Trace the rays of points in batches."""
    spread = spread_points(count, 4)
    turns = spread_points(len(source), 4)
    images_on_array = optics.on_array(source.positions)[:, ::-1]  # (y, x)
    scale = np.abs(optics.array_scale(source.positions[:, 2]))
    beta = np.atleast_1d(optics.array_alpha(source.positions[:, 2]))
    images = optics.image_of(source.positions)[:, ::-1]
    step = max(1, BATCH_RAYS // count)
    for first in range(0, len(source), step):
        part = slice(first, first + step)
        sample = (spread[None] + turns[part, None]) % 1
        on_disc = _disc(sample[..., :2])
        wavefront = _main_lens(optics, on_disc, images[part])
        u = (on_disc + wavefront.centre) * optics.aperture_diameter / 2
        source_offset = _disc(sample[..., 2:]) * (source.diameter / 2 * scale[part])[:, None, None]
        x = images_on_array[part, None] + source_offset + u * (1 - beta[part])[:, None, None]
        x += optics.array_distance * wavefront.slopes
        shares = np.broadcast_to(wavefront.passed, u.shape[:2]) / count
        pixels = _pixels(optics, x.reshape(-1, 2), u.reshape(-1, 2)).reshape(u.shape[:2])
        yield Rays(np.arange(len(source))[part], pixels, shares)


@dataclass(frozen=True)
class _MainLens:
    """Departure of the main lens from a thin lens, for rays of points."""

    slopes: Any = 0.0  # slopes (y, x) added to the rays', shape (n, count, 2) or 0
    # pupil's centre on the aperture, (y, x) as fractions of its radius, shape (n, 1, 2) or 0
    centre: Any = 0.0
    passed: Any = 1.0  # transmitted fraction of the energy of each ray, shape (n, count) or 1


def _main_lens(optics: RayOptics, on_disc: Vector, images: Vector) -> _MainLens:
    """Return departures for rays from the pupil, (n, count, 2), to images, (n, 2), all (y, x)."""
    aberrations, maps = optics.aberrations, optics.aberrations.main_lens_opd
    if not aberrations.bends_main_lens:
        return _MainLens()
    radius, bends, centres, shares = optics.aperture_diameter / 2, [], [], []
    for pupil_positions, image in zip(on_disc, images, strict=True):
        v, u = np.moveaxis(pupil_positions, -1, 0)
        y, x = (float(at) for at in image)
        centre = (0.0, 0.0) if maps is None else maps.pupil_centre(y, x, optics.wavelength)
        beyond = np.maximum(np.hypot(v + centre[0], u + centre[1]), 1)
        on_aperture = ((v + centre[0]) / beyond, (u + centre[1]) / beyond)
        bent = np.stack(slopes(aberrations.main_terms(y, x), *on_aperture), axis=-1) / radius
        if maps is not None:
            of_maps = maps.slopes(y, x, optics.wavelength, v, u)
            moved = np.subtract(maps.chief_ray(y, x, optics.wavelength), (y, x))
            bent += np.stack(of_maps, axis=-1) / radius + moved / optics.image_distance
            shares.append(maps.transmission(y, x, optics.wavelength, v, u))
        bends.append(bent)
        centres.append([centre])
    passed: Any = np.stack(shares) if shares else 1.0
    return _MainLens(np.stack(bends), np.array(centres), passed)


def _pixels(optics: RayOptics, x: Vector, u: Vector) -> Counts:
    """Return the pixels that rays from u on the lens to x on the array meet, -1 for none, (n,)."""
    bend, passes = _lenslet_bend(optics, x)
    slope = ((0.0 if optics.field_lens else x) - u) / optics.array_distance
    slope, tilt = slope + bend, optics.aberrations.sensor_tilt
    farther = (x @ tilt + optics.sensor_distance * (slope @ tilt)) / (1 - slope @ tilt)
    at = x + (optics.sensor_distance + farther[:, None]) * slope  # farther = at @ tilt
    ny, nx = optics.grid.shape
    pixel = np.rint((at - optics.grid.origin) / optics.grid.pitch).astype(np.int64)
    pixel += (ny // 2, nx // 2)
    passes &= ((pixel >= 0) & (pixel < (ny, nx))).all(axis=-1)
    return np.where(passes, pixel @ (nx, 1), -1)


def _lenslet_bend(optics: RayOptics, x: Vector) -> tuple[Vector, Any]:
    """Return slopes (y, x) that lenslets add at (y, x) on the array, and a mask of passing rays."""
    mla = optics.mla
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    turned = np.array([[cos, -sin], [sin, cos]])  # lattice to array coordinates, (y, x)
    lenslet, from_centre, inside = _nearest_lenslet(mla, (x - mla.offset) @ turned.T)
    down, right = from_centre.T
    bend = np.stack(mla.bend(lenslet, down, right, optics.wavelength), axis=-1)
    if optics.aberrations.bends_lenslets:
        errors = optics.aberrations.lenslet_errors(mla)
        designed = np.asarray(mla.focal_lengths)[mla.types().ravel()[lenslet], None]
        bend += np.stack(errors.bend(lenslet, *from_centre.T), axis=-1) + from_centre / designed
    in_lenslet = _in_aperture(mla, from_centre)
    if mla.gap == "clear":
        bend[~in_lenslet] = 0
        return bend @ turned, inside
    return bend @ turned, inside & in_lenslet


def _nearest_lenslet(mla: Any, local: Vector) -> tuple[Any, Vector, Any]:
    """Return the lenslet nearest to positions (y, x) along the lattice.

    Returns row times columns plus column, positions from its centre, and a mask of hits.
    """
    ny, nx = mla.count
    best, nearest = np.zeros_like(local), np.full(len(local), np.inf)
    inside, index = np.zeros(len(local), bool), np.zeros(len(local), np.int64)
    near = np.floor(local[:, 0] / mla.row_pitch + (ny - 1) / 2)
    for row in (near, near + 1):
        shift = 0.5 * (row % 2) if mla.lattice == "hexagonal" else 0.0
        column = np.rint(local[:, 1] / mla.pitch + (nx - 1) / 2 - shift)
        centre = np.stack(
            [(row - (ny - 1) / 2) * mla.row_pitch, (column + shift - (nx - 1) / 2) * mla.pitch], -1
        )
        distance = np.hypot(*(local - centre).T)
        closer = distance < nearest
        best[closer], nearest[closer] = centre[closer], distance[closer]
        exists = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
        inside[closer] = exists[closer]
        index[closer] = np.where(exists, row * nx + column, 0)[closer]
    return index, local - best, inside


def _in_aperture(mla: Any, from_centre: Vector) -> Any:
    """Return True for (y, x) from a lenslet's centre, along the lattice, in its aperture."""
    y, x = np.abs(from_centre).T
    half = mla.diameter / 2
    if mla.fill == "circular":
        return y**2 + x**2 <= half**2
    if mla.lattice == "hexagonal":
        return (x <= half) & (x / 2 + y * math.sqrt(3) / 2 <= half)
    return (y <= half) & (x <= half)


def _disc(square: Vector) -> Vector:
    """Map the unit square to the unit disc, with equal areas, shape (..., 2)."""
    radius, angle = np.sqrt(square[..., 0]), 2 * np.pi * square[..., 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
