"""Linear maps and steps in graphs of PyTorch: gradients, copies, lifetimes, one-sentence errors."""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
import pytest
from linear_maps import Broken, Copied, Dense, Fourier, matrix
from setups_microscope import any_projector

import clplen
from clplen.compute.device import Device
from clplen.compute.differentiation import name_of

torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
import clplen.torch as gradients  # noqa: E402
from clplen.torch.tensors import constant  # noqa: E402


def tensor(*shape: int, dtype: Any = torch.complex128, grad: bool = False) -> torch.Tensor:
    """Normal numbers."""
    generator = torch.Generator().manual_seed(sum(shape))
    x = torch.randn(*shape, dtype=dtype, generator=generator)
    return x.requires_grad_(grad)


def check_gradients_of_a_complex_map_are_those_of_differences(precise, shape, lead) -> None:
    operator = Fourier(shape, precise)
    x = tensor(*lead, *shape, grad=True)
    found = gradients.apply(operator, x)
    torch.testing.assert_close(found, torch.fft.fft2(x))
    assert torch.autograd.gradcheck(lambda x: gradients.apply(operator, x), x, fast_mode=True)


def test_gradients_of_a_complex_map_are_those_of_differences(precise) -> None:
    for shape, lead in [((4, 6), ()), ((7, 5), (2,)), ((1, 9), (3, 1)), ((11, 13), ())]:
        check_gradients_of_a_complex_map_are_those_of_differences(precise, shape, lead)


def test_gradients_of_a_matrix_of_any_order(precise) -> None:
    operator = Dense(matrix(5, 3, complex), precise)
    x = tensor(2, 3, grad=True)

    def function(x: torch.Tensor) -> torch.Tensor:
        return gradients.apply(operator, x).abs().square()

    assert torch.autograd.gradcheck(function, x)
    assert torch.autograd.gradgradcheck(function, x)
    y = tensor(4, 5, grad=True)
    assert torch.autograd.gradcheck(lambda y: gradients.apply(operator, y, adjoint=True), y)
    A = torch.from_numpy(operator.matrix)
    torch.testing.assert_close(gradients.apply(operator, y, adjoint=True), y @ A.conj())


def test_the_gradient_of_a_real_map_is_its_adjoint(device) -> None:
    operator = any_projector(device)
    x = tensor(3, *operator.in_shape, dtype=torch.float32, grad=True)
    frames = gradients.apply(operator, x)
    assert frames.dtype == torch.float32
    np.testing.assert_array_equal(frames.detach(), operator.forward(x.detach(), clamp=False))
    g = tensor(3, *operator.out_shape, dtype=torch.float32)
    frames.backward(g)
    np.testing.assert_array_equal(x.grad, operator.backward(g))
    a, b = (frames.double() * g.double()).sum(), (x.double() * x.grad.double()).sum()
    assert abs(a - b) <= 1e-5 * abs(frames.double() * g.double()).sum()


def test_a_real_tensor_goes_through_a_complex_map(precise) -> None:
    operator = Dense(matrix(4, 3, complex), precise)
    x = tensor(3, dtype=torch.float64, grad=True)
    assert torch.autograd.gradcheck(lambda x: gradients.apply(operator, x), x)
    gradients.apply(operator, x).abs().sum().backward()
    assert x.grad.dtype == torch.float64


def test_tensors_of_any_layout(precise) -> None:
    for made in [
        lambda x: x.mT,
        lambda x: x.conj().mT,
        lambda x: x.mT.contiguous().conj(),
        lambda x: x.flip(0).mT,
        lambda x: x.mT.expand(2, *x.mT.shape),
        lambda x: torch.view_as_complex(torch.view_as_real(x)).mT,
    ]:
        operator, x = Fourier((7, 5), precise), tensor(5, 7)
        torch.testing.assert_close(gradients.apply(operator, made(x)), torch.fft.fft2(made(x)))
        y = tensor(7, 5, grad=True)
        gradients.apply(operator, y).backward(made(x)[..., :7, :5].reshape(-1, 7, 5)[0])


# Forward mode of torch.func imports what PyTorch itself is about to leave behind.
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_forward_mode_and_vmap(precise) -> None:
    operator = Fourier((3, 5), precise)
    x, t = tensor(4, 3, 5), tensor(4, 3, 5) + 1

    def function(x: torch.Tensor) -> torch.Tensor:
        return gradients.apply(operator, x)

    torch.testing.assert_close(torch.func.jvp(function, (x,), (t,))[1], torch.fft.fft2(t))
    mapped = torch.func.vmap(function, in_dims=1)(x.movedim(0, 1))
    torch.testing.assert_close(mapped, torch.fft.fft2(x))
    grads = torch.func.vmap(torch.func.grad(lambda x: function(x).abs().square().sum()))(x)
    torch.testing.assert_close(grads, 2 * 15 * x)


@pytest.mark.parametrize("size", [1023, 2**21])
def test_nothing_is_copied_on_a_cpu_and_once_each_way_on_a_gpu(device, copies, size):
    operator = Copied((size,), np.float32, device)
    x = tensor(size, dtype=torch.float32, grad=True)
    once = 0 if device.is_cpu else 1
    with copies(4 * size) as count:
        y = gradients.apply(operator, x)
        assert count == {"up": once, "down": once}
        y.sum().backward()
        assert count == {"up": 2 * once, "down": 2 * once}
    assert not device.is_cpu or operator.made[0] == y.data_ptr()
    if "Portable Computing Language" in device.platform:
        assert operator.read[0] == x.data_ptr()
        assert operator.made[1] == x.grad.data_ptr()


def test_results_live_as_long_as_their_tensors(device) -> None:
    operator = Copied((2**20,), np.float32, device)
    kept = []
    for value in range(6):
        x = torch.full((2**20,), float(value))
        kept.append(gradients.apply(operator, x)[7:9])
        del x
    gc.collect()
    for value, part in enumerate(kept):
        assert part.tolist() == [value, value]


def test_a_graph_is_gone_through_twice_if_it_is_kept(device) -> None:
    operator = Copied((5,), np.float32, device)
    for function in (lambda x: gradients.apply(operator, x), lambda x: square(x, device)):
        x = tensor(5, dtype=torch.float32, grad=True)
        y = function(x).sum()
        y.backward(retain_graph=True)
        first = x.grad.clone()
        y.backward(retain_graph=True)
        torch.testing.assert_close(x.grad, 2 * first)
    y.backward()
    with pytest.raises(RuntimeError, match="second time"):
        y.backward()


def test_other_tensors_are_refused_in_one_sentence(device) -> None:
    for made, said in [
        (lambda x: x.half(), r"takes tensors of float32, got float16: pass x.to\(torch.float32\)"),
        (lambda x: x.double(), r"takes tensors of float32, got float64"),
        (lambda x: x.int(), r"got int32"),
        (lambda x: x.to("meta"), r"in host memory, got .* on meta: pass x.cpu\(\)"),
        (lambda x: x.to_sparse(), r"takes dense tensors, got torch.sparse_coo"),
        (lambda x: x.numpy(), r"takes tensors, got ndarray: convert it by"),
    ]:
        x = tensor(3, 5, dtype=torch.float32)
        operator = Copied((5,), np.float32, device)
        with pytest.raises(TypeError, match=said) as error:
            gradients.apply(operator, made(x))
        assert str(error.value).startswith(name_of(operator))
        with pytest.raises(
            TypeError, match=said.replace("float32, got", "float32 or complex64, got")
        ):
            square(made(x), device)


def test_other_shapes_and_operators_are_refused(device) -> None:
    with pytest.raises(clplen.ShapeError, match=r"shape \(\.\.\., 5\), got \(5, 3\)"):
        gradients.apply(Copied((5,), np.float32, device), torch.ones(5, 3))
    with pytest.raises(clplen.ShapeError, match=r"shape \(\.\.\., 5\), got \(\)"):
        gradients.apply(Copied((5,), np.float32, device), torch.tensor(1.0))
    with pytest.raises(TypeError, match=r"linear map with an adjoint.* got .*int"):
        gradients.apply(3, torch.ones(5))


def test_numbers_that_are_not_finite_are_named_where_they_arise(device) -> None:
    for size in [5, 40_001]:
        broken, copied = (kind((size,), np.float32, device) for kind in (Broken, Copied))
        x = torch.ones(size, requires_grad=True)
        with pytest.raises(
            ValueError, match=r"gradient through <Broken> has 1 value .*input is finite"
        ):
            gradients.apply(broken, x).sum().backward()
        with pytest.raises(ValueError, match=r"gradient passed to <Broken> has .* values that are"):
            (gradients.apply(broken, x).sum() * torch.inf).backward()
        with pytest.raises(ValueError, match=r"The input of .*Copied.* has [\d,]+ values"):
            gradients.apply(copied, x * torch.nan)
        gradients.apply(broken, x, check_finite=False).sum().backward()
        assert torch.isinf(x.grad[0])


# Steps with a pullback of their own.


def square(x: torch.Tensor, device: Device, scale: Any = 1.0, **options: Any) -> torch.Tensor:
    """scale |x|^2, whose pullback is (2 scale g x, sum g |x|^2)."""
    parameters = [torch.as_tensor(scale)] if not isinstance(scale, torch.Tensor) else [scale]

    def squared(u: Any, a: np.ndarray) -> Any:
        values = device.download(u)
        out = (a * np.abs(values) ** 2).astype(device.real)

        def pullback(g: Any) -> Any:
            back = device.download(g)
            grad = (2 * a * back * device.download(u)).astype(values.dtype)
            return device.upload(grad), np.sum(back * np.abs(values) ** 2, dtype=np.float64)

        return device.upload(out), pullback

    return gradients.apply_step(squared, x, parameters=parameters, device=device, **options)


def test_gradients_of_a_step_are_those_of_differences(precise) -> None:
    x = tensor(2, 3, grad=True)
    scale = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x, s: square(x, precise, s), (x, scale))
    assert torch.autograd.gradcheck(lambda x: square(x.real, precise), (x,))
    y = square(x.detach(), precise, scale)
    y.sum().backward()
    torch.testing.assert_close(scale.grad, x.detach().abs().square().sum())
    assert not square(x.detach(), precise).requires_grad


def test_parameters_of_any_shape_and_gradients_that_share_an_array(precise) -> None:
    device = precise

    def added(a: Any, b: Any, c: np.ndarray) -> Any:
        def pullback(g: Any) -> Any:
            twice = device.upload(2 * device.download(g))
            return twice, twice, device.download(g)[0, :2].real

        total = 2 * (device.download(a) + device.download(b))
        total[0, :2] += c
        return device.upload(total), pullback

    a, b = tensor(3, 4, grad=True), tensor(3, 4, grad=True)
    c = torch.tensor([0.3, 0.4], requires_grad=True)

    def function(a: Any, b: Any, c: Any) -> torch.Tensor:
        return gradients.apply_step(added, a, b, parameters=[c], device=device)

    assert torch.autograd.gradcheck(function, (a, b, c.detach().double().requires_grad_()))
    function(a, b, c).abs().sum().backward()
    assert a.grad.data_ptr() != b.grad.data_ptr()
    assert c.grad.dtype == torch.float32


def test_a_second_derivative_of_a_step_is_refused_in_one_sentence(device) -> None:
    x = tensor(5, dtype=torch.float32, grad=True)
    (grad,) = torch.autograd.grad(square(x, device, name="square").sum(), x, create_graph=True)
    torch.testing.assert_close(grad, 2 * x)
    with pytest.raises(RuntimeError, match=r"^square can be differentiated once, got"):
        grad.sum().backward()


def test_an_input_without_gradient_and_a_changed_one(device) -> None:
    def fixed(u: Any, a: np.ndarray) -> Any:
        return device.upload(device.download(u) * np.float32(a)), lambda g: (g, None)

    x, a = tensor(5, dtype=torch.float32, grad=True), torch.tensor(2.0)
    y = gradients.apply_step(fixed, x, parameters=[a], device=device)
    y.sum().backward()
    assert x.grad.tolist() == [1] * 5
    y = gradients.apply_step(fixed, x, parameters=[a.clone().requires_grad_()], device=device)
    with pytest.raises(ValueError, match=r"^fixed has no gradient of its input 2, of shape \(\): "):
        y.sum().backward()
    leaf = tensor(5, dtype=torch.float32)
    z = (leaf * 1).requires_grad_()
    y = square(z * 1, device)
    inner = z * 1
    y = square(inner, device)
    inner += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        y.sum().backward()
    assert constant(2.5, "z") == 2.5
    assert constant(torch.tensor(2.5), "z") == 2.5
    with pytest.raises(TypeError, match=r"^The wavelength has no gradient here"):
        constant(torch.tensor(5e-7, requires_grad=True), "The wavelength")


def check_gradients_of_other_shapes_are_refused(device, grads, said) -> None:
    def step(u: Any, a: np.ndarray) -> Any:
        return device.upload(device.download(u)), grads

    x = tensor(5, dtype=torch.float32, grad=True)
    y = gradients.apply_step(step, x, parameters=[torch.tensor(1.0)], device=device)
    with pytest.raises(clplen.ShapeError, match=said):
        y.sum().backward()


def test_gradients_of_other_shapes_are_refused(device) -> None:
    for grads, said in [
        (lambda g: [g[:3], None], r"gradient of input 1 of .* must have .*\(5,\), got \(3,\)"),
        (lambda g: [g], r"2 inputs, but its pullback returned 1 gradients"),
        (lambda g: [g, np.array([1.0])], r"gradient of input 2 of .* got \(1,\)"),
    ]:
        check_gradients_of_other_shapes_are_refused(device, grads, said)


def test_steps_copy_nothing_on_a_cpu(device, copies) -> None:
    def copied(u: Any) -> Any:
        def back(data: Any) -> Any:
            out = device.empty(data.shape, data.dtype)
            device.copy_into(out, data, 0)
            return out

        return back(u), lambda g: [back(g)]

    x = tensor(100, 101, dtype=torch.float32, grad=True)
    once = 0 if device.is_cpu else 1
    with copies(x.nbytes) as count:
        gradients.apply_step(copied, x, device=device).sum().backward()
    assert count == {"up": 2 * once, "down": 2 * once}
    assert torch.equal(x.grad, torch.ones(100, 101))
