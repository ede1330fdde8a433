"""Every FFT route on every device against complex128; how a route is chosen."""

from __future__ import annotations

import importlib.util
import itertools
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
import scipy.fft
from tolerance import fft_tolerance, relative_max

from clplen.compute.device import Device
from clplen.compute.fft import routes
from clplen.compute.fft.routes import FFTRoute, choose_route
from clplen.errors import DeviceError

ROUTES = ("vkfft", "ducc0", "scipy")
# A power of two, a prime (Bluestein), 2 5 101 and 2 3 5 101 (Bluestein for 101 in some
# libraries), two odd lengths under two batch axes, and the cylindrical problem.
SHAPES = [(64, 64), (509, 64), (31, 1010), (3030, 7), (2, 3, 45, 37), (1, 96)]
find_spec = importlib.util.find_spec


@pytest.fixture(params=ROUTES)
def route(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> FFTRoute:
    """Each route, as ``$CLPLEN_FFT`` forces it."""
    module = {"vkfft": "pyvkfft"}.get(request.param, request.param)
    if find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    monkeypatch.setenv("CLPLEN_FFT", request.param)
    return choose_route(is_cpu=True)


def without(*names: str, installed: object = None) -> object:
    """What finds modules on a machine that lacks these."""
    return lambda name: None if name in names else installed or find_spec(name)


def random_field(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    random = np.random.default_rng(sum(shape))
    return (random.standard_normal(shape) + 1j * random.standard_normal(shape)).astype(dtype)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_transform_is_right_and_in_place(
    device: Device,
    route: FFTRoute,
    precision: str,
    request: pytest.FixtureRequest,
) -> None:
    if route.name == "vkfft" and device.is_cpu and device.platform.startswith("Intel"):
        # One plan in three is wrong there for lengths that VkFFT does by Rader's algorithm (31,
        # 37), whichever run; PoCL and one core of the same machine are right.
        pytest.skip("VkFFT's set-up is not reliable on Intel's CPU runtime")
    if precision == "double":
        device = request.getfixturevalue("precise")
    ways = ((route.forward, np.fft.fft2), (route.inverse, np.fft.ifft2))
    for shape, (transform, reference) in itertools.product(SHAPES, ways):
        values = random_field(shape, device.complex)
        array = device.upload(values)
        place = array.base_data.int_ptr
        transform(array, device)
        got = device.download(array)
        assert array.base_data.int_ptr == place
        assert (got.shape, got.dtype) == (values.shape, device.complex)
        tolerance = fft_tolerance(shape[-2:], device.complex)
        assert relative_max(reference(values.astype(complex)), got) <= tolerance


def test_a_scipy_that_does_not_work_in_place_is_written_back(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    fft2 = scipy.fft.fft2
    monkeypatch.setattr(scipy.fft, "fft2", lambda x, **more: fft2(x.copy(), **more))
    values = random_field((64, 64), device.complex)
    array = device.upload(values)
    FFTRoute("scipy", 1).forward(array, device)
    expected = np.fft.fft2(values.astype(complex))
    assert relative_max(expected, device.download(array)) <= fft_tolerance((64, 64), np.complex64)


def test_a_plan_of_vkfft_is_kept(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyvkfft")
    values = random_field((64, 64), device.complex)
    array = device.upload(values)
    for _ in range(2):
        FFTRoute("vkfft", 1).forward(array, device)
        monkeypatch.setattr(routes, "_vkfft_app", lambda *_: pytest.fail("planned again"))
    expected = np.fft.fft2(np.fft.fft2(values.astype(complex)))
    assert relative_max(expected, device.download(array)) <= 2 * fft_tolerance(64**2, np.complex64)


def test_a_forced_route_that_is_missing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ROUTES:
        monkeypatch.setenv("CLPLEN_FFT", f" {name.upper()} ")
        module = {"vkfft": "pyvkfft"}.get(name, name)
        monkeypatch.setattr(routes, "find_spec", without(module))
        with pytest.raises(DeviceError) as error:
            choose_route(is_cpu=True)
        words = str(error.value)
        assert f"CLPLEN_FFT={name!r} requires {module}, which is not installed: " in words
        remedy = {
            "vkfft": 'VKFFT_BACKEND=opencl pip install "clplen[gpu]"',
            "ducc0": 'pip install "clplen[fast]"',
        }
        assert remedy.get(name, f"pip install {name}") in words
        monkeypatch.setattr(routes, "find_spec", lambda _: "found")
        assert choose_route(is_cpu=True).name == name
    monkeypatch.setenv("CLPLEN_FFT", "fftw")
    with pytest.raises(DeviceError, match="must be one of vkfft, ducc0, scipy, got 'fftw'"):
        choose_route(is_cpu=False)


def test_what_is_installed_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CLPLEN_FFT", raising=False)
    for is_cpu, missing, name in [
        (True, (), "ducc0"),
        (True, ("ducc0",), "scipy"),
        (True, ("pyvkfft",), "ducc0"),
        (False, (), "vkfft"),
        (False, ("pyvkfft",), "ducc0"),
        (False, ("pyvkfft", "ducc0"), "scipy"),
    ]:
        found = without(*missing, installed="found")
        monkeypatch.setattr(routes, "find_spec", found)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert choose_route(is_cpu).name == name
        assert len(said) == (not is_cpu and name != "vkfft")
        for warning in said:
            assert warning.category is RuntimeWarning
            assert f"run on the host ({name}) with transfers both ways" in str(warning.message)
            assert 'VKFFT_BACKEND=opencl pip install "clplen[gpu]"' in str(warning.message)


@pytest.fixture
def gpu(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device taken for a GPU without pyvkfft: memory of its own, an item a sample."""
    monkeypatch.delenv("CLPLEN_FFT", raising=False)
    monkeypatch.setattr(routes, "find_spec", without("pyvkfft"))
    mock = Device(device.cl_device)
    mock.is_cpu = mock.rows = False
    return mock


def test_a_gpu_without_vkfft_transforms_on_the_host(
    gpu: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = random_field((3, 31, 64), gpu.complex)
    array = gpu.upload(values)
    copies = []
    enqueue_copy = cl.enqueue_copy

    def copy(queue: cl.CommandQueue, to: object, source: object, **more: object) -> object:
        copies.append("down" if isinstance(to, np.ndarray) else "up")
        return enqueue_copy(queue, to, source, **more)

    monkeypatch.setattr(cl, "enqueue_copy", copy)
    monkeypatch.setattr(cl, "enqueue_map_buffer", lambda *_: pytest.fail("mapped"))
    with pytest.warns(RuntimeWarning, match="pyvkfft is not installed") as said:
        gpu.fft.forward(array, gpu)
    assert len(said) == 1
    assert copies == ["down", "up"]
    gpu.fft.inverse(array, gpu)  # without another word: a warning is an error here
    assert copies == ["down", "up"] * 2
    assert gpu.fft.name in repr(gpu)
    assert relative_max(values, gpu.download(array)) <= 2 * fft_tolerance((31, 64), np.complex64)


class Application:
    """Of VkFFT; it changes the array before it is refused, if it is."""

    tmp_buffer_nbytes = 0

    def __init__(self, error: RuntimeError | None = None) -> None:
        self.error = error

    def fft(self, array: Any, *_: object, queue: object) -> None:
        array += 1
        if self.error is not None:
            raise self.error


NO_MEMORY = RuntimeError("VkFFT error 4001: VKFFT_ERROR_FAILED_TO_ALLOCATE_MEMORY")
NO_LAUNCH = RuntimeError("VkFFT error 4039: VKFFT_ERROR_FAILED_TO_LAUNCH_KERNEL")


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ([], None),
        ([NO_MEMORY], None),
        ([NO_MEMORY, NO_MEMORY], "by VkFFT needs more memory than .*4001"),
        ([NO_LAUNCH], "by VkFFT failed on .*4039"),
    ],
)
def test_a_plan_that_has_no_memory_is_made_once_more(
    device: Device,
    monkeypatch: pytest.MonkeyPatch,
    errors: list[RuntimeError],
    words: str | None,
) -> None:
    fresh = Device(device.cl_device)
    fresh.plans.keep("kept", "plan", 7)
    left = list(errors)

    def made(*_: object) -> Application:
        if left:
            raise left.pop()
        return Application()

    monkeypatch.setattr(routes, "_vkfft_app", made)
    array = fresh.zeros((4, 6), np.complex64)
    if words is None:
        FFTRoute("vkfft", 1).forward(array, fresh)
        assert np.array_equal(fresh.download(array), np.ones((4, 6)))
    else:
        with pytest.raises(DeviceError, match=rf"shape \(4, 6\) {words}"):
            FFTRoute("vkfft", 1).forward(array, fresh)
    assert len(fresh.plans) == (0 if NO_MEMORY in errors else 1)


def test_a_transform_that_is_refused_is_not_repeated(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is done in place, and may have been done in part."""
    monkeypatch.setattr(routes, "_vkfft_app", lambda *_: Application(NO_MEMORY))
    fresh = Device(device.cl_device)
    array = fresh.zeros((4, 6), np.complex64)
    with pytest.raises(DeviceError, match=r"shape \(4, 6\) by VkFFT"):
        FFTRoute("vkfft", 1).forward(array, fresh)
    assert np.array_equal(fresh.download(array), np.ones((4, 6)))


def test_vkfft_is_not_asked_for_a_single_sample(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "_vkfft_app", lambda *_: pytest.fail("asked"))
    values = np.full((3, 1, 1), 2 - 3j, np.complex64)
    array = device.upload(values)
    FFTRoute("vkfft", 1).forward(array, device)
    FFTRoute("vkfft", 1).inverse(array, device)
    assert np.array_equal(device.download(array), values)


def test_vkfft_runs_on_the_queue_of_a_profile(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    queues = []

    def fft(*_: object, queue: object) -> None:
        queues.append(queue)

    app = SimpleNamespace(fft=fft)
    monkeypatch.setattr(routes, "_vkfft_app", lambda *_: app)
    fresh = Device(device.cl_device)
    array = fresh.zeros((4, 6), np.complex64)
    with fresh.profiling():
        FFTRoute("vkfft", 1).forward(array, fresh)
        during = fresh.queue
    FFTRoute("vkfft", 1).forward(array, fresh)
    assert queues == [during, fresh.queue]
    assert during != fresh.queue
