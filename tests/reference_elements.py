"""Slow, simple float64 twins of the elements: lens, apertures, microlens array.

Everything is evaluated at coordinates, never at indices; area fractions are exact. Nothing here
imports the package under test.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from reference_optics import Complex, Pair, Real, axis, pair


def lens_phase(
    shape: Sequence[int], pitch: Pair, f: float, wavelength: float, *, origin: Pair = 0.0
) -> Complex:
    """Paraxial thin lens exp(-i pi r^2/(lam f)), shape (ny, nx)."""
    y, x = from_centre(shape, pitch, origin=origin)
    return np.exp(-1j * np.pi * (y[:, None] ** 2 + x[None, :] ** 2) / (wavelength * f))


def from_centre(
    shape: Sequence[int], pitch: Pair, *, centre: Pair = 0.0, origin: Pair = 0.0
) -> tuple[Real, Real]:
    """Coordinates (y, x) from a centre; 0 along an axis of length 1, where nothing varies."""
    y, x = (
        axis(n, d, o) - c if n > 1 else np.zeros(1)
        for n, d, o, c in zip(shape, *map(pair, (pitch, origin, centre)), strict=True)
    )
    return y, x


def stigmatic_phase(
    shape: Sequence[int], pitch: Pair, f: float, wavelength: float, *, origin: Pair = 0.0
) -> Complex:
    """Lens exp(-ik sign(f) (sqrt(r^2 + f^2) - |f|)) that images infinity to a point."""
    y, x = from_centre(shape, pitch, origin=origin)
    r2 = y[:, None] ** 2 + x[None, :] ** 2
    longer = r2 / (np.sqrt(r2 + f**2) + abs(f))
    return np.exp(-2j * np.pi * np.sign(f) * longer / wavelength)


# Sources -------------------------------------------------------------------------------------


def spherical_wave(
    shape: Sequence[int],
    pitch: Pair,
    z: float,
    wavelength: float,
    *,
    source: Pair = 0.0,
    origin: Pair = 0.0,
) -> Complex:
    """exp(ik(r - |z|))/r from a point |z| before the plane, its conjugate for z < 0."""
    y, x = from_centre(shape, pitch, centre=source, origin=origin)
    r = np.sqrt(y[:, None] ** 2 + x[None, :] ** 2 + z**2)
    longer = (y[:, None] ** 2 + x[None, :] ** 2) / (r + abs(z))
    return np.exp(2j * np.pi * np.sign(z) * longer / wavelength) / r


def tilt_phase(
    shape: Sequence[int], pitch: Pair, direction: Pair, wavelength: float, *, origin: Pair = 0.0
) -> Complex:
    """exp(ik(a_y y + a_x x)) for direction cosines (a_y, a_x)."""
    y, x = from_centre(shape, pitch, origin=origin)
    ay, ax = pair(direction)
    return np.exp(2j * np.pi * (ay * y[:, None] + ax * x[None, :]) / wavelength)


# Coverage of sample cells --------------------------------------------------------------------


def disc_corner_area(x: Real, y: Real, radius: float) -> Real:
    """Exact area of {0 < x' < x, 0 < y' < y, x'^2 + y'^2 < radius^2}, odd in x and in y."""
    sign = np.sign(x) * np.sign(y)
    x, y = np.minimum(np.abs(x), radius), np.minimum(np.abs(y), radius)

    def integral(t: Real) -> Real:
        """Integral of sqrt(radius^2 - t'^2) from 0 to t."""
        root = np.sqrt(np.maximum(radius**2 - t**2, 0))
        return 0.5 * (t * root + radius**2 * np.arcsin(t / radius))

    knee = np.minimum(x, np.sqrt(np.maximum(radius**2 - y**2, 0)))
    return sign * (y * knee + integral(x) - integral(knee))


def circle_coverage(
    shape: Sequence[int],
    pitch: Pair,
    diameter: float,
    *,
    centre: Pair = 0.0,
    origin: Pair = 0.0,
) -> Real:
    """Exact fraction of every sample's cell (dy x dx) inside a disc, shape (ny, nx)."""
    y, x = (
        cell_edges(axis(n, d, o) - c, d)
        for n, d, o, c in zip(shape, *map(pair, (pitch, origin, centre)), strict=True)
    )
    return cell_fraction(disc_corner_area(x[None, :], y[:, None], diameter / 2), pitch)


def cell_edges(t: Real, d: float) -> Real:
    """The n + 1 edges of n cells of width d centred at t."""
    return np.append(t - d / 2, t[-1] + d / 2)


def cell_fraction(corner: Real, pitch: Pair) -> Real:
    """Fraction of every cell covered, from the areas below and left of the cells' corners.

    What is 0 or 1 within 1e-9, the rounding of the differences, is made so.
    """
    dy, dx = pair(pitch)
    fraction = np.diff(np.diff(corner, axis=0), axis=1) / (dy * dx)
    fraction[fraction < 1e-9] = 0
    fraction[fraction > 1 - 1e-9] = 1
    return fraction


def rectangle_coverage(
    shape: Sequence[int],
    pitch: Pair,
    size: Pair,
    *,
    centre: Pair = 0.0,
    origin: Pair = 0.0,
) -> Real:
    """Exact fraction of every sample's cell inside an axis-aligned rectangle of size (y, x)."""
    sides = []
    for n, d, w, c, o in zip(shape, *map(pair, (pitch, size, centre, origin)), strict=True):
        t = axis(n, d, o) - c
        overlap = np.minimum(t + d / 2, w / 2) - np.maximum(t - d / 2, -w / 2)
        sides.append(np.clip(overlap / d, 0, 1))
    return sides[0][:, None] * sides[1][None, :]


def polygon_coverage(
    shape: Sequence[int], pitch: Pair, vertices: Real, *, origin: Pair = 0.0
) -> Real:
    """Exact fraction of every sample's cell inside a polygon; vertices (n, 2) as (y, x)."""
    points = np.asarray(vertices)[:, ::-1]
    y, x = (
        cell_edges(axis(n, d, o), d)
        for n, d, o in zip(shape, pair(pitch), pair(origin), strict=True)
    )
    corner = polygon_corner_area(points, x[None, :], y[:, None])
    return np.abs(cell_fraction(corner * np.sign(corner[-1, -1]), pitch))


def polygon_corner_area(vertices: Real, x: Real, y: Real) -> Real:
    """Exact area of {(x', y') in the polygon: x' < x, y' < y}; vertices (n, 2) as (x, y).

    Every edge adds the signed area between it, cut off at y, and the x axis.
    """
    area = np.zeros(np.broadcast(x, y).shape)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if ax == bx:
            continue
        low, high = min(ax, bx), np.clip(x, min(ax, bx), max(ax, bx))
        slope = (by - ay) / (bx - ax)
        below, beyond = y - (ay + slope * (low - ax)), y - (ay + slope * (high - ax))
        cut = (high - low) * mean_positive_part(below, beyond)
        area += np.sign(ax - bx) * ((high - low) * y - cut)
    return area


def mean_positive_part(a: Real, b: Real) -> Real:
    """Mean of max(t, 0) for t running linearly from a to b."""
    a, b = np.broadcast_arrays(a, b)
    flat = np.abs(b - a) <= 1e-9 * (np.abs(a) + np.abs(b))
    change = np.where(flat, 1.0, b - a)
    steep = (np.maximum(b, 0) ** 2 - np.maximum(a, 0) ** 2) / (2 * change)
    return np.where(flat, np.maximum((a + b) / 2, 0), steep)


# Microlens array -----------------------------------------------------------------------------


def rotate(points: Real, angle: float) -> Real:
    """Rotate points (..., 2) given as (x, y); a positive angle turns +x towards +y (y down)."""
    x, y = points[..., 0], points[..., 1]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x * c - y * s, x * s + y * c], axis=-1)


def lenslet_centres(
    pitch: float,
    *,
    count: int | tuple[int, int],
    lattice: str = "square",
    offset: Pair = 0.0,
    rotation: float = 0.0,
) -> Real:
    """Centres (ny, nx, 2) as (x, y) of lenslet [row, column]; offset is (y, x)."""
    ny, nx = np.broadcast_to(count, 2)
    y, x = np.meshgrid(np.arange(ny) - (ny - 1) / 2, np.arange(nx) - (nx - 1) / 2, indexing="ij")
    if lattice == "hexagonal":
        x[1::2] += 0.5
        y *= np.sqrt(3) / 2
    elif lattice != "square":
        raise ValueError(f"lattice {lattice!r} is unknown: 'square' or 'hexagonal'")
    oy, ox = pair(offset)
    return rotate(pitch * np.stack([x, y], axis=-1), rotation) + np.array([ox, oy])


def lenslet_outline(lattice: str, width: float, rotation: float) -> Real:
    """Vertices (n, 2) as (x, y) of a full lenslet: a square, or a hexagon of that width in x."""
    start, sides = (np.pi / 4, 4) if lattice == "square" else (np.pi / 2, 6)
    angle = start + 2 * np.pi * np.arange(sides) / sides
    radius = width / 2 / np.cos(np.pi / sides)
    return rotate(radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1), rotation)


def microlens_array(
    shape: Sequence[int],
    sample_pitch: Pair,
    *,
    pitch: float,
    f: float,
    count: int | tuple[int, int],
    wavelength: float,
    lattice: str = "square",
    fill: str = "circular",
    diameter: float | None = None,
    offset: Pair = 0.0,
    rotation: float = 0.0,
    origin: Pair = 0.0,
) -> Complex:
    """Transmission of a microlens array at the samples of a grid, shape (ny, nx).

    Phase -pi r^2/(lam f) from the nearest lenslet centre of the array to the sample centre;
    amplitude the exact fraction of the sample's cell covered by the lenslets: discs of diameter
    (fill "circular") or lattice cells scaled by diameter/pitch ("full"); diameter None is pitch.
    """
    diameter = pitch if diameter is None else diameter
    if fill not in ("circular", "full") or diameter > pitch * (1 + 1e-12):
        raise ValueError(f"fill {fill!r} with diameter {diameter} does not fit pitch {pitch}")
    centres = lenslet_centres(
        pitch, count=count, lattice=lattice, offset=offset, rotation=rotation
    ).reshape(-1, 2)
    outline = lenslet_outline(lattice, diameter, rotation)
    (dy, dx), (oy, ox) = pair(sample_pitch), pair(origin)
    y, x = axis(shape[0], dy, oy), axis(shape[1], dx, ox)
    reach = np.hypot(*outline[0]) + np.hypot(dy, dx)
    amplitude, r2 = np.zeros(tuple(shape)), np.full(tuple(shape), np.inf)
    for cx, cy in centres:
        part = near(y - cy, reach), near(x - cx, reach)
        ty, tx = y[part[0]] - cy, x[part[1]] - cx
        if not (len(ty) and len(tx)):
            continue
        r2[part] = np.minimum(r2[part], ty[:, None] ** 2 + tx[None, :] ** 2)
        ey, ex = cell_edges(ty, dy)[:, None], cell_edges(tx, dx)[None, :]
        if fill == "circular":
            corner = disc_corner_area(ex, ey, diameter / 2)
        else:
            corner = polygon_corner_area(outline, ex, ey)
        amplitude[part] += cell_fraction(corner, sample_pitch)
    r2[amplitude == 0] = 0
    return np.minimum(amplitude, 1) * np.exp(-1j * np.pi * r2 / (wavelength * f))


def near(t: Real, reach: float) -> slice:
    """Samples of a sorted axis with |t| < reach."""
    return slice(int(np.searchsorted(t, -reach)), int(np.searchsorted(t, reach)))
