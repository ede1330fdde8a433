"""Gradients through the mean intensity of partially coherent light, against differences."""

from __future__ import annotations

import numpy as np
import pytest

import clplen
from clplen.wave import IncoherentLight, Lens, Pupil, RandomPhaseMask, Space

LAM = 500e-9
GRID = clplen.Grid((15, 26), (8e-6, 5e-6))
IMAGING = clplen.OpticalSystem([Space(2e-3), Lens(0.01), Space(3e-3)])
FILTER = clplen.OpticalSystem([Pupil(4e-3, 0.05)])
SPECTRUM = clplen.Spectrum.gaussian(LAM, 20e-9)
MASK = RandomPhaseMask((24e-6, 26e-6))


def check_gradient_by_the_object_against_differences(precise, light, system, method):
    rng = np.random.default_rng(1)
    t = rng.normal(size=GRID.shape) + 1j * rng.normal(size=GRID.shape)
    target = rng.random(GRID.shape)

    def mean(values):
        field = clplen.Field.from_array(values, GRID, wavelength=LAM, device=precise)
        return light.vjp(system, field, snapshots=3)

    image, pullback = mean(t)
    assert image.method == pullback.method == method
    plain = light.average(
        system, clplen.Field.from_array(t, GRID, wavelength=LAM, device=precise), snapshots=3
    )
    np.testing.assert_array_equal(image.to_numpy(), plain.to_numpy())
    gradient = pullback(2 * (image.to_numpy() - target)).field.to_numpy()
    direction = rng.normal(size=GRID.shape) + 1j * rng.normal(size=GRID.shape)
    h = 1e-4
    losses = [
        ((mean(t + a * h * direction)[0].to_numpy() - target) ** 2).sum() for a in (2, 1, -1, -2)
    ]
    expected = (8 * (losses[1] - losses[2]) - (losses[0] - losses[3])) / (12 * h)
    assert (np.conj(gradient) * direction).sum().real == pytest.approx(expected, rel=1e-6)


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_gradient_by_the_object_against_differences(precise):
    for light, system, method in [
        (clplen.Coherence(MASK, SPECTRUM, wavelengths=2), IMAGING, "monte-carlo"),
        (clplen.Coherence(MASK), FILTER, "abbe"),
        (clplen.Coherence(IncoherentLight()), FILTER, "incoherent"),
        (clplen.Coherence(None, SPECTRUM, wavelengths=3), IMAGING, "coherent"),
    ]:
        check_gradient_by_the_object_against_differences(precise, light, system, method)


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_gradient_by_parameters_and_without_memory(precise, monkeypatch):
    rng = np.random.default_rng(2)
    t = rng.normal(size=GRID.shape) + 1j * rng.normal(size=GRID.shape)
    field = clplen.Field.from_array(t, GRID, wavelength=LAM, device=precise)
    light, weights = clplen.Coherence(MASK), rng.random(GRID.shape)

    def at(focal_length):
        system = clplen.OpticalSystem([Space(2e-3), Lens(focal_length), Space(3e-3, method="as")])
        return light.vjp(system, field, snapshots=3, parameters=[1])

    _, pullback = at(0.01)
    assert pullback.nbytes == 0  # with parameters fields are computed again
    gradient = pullback(weights)
    h = 1e-6
    expected = ((at(0.01 + h)[0].to_numpy() - at(0.01 - h)[0].to_numpy()) * weights).sum() / (2 * h)
    assert gradient.parameters[1]["focal_length"] == pytest.approx(expected, rel=1e-6)
    _, kept = light.vjp(IMAGING, field, snapshots=3)
    assert len(kept.fields) == 3
    assert kept.nbytes == 3 * 16 * 15 * 26
    np.testing.assert_allclose(
        kept(weights).field.to_numpy(),
        light.vjp(IMAGING, field, snapshots=3, parameters=[1])[1](weights).field.to_numpy(),
        rtol=1e-12,
    )
