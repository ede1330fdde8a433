"""Checks of gradients with respect to lenslets and to what multiplies a field."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs
from clplen.types import Array
from clplen.wave.elements.lenslet_errors import LensletErrors
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.field_gradients import log_moments

LAM = 532e-9
DX = 5e-6
PITCH = 9.37 * DX  # of lenslets
GRID = Grid((33, 38), (DX, 1.1 * DX), origin=(0, DX / 2))
LENGTHS = (2.5e-3, 3.5e-3, 2.8e-3)


def _array(**values: Any) -> MicrolensArray:
    return MicrolensArray(PITCH, LENGTHS, lattice="hexagonal", rotation=0.12, **values)


def _fields(device: Device) -> tuple[Field, Field, Array]:
    """A field of two, the gradient behind an element, and the sum of conj(u) g."""
    u, g = twins.waves(11, 2, *GRID.shape), twins.waves(12, 2, *GRID.shape)
    field, behind = (
        Field.from_array(values, GRID, wavelength=LAM, device=device) for values in (u, g)
    )
    return field, behind, (u.astype(np.complex128).conj() * g).sum(axis=0)


def _places(mla: MicrolensArray) -> tuple[Array, Array, Array]:
    """(y, x) of every sample from its nearest lenslet, and the number of that."""
    y, x = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    index = np.argmin([(y - a) ** 2 + (x - b) ** 2 for a, b in centres], axis=0)
    return y - centres[index, 0], x - centres[index, 1], index


def _sums(mla: MicrolensArray, index: Array, values: Array) -> Array:
    rows, columns = mla.count
    found = np.bincount(index.ravel(), values.ravel(), minlength=rows * columns)
    return np.asarray(found.reshape(mla.count))


def _lenslet_errors(device: Device) -> Pairs:
    """Tilts of lenslets, each another."""
    mla = _array(count=(3, 4))
    field, behind, weight = _fields(device)
    y, x, index = _places(mla)
    down = 1e-3 * np.arange(12).reshape(mla.count)
    tilt = np.stack([down, -0.7 * down], axis=-1)
    lengths = np.array(LENGTHS)[mla.types()]
    errors = LensletErrors({}, PITCH, lengths, tilt, np.zeros(tilt.shape))
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    b, a = y * cos - x * sin, x * cos + y * sin
    ty, tx = np.moveaxis(tilt.reshape(-1, 2)[index], -1, 0)
    k = 2 * np.pi / LAM
    slopes = k * (weight * np.exp(-1j * k * (ty * b + tx * a))).imag
    expected = np.stack([_sums(mla, index, slopes * c) for c in (b, a)], axis=-1)
    yield expected, errors.gradient(mla, field, behind)["tilt"]


def _focal_lengths(device: Device) -> Pairs:
    """Focal lengths of round lenslets, there and back, and the width of square ones."""
    mla = _array(count=(2, 2))
    field, behind, weight = _fields(device)
    y, x, index = _places(mla)
    f, r2 = np.array(LENGTHS)[mla.types().ravel()[index]], y**2 + x**2
    Y, X = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    share = sum(
        twins.disc_share(Y - a, X - b, PITCH / 2, GRID.pitch)
        for a, b in mla.centres().reshape(-1, 2)
    )
    bent = np.minimum(share, 1) * (weight * np.exp(1j * np.pi * r2 / (LAM * f))).imag
    expected = _sums(mla, index, bent * np.pi * r2 / (LAM * f**2))
    yield expected, mla.gradient(field, behind)["lenslet_focal_lengths"]
    thin = np.minimum(share, 1) * np.exp(-1j * np.pi * r2 / (LAM * f))
    changed = mla.jacobian(GRID, LAM, device)["focal_lengths"].sum(axis=0)
    yield 1j * np.pi * r2 / (LAM * f**2) * thin, changed
    cells = MicrolensArray(PITCH, LENGTHS[0], count=(1, 2), fill="full", diameter=0.8 * PITCH)
    y, x, _ = _places(cells)
    lit = (weight * np.exp(1j * np.pi * (y**2 + x**2) / (LAM * LENGTHS[0]))).real
    wider, narrower = (
        sum(
            np.outer(*(twins.interval_share(c - at, half, d)
                       for c, at, d in zip((GRID.y, GRID.x), centre, GRID.pitch, strict=True)))
            for centre in cells.centres().reshape(-1, 2)
        )
        for half in (0.4 * PITCH + 1e-4 * DX, 0.4 * PITCH - 1e-4 * DX)
    )  # fmt: skip
    expected = np.array([(lit * (wider - narrower)).sum() / (4e-4 * DX)])
    yield expected, np.array([cells.gradient(field, behind)["diameter"]])


def _share(y: Array, x: Array, radius: float) -> Array:
    """Covered share of the cell about each (y, x) by a disc about 0: 32 strips, as on a device."""
    (ay, ax), (hy, hx) = np.broadcast_arrays(abs(y), abs(x)), np.array(GRID.pitch) / 2
    strips = (np.arange(32) + 0.5) / 16 - 1

    def covered(along: Array, across: Array, reach: float, width: float) -> Array:
        square = radius**2 - (across[..., None] + width * strips) ** 2
        chord, middle = np.sqrt(np.maximum(square, 0)), along[..., None]
        ends = np.minimum(middle + chord, reach), np.maximum(middle - chord, -reach)
        return np.asarray(np.maximum(ends[0] - ends[1], 0).mean(axis=-1) / (2 * reach))

    return np.where(ax * hy >= ay * hx, covered(ax, ay, hx, hy), covered(ay, ax, hy, hx))


def _centres(device: Device) -> Pairs:
    """Places of two round lenslets: slopes of their phase, and what their rims cover."""
    mla = _array(count=(1, 2))
    field, behind, weight = _fields(device)
    y, x, index = _places(mla)
    f = np.array(LENGTHS)[mla.types().ravel()[index]]
    lit = weight * np.exp(1j * np.pi * (y**2 + x**2) / (LAM * f))

    def share(centre: Any) -> Array:
        return _share(GRID.y[:, None] - centre[0], GRID.x - centre[1], PITCH / 2)

    centres, step = mla.centres().reshape(-1, 2), 1e-5 * DX
    rims = [
        [(lit.real * (share(c + s) - share(c - s))).sum() / (2 * step) for s in step * np.eye(2)]
        for c in centres
    ]
    bent = np.minimum(sum(share(c) for c in centres), 1) * lit.imag * 2 * np.pi / (LAM * f)
    slopes = np.stack([_sums(mla, index, bent * c) for c in (y, x)], axis=-1)
    yield slopes + np.array([rims]), mla.gradient(field, behind)["centres"]


def _log_moments(device: Device) -> Pairs:
    field, behind, expected = _fields(device)
    y, x = GRID.y / np.abs(GRID.y).max(), GRID.x / np.abs(GRID.x).max()
    powers = np.arange(3)[:, None]
    yield y**powers @ expected @ (x**powers).T, log_moments(field, behind, y, x)


CHECKS = (
    Check("gradient moments", "sums over a batch and along rows", _log_moments, 1e-5,
          ("transmission_gradient.cl",)),
    Check("tilt gradients", "gradients of lenslets' tilts", _lenslet_errors, 1e-5,
          ("lenslet_moments.cl", "lenslet_sums.cl")),
    Check("lenslet gradients", "gradients of focal lengths and widths", _focal_lengths, 3e-4,
          ("lenslet_gradient.cl", "lenslet_sums.cl")),
    Check("centre gradients", "gradients of lenslets' places", _centres, 1e-3,
          ("lenslet_gradient.cl",)),
)  # fmt: skip
