"""Partially coherent light through systems: limits, exact partners, fringes, bad input."""

import math

import numpy as np
import pytest

from clplen import (
    Coherence,
    Field,
    Grid,
    OpticalSystem,
    SamplingError,
    SamplingWarning,
    ShapeError,
    Spectrum,
    propagate,
)
from clplen.wave import (
    IncoherentLight,
    Lens,
    Pupil,
    RandomPhaseMask,
    Space,
    imaging_system,
)

LAM = 550e-9
N, DX = 64, 10e-6
GRID = Grid((N, N), DX)
FC = 13636.0  # D/(2 lam z2) of D = 3.6 mm at 240 mm
PUPIL = OpticalSystem([Pupil.of_cutoff(FC, LAM)])


def bars(device, grid=GRID):
    """Bright bars of different lengths off the middle: asymmetric along both axes."""
    t = np.zeros(grid.shape)
    ny, nx = grid.shape
    t[ny // 8 : ny // 2, nx // 6 : nx // 6 + 5] = 1
    t[ny // 2 : ny // 2 + 4, nx // 3 : nx - 9] = 0.7
    return Field.from_array(t, grid, wavelength=LAM, device=device)


def image(result):
    return result.to_numpy().astype(float)


def distance(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@pytest.mark.thorough
def test_snapshots_converge_to_the_sum_over_the_source(device):
    for iota in [0.56, 1.1, 2.2]:
        for kernel in ["square", "gaussian"]:
            cells = {0.56: 8, 1.1: 16, 2.2: 32}[iota]
            light = Coherence(RandomPhaseMask(N * DX / cells, kernel=kernel), seed=6)
            thing = bars(device)
            exact = PUPIL(thing, coherence=light)
            assert exact.method == "abbe"
            assert not exact.standard_error.to_numpy().any()
            for snapshots in (100, 400):
                found = PUPIL(thing, coherence=light, snapshots=snapshots, method="monte-carlo")
                assert distance(image(found), image(exact)) <= 1.5 / math.sqrt(snapshots)


@pytest.mark.thorough
def test_the_limits(device):
    thing = bars(device)
    coherent = PUPIL(thing, coherence=Coherence())
    assert coherent.method == "coherent"
    assert coherent.snapshots == 1
    assert distance(image(coherent), np.abs(PUPIL(thing).to_numpy()) ** 2) < 1e-5
    incoherent = PUPIL(thing, coherence=Coherence(IncoherentLight()))
    assert incoherent.method == "incoherent"
    many = PUPIL(thing, coherence=Coherence(IncoherentLight()), snapshots=400, method="monte-carlo")
    assert many.method == "monte-carlo"
    assert distance(image(many), image(incoherent)) <= 1.5 / 20
    wide, narrow = (
        image(PUPIL(thing, coherence=Coherence(RandomPhaseMask(N * DX / n)), method="abbe"))
        for n in (2, 32)
    )
    assert distance(wide, image(coherent)) < 0.1 < distance(narrow / narrow.max(), wide)


def test_auto_takes_snapshots_for_what_varies_across_the_field(device):
    grid = Grid((64, 64), 20e-6)
    system = imaging_system(0.12, diameter=1e-3, koehler=True)
    result = system(bars(device, grid), coherence=Coherence(RandomPhaseMask(160e-6)), snapshots=3)
    assert result.method == "monte-carlo"
    assert result.snapshots == 3
    with pytest.raises(SamplingError, match="method='monte-carlo'"):
        system(bars(device, grid), coherence=Coherence(RandomPhaseMask(160e-6)), method="abbe")


def test_free_space_periodic_is_summed_exactly(device):
    light, thing = Coherence(RandomPhaseMask(80e-6), seed=1), bars(device)
    space = Space(5e-3, method="as", pad=1)
    exact = light.average(space, thing)
    assert exact.method == "abbe"
    found = light.average(space, thing, snapshots=400, method="monte-carlo")
    assert distance(image(found), image(exact)) <= 1.5 / 20


def test_propagate_takes_coherence(device):
    light, thing = Coherence(RandomPhaseMask(80e-6), seed=1), bars(device)
    result = propagate(thing, 5e-3, coherence=light, snapshots=4)
    same = light.average(Space(5e-3), thing, snapshots=4)
    assert np.array_equal(image(result), image(same))


def test_wavelengths_add_their_intensities(device):
    thing, system = bars(device), OpticalSystem([Space(20e-3)])
    lines = Spectrum.lines([500e-9, 620e-9], [1, 3])
    result = image(system(thing, coherence=Coherence(None, lines)))
    expected = 0
    for lam, share in ((500e-9, 0.25), (620e-9, 0.75)):
        field = Field.from_array(thing.to_numpy(), GRID, wavelength=lam, device=device)
        expected = expected + share * np.abs(system(field).to_numpy().astype(complex)) ** 2
    assert distance(result, expected) < 1e-5


def test_an_object_may_depend_on_the_wavelength(device):
    lines = Spectrum.lines([500e-9, 620e-9], [1, 1])

    def thing(wavelength):
        t = np.full(GRID.shape, 1.0 if wavelength < 550e-9 else 0.5)
        return Field.from_array(t, GRID, wavelength=wavelength, device=device)

    result = image(PUPIL(thing, coherence=Coherence(None, lines)))
    assert np.allclose(result, (1 + 0.25) / 2, rtol=1e-5)


def test_wavelengths_of_a_mask_are_independent(device):
    one = Field.from_array(np.ones(GRID.shape), GRID, wavelength=LAM, device=device)
    mask = RandomPhaseMask(20e-6)
    contrast = {}
    for name, spectrum in (
        ("one", None),
        ("four", Spectrum.lines([5e-7, 5.3e-7, 5.6e-7, 6e-7], [1] * 4)),
    ):
        found = PUPIL(one, coherence=Coherence(mask, spectrum), snapshots=25, method="monte-carlo")
        contrast[name] = image(found).std() / image(found).mean()
    assert contrast["four"] == pytest.approx(contrast["one"] / 2, rel=0.25)


# Bad input ---------------------------------------------------------------------------------------


def test_a_source_that_misses_the_pupil_is_refused(device):
    grid = Grid((128, 128), 40e-6)
    one = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    light = Coherence(RandomPhaseMask(640e-6))
    with pytest.raises(
        SamplingError, match=r"spreads by 429.* um only: it misses the pupil.*koehler"
    ):
        imaging_system(0.25, diameter=3e-3)(one, coherence=light)
    lit = imaging_system(0.25, diameter=3e-3, koehler=True)(one, coherence=light, snapshots=2)
    assert lit.snapshots == 2


def test_bad_input(device):
    thing, mask, spectrum = (
        bars(device),
        RandomPhaseMask(40e-6),
        Spectrum.lines([5e-7, 6e-7], [1, 3]),
    )
    batch = Field.from_array(np.ones((2, N, N)), GRID, wavelength=LAM, device=device)
    light, still = Coherence(mask), Coherence(RandomPhaseMask(40e-6, jitter=False))
    fine, outside = Coherence(RandomPhaseMask(15e-6)), (slice(70, 80), slice(3))
    assert PUPIL(thing, coherence=still, snapshots=2).method == "monte-carlo"

    def two(field):
        return propagate(field, [1e-3, 2e-3])

    for call, error, words in [
        (lambda: PUPIL(thing, snapshots=3), TypeError, "snapshots require coherence="),
        (lambda: propagate(thing, 1e-3, snapshots=3), TypeError, "snapshots"),
        (lambda: PUPIL(thing, coherence=mask), TypeError, "coherence must be a Coherence"),
        (
            lambda: propagate(thing, 1e-3, coherence="led"),
            TypeError,
            "coherence must be a Coherence",
        ),
        (lambda: PUPIL(batch, coherence=light), ShapeError, "a single object"),
        (lambda: Coherence().average(two, thing), ShapeError, r"batch of shape \(2, 64, 64\)"),
        (lambda: light.average(two, thing, snapshots=2), ShapeError, "batch of shape"),
        (lambda: PUPIL(thing, coherence=still, method="abbe"), ValueError, "jitter=True"),
        (
            lambda: PUPIL(thing, coherence=Coherence(), region=outside),
            ValueError,
            "must contain pixels",
        ),
        (lambda: PUPIL(thing, coherence=light, region=outside), ValueError, "must contain pixels"),
        (
            lambda: Coherence(None, spectrum).average(Space(0.1, method="fresnel-1fft"), thing),
            ShapeError,
            "image grid must be equal at all wavelengths",
        ),
        (lambda: Coherence("speckle"), TypeError, "spatial must be a RandomPhaseMask"),
        (lambda: Coherence(None, 550e-9), TypeError, "spectrum must be a Spectrum"),
        (lambda: Coherence(wavelengths=0), ValueError, "wavelengths must be an integer"),
        (lambda: Coherence(seed=2**64), ValueError, "seed"),
        (
            lambda: PUPIL(thing, coherence=light, method="exact"),
            ValueError,
            "auto, monte-carlo, abbe",
        ),
        (
            lambda: fine.snapshots(GRID, wavelength=LAM, device=device),
            SamplingError,
            "integer number|fewer than",
        ),
        (
            lambda: Coherence.plan(OpticalSystem([0.1]), snr=5, grid=GRID, wavelength=LAM),
            ValueError,
            "begins with free space and a lens",
        ),
    ]:
        with pytest.raises(error, match=words):
            call()


def test_snapshots_of_a_spectrum_are_of_its_centre(device):
    light = Coherence(RandomPhaseMask(40e-6), Spectrum.gaussian(500e-9, 10e-9))
    assert next(light.snapshots(GRID, device=device)).wavelength == pytest.approx(500e-9)
    with pytest.raises(ValueError, match="require wavelength="):
        Coherence(RandomPhaseMask(40e-6)).snapshots(GRID, device=device)


def test_light_is_checked_at_both_ends_of_a_spectrum(device):
    lines = Spectrum.lines([450e-9, 650e-9], [1, 1])
    short = RandomPhaseMask(40e-6, distance=4 * 40e-6**2 / 650e-9)
    with pytest.warns(SamplingWarning, match="14.2222 mm"):
        PUPIL(bars(device), coherence=Coherence(short, lines), snapshots=1, method="monte-carlo")


def test_snapshots_go_on_from_any_number(device):
    light = Coherence(RandomPhaseMask(20e-6), seed=3)
    first = list(light.snapshots(GRID, wavelength=LAM, device=device, count=4))
    third = next(light.snapshots(GRID, wavelength=LAM, device=device, start=2))
    assert np.array_equal(first[2].to_numpy(), third.to_numpy())


# Planning ----------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_plan_predicts_the_clear_field(device):
    for kind in ["field", "phase"]:
        for iota in [0.14, 0.56, 2.0]:
            grid = Grid((192, 192), 10e-6)
            plan = Coherence.plan(PUPIL, snr=8, grid=grid, wavelength=LAM, iota=iota, kind=kind)
            assert plan.snr >= 8
            one = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
            values = []
            for seed in range(3):
                light = Coherence(plan.coherence.spatial, seed=seed)
                found = image(
                    PUPIL(one, coherence=light, snapshots=plan.snapshots, method="monte-carlo")
                )
                values.append((found.std() / found.mean()) ** 2)
            assert 1 / math.sqrt(np.mean(values)) == pytest.approx(plan.snr, rel=0.15)


def test_the_plan_along_one_axis(device):
    for kind in ["field", "phase"]:
        grid = Grid((1, 6000), 10e-6)
        plan = Coherence.plan(PUPIL, snr=5, grid=grid, wavelength=LAM, iota=0.5, kind=kind)
        one = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
        light = plan.coherence
        found = image(PUPIL(one, coherence=light, snapshots=plan.snapshots, method="monte-carlo"))
        assert found.mean() / found.std() == pytest.approx(plan.snr, rel=0.15)


def test_the_plan_counts_wavelengths():
    grid = Grid((256, 256), 10e-6)
    one = Coherence.plan(PUPIL, snr=20, grid=grid, wavelength=LAM)
    lines = Spectrum.lines([5e-7, 5.2e-7, 5.4e-7, 5.6e-7], [1, 1, 1, 1])
    four = Coherence.plan(PUPIL, snr=20, grid=grid, spectrum=lines)
    assert four.wavelengths == 4
    assert four.snapshots == pytest.approx(one.snapshots / 4, rel=0.1)
    assert "predicted SNR" in str(four)
    assert four.distance == pytest.approx(4 * four.cell**2 / 5e-7)


def test_the_plan_of_a_lens_is_that_of_its_pupil():
    grid = Grid((256, 256), 10e-6)
    lens = OpticalSystem([0.24, Lens(0.12, diameter=3.6e-3), 0.24])
    a = Coherence.plan(lens, snr=10, grid=grid, wavelength=LAM)
    b = Coherence.plan(OpticalSystem([Pupil(3.6e-3, 0.24)]), snr=10, grid=grid, wavelength=LAM)
    assert a == b


def test_bad_plans():
    for options, words in [
        ({"snr": 0}, "snr must be positive"),
        ({"snr": 5, "iota": 50}, "iota"),
        ({"snr": 5, "kind": "both"}, "'field' or 'phase'"),
        ({"snr": "high"}, "snr must be positive"),
        ({"snr": 5, "wavelength": -1.0}, "wavelength"),
        ({"snr": 5, "wavelength": 550.0}, "wavelength"),
        ({"snr": 5, "grid": None}, "requires grid="),
        ({"snr": 5, "wavelength": None}, "requires wavelength="),
    ]:
        known = {"grid": GRID, "wavelength": LAM, **options}
        with pytest.raises(ValueError, match=words):
            Coherence.plan(PUPIL, **known)


def test_the_grid_of_the_last_part_counts(device):
    small = Grid((32, 32), DX)
    system = OpticalSystem([Pupil.of_cutoff(FC, LAM), Space(0, out_grid=small)])
    light = Coherence(RandomPhaseMask(40e-6))
    assert system(bars(device), coherence=light, snapshots=2).method == "monte-carlo"
