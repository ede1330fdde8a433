"""Transfer functions against closed forms, and the frequencies read from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_closed import airy

from clplen.analysis.point.otf import OTF, Curve, circular_mtf, pixel_mtf, square_mtf
from clplen.analysis.point.psf import PSF
from clplen.errors import ShapeError
from clplen.wave.field.field import Grid

WAVELENGTH, DISTANCE, WIDTH = 532e-9, 0.018, 150e-6
UNIT = WAVELENGTH * DISTANCE / WIDTH  # lam a/d: 63.84 um
APERTURE = {"wavelength": WAVELENGTH, "distance": DISTANCE, "width": WIDTH}
CENTRE = (91e-6, -57e-6)
GRIDS = [
    Grid((403, 360), (0.41 * UNIT, 0.33 * UNIT), origin=(30e-6, -12e-6)),
    Grid((320, 401), (0.29 * UNIT, 0.45 * UNIT), origin=(-5e-6, 44e-6)),
]


def square_psf(grid: Grid) -> PSF:
    lines = [np.sinc((c - m) / UNIT) ** 2 for c, m in zip((grid.y, grid.x), CENTRE, strict=True)]
    return PSF(np.multiply.outer(*lines), grid.pitch, grid.origin)


def circular_psf(grid: Grid) -> PSF:
    r = np.hypot.outer(grid.y - CENTRE[0], grid.x - CENTRE[1]) / UNIT
    return PSF(airy(np.pi * r) ** 2, grid.pitch, grid.origin)


@pytest.mark.parametrize(
    ("grid", "axis", "psf", "mtf"),
    [(GRIDS[0], 0, square_psf, square_mtf), (GRIDS[1], 1, circular_psf, circular_mtf)],
)
def test_apertures_have_their_transfer_functions(grid: Grid, axis: int, psf, mtf) -> None:
    # light in tails beyond the window W is missing: unit/(pi^2 W/2) = .003 of a sinc^2's at most
    transfer = OTF.of(psf(grid))
    curve = transfer.mtf(axis)
    np.testing.assert_allclose(curve.value, mtf(curve.frequency, **APERTURE), atol=4e-3)
    assert curve.frequency[0] == 0
    assert curve.frequency[-1] == pytest.approx(0.5 / grid.pitch[axis], rel=5e-3)
    assert curve.cutoff(level=0.005) == pytest.approx(1 / UNIT, rel=0.03)
    half = 0.5 if mtf is square_mtf else 0.403973
    assert curve.at(0.5) == pytest.approx(half / UNIT, rel=0.01)


def test_the_phase_of_a_shift_has_its_sign() -> None:
    grid = GRIDS[0]
    about = (CENTRE[0] - 20e-6, CENTRE[1] + 31e-6)  # the centre lies +20 um in y, -31 um in x
    transfer = OTF.of(square_psf(grid), centre=about)
    fy, fx = np.meshgrid(transfer.fy, transfer.fx, indexing="ij")
    low = (np.abs(fy) < 0.5 / UNIT) & (np.abs(fx) < 0.5 / UNIT)
    expected = np.exp(-2j * np.pi * (20e-6 * fy - 31e-6 * fx))
    turned = transfer.values / np.abs(transfer.values) / expected
    assert np.abs(np.angle(turned[low])).max() < 1e-2


@pytest.mark.parametrize(("pad", "shape"), [(1, (9, 12)), (2.7, (13, 8))])
def test_the_transform_is_the_sum_that_it_stands_for(pad: float, shape: tuple[int, int]) -> None:
    values = np.random.default_rng(2).uniform(0.1, 1, shape)
    psf = PSF(values, (2e-6, 3e-6), (5e-6, -7e-6))
    transfer = OTF.of(psf, pad=pad, centre=(1e-6, 2e-6))
    y, x = psf.coordinates(0) - 1e-6, psf.coordinates(1) - 2e-6
    down = np.exp(-2j * np.pi * np.multiply.outer(transfer.fy, y))
    along = np.exp(-2j * np.pi * np.multiply.outer(x, transfer.fx))
    np.testing.assert_allclose(transfer.values, down @ values @ along / values.sum(), atol=1e-12)
    assert transfer.values.shape == tuple(math.ceil(n * pad) for n in shape)
    for axis, f in ((0, transfer.fy), (1, transfer.fx)):
        curve = transfer.mtf(axis)
        assert curve.frequency.size == f.size // 2 + 1
        np.testing.assert_allclose(np.diff(curve.frequency), np.diff(f)[0], rtol=1e-9)
        assert curve.value[0] == pytest.approx(1, abs=1e-12)
        line = values.sum(axis=1 - axis)
        k = curve.frequency.size - 1
        r = psf.coordinates(axis)
        direct = abs(np.sum(line * np.exp(-2j * np.pi * curve.frequency[k] * r))) / line.sum()
        assert curve.value[k] == pytest.approx(direct, abs=1e-12)


def test_closed_forms_at_known_places() -> None:
    f = np.array([0, 0.25, 0.5, 1, 3]) / UNIT
    np.testing.assert_allclose(square_mtf(f, **APERTURE), [1, 0.75, 0.5, 0, 0], atol=1e-12)
    expected = [1, 0.685038, 0.391002, 0, 0]
    np.testing.assert_allclose(circular_mtf(f, **APERTURE), expected, atol=1e-6)
    for name in APERTURE:
        with pytest.raises(ValueError, match=f"{name} must be positive"):
            square_mtf(f, **(APERTURE | {name: 0.0}))
    with pytest.raises(ValueError, match="width must be positive"):
        pixel_mtf(f, width=-1e-6)
    assert pixel_mtf(0.25e6, width=4e-6) == pytest.approx(0)
    assert pixel_mtf(0.125e6, width=4e-6) == pytest.approx(2 / math.pi)


LOBES = Curve(np.arange(9) * 1e3, np.array([1, 0.7, 0.2, 0.02, 0.12, 0.04, 0.02, 0.03, 0.01]))


def test_frequencies_are_read_between_samples() -> None:
    assert LOBES.at(0.5) == pytest.approx(1400)
    assert LOBES.at(0.1) == pytest.approx(2000 + 1000 * 0.1 / 0.18)
    assert math.isnan(LOBES.at(0.005))
    assert LOBES.contrast(1500) == pytest.approx(0.45)
    assert math.isnan(LOBES.contrast(9000))
    np.testing.assert_allclose(LOBES.contrast([500, 4500]), [0.85, 0.08])


def test_the_cutoff_is_where_the_curve_stays_below() -> None:
    assert LOBES.cutoff(level=0.05) == pytest.approx(4000 + 1000 * 0.07 / 0.08)  # past the lobe
    assert LOBES.cutoff(level=0.05, noise=0.08) == pytest.approx(2000 + 1000 * 0.07 / 0.18)
    assert math.isnan(LOBES.cutoff(level=0.005))
    assert LOBES.floor(5500) == pytest.approx(math.sqrt((4 + 9 + 1) / 3) / 100)


def test_bad_curves_and_questions_are_told() -> None:
    for call, error, words in (
        (lambda: Curve(np.arange(3.0), np.ones(4)), ShapeError, "equal lengths"),
        (lambda: Curve(np.array([0.0, 2.0, 1.0]), np.ones(3)), ValueError, "ascend"),
        (lambda: LOBES.at(1.0), ValueError, "between 0 and 1"),
        (lambda: LOBES.floor(8000), ValueError, "below 8000"),
        (lambda: LOBES.cutoff(level=0, noise=0), ValueError, "level and noise"),
        (lambda: OTF.of(square_psf(GRIDS[0]), pad=0.5), ValueError, "pad must be at least 1"),
        (lambda: OTF.of(PSF(np.ones((4, 5)), 1e-6)).mtf(-1), ValueError, "axis must be 0"),
    ):
        with pytest.raises(error, match=words):
            call()
