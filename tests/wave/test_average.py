"""Averages of snapshots: their error, when they stop, and how they survive an interruption."""

import math

import numpy as np
import pytest

from clplen import (
    Coherence,
    Field,
    FormatError,
    Grid,
    OpticalSystem,
    SamplingWarning,
    Spectrum,
)
from clplen.wave import RandomPhaseMask, Space
from clplen.wave.coherence import averaging as module

LAM = 550e-9
GRID = Grid((48, 60), (4e-6, 3e-6))
MASK = RandomPhaseMask((16e-6, 18e-6))
SYSTEM = OpticalSystem([Space(1e-3, method="as", pad=1)])


def clear(device, grid=GRID):
    rng = np.random.default_rng(5)
    t = 0.5 + 0.5 * rng.random(grid.shape)
    return Field.from_array(t, grid, wavelength=LAM, device=device)


def run(device, *, seed=0, **how):
    light = Coherence(MASK, seed=seed)
    return light.average(SYSTEM, clear(device), method="monte-carlo", **how)


def test_mean_and_error_are_those_of_the_snapshots(device):
    light, thing = Coherence(MASK, seed=2), clear(device)
    intensities = []
    for field in light.snapshots(GRID, wavelength=LAM, device=device, count=9):
        lit = field.to_numpy() * thing.to_numpy()
        behind = SYSTEM(Field.from_array(lit, GRID, wavelength=LAM, device=device))
        intensities.append(np.abs(behind.to_numpy().astype(complex)) ** 2)
    result = run(device, seed=2, snapshots=9)
    assert result.snapshots == 9
    assert np.allclose(result.to_numpy(), np.mean(intensities, 0), rtol=1e-4, atol=1e-5)
    error = np.std(intensities, 0, ddof=1) / 3
    assert np.allclose(result.standard_error.to_numpy(), error, rtol=1e-3, atol=1e-5)
    expected = math.sqrt((error**2).mean()) / np.mean(intensities)
    assert result.convergence[-1] == pytest.approx([9, expected], rel=1e-4)
    assert [int(k) for k, _ in result.convergence] == list(range(2, 10))


@pytest.mark.thorough
def test_reported_error_is_the_scatter_of_independent_runs(device):
    region = (slice(5, 40), slice(10, 50))
    results = [run(device, seed=seed, snapshots=40, region=region) for seed in range(20)]
    scatter = np.std([r.to_numpy() for r in results], axis=0, ddof=1)[region]
    reported = np.array([r.standard_error.to_numpy()[region] for r in results])
    ratio = math.sqrt((reported**2).mean()) / math.sqrt((scatter**2).mean())
    assert 0.8 <= ratio <= 1.25


def test_a_tolerance_stops_it(device):
    region = (slice(10, 30), slice(20, 40))
    result = run(device, rtol=0.15, region=region)
    assert 30 < result.snapshots < 70  # speckle of contrast .95: (.95/.15)^2 = 40
    assert result.relative_error <= 0.15
    assert (result.convergence[14:-1, 1] > 0.15).all()  # from 16 snapshots on
    assert run(device, rtol=10.0).snapshots == module.MIN_RTOL_SNAPSHOTS


def test_a_tolerance_that_is_not_reached_is_said(device):
    with pytest.warns(SamplingWarning, match="After 20 snapshots .* above rtol=0.01"):
        result = run(device, rtol=0.01, snapshots=20)
    assert result.snapshots == 20


def test_points_of_the_curve_thin_out(device):
    result = run(device, snapshots=137)
    steps = [int(k) for k, _ in result.convergence]
    octaves = [*range(2, 16), *range(16, 32, 2), *range(32, 64, 4), *range(64, 128, 8)]
    assert steps == [*octaves, 128, 137]


def test_a_tolerance_in_the_dark_is_refused(device):
    thing = Field.from_array(np.zeros(GRID.shape), GRID, wavelength=LAM, device=device)
    with pytest.raises(ValueError, match="image is dark after 16 snapshots"):
        Coherence(MASK).average(SYSTEM, thing, rtol=0.1, method="monte-carlo")


# Checkpoints ------------------------------------------------------------------------------------


def same(a, b):
    return (
        np.array_equal(a.to_numpy(), b.to_numpy())
        and np.array_equal(a.standard_error.to_numpy(), b.standard_error.to_numpy())
        and np.array_equal(a.convergence, b.convergence)
        and a.snapshots == b.snapshots
    )


def test_a_resumed_run_has_the_same_bits(device, tmp_path):
    file = tmp_path / "run.npz"
    run(device, snapshots=7, checkpoint=file)
    assert same(run(device, snapshots=23, checkpoint=file), run(device, snapshots=23))


def test_an_interrupted_run_goes_on_from_what_it_saved(device, tmp_path, monkeypatch):
    file, steps = tmp_path / "run.npz", []

    def stop(done, most):
        if done == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(module, "SAVE_SECONDS", 0.0)
    with pytest.raises(KeyboardInterrupt):
        run(device, snapshots=9, checkpoint=file, progress=stop)
    again = run(device, snapshots=9, checkpoint=file, progress=lambda *step: steps.append(step))
    assert steps[0] == (5, 9)  # four were saved
    assert same(again, run(device, snapshots=9))


def test_a_finished_run_is_not_done_again(device, tmp_path):
    file, seen, steps = tmp_path / "run.npz", [], []
    first = run(device, snapshots=7, checkpoint=file, progress=lambda *step: steps.append(step))
    assert steps == [(n, 7) for n in range(1, 8)]
    again = run(device, snapshots=7, checkpoint=file, progress=lambda *_: seen.append(1))
    assert same(first, again)
    assert not seen
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_a_checkpoint_of_another_set_up_is_refused(device, tmp_path):
    for change, words in [
        ({"seed": 4}, r"its seed is 0, this run's is 4"),
        ({"region": (slice(3), slice(3))}, r"its region is .*y1=48.*this run's is .*y1=3"),
        ({"mask": RandomPhaseMask((16e-6, 20e-6))}, r"its spatial model is .*1.8e-05"),
        ({"spectrum": Spectrum.lines([5e-7, 6e-7], [1, 1])}, r"its spectrum is None"),
        ({"grid": Grid((48, 60), (4e-6, 6e-6))}, r"its grid is .*3e-06"),
        ({"scale": 0.5}, r"its object is"),
        (
            {"label": "two lenses"},
            r"its label is a lens, this run's is two lenses\. Choose another",
        ),
    ]:
        file = tmp_path / "run.npz"
        run(device, snapshots=3, checkpoint=(file, "a lens"))
        before = file.read_bytes()
        light = Coherence(
            change.get("mask", MASK), change.get("spectrum"), seed=change.get("seed", 0)
        )
        thing = clear(device, change.get("grid", GRID))
        if "scale" in change:
            values = change["scale"] * thing.to_numpy()
            thing = Field.from_array(values, GRID, wavelength=LAM, device=device)
        with pytest.raises(FormatError, match=words):
            light.average(
                SYSTEM, thing, snapshots=5, checkpoint=(file, change.get("label", "a lens")),
                region=change.get("region"), method="monte-carlo",
            )  # fmt: skip
        assert file.read_bytes() == before


def truncated(good):
    return good[: len(good) // 2]


def flipped(good):
    place = good.find(b"m2.npy") + 500  # in the middle of numbers
    return good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :]


def test_a_damaged_checkpoint_is_refused(device, tmp_path):
    file = tmp_path / "run.npz"
    run(device, snapshots=3, checkpoint=file)
    whole = file.read_bytes()
    for damaged in (truncated(whole), flipped(whole), b"", b"PK"):
        file.write_bytes(damaged)
        with pytest.raises(FormatError, match=r"run.npz is damaged or not a checkpoint"):
            run(device, snapshots=5, checkpoint=file)
    np.savez(file, mean=np.ones(3))
    with pytest.raises(FormatError, match=r"damaged or not a checkpoint"):
        run(device, snapshots=5, checkpoint=file)
    with pytest.raises(FileNotFoundError, match=r"the folder .* does not exist"):
        run(device, snapshots=5, checkpoint=tmp_path / "no" / "run.npz")


def test_bad_numbers(device):
    for how in ({"snapshots": 0}, {"snapshots": 2.5}, {"rtol": 0}, {"rtol": math.nan}):
        with pytest.raises(ValueError, match=r"snapshots must be|rtol"):
            run(device, **how)


def test_any_amplitude(device):
    for size in [1e-12, 1e10]:
        values = size * clear(device).to_numpy().astype(complex)
        thing = Field.from_array(values, GRID, wavelength=LAM, device=device)
        scaled = Coherence(MASK).average(SYSTEM, thing, snapshots=9, method="monte-carlo")
        plain = run(device, snapshots=9)
        assert scaled.relative_error == pytest.approx(plain.relative_error, rel=1e-3)
        errors = scaled.standard_error.to_numpy().astype(float) / size**2
        assert np.allclose(errors, plain.standard_error.to_numpy(), rtol=1e-3, atol=1e-5)
