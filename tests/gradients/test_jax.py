"""Linear maps and steps in programs of JAX: against explicit matrices, in jit, vmap and grad."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from linear_maps import Broken, Copied, Dense, Fourier, matrix

import clplen
from clplen.compute.device import Device

jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
import jax.numpy as jnp  # noqa: E402

import clplen.jax as gradients  # noqa: E402


@pytest.fixture
def double() -> Iterator[None]:
    """JAX in double precision."""
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def numbers(*shape: int, dtype: Any = np.complex64) -> np.ndarray:
    return matrix(1, int(np.prod(shape)), dtype).reshape(shape)


def close(a: Any, b: Any) -> bool:
    wide = np.asarray(a).dtype in (np.float64, np.complex128)
    return np.allclose(a, b, rtol=1e-11 if wide else 1e-4, atol=1e-11 if wide else 1e-4)


@pytest.mark.parametrize(
    ("dtype", "lead"), [(np.float32, (2,)), (np.complex64, ()), (np.complex64, (2, 3))]
)
def test_a_map_and_its_gradient_are_those_of_its_matrix(device, dtype, lead) -> None:
    A = matrix(5, 3, dtype)
    x, ct = numbers(*lead, 3, dtype=dtype), numbers(*lead, 5, dtype=dtype) + dtype(0.5)
    for adjoint, M in ((False, A), (True, A.conj().T)):
        given, back = (x, ct) if not adjoint else (ct, x)

        def function(x: Any, adjoint: bool = adjoint) -> Any:
            return gradients.apply(Dense(A, device), x, adjoint=adjoint)

        found, pull = jax.vjp(function, given)
        known, pull_known = jax.vjp(lambda x, M=M: x @ M.T, given)
        assert found.dtype == known.dtype
        assert close(found, known)
        assert close(pull(jnp.asarray(back))[0], pull_known(jnp.asarray(back))[0])


def test_double_precision(precise, double) -> None:
    operator = Fourier((7, 5), precise)
    x, ct = numbers(2, 7, 5, dtype=complex), numbers(2, 7, 5, dtype=complex) + 0.5
    found, pull = jax.vjp(lambda x: gradients.apply(operator, x), x)
    known, pull_known = jax.vjp(jnp.fft.fft2, jnp.asarray(x))
    assert found.dtype == np.complex128
    assert close(found, known)
    assert close(pull(jnp.asarray(ct))[0], pull_known(jnp.asarray(ct))[0])
    real = jax.grad(lambda x: jnp.sum(jnp.abs(gradients.apply(operator, x)) ** 2))(x.real)
    assert real.dtype == np.float64
    assert close(real, 2 * 35 * x.real)


def test_double_precision_has_to_be_on(precise) -> None:
    with pytest.raises(TypeError, match=r"complex128, got complex64: set .*jax_enable_x64"):
        gradients.apply(Fourier((3, 4), precise), jnp.ones((3, 4), np.complex64))


def test_jit_vmap_and_gradients_of_gradients(device) -> None:
    operator = Dense(matrix(5, 3, np.float32), device)
    A = jnp.asarray(operator.matrix)
    x = numbers(4, 3, dtype=np.float32)

    def loss(x: Any) -> Any:
        return jnp.sum(gradients.apply(operator, x) ** 2)

    def known(x: Any) -> Any:
        return jnp.sum((A @ x) ** 2)

    assert close(jax.jit(loss)(x[0]), known(x[0]))
    assert close(jax.jit(jax.vmap(loss))(x), jax.vmap(known)(x))
    assert close(jax.jit(jax.vmap(jax.grad(loss)))(x), jax.vmap(jax.grad(known))(x))
    assert close(jax.jacrev(jax.grad(loss))(x[0]), 2 * A.T @ A)
    columns = jax.vmap(lambda x: gradients.apply(operator, x), in_axes=1, out_axes=1)(x.T)
    assert close(columns, A @ x.T)


def test_a_map_is_compiled_once(device) -> None:
    operator, traced = Copied((3,), np.float32, device), []

    @jax.jit
    def function(x: Any) -> Any:
        traced.append(x)
        return gradients.apply(operator, x) + gradients.apply(operator, 2 * x)

    for value in range(3):
        assert function(jnp.full(3, float(value))).tolist() == [3 * value] * 3
    assert len(traced) == 1
    assert gradients.apply(operator, np.ones((0, 3), np.float32)).shape == (0, 3)


@pytest.mark.parametrize("size", [1023, 2**19])
def test_copies_are_few(device, copies, size) -> None:
    operator = Copied((size,), np.float32, device)
    x = jnp.arange(size, dtype=np.float32)
    once = 0 if device.is_cpu else 1
    with copies(4 * size) as count:
        y = jax.block_until_ready(gradients.apply(operator, x))
    assert count == {"up": once, "down": once}
    assert (y == x).all()


def test_one_sentence_for_each_mistake(device) -> None:
    operator = Copied((5,), np.float32, device)
    with pytest.raises(clplen.ShapeError, match=r"shape \(\.\.\., 5\), got \(5, 3\)"):
        gradients.apply(operator, jnp.ones((5, 3)))
    with pytest.raises(TypeError, match=r"of float32, got float16: pass x.astype\('float32'\)"):
        jax.jit(lambda x: gradients.apply(operator, x))(jnp.ones(5, jnp.float16))
    with pytest.raises(TypeError, match=r"of float32, got bfloat16"):
        gradients.apply(operator, jnp.ones(5, jnp.bfloat16))
    with pytest.raises(TypeError, match=r"linear map with an adjoint"):
        gradients.apply(3, jnp.ones(5))


@pytest.mark.parametrize("size", [5, 40_001])
def test_numbers_that_are_not_finite_are_named_where_they_arise(device, size, caplog) -> None:
    broken = Broken((size,), np.float32, device)
    with pytest.raises(Exception, match=r"The input of <Broken> has [\d,]+ values"):
        jax.block_until_ready(gradients.apply(broken, jnp.full(size, jnp.nan)))
    loss = jax.grad(lambda x: gradients.apply(broken, x).sum())
    with pytest.raises(Exception, match=r"gradient through <Broken> has 1 value that is"):
        jax.block_until_ready(loss(jnp.ones(size)))


def test_one_core_is_warned_of(device, monkeypatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0}, raising=False)
    operator = Copied((5,), np.float32, device)
    with pytest.warns(RuntimeWarning, match=r"On one core .*jax_cpu_enable_async_dispatch") as seen:
        gradients.apply(operator, jnp.ones(5))
    assert seen[0].filename == __file__


def square(x: Any, scale: Any, device: Device) -> Any:
    """scale |x|^2 as a step."""
    return gradients.apply_step(
        squared(device),
        x,
        parameters=[scale],
        out=jax.ShapeDtypeStruct(x.shape, device.real),
        device=device,
        name="square",
    )


def squared(device: Device) -> Any:
    def forward(u: Any, a: np.ndarray) -> Any:
        values = device.download(u)
        out = (a * np.abs(values) ** 2).astype(device.real)

        def pullback(g: Any) -> Any:
            back = device.download(g)
            grad = (2 * a * back * values).astype(values.dtype)
            return device.upload(grad), np.sum(back * np.abs(values) ** 2, dtype=np.float64)

        return device.upload(out), pullback

    return forward


def test_gradients_of_a_step_are_those_of_jax(device) -> None:
    x, scale = jnp.asarray(numbers(4, 3)), jnp.float32(0.7)

    def known(x: Any, scale: Any) -> Any:
        return scale * jnp.abs(x) ** 2

    ct = jnp.asarray(numbers(4, 3, dtype=np.float32))
    found, pull = jax.vjp(lambda x, s: square(x, s, device), x, scale)
    wanted, pull_known = jax.vjp(known, x, scale)
    assert close(found, wanted)
    for a, b in zip(pull(ct), pull_known(ct), strict=True):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert close(a, b)
    rows = jax.jit(jax.vmap(jax.grad(lambda x, s: square(x, s, device).sum()), (0, None)))
    assert close(rows(x, scale), jax.vmap(jax.grad(lambda x: known(x, scale).sum()))(x))


def test_a_complex_step_has_conjugate_cotangents(device) -> None:
    A = Dense(matrix(5, 3, np.complex64), device)

    def forward(u: Any) -> Any:
        return A.forward_data(u), lambda g: [A.adjoint_data(g)]

    x, ct = numbers(3), jnp.asarray(numbers(5) + 1j)
    shape = jax.ShapeDtypeStruct((5,), np.complex64)
    _, pull = jax.vjp(lambda x: gradients.apply_step(forward, x, out=shape, device=device), x)
    assert close(pull(ct)[0], A.matrix.T @ ct)


def test_an_input_without_gradient(device) -> None:
    def fixed(u: Any, a: np.ndarray) -> Any:
        return device.upload(device.download(u) * np.float32(a)), lambda g: (g, None)

    def loss(x: Any, a: Any) -> Any:
        shape = jax.ShapeDtypeStruct((5,), np.float32)
        return gradients.apply_step(fixed, x, parameters=[a], out=shape, device=device).sum()

    x = jnp.ones(5)
    assert jax.grad(loss)(x, 2.0).tolist() == [1] * 5
    with pytest.raises(Exception, match=r"fixed has no gradient of its input 2, of shape \(\): "):
        jax.block_until_ready(jax.grad(loss, 1)(x, 2.0))
    with pytest.raises(TypeError, match=r"takes real parameters, got complex64"):
        loss(x, jnp.complex64(1))
