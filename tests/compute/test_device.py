"""Devices are found by selector, refuse what cannot work, and move data without changing it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
import pytest

from clplen import Field, Grid, Propagator
from clplen.compute.device import Device, require_same_device
from clplen.compute.drivers import pocl, selection
from clplen.errors import DeviceError, ShapeError

CPU, GPU = cl.device_type.CPU, cl.device_type.GPU


@dataclass(eq=False)
class FakePlatform:
    """An OpenCL platform as far as `Device` looks at it; no device raises, as drivers do."""

    name: str
    vendor: str = "somebody"
    version: str = "OpenCL 3.0"
    devices: list[FakeDevice] = field(default_factory=list)

    def get_devices(self) -> list[FakeDevice]:
        if not self.devices:
            raise cl.RuntimeError("clGetDeviceIDs failed: DEVICE_NOT_FOUND")
        return self.devices

    def with_device(self, name: str, kind: int, **more: object) -> FakePlatform:
        self.devices.append(FakeDevice(name, kind, self, **more))
        return self


@dataclass(eq=False)
class FakeDevice:
    """An OpenCL device as far as `Device` looks at it."""

    name: str
    type: int
    platform: FakePlatform
    vendor: str = "somebody"
    driver_version: str = "1.2"
    extensions: str = "cl_khr_fp64 cl_khr_icd"
    global_mem_size: int = 2**30
    max_mem_alloc_size: int = 2**28


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[FakePlatform]:
    """A machine with four platforms, one of them without a device."""
    platforms = [
        FakePlatform("Portable Computing Language").with_device("pthread-Intel(R) Xeon", CPU),
        FakePlatform("Empty driver"),
        FakePlatform("Intel(R) OpenCL", vendor="Intel").with_device("Xeon Gold 6230", CPU),
        FakePlatform("NVIDIA CUDA")
        .with_device("GeForce RTX 3090", GPU)
        .with_device("GeForce GTX 1080", GPU, extensions="cl_khr_icd"),
    ]
    monkeypatch.delenv("CLPLEN_DEVICE", raising=False)
    monkeypatch.setattr(selection.environment, "expose_intel_runtime", lambda: None)
    monkeypatch.setattr(pocl, "ensure_usable", lambda cl_device: "")
    monkeypatch.setattr(cl, "get_platforms", lambda: platforms)
    return platforms


def test_a_selector_finds_its_device(machine: list[FakePlatform]) -> None:
    for selector, name in [
        (None, "GeForce RTX 3090"),
        ("gpu", "GeForce RTX 3090"),
        ("cpu", "pthread-Intel(R) Xeon"),
        ("CPU ", "pthread-Intel(R) Xeon"),
        ("0:0", "pthread-Intel(R) Xeon"),
        ("2:0", "Xeon Gold 6230"),
        ("3:1", "GeForce GTX 1080"),
        ("gtx", "GeForce GTX 1080"),
        ("1080", "GeForce GTX 1080"),
        ("NVIDIA", "GeForce RTX 3090"),
        ("portable", "pthread-Intel(R) Xeon"),
        ("intel", "Xeon Gold 6230"),  # the platform, not PoCL on an Intel processor
        ("gold 62", "Xeon Gold 6230"),
    ]:
        assert Device.open(selector).name == name


def test_without_a_gpu_the_first_cpu_is_taken(machine: list[FakePlatform]) -> None:
    machine.pop()
    assert Device.open().name == "pthread-Intel(R) Xeon"
    with pytest.raises(DeviceError, match="No OpenCL device matches 'gpu'"):
        Device.open("gpu")


def test_an_unknown_selector_lists_what_is_there(machine: list[FakePlatform]) -> None:
    for selector in ["3:2", "1:0", "radeon", "7", "cuda0"]:
        with pytest.raises(DeviceError) as error:
            Device.open(selector)
        words = str(error.value)
        assert f"No OpenCL device matches {selector!r}" in words
        assert "0:0 Portable Computing Language: pthread-Intel(R) Xeon;" in words
        assert "2:0 Intel(R) OpenCL: Xeon Gold 6230;" in words
        assert "3:1 NVIDIA CUDA: GeForce GTX 1080." in words
        assert "'cpu', 'gpu', 'platform:device' or part of a name" in words


def test_the_environment_chooses_where_nothing_is_asked_for(
    machine: list[FakePlatform], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", "intel")
    assert Device.open().name == "Xeon Gold 6230"
    assert Device.open("0:0").name == "pthread-Intel(R) Xeon"
    monkeypatch.setenv("CLPLEN_DEVICE", "voodoo")
    with pytest.raises(DeviceError, match="No OpenCL device matches 'voodoo'"):
        Device.open()
    monkeypatch.setenv("CLPLEN_DEVICE", "")
    assert Device.open().name == "GeForce RTX 3090"


def test_a_device_that_cannot_compile_is_passed_over_unless_asked_for(
    machine: list[FakePlatform], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ensure_usable(cl_device: FakeDevice) -> str:
        if cl_device.type == GPU or cl_device.platform.name == "Intel(R) OpenCL":
            raise DeviceError(f"{cl_device.name} is broken.")
        return ""

    monkeypatch.setattr(pocl, "ensure_usable", ensure_usable)
    assert Device.open().name == "pthread-Intel(R) Xeon"
    with pytest.raises(DeviceError, match="RTX 3090 is broken"):
        Device.open("gpu")
    del machine[0]
    with pytest.raises(
        DeviceError, match=r"RTX 3090 is broken\..*1080 is broken\..*6230 is broken\."
    ):
        Device.open()


def test_every_device_is_listed_once_in_platform_order(machine: list[FakePlatform]) -> None:
    assert [(d.platform, d.name) for d in Device.all()] == [
        ("Portable Computing Language", "pthread-Intel(R) Xeon"),
        ("Intel(R) OpenCL", "Xeon Gold 6230"),
        ("NVIDIA CUDA", "GeForce RTX 3090"),
        ("NVIDIA CUDA", "GeForce GTX 1080"),
    ]


def no_platform() -> list[FakePlatform]:
    raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")


def test_no_opencl_names_what_to_install(
    machine: list[FakePlatform], monkeypatch: pytest.MonkeyPatch
) -> None:
    for call in [Device.open, Device.all]:
        for found in [no_platform, list, lambda: [FakePlatform("Empty driver")]]:
            monkeypatch.setattr(cl, "get_platforms", found)
            with pytest.raises(DeviceError) as error:
                call()
            words = str(error.value)
            assert "OpenCL platform" in words
            for system, remedy in (
                ("Linux on x86-64", "pip install pocl-binary-distribution"),
                ("Linux on ARM", "apt install pocl-opencl-icd"),
                ("macOS", "conda install -c conda-forge pocl"),
                ("Windows", "pip install intel-opencl-rt"),
            ):
                _, _, rest = words.partition(f"{system}: ")
                assert remedy in rest.split(";")[0], system


def test_double_precision_needs_fp64(machine: list[FakePlatform]) -> None:
    assert Device.open("3:0", precision="double").complex == np.complex128
    assert Device.open("3:1").complex == np.complex64
    with pytest.raises(DeviceError) as error:
        Device.open("3:1", precision="double")
    assert "GeForce GTX 1080 (NVIDIA CUDA) has no double precision" in str(error.value)
    assert "cl_khr_fp64" in str(error.value)
    with pytest.raises(ValueError, match="'single' or 'double', got 'half'"):
        Device.open("3:0", precision="half")


def test_repr_names_driver_precision_and_fft_route(
    machine: list[FakePlatform], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLPLEN_FFT", "scipy")
    opened = Device.open("intel", precision="double")
    assert repr(opened) == "<Device Xeon Gold 6230, Intel(R) OpenCL 1.2, double, FFT scipy>"


def test_two_devices_are_not_mixed(device: Device, precise: Device) -> None:
    with pytest.raises(DeviceError) as error:
        require_same_device(device, precise)
    assert repr(device) in str(error.value)
    assert repr(precise) in str(error.value)
    grid = Grid((3, 5), 1e-5)
    field = Field.from_array(np.ones((3, 5)), grid, wavelength=5e-7, device=device)
    plan = Propagator(grid, 1e-3, wavelength=5e-7, device=precise)
    with pytest.raises(DeviceError, match="two devices"):
        plan(field)


def test_one_hardware_is_one_device(device: Device) -> None:
    """Data of `open` and of `all` meet, from whatever thread."""
    with ThreadPoolExecutor(4) as pool:
        opened = list(pool.map(lambda _: Device.open(device.place), range(8)))
    assert {id(d) for d in opened} == {id(device)}
    assert device in Device.all()


def test_a_device_is_asked_for() -> None:
    for wrong in [b"cpu", 0, 1.5, ["cpu"], True]:
        with pytest.raises(TypeError, match=r"device must be a Device, such as Device.open"):
            Field.from_array(np.ones((3, 5)), Grid((3, 5), 1.0), wavelength=1.0, device=wrong)


def test_memory_is_refused_with_bytes_needed_and_there(machine: list[FakePlatform]) -> None:
    small = Device.open("2:0")
    small.require_memory(2**30, "A stack")
    with pytest.raises(DeviceError) as error:
        small.require_memory(3 * 2**30, "A stack")
    words = str(error.value)
    assert words.startswith("A stack needs 3,221,225,472 bytes (3.00 GiB), but Xeon Gold 6230 has ")
    assert "1,073,741,824 bytes (1.00 GiB)" in words
    assert "fewer planes" in words


def test_one_array_larger_than_the_device_gives_is_refused(machine: list[FakePlatform]) -> None:
    with pytest.raises(DeviceError) as error:
        Device.open("2:0").empty((3, 2**26), np.float32)
    words = str(error.value)
    assert "shape (3, 67108864) (float32) needs 805,306,368 bytes (0.75 GiB)" in words
    assert "268,435,456 bytes (0.25 GiB)" in words


SAMPLES = np.random.default_rng(3).integers(1, 100, (3, 5, 7))


def test_what_goes_up_comes_down(device: Device) -> None:
    for values in [
        SAMPLES.astype(np.float32),
        SAMPLES.astype(np.uint16),
        SAMPLES * (1 + 2j),
        (SAMPLES * (1 + 2j)).astype(np.complex64),
        SAMPLES.transpose(2, 0, 1),
        SAMPLES[:, ::2, ::-3],
        np.asfortranarray(SAMPLES[0]),
        np.zeros((3, 0, 2), np.complex64),
        np.float32(2.5),
    ]:
        before = values.copy()
        array = device.upload(values)
        got = device.download(array)
        assert isinstance(array, cla.Array)
        assert (got.shape, got.dtype) == (values.shape, values.dtype)
        np.testing.assert_array_equal(got, before)
        np.testing.assert_array_equal(values, before)


def test_part_of_an_array_comes_down(device: Device) -> None:
    array = device.upload(SAMPLES)
    np.testing.assert_array_equal(device.download(array[1:]), SAMPLES[1:])
    with device.on_host(array[2]) as part:
        part += 1000
    expected = SAMPLES.copy()
    expected[2] += 1000
    np.testing.assert_array_equal(device.download(array), expected)


def test_strided_arrays_are_refused(device: Device) -> None:
    array = device.upload(SAMPLES)
    for strided in (array[:, 1:3], array.transpose((2, 1, 0))):
        with pytest.raises(ShapeError, match="must be C-contiguous"):
            device.download(strided)
        with pytest.raises(ShapeError, match="must be C-contiguous"), device.on_host(strided):
            pass


def test_zeros(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = device.empty

    def used(shape: tuple[int, ...], dtype: type) -> cla.Array:
        array = empty(shape, dtype)
        if array.size:
            array.fill(7)
        return array

    monkeypatch.setattr(device, "empty", used)
    for shape in ((3, 5), (0, 4)):
        np.testing.assert_array_equal(
            device.download(device.zeros(shape, np.complex64)), np.zeros(shape)
        )


@pytest.fixture
def copies(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The directions of every copy between host and device from now on."""
    seen: list[str] = []
    enqueue_copy = cl.enqueue_copy

    def copy(queue: cl.CommandQueue, to: object, source: object, **more: object) -> object:
        seen.append("down" if isinstance(to, np.ndarray) else "up")
        return enqueue_copy(queue, to, source, **more)

    monkeypatch.setattr(cl, "enqueue_copy", copy)
    return seen


def test_a_cpu_maps_its_memory_without_a_copy(device: Device, copies: list[str]) -> None:
    if not device.is_cpu:
        pytest.skip("a GPU has memory of its own")
    array = device.upload(SAMPLES)
    places = []
    del copies[:]
    for _ in range(2):
        with device.on_host(array) as values:
            assert values.shape == SAMPLES.shape
            places.append(values.ctypes.data)
            values *= 2
    assert copies == []
    assert places[0] == places[1]
    np.testing.assert_array_equal(device.download(array), 4 * SAMPLES)


def test_elsewhere_values_are_fetched_and_written_back(device: Device, copies: list[str]) -> None:
    gpu = Device(device.cl_device)
    gpu.is_cpu = False
    array = gpu.upload(SAMPLES)
    del copies[:]
    with gpu.on_host(array[1]) as values:
        values *= 3
    assert copies == ["down", "up"]
    expected = SAMPLES.copy()
    expected[1] *= 3
    np.testing.assert_array_equal(gpu.download(array), expected)


def test_a_buffer_is_mapped_once_for_all_who_use_it(device):
    if not device.is_cpu:
        pytest.skip("only the memory of CPU devices is mapped")
    values = np.arange(12, dtype=np.float32)
    array = device.upload(values)
    with device.on_host(array) as first:
        with device.on_host(array, write=False) as second:
            first[3] = 7
            assert second[3] == 7
        first[4] = 8
    values[3:5] = 7, 8
    np.testing.assert_array_equal(device.download(array), values)
