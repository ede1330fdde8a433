"""Arrays of other libraries at public entrances: taken as they are, or refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import objects
import pytest
from setups_microscope import any_projector

import clplen
from clplen.checks import host_array
from clplen.compute.device import Device

Maker = Callable[[np.ndarray], Any]


class ByDLPack:
    """An array of which DLPack alone is known."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self.shape, self.ndim, self.dtype = values.shape, values.ndim, values.dtype

    def __dlpack__(self, **options: Any) -> Any:
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.values.__dlpack_device__()


class ByInterface:
    """An array of which the memory alone is known."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self.__array_interface__ = values.__array_interface__


class OnCUDA(ByDLPack):
    """An array in the memory of a GPU, as CuPy has them."""

    __cuda_array_interface__: dict[str, Any] = {}  # noqa: RUF012

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("Implicit conversion to a NumPy array is not allowed.")

    def __dlpack_device__(self) -> tuple[int, int]:
        return (2, 0)


def by_torch(values: np.ndarray) -> Any:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    return torch.from_numpy(values)


def by_jax(values: np.ndarray) -> Any:
    jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    return jax.numpy.asarray(values)


def by_xarray(values: np.ndarray) -> Any:
    return pytest.importorskip("xarray", reason="xarray: pip install xarray").DataArray(values)


MAKERS: dict[str, Maker] = {
    "DLPack": ByDLPack,
    "interface": ByInterface,
    "JAX": by_jax,
    "PyTorch": by_torch,
    "xarray": by_xarray,
}
GRID = clplen.Grid((32, 24), 10e-6)
COMPLEX = (objects.samples(32, 24) + 1j * objects.samples(32, 24)).astype(np.complex64)
ENTRANCES: dict[str, tuple[np.ndarray, Callable[[Any, Device], Any]]] = {
    "Field": (
        COMPLEX,
        lambda a, device: clplen.Field.from_array(a, GRID, wavelength=5e-7, device=device),
    ),
    "LightField": (
        objects.samples(3, 3, 32, 32),
        lambda a, device: clplen.LightField.from_array(a, device=device),
    ),
    "focal_stack": (
        objects.samples(3, 3, 32, 32),
        lambda a, device: clplen.focal_stack(a, disparities=[-1, 0, 1], device=device),
    ),
    "Projector.forward": (
        objects.samples(2, 6, 10),
        lambda a, device: any_projector(device).forward(a),
    ),
    "Projector.backward": (
        objects.samples(9, 15),
        lambda a, device: any_projector(device).backward(a),
    ),
    "deconvolve": (
        1 + objects.samples(15, 15),
        lambda a, device: clplen.deconvolve(a, any_projector(device, (5, 5)), iterations=2).volume,
    ),
    "phase of transparency": (
        objects.samples(32, 24),
        lambda a, device: clplen.wave.transparency(
            clplen.Field.from_array(COMPLEX, GRID, wavelength=5e-7, device=device), phase=a
        ),
    ),
    "Texture": (objects.samples(32, 24), lambda a, device: clplen.cameras.Texture(a)),
    "render": (
        objects.samples(3, 3),
        lambda a, device: objects.lightfield(device).render(aperture=a),
    ),
}


@pytest.mark.parametrize("library", MAKERS)
@pytest.mark.parametrize("name", ENTRANCES)
def test_an_entrance_takes_arrays_of_a_library(name: str, library: str, device: Device) -> None:
    values, function = ENTRANCES[name]
    if library == "interface" and name == "focal_stack":
        pytest.skip("what functions take in place of a light field has __array__ or __dlpack__")
    found = function(MAKERS[library](values), device)
    np.testing.assert_array_equal(np.asarray(found), np.asarray(function(values, device)))


@pytest.mark.parametrize("name", ENTRANCES)
def test_an_entrance_refuses_arrays_of_a_gpu_in_one_sentence(name: str, device: Device) -> None:
    values, function = ENTRANCES[name]
    with pytest.raises(TypeError, match=r"in host memory, not on device 0 .*cupy\.asnumpy"):
        function(OnCUDA(values), device)


@pytest.mark.parametrize("name", ENTRANCES)
def test_an_entrance_refuses_to_drop_gradients(name: str, device: Device) -> None:
    values, function = ENTRANCES[name]
    x = by_torch(values).requires_grad_()
    with pytest.raises(TypeError, match=r"with requires_grad, .* give tensor\.detach\(\)"):
        function(x, device)
    function(x.detach(), device)


def test_a_conjugate_tensor_is_taken(device: Device) -> None:
    x = by_torch(COMPLEX).conj()
    assert x.is_conj()
    field = clplen.Field.from_array(x, GRID, wavelength=5e-7, device=device)
    np.testing.assert_array_equal(field.to_numpy(), COMPLEX.conj())


def test_types_that_numpy_lacks_and_other_devices_of_torch() -> None:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    with pytest.raises(TypeError, match=r"A frame is .* not of torch\.bfloat16 .*convert it"):
        host_array(torch.ones(3, dtype=torch.bfloat16), "A frame")
    with pytest.raises(TypeError, match=r"A frame is .* not of torch\.float32 .*convert it"):
        host_array(torch.ones(3, 3).to_sparse(), "A frame")
    with pytest.raises(TypeError, match=r"not on meta: bring it there first"):
        host_array(torch.ones(3, device="meta"), "A frame")
    half = host_array(torch.ones(3, dtype=torch.float16), "A frame")
    assert half.dtype == np.float16


def test_types_that_numpy_lacks_of_jax() -> None:
    jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    with pytest.raises(TypeError, match=r"A frame is of bfloat16, which NumPy lacks: convert it"):
        host_array(jax.numpy.ones(3, jax.numpy.bfloat16), "A frame")


def test_rows_of_unequal_lengths_are_no_array() -> None:
    with pytest.raises(TypeError, match=r"^A frame is one array of numbers, not rows of unequal"):
        host_array([[1, 2], [3]], "A frame")


@pytest.mark.parametrize("library", ["DLPack", "interface", "JAX", "PyTorch"])
def test_the_host_makes_no_copy(library: str) -> None:
    values = objects.samples(64, 64)
    foreign = MAKERS[library](values)
    found = host_array(foreign, "A frame")
    address = foreign.unsafe_buffer_pointer() if library == "JAX" else values.ctypes.data
    assert found.ctypes.data == address


@pytest.mark.parametrize("library", ["DLPack", "PyTorch"])
@pytest.mark.parametrize("size", [32, 2048])  # small, and in a buffer of the pool
def test_one_copy_goes_to_the_device_and_one_comes_back(
    library: str, size: int, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = objects.samples(size, size).astype(device.complex)
    uploaded: list[int] = []
    downloads: list[tuple[int, ...]] = []
    upload, download = Device.upload, Device.download
    monkeypatch.setattr(
        Device, "upload", lambda d, a: (uploaded.append(a.ctypes.data), upload(d, a))[1]
    )
    grid = clplen.Grid((size, size), 10e-6)
    field = clplen.Field.from_array(MAKERS[library](values), grid, wavelength=5e-7, device=device)
    assert uploaded == [values.ctypes.data]
    monkeypatch.setattr(
        Device, "download", lambda d, a: (downloads.append(a.shape), download(d, a))[1]
    )
    np.testing.assert_array_equal(field.to_numpy(), values)
    assert downloads == [(size, size)]


@pytest.mark.parametrize("name", ["DepthMap", "Field", "FocalStack", "Image", "LightField"])
@pytest.mark.parametrize("library", ["JAX", "PyTorch"])
def test_libraries_take_results(name: str, library: str, device: Device) -> None:
    one = objects.EXAMPLES[name](device)
    if library == "PyTorch":
        torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
        found = torch.from_dlpack(one)
    else:
        jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
        found = jax.numpy.asarray(one)
    np.testing.assert_array_equal(np.asarray(found), one.to_numpy())
