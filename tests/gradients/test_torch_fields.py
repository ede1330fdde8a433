"""Propagations and systems in graphs of PyTorch and JAX."""

from __future__ import annotations

import numpy as np
import pytest

import clplen
from clplen.wave import Lens, Space

pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")

LAM = 500e-9
GRID = clplen.Grid((11, 14), (4e-6, 5e-6))


def waves(*shape):
    rng = np.random.default_rng(1)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("method", ["as", "rs", "cblas"])
def test_gradients_of_propagate_in_torch(precise, method) -> None:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    import clplen.torch as gradients

    x = torch.from_numpy(waves(2, 11, 14)).requires_grad_()
    z = torch.tensor(2e-3, dtype=torch.float64, requires_grad=True)

    def light(x, z):
        u = gradients.propagate(x, z, GRID, wavelength=LAM, method=method, device=precise)
        return u.abs() ** 2

    expected = (
        clplen.propagate(
            clplen.Field.from_array(x.detach(), GRID, wavelength=LAM, device=precise),
            2e-3,
            method=method,
        )
        .intensity()
        .to_numpy()
    )
    np.testing.assert_allclose(light(x, z).detach().numpy(), expected, rtol=1e-10)
    assert torch.autograd.gradcheck(lambda x: light(x, 2e-3), x, fast_mode=True)
    weights = torch.linspace(0, 1, 14, dtype=torch.float64)
    (weights * light(x, z)).sum().backward()
    (above, below) = (
        float((weights * light(x.detach(), z.detach() + h)).sum()) for h in (1e-7, -1e-7)
    )
    assert float(z.grad) == pytest.approx((above - below) / 2e-7, rel=1e-6)


def test_a_system_is_an_operator_of_torch(precise) -> None:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    import clplen.torch as gradients

    system = clplen.OpticalSystem([Space(1e-3), Lens(0.01), Space(2e-3)])
    operator = system.operator(GRID, wavelength=LAM, device=precise)
    x = torch.from_numpy(waves(3, 11, 14)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: gradients.apply(operator, x), x, fast_mode=True)


def test_gradients_of_propagate_in_jax(precise) -> None:
    jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    import clplen.jax as gradients

    with jax.enable_x64():
        x, weights = jax.numpy.asarray(waves(11, 14)), np.linspace(0, 1, 14)

        def light(z):
            u = gradients.propagate(x, z, GRID, wavelength=LAM, device=precise)
            return (weights * abs(u) ** 2).sum()

        z = jax.numpy.float64(2e-3)
        found = jax.jit(jax.grad(light))(z)
        expected = (light(z + 1e-7) - light(z - 1e-7)) / 2e-7
        assert float(found) == pytest.approx(float(expected), rel=1e-6)
