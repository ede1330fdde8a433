"""Launching the kernels of scenes of surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.scenes.ground_truth import Truth, truth_of
from clplen.cameras.scenes.outlines import Bars, Ellipse, Outline, Polygon

if TYPE_CHECKING:
    from clplen.cameras.scenes.surfaces import Plane, Sphere, SurfaceScene
    from clplen.compute.device import Device

SHAPE, WHICH = 17, 9  # numbers a surface in kernels/surfaces.cl
MARGIN = 2  # pixels added to the bounds of a surface
FAR = 2**30
_KINDS: dict[Any, int] = {type(None): 0, Ellipse: 1, Polygon: 2, Bars: 3}


@dataclass(frozen=True, eq=False)
class Tables:
    """A scene as its kernels read it.

    Attributes
    ----------
    scene : SurfaceScene
    device : Device
    shape, which, edges, spots, texels : pyopencl.array.Array
        See kernels/surfaces.cl.
    """

    scene: SurfaceScene
    device: Device
    shape: cla.Array
    which: cla.Array
    edges: cla.Array
    spots: cla.Array
    texels: cla.Array

    @property
    def count(self) -> int:
        """Surfaces."""
        return len(self.scene.surfaces)

    def all(self) -> tuple[cla.Array, ...]:
        """The tables in the order of the kernels' arguments."""
        return (self.shape, self.which, self.edges, self.spots, self.texels)


def tables(scene: SurfaceScene, device: Device) -> Tables:
    """Tables of a scene on a device.

    Parameters
    ----------
    scene : SurfaceScene
    device : Device

    Returns
    -------
    Tables
    """
    shape = np.zeros((len(scene.surfaces), SHAPE), np.float32)
    which = np.zeros((len(scene.surfaces), WHICH), np.int32)
    edges: list[Any] = [np.zeros((0, 4))]
    spots: list[Any] = []
    texels: list[Any] = []
    places: dict[int, int] = {}
    for one, numbers, links in zip(scene.surfaces, shape, which, strict=True):
        texture = one.texture
        if id(texture) not in places:
            places[id(texture)] = sum(part.size for part in texels)
            texels.append(texture.coefficients(scene.channels).ravel())
        outline = getattr(one, "outline", None)
        numbers[:12] = _geometry(one)
        ny, nx = texture.samples.shape[:2]
        middle = (ny // 2 - texture.centre[0] / texture.scale,
                  nx // 2 - texture.centre[1] / texture.scale)  # fmt: skip
        numbers[12:] = (1 / texture.scale, *np.mod(middle, (ny, nx)), *one.shade)
        lines = outline.edges() if isinstance(outline, Polygon) else np.zeros((0, 4))
        links[:] = (
            0 if hasattr(one, "slope") else 1, _KINDS[type(outline)], sum(map(len, edges)),
            len(lines), places[id(texture)], ny, nx, len(spots), len(one.spots),
        )  # fmt: skip
        edges.append(lines)
        spots += [(*s.centre, 0.5 / s.width**2, s.strength, s.d) for s in one.spots]
    return Tables(
        scene,
        device,
        device.upload(shape),
        device.upload(which),
        device.upload(_not_empty(np.concatenate(edges), 4)),
        device.upload(_not_empty(np.asarray(spots), 5)),
        device.upload(np.concatenate(texels)),
    )


def rows_of_views(
    tables: Tables, gain: np.ndarray[Any, Any], shape: tuple[int, int]
) -> Iterator[np.ndarray[Any, np.dtype[np.float32]]]:
    """Views of a scene without noise, a row of views at a time.

    Parameters
    ----------
    tables : Tables
    gain : numpy.ndarray
        float32, shape (V, U).
    shape : tuple of int
        (ny, nx).

    Yields
    ------
    numpy.ndarray
        float32, shape (U, ny, nx, channels).
    """
    device, scene = tables.device, tables.scene
    (V, U), (ny, nx) = gain.shape, shape
    out = device.empty((U, ny, nx, scene.channels), np.float32)
    bounds = device.upload(view_bounds(scene, (V, U), shape))
    levels = device.upload(gain)
    kernel = device.kernel("scene.cl", "views")
    for v in range(V):
        device.launch_rows(
            kernel, (U, ny, nx), out, *tables.all(), bounds, levels,
            *(np.float32(n) for n in ((V - 1) / 2, (U - 1) / 2, scene.background)),
            *(np.int32(n) for n in (v * U, U, tables.count, ny, nx, scene.channels)),
        )  # fmt: skip
        yield device.download(out)


def truth(tables: Tables, shape: tuple[int, int]) -> Truth:
    """Disparity and surface of every pixel of the centre view.

    Parameters
    ----------
    tables : Tables
    shape : tuple of int
        (ny, nx).

    Returns
    -------
    Truth
        Without z.
    """
    device = tables.device
    disparity, seen = device.empty(shape, np.float32), device.empty(shape, np.int32)
    device.launch_rows(
        device.kernel("scene.cl", "truth"),
        shape,
        *(disparity, seen, tables.shape, tables.which, tables.edges),
        *(np.int32(n) for n in (tables.count, *shape)),
    )
    is_smooth = [not hasattr(one, "slope") for one in tables.scene.surfaces]
    return truth_of(device.download(disparity), device.download(seen), is_smooth)


def view_bounds(
    scene: SurfaceScene, views: tuple[int, int], shape: tuple[int, int]
) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Rows and columns that each surface may be in, (y0, y1, x0, x1), shape (V, U, n, 4).

    A point (Y, X, d) lies at (Y - d a, X - d b) in the view (a, b) from the centre; surfaces lie in
    the hull of theirs.
    """
    V, U = views
    found = np.empty((V, U, len(scene.surfaces), 4), np.int64)
    a, b = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
    for i, one in enumerate(scene.surfaces):
        points = one.bounds()
        if points is None:
            found[:, :, i] = (-FAR, FAR, -FAR, FAR)
            continue
        y = points[:, 0] - points[:, 2] * a[:, None] + (shape[0] - 1) / 2
        x = points[:, 1] - points[:, 2] * b[:, None] + (shape[1] - 1) / 2
        found[:, :, i, 0] = np.floor(y.min(axis=1))[:, None] - MARGIN
        found[:, :, i, 1] = np.ceil(y.max(axis=1))[:, None] + MARGIN
        found[:, :, i, 2] = np.floor(x.min(axis=1))[None, :] - MARGIN
        found[:, :, i, 3] = np.ceil(x.max(axis=1))[None, :] + MARGIN
    return np.clip(found, -FAR, FAR).astype(np.int32)


def _geometry(one: Plane | Sphere) -> tuple[float, ...]:
    """The first twelve numbers of a surface."""
    if not hasattr(one, "slope"):
        sphere: Any = one
        start = (sphere.d, sphere.height, sphere.radius, *sphere.centre)
        return (*start, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    plane: Any = one
    outline: Outline | None = plane.outline
    if outline is None or isinstance(outline, Polygon):
        return (plane.d, *plane.slope, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    period, widths = 1.0, (0.0, 0.0)
    if isinstance(outline, Bars):
        period, widths = outline.period, outline.widths
    turn = (math.cos(outline.angle), math.sin(outline.angle))
    halves = (widths[0] / 2, widths[1] / 2)
    return (plane.d, *plane.slope, *outline.centre, *turn, *outline.half, period, *halves)


def _not_empty(values: Any, width: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Rows of a table, one of zeros where there is none."""
    rows = np.asarray(values, np.float32).reshape(-1, width)
    return rows if len(rows) else np.zeros((1, width), np.float32)
