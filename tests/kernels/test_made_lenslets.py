"""made_lenslets.cl: surfaces, maps and clear gaps against a float64 twin sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import reference

from clplen import Grid, MicrolensArray
from clplen.compute.device import Device
from clplen.wave import Glass, LensletMap, LensletSurface

DX = 5e-6
P = 9.37 * DX
LAM = 532e-9
SURFACES = (
    LensletSurface(1.6e-4, "N-BK7", conic=-0.6, aspheric=(3e11, -2e20)),
    LensletSurface(-1.3e-4, 1.62, conic=2.5),
    LensletSurface(2.1e-4, "PMMA", aspheric=(-1e12,)),
)


def keys(values: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Cubic convolution (Keys 1981, eq. 15 and its boundary), one place after the other."""
    for axis in (0, 1):
        for _ in range(2):
            v = np.moveaxis(values, axis, 0)
            v = np.concatenate(
                [[3 * v[0] - 3 * v[1] + v[2]], v, [3 * v[-1] - 3 * v[-2] + v[-3]]], axis=0
            )
            values = np.moveaxis(v, 0, axis)

    def weight(s: float) -> float:
        s = abs(s)
        if s < 1:
            return 1.5 * s**3 - 2.5 * s**2 + 1
        return -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2 if s < 2 else 0.0

    found = np.zeros(row.shape)
    for k in np.ndindex(row.shape):
        y = np.clip(row[k], -0.5, values.shape[0] - 4.5) + 2
        x = np.clip(column[k], -0.5, values.shape[1] - 4.5) + 2
        rows = range(max(int(y) - 2, 0), min(int(y) + 4, values.shape[0]))
        columns = range(max(int(x) - 2, 0), min(int(x) + 4, values.shape[1]))
        found[k] = sum(weight(y - i) * weight(x - j) * values[i, j] for i in rows for j in columns)
    return found


def twin(grid: Grid, array: MicrolensArray, lam: float = LAM) -> Any:
    """Amplitude of the lenslets, amplitude of the gaps, and turns."""
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    centres = array.centres().reshape(-1, 2)
    away = [np.hypot(y - cy, x - cx) for cy, cx in centres]
    near = np.argmin(away, axis=0)
    r = np.min(away, axis=0)
    kind = array.types().ravel()[near]
    turns = np.zeros(grid.shape)
    rim = np.zeros(len(array.focal_lengths))
    for k in range(len(rim)):
        at = np.append(np.where(kind == k, r, 0), array.diameter / 2)
        if array.surface:
            s = array.surface[k]
            n = s.glass.index(lam) if isinstance(s.glass, Glass) else s.glass
            under = np.clip(1 - (1 + s.conic) * at**2 / s.radius**2, 0, None)  # beyond lenslets
            sag = at**2 / s.radius / (1 + np.sqrt(under))
            sag += sum(a * at ** (4 + 2 * i) for i, a in enumerate(s.aspheric))
            path = (n - 1) * sag
        else:
            path = at**2 / (2 * array.focal_lengths[k])
        turns -= np.where(kind == k, path[:-1].reshape(grid.shape) / lam, 0)
        rim[k] = path[-1] / lam
    if array.gap == "clear":
        turns += rim[kind]
    if array.map is not None:
        m = array.map
        cos, sin = np.cos(array.rotation), np.sin(array.rotation)
        down, right = y - centres[near, 0], x - centres[near, 1]
        b, a = down * cos - right * sin, down * sin + right * cos
        ny, nx = m.values.shape[-2:]
        row = (b - m.origin[0]) / m.pitch[0] + ny // 2
        column = (a - m.origin[1]) / m.pitch[1] + nx // 2
        maps = m.values.reshape(-1, ny, nx)
        index = m.glass.index(lam) if isinstance(m.glass, Glass) else m.glass
        scale = 1 / lam if m.glass is None else (1 - index) / lam
        turns *= not m.complete
        for k in range(len(maps)):
            own = near == k if m.is_per_lenslet else np.ones(grid.shape, bool)
            turns[own] += scale * keys(maps[k], row[own], column[own])
    lay = {
        "pitch": array.pitch, "f": 1.0, "count": array.count, "wavelength": 1.0,
        "lattice": array.lattice, "offset": array.offset, "rotation": array.rotation,
        "origin": grid.origin,
    }  # fmt: skip
    lit = np.abs(
        reference.microlens_array(
            grid.shape, grid.pitch, fill=array.fill, diameter=array.diameter, **lay
        )
    )
    cells = np.abs(reference.microlens_array(grid.shape, grid.pitch, fill="full", **lay))
    gap = np.clip(cells - lit, 0, None) if array.gap == "clear" else np.zeros(grid.shape)
    return np.minimum(lit, 1), gap, turns


def check(
    device: Device, grid: Grid, array: MicrolensArray, phase: float, lam: float = LAM
) -> None:
    lit, gap, turns = twin(grid, array, lam)
    got = device.download(array.transmission(grid, lam, device)).astype(complex)
    expected = lit * np.exp(2j * np.pi * turns) + gap
    # strips of exact chord: 2.6e-4 of a cell, once for the lenslet and once for the gap
    assert np.abs(got - expected).max() <= 1e-3
    inner = (lit > 1 - 1e-9) & (gap == 0)
    assert 0.05 < inner.mean() < 1
    assert np.ptp(turns[inner]) > 0.3
    assert np.abs(np.angle(got[inner] * np.conj(expected[inner]))).max() <= phase
    assert np.abs(np.abs(got[inner]) - 1).max() <= 1e-6
    dark = lit + gap < 1e-9
    assert not dark.any() or np.abs(got[dark]).max() <= 1e-6


LAYS = [
    {"count": (3, 4), "fill": "full"},
    {"count": (3, 4), "rotation": 0.3, "diameter": 0.83 * P, "gap": "clear"},
    {"count": (4, 3), "lattice": "hexagonal", "offset": (0.4 * DX, -1.3 * DX), "gap": "clear"},
    {"count": (4, 3), "lattice": "hexagonal", "fill": "full", "rotation": -0.5},
    {"count": (1, 5), "diameter": 0.7 * P, "rotation": 1.2},
]


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_surfaces(wave: Device) -> None:
    for lay, kinds in list(zip(LAYS, (3, 1, 3, 1, 1), strict=True)):
        grid = Grid((37, 46), (DX, 0.9 * DX), origin=(0.131 * DX, 0.377 * DX))
        array = MicrolensArray(P, surface=SURFACES[:kinds], **lay)
        check(wave, grid, array, 1e-6 if wave.precision == "single" else 1e-11)
        check(wave, grid, array, 1e-6 if wave.precision == "single" else 1e-11, lam=640e-9)


def test_thin_lenses_with_clear_gaps_and_maps(device: Device) -> None:
    for lay in LAYS[:3]:
        random = np.random.default_rng(3)
        grid = Grid((31, 37), (DX, 0.9 * DX), origin=(0.131 * DX, 0.377 * DX))
        one = LensletMap(
            2e-7 * random.normal(size=(11, 9)),
            pitch=(0.11 * P, 0.14 * P),
            glass="N-BK7",
            origin=(0.02 * P, -0.03 * P),
        )
        own = LensletMap(
            phase=random.normal(size=(*np.broadcast_to(lay["count"], 2), 6, 8)),
            pitch=(0.2 * P, 0.19 * P),
            wavelength=600e-9,
        )
        for more in (one, own):
            array = MicrolensArray(P, (2.5e-3, 3.4e-3, -3e-3), map=more, **lay)
            check(device, grid, array, 2e-6)


def test_a_map_alone(device: Device) -> None:
    random = np.random.default_rng(4)
    whole = LensletMap(1e-6 * random.random((9, 13)), pitch=0.14 * P, glass=1.46, complete=True)
    array = MicrolensArray(P, 2.5e-3, count=(3, 2), fill="full", rotation=0.2, map=whole)
    check(device, Grid((30, 33), DX), array, 2e-6)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_many_turns(wave: Device) -> None:
    """60 turns at the rim of large lenslets, far from the middle of the array."""
    surface = LensletSurface(2.6e-3, "N-SF11", conic=-1.3, aspheric=(2e6,))
    grid = Grid((40, 41), 0.4e-6, origin=(33.51e-3, -21.495e-3))
    array = MicrolensArray(1e-3, count=(71, 69), surface=surface, fill="full")
    lit, _, turns = twin(grid, array)
    assert lit.min() > 0.99
    assert np.abs(turns).max() > 50
    got = wave.download(array.transmission(grid, LAM, wave)).astype(complex)
    error = np.abs(np.angle(got * np.exp(-2j * np.pi * turns))).max()
    # the grid's coordinates: 2e-16 of 33 mm, times 1/100 a sample of phase
    assert error <= (1e-6 if wave.precision == "single" else 1e-8)


def test_without_float64(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Float32 keeps 8e-7 rad a turn."""
    monkeypatch.setattr(device, "has_fp64", False)
    grid = Grid((37, 43), (DX, 0.9 * DX), origin=(0.131 * DX, 0.377 * DX))
    for lay in LAYS[1:3]:
        array = MicrolensArray(P, surface=SURFACES, **lay)
        turns = np.abs(twin(grid, array)[2]).max()
        check(device, grid, array, 2e-6 + 8e-7 * turns)
