"""Young's fringes: their visibility is the degree of coherence of the light on the pinholes.

A pinhole is one sample, so it takes the light at a point. Visibility is twice the Fourier
coefficient of the fringes over the mean intensity, which is Michelson's without picking maxima out
of noise (Goodman 2015, sections 5.1 and 5.2).
"""

from __future__ import annotations

import numpy as np
import pytest

from clplen import Coherence, Device, Field, Grid, Spectrum, propagate
from clplen.wave import ExtendedSource, RandomPhaseMask

pytestmark = pytest.mark.thorough

LAM = 550e-9
TOLERANCE = 0.02

# Spatial: separations j STEP DX make j STEP fringes in a screen as wide as one FFT has it, lam Z/DX
DX, Z = 40e-6, 0.5
SEPARATIONS = np.arange(1, 11)  # in steps of STEP samples
STEP = 2  # samples
ROWS, COLUMNS = 400, 132  # a row is an experiment of its own: 40 of each separation
SNAPSHOTS = 350  # times 40: 14000, a standard error of 1/sqrt(2 M) = .006 of a visibility
CELL = 22 * DX  # six fill a row; the widest pair is .91 of a cell apart
ROW = CELL / 2  # from row to row, two a cell: rows of one separation, ten apart, share none
MODELS = {  # and the distance from row to row: of the source |mu| = .18; its first zero: 671 um
    "source": (ExtendedSource(0.5e-3, 0.5, points=200), 550e-6),
    "square cells": (RandomPhaseMask((2 * ROW, CELL)), ROW),
    "gaussian cells": (RandomPhaseMask((2 * ROW, CELL / 2), kernel="gaussian"), ROW),
    "phase alone": (RandomPhaseMask((2 * ROW, CELL / 2), kernel="gaussian", kind="phase"), ROW),
}

# Temporal: every second fringe from the middle on, to a path difference of 18 wavelengths
FWHM, APART, FAR = 30e-9, 1e-3, 0.1
A_FRINGE = 16  # samples of the screen
ORDERS = 2 * np.arange(10)


def pairs(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the two pinholes in each row.

    The separation changes from row to row, and the place after every ten, across five whole cells:
    all rows of a snapshot share the lattice, which in so small a window does not fade altogether.
    """
    row = np.arange(rows)
    left = row // 10 * 11 // 4
    return left, left + STEP * SEPARATIONS[row % 10]


def pinholes(grid: Grid, device: Device) -> Field:
    """A pair in each row."""
    u, rows = np.zeros(grid.shape), np.arange(grid.shape[0])
    for columns in pairs(len(rows)):
        u[rows, columns] = 1
    return Field.from_array(u, grid, wavelength=LAM, device=device)


def screens(field: Field) -> Field:
    """Each row by itself on its way to the screen, as between walls."""
    rows = Field(
        field.data.reshape(-1, 1, COLUMNS), Grid((1, COLUMNS), DX), field.wavelength, field.device
    )
    lit = propagate(rows, Z, method="fresnel-1fft", pad=1)
    pitch = (field.grid.pitch[0], lit.grid.pitch[1])
    return Field(
        lit.data.reshape(field.shape), Grid(field.shape, pitch), field.wavelength, field.device
    )


def measured(light: Coherence, pitch: float, device: Device, rows: int, snapshots: int):
    """<u1* u2>/<|u|^2> of ten pairs: visibility of the fringes, and their place.

    I(x) = 2 + 2 Re(mu exp(-2 pi i (x - middle) d/(lam Z))), d = x2 - x1 (Fresnel).
    """
    apertures = pinholes(Grid((rows, COLUMNS), (pitch, DX)), device)
    found = light.average(screens, apertures, snapshots=snapshots).to_numpy().astype(float)
    terms = np.fft.ifft(np.fft.ifftshift(found, axes=1), axis=1)
    left, right = pairs(rows)
    middle = (left + right) / 2 - COLUMNS // 2
    turns = middle * (right - left) * DX**2 / (LAM * Z)
    fringes = terms[np.arange(rows), right - left] * np.exp(-2j * np.pi * turns)
    return 2 * fringes.reshape(-1, 10).sum(0) / terms[:, 0].reshape(-1, 10).sum(0)


@pytest.mark.parametrize("name", MODELS)
def test_visibility_is_the_degree_of_spatial_coherence(device, name):
    model, pitch = MODELS[name]
    stated = model.degree(0.0, SEPARATIONS * STEP * DX, wavelength=LAM)
    got = measured(Coherence(model, seed=11), pitch, device, ROWS, SNAPSHOTS)
    assert np.abs(np.abs(got) - np.abs(stated)).max() <= TOLERANCE
    assert np.abs(got.real - stated).max() <= TOLERANCE  # whether the middle is bright or dark
    assert np.abs(got.imag).max() <= TOLERANCE


def test_a_source_beside_the_axis_moves_the_fringes(device):
    # the last quarter of the same square: mu is complex, and large
    source = ExtendedSource(0.5e-3, 0.5, picture=np.array([[0.0, 0.0, 0.0, 1.0]]), points=50)
    stated = source.degree(0.0, SEPARATIONS * STEP * DX, wavelength=LAM)
    assert np.abs(stated.imag).max() > 0.9
    got = measured(Coherence(source, seed=11), 2e-3, device, ROWS, 100)
    assert np.abs(got - stated).max() <= TOLERANCE


def test_coherent_light_has_full_visibility(device):
    # float32 alone
    assert np.abs(measured(Coherence(), DX, device, 10, 1) - 1).max() <= 1e-5


def test_visibility_is_the_degree_of_temporal_coherence(device):
    grid, fringe = Grid((1, 1024), 1e-6), LAM * FAR / APART
    u = np.zeros(grid.shape)
    u[0, np.searchsorted(grid.x, [-APART / 2, APART / 2])] = 1
    pair = Field.from_array(u, grid, wavelength=LAM, device=device)
    screen = Grid((1, 20 * A_FRINGE), fringe / A_FRINGE, origin=(0.0, 9.5 * fringe))
    led = Spectrum.gaussian(LAM, FWHM)
    found = propagate(pair, FAR, coherence=Coherence(None, led, wavelengths=21), out_grid=screen)
    assert found.method == "coherent"  # nothing random
    one = np.arange(-A_FRINGE // 2, A_FRINGE // 2 + 1)  # a fringe from minimum to minimum
    weights = np.where(np.abs(one) < A_FRINGE // 2, 1, 0.5)
    pieces = found.to_numpy()[0, A_FRINGE * ORDERS[:, None] + A_FRINGE // 2 + one] * weights
    visibility = 2 * (pieces @ np.cos(2 * np.pi * one / A_FRINGE)) / pieces.sum(axis=1)
    x = ORDERS * fringe
    path = np.hypot(FAR, x + APART / 2) - np.hypot(FAR, x - APART / 2)
    closed = np.exp(-((np.pi * FWHM * path / (2 * LAM**2 * np.sqrt(np.log(2)))) ** 2))
    assert np.abs(led.degree(path) - closed).max() <= 1e-9
    assert np.abs(visibility - closed).max() <= 2e-3  # it bends within a fringe: 8e-4
