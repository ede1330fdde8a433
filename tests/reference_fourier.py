"""A Fourier light-field microscope in float64: the twin of clplen.cameras.fourier_microscope.

Rims are hard on fine samples. `sensor` is one Fresnel integral from the whole array to some places,
by sums alone; `frame` an exact angular spectrum on some eight samples a pixel. Lengths in metres,
arrays [y, x], z > 0 farther from the objective.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from reference_optics import Complex, Real
from scipy import fft

TIE = 1e-10  # metres: a sample on the rim of two lenslets is of one of them


@dataclass(frozen=True)
class Setup:
    """Objective, relay, lenslets (y, x, focal length) of one aperture, sensor."""

    M: float
    na: float
    index: float
    lam: float
    relay: float
    lenslets: tuple[tuple[float, float, float], ...]
    diameter: float
    fill: str
    s: float
    pixel: float
    shape: tuple[int, int]
    power: float = 0.5
    stop: float = np.inf  # diameter of the field stop, for `frame`


def within(setup: Setup, y: Real, x: Real) -> Real:
    """Whether places lie in an aperture about the origin: disc, square, hexagon flat across x."""
    half = setup.diameter / 2
    if setup.fill == "circular":
        return np.hypot(y, x) <= half
    if setup.fill == "square":
        return np.maximum(np.abs(y), np.abs(x)) <= half
    slanted = 0.5 * np.abs(x) + np.sqrt(0.75) * np.abs(y)
    return np.maximum(np.abs(x), slanted) <= half


def pupil_rows(setup: Setup, point: tuple[float, float, float], y: Real, x: Real) -> Complex:
    """Field of a point on the conjugate pupil, not normalised."""
    n_sine = setup.M * np.hypot(y, x) / setup.relay
    inside = n_sine <= setup.na
    cosine = np.sqrt(1 - np.minimum(n_sine / setup.index, 1) ** 2)
    k = 2 * np.pi / setup.lam
    defocus = k * setup.index * point[2] * (cosine - 1)
    tilt = k * setup.M / setup.relay * (point[0] * x + point[1] * y)
    return inside * np.where(inside, cosine, 1) ** setup.power * np.exp(1j * (defocus + tilt))


def covered(setup: Setup, y: Real, x: Real, parts: int) -> Real:
    """Share of samples at y, (ny, 1), and x, (1, nx), in an aperture, by parts x parts of each."""
    step = float(x[0, 1] - x[0, 0])
    moves = ((np.arange(parts) + 0.5) / parts - 0.5) * step + TIE
    total = np.zeros(np.broadcast_shapes(y.shape, x.shape))
    for down in moves:
        for right in moves:
            total += within(setup, y + down, x + right)
    return total / parts**2


def behind_lenslets(setup: Setup, y: Real, x: Real, parts: int = 1) -> Complex:
    """Transmission of the array on rows y of places x, both rising, shapes (ny,) and (nx,)."""
    out = np.zeros((y.size, x.size), complex)
    for cy, cx, focal in setup.lenslets:
        near = 0.6 * setup.diameter  # beyond every corner along an axis
        rows, columns = np.abs(y - cy) < near, np.abs(x - cx) < near
        v, u = y[rows, None] - cy, x[None, columns] - cx
        lens = np.exp(-1j * np.pi * (v**2 + u**2) / (setup.lam * focal))
        out[np.ix_(rows, columns)] += covered(setup, v, u, parts) * lens
    return out


def sensor(
    setup: Setup,
    point: tuple[float, float, float],
    corner: tuple[int, int],
    size: int,
    *,
    step: float,
    nodes: int = 5,
) -> Real:
    """Energy on size x size pixels from ``corner`` on, of a point of unit energy in the pupil.

    Samples of the array lie ``step`` apart; pixels are integrals by Gauss and Legendre.
    """
    radius = setup.na * setup.relay / setup.M
    count = 2 * int(np.ceil(radius / step)) + 2
    u = (np.arange(count) - (count - 1) / 2) * step
    places, weights = leggauss(nodes)
    weight = np.outer(weights, weights) / 4
    kernels = []
    for axis in (0, 1):
        t = corner[axis] + np.arange(size)[:, None] + places / 2 - (setup.shape[axis] - 1) / 2
        apart = t.reshape(-1, 1) * setup.pixel - u
        kernels.append(np.exp(1j * np.pi * apart**2 / (setup.lam * setup.s)))
    energy, field = 0.0, np.zeros((size * nodes,) * 2, complex)
    for rows in np.array_split(np.arange(count), max(1, count // 256)):
        before = pupil_rows(setup, point, u[rows][:, None], u[None])
        energy += float((np.abs(before) ** 2).sum()) * step**2
        behind = before * behind_lenslets(setup, u[rows], u)
        field += kernels[0][:, rows] @ (behind @ kernels[1].T)
    field *= step**2 / (setup.lam * setup.s)
    intensity = (np.abs(field) ** 2).reshape(size, nodes, size, nodes)
    mean = np.einsum("iakb,ab->ik", intensity, weight)
    return np.asarray(mean * setup.pixel**2 / energy)


def frame(
    setup: Setup, point: tuple[float, float, float], *, parts: int = 8, room: float = 1.15
) -> Real:
    """Energy on all pixels, by an angular spectrum without the paraxial terms of `sensor`.

    An even number of samples lie a pixel apart from edge to edge, integrated by Simpson's rule.
    """
    widest = max(setup.shape) * setup.pixel
    count = parts * int(np.ceil(room * widest / setup.pixel))
    step = setup.pixel / parts
    u = (np.arange(count) - count // 2) * step
    f = np.fft.fftfreq(count, step)
    blocks = [slice(start, start + 256) for start in range(0, count, 256)]  # rows: less memory
    field, energy = np.empty((count, count), complex), 0.0
    for some in blocks:
        field[some] = pupil_rows(setup, point, u[some, None], u[None])
        energy += float((np.abs(field[some]) ** 2).sum())
    if setup.stop < np.inf:
        place = f * setup.lam * setup.relay
        field = fft.ifft2(field, overwrite_x=True, workers=-1)
        for some in blocks:
            field[some] *= np.hypot(place[some, None], place) <= setup.stop / 2
        field = fft.fft2(field, overwrite_x=True, workers=-1)
    for some in blocks:
        field[some] *= behind_lenslets(setup, u[some], u, 3)
    field = fft.fft2(field, overwrite_x=True, workers=-1)
    for some in blocks:
        axial = np.sqrt(np.maximum(setup.lam**-2 - f[some, None] ** 2 - f**2, 0))
        field[some] *= np.exp(2j * np.pi * setup.s * (axial - 1 / setup.lam))
    field = fft.ifft2(field, overwrite_x=True, workers=-1)
    weights = np.array([1.0, *[4.0, 2.0] * (parts // 2 - 1), 4.0, 1.0]) / 3
    starts = [count // 2 - size * parts // 2 + np.arange(size) * parts for size in setup.shape]
    across = np.empty((count, setup.shape[1]))
    for some in blocks:
        intensity = np.abs(field[some]) ** 2
        across[some] = sum(w * intensity[:, starts[1] + k] for k, w in enumerate(weights))
    return np.asarray(sum(w * across[starts[0] + k] for k, w in enumerate(weights)) / energy)
