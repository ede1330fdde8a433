"""Rays of a camera's pixels, traced back through its lenslets to the surfaces of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.lenslet_camera import lenslet_grid
from clplen.cameras.optics.ray_optics import RayOptics, view_step
from clplen.cameras.scenes.surface_scene import (
    FAR,
    MARGIN_PIXELS,
    SurfaceScene,
    SurfaceTables,
    surface_tables,
)
from clplen.lightfield.raw.lenslet_grid import LensletGrid

Vector = np.ndarray[Any, np.dtype[np.float64]]

RAYS_PER_PIXEL = 64  # rays for each pixel and lenslet
INTEGER_BITS = 33  # bits of the largest pixel in the integers of the adjoint


@dataclass(frozen=True, eq=False)
class SurfaceRays:
    """Rays of a camera's pixels through a scene of surfaces, as arguments of the kernel."""

    optics: RayOptics
    tables: SurfaceTables
    arguments: tuple[Any, ...]  # arguments of the kernel `expose` after the tables
    defines: dict[str, Any]  # switches of the kernel

    @classmethod
    def of(cls, optics: RayOptics, scene: SurfaceScene) -> SurfaceRays:
        """Prepare the rays of a camera."""
        device, mla = optics.device, optics.mla
        if optics.aberrations.bends_main_lens or optics.aberrations.bends_lenslets:
            raise ValueError(
                "A SurfaceScene does not support wavefronts of the lenses: keep only sensor_shift "
                "of the camera's aberrations, or expose points and pictures."
            )
        if any(optics.aberrations.sensor_tilt):
            raise ValueError(
                "A SurfaceScene does not support a tilted sensor: leave out sensor_tilt of the "
                "camera's aberrations, or expose points and pictures."
            )
        if not mla.is_thin:
            raise ValueError(
                "A SurfaceScene supports thin lenslets only: expose points and pictures, or use a "
                f"MicrolensArray of focal_length={mla.focal_length:.6g} without surface, map and "
                "gap."
            )
        step = view_step(optics)
        radius, aspect = optics.aperture_diameter / 2 / step, mla.pitch / mla.row_pitch
        blurs = _gains(optics)[:, None] * (mla.row_pitch / step, mla.pitch / step)
        blur = np.abs(blurs).max(axis=0)
        scene.check_views(*view_reach(optics))
        tables = surface_tables(scene, device)
        grid = lenslet_grid(optics, optics.sub_image_scale)
        size = (math.hypot(*grid.row_step), math.hypot(*grid.column_step))  # pixels a sub-image
        samples = sample_rays(mla, count=RAYS_PER_PIXEL)
        reach = math.ceil((radius + 1 + float(blur.max())) / min(size) + 0.5)
        defines = {"TYPES": len(blurs), "TYPE_STEP": mla.type_step}
        defines |= {"HEXAGONAL": True} if mla.lattice == "hexagonal" else {}
        numbers = (radius, aspect, grid.odd_row_shift, scene.background)
        counts = (reach, len(samples), *mla.count, tables.count, *optics.grid.shape, scene.channels)
        arguments = (
            device.upload(lenslet_bounds(scene, mla.count, view_reach(optics)[1], aspect)),
            *_pixel_tables(optics, grid),
            device.upload(samples),
            np.array(size, np.float32),
            device.upload(blurs.astype(np.float32)),
            blur.astype(np.float32),
            *(np.float32(number) for number in numbers),
            *(np.int32(number) for number in counts),
        )
        return cls(optics, tables, arguments, defines)

    def expose(self, raw: cla.Array, texels: cla.Array) -> None:
        """Write the raw image, shape of the sensor, for coefficients of textures."""
        self._launch(raw, texels)

    def adjoint(self, image: Vector) -> Vector:
        """Compute the weight of each coefficient of the textures in the pixels of an image.

        Sums of integers do not depend on their order: a term is rounded to 2^-33 of the largest
        pixel, and a sum may be 2^30 times as large as that.
        """
        device, count = self.optics.device, int(self.tables.texels.size)
        texels = device.zeros((2 * count,), np.uint32)
        exponent = INTEGER_BITS - math.frexp(float(np.abs(image).max()))[1]
        raw = device.upload(np.ldexp(image, exponent).astype(np.float32))
        self._launch(raw, texels, ADJOINT=True)
        return np.ldexp(device.download(texels).view("<i8").astype(np.float64), -exponent)

    def _launch(self, raw: cla.Array, texels: cla.Array, **more: Any) -> None:
        device, tables = self.optics.device, self.tables.all()[:-1]
        kernel = device.kernel("rays.cl", "expose", **(self.defines | more))
        device.launch_rows(kernel, self.optics.grid.shape, raw, *tables, texels, *self.arguments)


def view_reach(optics: RayOptics) -> tuple[float, float]:
    """Return the largest distance of rays from the centre view, (down, right), in view steps.

    It includes the rays of a pixel and a lenslet just outside the main lens, also traced.
    """
    mla, step = optics.mla, view_step(optics)
    lenslet = mla.pitch / step * max(1.0, float(np.abs(_gains(optics)).max()))
    widest = optics.aperture_diameter / 2 / step + 1 + lenslet
    return widest * mla.pitch / mla.row_pitch, widest


def _gains(optics: RayOptics) -> Vector:
    """Return g of each kind of lenslets: the change of u on the main lens with the lenslet's xi.

    From pixel e of a sub-image u = g xi - z2 e/z3, g = 1 + z2/z3 - z2/f; 1 less with field lens.
    """
    z2, z3 = optics.array_distance, optics.sensor_distance
    bent = z2 * (1 / z3 - 1 / np.array(optics.mla.focal_lengths))
    return np.asarray(bent if optics.field_lens else 1 + bent)


def sample_rays(mla: Any, *, count: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return well-spread positions in a lenslet and in a pixel, each with its mirror image.

    Points of the additive recurrence of the generalised golden ratio in four dimensions (Roberts
    2018) within the lenslet's aperture; the mirror images make linear terms cancel.
    """
    points = spread_points(64 * count, 4) - 0.5
    tall = 2 / math.sqrt(3) if mla.lattice == "hexagonal" and mla.fill == "full" else 1.0
    y, x = points[:, 0] * tall * mla.diameter, points[:, 1] * mla.diameter
    half = mla.diameter / 2
    if mla.fill == "circular":
        inside = y**2 + x**2 <= half**2
    elif mla.lattice == "hexagonal":
        inside = np.abs(x) / 2 + np.abs(y) * math.sqrt(3) / 2 <= half
    else:
        inside = np.ones(len(points), bool)
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    down, right = points[:, 2] * cos - points[:, 3] * sin, points[:, 2] * sin + points[:, 3] * cos
    columns = (y / mla.row_pitch, x / mla.pitch, down, right)
    chosen = np.stack(columns, axis=-1)[inside][: count // 2]
    return np.concatenate([chosen, -chosen]).astype(np.float32)


def lenslet_bounds(
    scene: SurfaceScene, count: tuple[int, int], widest: float, aspect: float
) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Return rows and columns of lenslets that may see each surface, (y0, y1, x0, x1), (n, 4)."""
    bounds = np.empty((len(scene.surfaces), 4))
    for i, surface in enumerate(scene.surfaces):
        points = surface.bounds()
        if points is None:
            bounds[i] = (-FAR, FAR) * 2
            continue
        for axis, reach in ((0, widest * aspect), (1, widest)):
            middle = (count[axis] - 1) / 2
            spread = np.abs(points[:, 2]).max() * reach + MARGIN_PIXELS
            low, high = points[:, axis].min() - spread, points[:, axis].max() + spread
            bounds[i, 2 * axis : 2 * axis + 2] = (low + middle, high + middle)
    return np.clip(bounds, -FAR, FAR).astype(np.int32)


def _pixel_tables(optics: RayOptics, grid: LensletGrid) -> tuple[cla.Array, ...]:
    """Return (row, column) of sub-images by y and x of a pixel, in integer and fraction."""
    to_index = np.linalg.inv(np.column_stack([grid.row_step, grid.column_step]))
    ny, nx = optics.grid.shape
    rows = (np.arange(ny)[:, None] - grid.first[0]) * to_index[:, 0]
    columns = (np.arange(nx)[:, None] - grid.first[1]) * to_index[:, 1]
    tables = []
    for coordinates in (rows, columns):
        integers = np.rint(coordinates)
        tables += [integers.astype(np.int32), (coordinates - integers).astype(np.float32)]
    return tuple(optics.device.upload(table) for table in tables)


def spread_points(count: int, dimensions: int) -> Vector:
    """Return well-spread points of the unit cube (Roberts 2018), shape (count, dimensions)."""
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (dimensions + 1))
    steps = root ** -np.arange(1, dimensions + 1)
    return (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1
