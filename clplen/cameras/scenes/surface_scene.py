"""Scenes of surfaces with exact disparity, and the kernels that render them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.scenes.ground_truth import Truth, truth_of
from clplen.cameras.scenes.surfaces import Bars, Ellipse, Plane, Polygon, Sphere, require_numbers
from clplen.checks import real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.lightfield.model.light_field import LightField
from clplen.reprs import OneLine

MAX_SURFACES = 64  # maximum number of surfaces: bits of a mask in the kernels
EDGE_ON = 0.05  # minimum 1 - gy a - gx b of a plane: views at a smaller angle are rejected
SHAPE_NUMBERS, LINK_NUMBERS = 17, 9  # numbers of a surface in kernels/cameras/surfaces.cl
MARGIN_PIXELS = 2  # pixels added to the bounds of a surface
FAR = 2**30  # bound of surfaces without an outline, in pixels
_KINDS: dict[Any, int] = {type(None): 0, Ellipse: 1, Polygon: 2, Bars: 3}


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SurfaceScene(OneLine):
    """Opaque surfaces in the space (Y, X, d) of a light field's centre view.

    The ray of L[v, u, y, x] is the straight line (Y, X) = (y + d (v - vc), x + d (u - uc)) for all
    d, y and x from the middle of the picture. It sees the surface of the largest d on it. Views and
    their disparity are exact, with occlusions, for any number of views.

    Parameters
    ----------
    surfaces : Plane, Sphere or sequence of them
        Surfaces, at most 64.
    background : float
        Brightness of rays that meet no surface; such pixels have no disparity (nan).

    Raises
    ------
    TypeError
        If a member is neither `Plane` nor `Sphere`.
    ValueError
        If there are no surfaces, or more than 64, or the background is not finite.

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> lf.shape, [f"{d:.1f}" for d in truth.disparity[16, ::8]]
    ((3, 3, 32, 32), ['-0.5', '1.0', '1.0', '-0.5'])
    """

    surfaces: tuple[Plane | Sphere, ...]
    background: float

    def __init__(
        self, surfaces: Plane | Sphere | Sequence[Plane | Sphere], background: float = 0.0
    ) -> None:
        members = (surfaces,) if isinstance(surfaces, Plane | Sphere) else tuple(surfaces)
        if not 1 <= len(members) <= MAX_SURFACES:
            raise ValueError(
                f"A scene must have 1 to {MAX_SURFACES} surfaces, got {len(members)}: bars and "
                "polygons of several contours are one surface."
            )
        for member in members:
            if not isinstance(member, Plane | Sphere):
                kind = type(member).__name__
                raise TypeError(f"A surface must be a Plane or a Sphere, got {kind}.")
        require_numbers("The background", background)
        object.__setattr__(self, "surfaces", members)
        object.__setattr__(self, "background", float(background))

    @property
    def channels(self) -> int:
        """Number of channels: 3 if a texture has colour, else 1."""
        return max(surface.texture.channels for surface in self.surfaces)

    def light_field(
        self,
        views: tuple[int, int] = (9, 9),
        shape: tuple[int, int] = (512, 512),
        *,
        device: DeviceLike | None = None,
        noise: Any = 0.0,
        seed: int = 0,
        dtype: Any = np.float32,
        gain: Any = None,
    ) -> tuple[LightField, Truth]:
        """Render views of the scene, and the ground truth of its centre view.

        Edges are anti-aliased by 8 x 8 rays a pixel. Textures are already averaged over a pixel,
        equally in every view.

        Parameters
        ----------
        views : tuple of int
            Number of views (V, U), at least 1 each.
        shape : tuple of int
            (ny, nx) of a view, at least 1 each.
        device : Device or str, optional
            Device of the computation; None is ``Device.open()``.
        noise : float or array_like
            Standard deviation of additive Gaussian noise, as a fraction of white; broadcast over
            (ny, nx): shape (ny, 1) sets it for each row.
        seed : int
            Seed of the noise (`numpy.random.default_rng`); results are equal on every device.
        dtype : dtype-like
            float32, or uint8 or uint16 with white at the largest number, rounded and clipped.
        gain : array_like, optional
            Brightness of each view before the noise, finite, shape (V, U); default 1.

        Returns
        -------
        LightField
            Views, shape (V, U, ny, nx), or (V, U, ny, nx, 3) if a texture has colour.
        Truth

        Raises
        ------
        ValueError
            If a plane is so steep that a view sees it edge-on or from behind, or a number is
            outside its range.
        ShapeError
            If noise or gain do not fit, or views or shape are not two positive integers.
        DeviceError
            If the light field does not fit the device.
        """
        device = as_device(device)
        V, U = _counts(views, "views")
        ny, nx = _counts(shape, "shape")
        kind = np.dtype(dtype)
        if kind not in (np.float32, np.uint8, np.uint16):
            raise ValueError(f"dtype must be float32, uint8 or uint16, got {kind}.")
        sd = _spread(noise, (ny, nx))
        levels = _gains(gain, (V, U))
        self.check_views((V - 1) / 2, (U - 1) / 2)
        tables = surface_tables(self, device)
        full = (V, U, ny, nx) if self.channels == 1 else (V, U, ny, nx, 3)
        device.require_memory(kind.itemsize * math.prod(full), "This light field")
        result = np.empty(full, kind)
        random = np.random.default_rng(seed)
        for v, row in enumerate(rows_of_views(tables, levels, (ny, nx))):
            result[v] = _to_storage(row.reshape(full[1:]), sd, random, kind)
        weights = np.ones((V, U), np.float32)
        lf = LightField.from_array(result, device=device, weights=weights)
        return lf, centre_truth(tables, (ny, nx))

    def check_views(self, down: float, right: float) -> None:
        """Raise for planes that a view up to (down, right) from the centre sees edge-on."""
        for number, surface in enumerate(self.surfaces):
            if not isinstance(surface, Plane):
                continue
            turn = abs(surface.slope[0]) * down + abs(surface.slope[1]) * right
            if turn > 1 - EDGE_ON:
                raise ValueError(
                    f"Surface {number}, a plane of slope {surface.slope} disparities a pixel, is "
                    f"edge-on or reversed in views up to {max(down, right):g} from the centre: "
                    f"|gy| {down:g} + |gx| {right:g} must be at most {1 - EDGE_ON:g}, got "
                    f"{turn:.3g}."
                )


@dataclass(frozen=True, eq=False)
class SurfaceTables:
    """Tables of a scene for its kernels."""

    scene: SurfaceScene
    device: Device
    shape: cla.Array  # shape, which, edges, spots, texels: see kernels/surfaces.cl
    which: cla.Array
    edges: cla.Array
    spots: cla.Array
    texels: cla.Array

    @property
    def count(self) -> int:
        """Number of surfaces."""
        return len(self.scene.surfaces)

    def all(self) -> tuple[cla.Array, ...]:
        """Return the tables in the order of the kernels' arguments."""
        return (self.shape, self.which, self.edges, self.spots, self.texels)


def surface_tables(scene: SurfaceScene, device: Device) -> SurfaceTables:
    """Return the tables of a scene on a device."""
    shape = np.zeros((len(scene.surfaces), SHAPE_NUMBERS), np.float32)
    which = np.zeros((len(scene.surfaces), LINK_NUMBERS), np.int32)
    edges: list[Any] = [np.zeros((0, 4))]
    spots: list[Any] = []
    texels: list[Any] = []
    offsets: dict[int, int] = {}
    for surface, numbers, links in zip(scene.surfaces, shape, which, strict=True):
        texture = surface.texture
        if id(texture) not in offsets:
            offsets[id(texture)] = sum(part.size for part in texels)
            texels.append(texture.coefficients(scene.channels).ravel())
        outline = getattr(surface, "outline", None)
        numbers[:12] = _geometry(surface)
        ny, nx = texture.samples.shape[:2]
        middle = (ny // 2 - texture.centre[0] / texture.scale,
                  nx // 2 - texture.centre[1] / texture.scale)  # fmt: skip
        numbers[12:] = (1 / texture.scale, *np.mod(middle, (ny, nx)), *surface.shade)
        lines = outline.edges() if isinstance(outline, Polygon) else np.zeros((0, 4))
        links[:] = (
            0 if isinstance(surface, Plane) else 1, _KINDS[type(outline)], sum(map(len, edges)),
            len(lines), offsets[id(texture)], ny, nx, len(spots), len(surface.spots),
        )  # fmt: skip
        edges.append(lines)
        spots += [
            (*s.centre, 0.5 / (s.width * s.width), s.strength, s.disparity) for s in surface.spots
        ]
    return SurfaceTables(
        scene,
        device,
        device.upload(shape),
        device.upload(which),
        device.upload(_pad_rows(np.concatenate(edges), 4)),
        device.upload(_pad_rows(np.asarray(spots), 5)),
        device.upload(np.concatenate(texels)),
    )


def rows_of_views(
    tables: SurfaceTables, gain: np.ndarray[Any, Any], shape: tuple[int, int]
) -> Iterator[np.ndarray[Any, np.dtype[np.float32]]]:
    """Yield views of a scene without noise, a row of views at a time."""
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


def centre_truth(tables: SurfaceTables, shape: tuple[int, int]) -> Truth:
    """Compute disparity and surface of every pixel of the centre view."""
    device = tables.device
    disparity, index = device.empty(shape, np.float32), device.empty(shape, np.int32)
    device.launch_rows(
        device.kernel("scene.cl", "truth"),
        shape,
        *(disparity, index, tables.shape, tables.which, tables.edges),
        *(np.int32(n) for n in (tables.count, *shape)),
    )
    is_smooth = [not isinstance(surface, Plane) for surface in tables.scene.surfaces]
    return truth_of(device.download(disparity), device.download(index), is_smooth)


def view_bounds(
    scene: SurfaceScene, views: tuple[int, int], shape: tuple[int, int]
) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Return rows and columns of each surface, (y0, y1, x0, x1), shape (V, U, n, 4).

    A point (Y, X, d) lies at (Y - d a, X - d b) in the view (a, b) from the centre. A surface lies
    in the hull of its points.
    """
    V, U = views
    bounds = np.empty((V, U, len(scene.surfaces), 4), np.int64)
    a, b = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
    for i, surface in enumerate(scene.surfaces):
        points = surface.bounds()
        if points is None:
            bounds[:, :, i] = (-FAR, FAR, -FAR, FAR)
            continue
        y = points[:, 0] - points[:, 2] * a[:, None] + (shape[0] - 1) / 2
        x = points[:, 1] - points[:, 2] * b[:, None] + (shape[1] - 1) / 2
        bounds[:, :, i, 0] = np.floor(y.min(axis=1))[:, None] - MARGIN_PIXELS
        bounds[:, :, i, 1] = np.ceil(y.max(axis=1))[:, None] + MARGIN_PIXELS
        bounds[:, :, i, 2] = np.floor(x.min(axis=1))[None, :] - MARGIN_PIXELS
        bounds[:, :, i, 3] = np.ceil(x.max(axis=1))[None, :] + MARGIN_PIXELS
    return np.clip(bounds, -FAR, FAR).astype(np.int32)


def _geometry(surface: Plane | Sphere) -> tuple[float, ...]:
    """Return the first twelve numbers of a surface."""
    if isinstance(surface, Sphere):
        start = (surface.disparity, surface.height, surface.radius, *surface.centre)
        return (*start, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    plane, outline = surface, surface.outline
    if outline is None or isinstance(outline, Polygon):
        return (plane.disparity, *plane.slope, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    period, widths = 1.0, (0.0, 0.0)
    if isinstance(outline, Bars):
        period, widths = outline.period, outline.widths
    turn = (math.cos(outline.angle), math.sin(outline.angle))
    halves = (widths[0] / 2, widths[1] / 2)
    return (plane.disparity, *plane.slope, *outline.centre, *turn, *outline.half, period, *halves)


def _pad_rows(values: Any, width: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the rows of a table; an empty table gets a row of zeros."""
    rows = np.asarray(values, np.float32).reshape(-1, width)
    return rows if len(rows) else np.zeros((1, width), np.float32)


def _counts(pair: Any, what: str) -> tuple[int, int]:
    """Return two positive integers."""
    values = np.asarray(pair)
    if values.shape != (2,) or values.dtype.kind not in "iu" or (values < 1).any():
        raise ShapeError(f"{what} must be two positive integers, got {pair!r}.")
    return int(values[0]), int(values[1])


def _spread(noise: Any, shape: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Return the standard deviation of the noise, broadcastable to (ny, nx, 1)."""
    values = real_array(noise, "noise")
    try:
        np.broadcast_to(values, shape)
    except ValueError as error:
        raise ShapeError(
            f"noise must broadcast to pixels {shape}, got shape {values.shape}."
        ) from error
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError("noise must be finite and >= 0.")
    return values


def _gains(gain: Any, views: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Return the brightness of each view, float32, shape (V, U)."""
    values = np.ones(views, np.float32) if gain is None else real_array(gain, "gain")
    if values.shape != views:
        raise ShapeError(f"gain must have the shape of the views, {views}, got {values.shape}.")
    if not np.isfinite(values).all():
        raise ValueError("gain must be finite.")
    return values


def _to_storage(row: Any, sd: Any, random: np.random.Generator, kind: np.dtype[Any]) -> Any:
    """Add noise to a row of views, and convert it to its storage type."""
    if sd.any():
        grown = sd if row.ndim == 3 else np.broadcast_to(sd, row.shape[1:3])[..., None]
        row = row + grown * random.standard_normal(row.shape, np.float32)
    if kind == np.float32:
        return row
    top = np.iinfo(kind).max
    return np.clip(np.rint(row * np.float32(top)), 0, top).astype(kind)
