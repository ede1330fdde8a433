"""Whatever OpenCL refuses is an error of clplen that names device, driver, step and remedy."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
import pytest
from click.testing import CliRunner

from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import DeviceError, KernelBuildError


def words_of(device: Device) -> list[str]:
    """What every sentence has to name."""
    return [device.name, device.platform, "clplen devices --check"]


def test_a_kernel_that_the_program_lacks(device: Device) -> None:
    with pytest.raises(KernelBuildError) as caught:
        device.kernel("multiply.cl", "divide_by_nothing")
    sentence = str(caught.value)
    assert "'multiply.cl' but cannot create its kernel 'divide_by_nothing'" in sentence
    assert "INVALID_KERNEL_NAME" in sentence
    assert all(word in sentence for word in words_of(device))


def test_a_launch_that_is_refused(device: Device) -> None:
    kernel = device.kernel("multiply.cl", "multiply")
    a = device.zeros((3,), np.complex64)
    group = (2 * device.cl_device.max_work_group_size,)
    size = np.int32(3)
    with pytest.raises(DeviceError, match="The kernel 'multiply' failed on ") as caught:
        device.launch(kernel, group, a, a, a, size, size, group=group)
    assert all(word in str(caught.value) for word in words_of(device))
    assert isinstance(caught.value.__cause__, cl.Error)


STEPS: list[tuple[str, Callable[[Device, Any], Any]]] = [
    ("enqueue_copy", lambda device, array: device.download(array)),
    ("enqueue_copy", lambda device, array: device.copy_into(array, array, 0)),
    ("enqueue_copy", lambda device, array: device.copy_lines(array, array, (4, 1), (0, 4), (0, 4))),
    ("enqueue_fill_buffer", lambda device, array: device.zeros((3, 5), np.float32)),
    ("Buffer", lambda device, array: device.upload(np.ones(7, np.float32))),
    ("enqueue_map_buffer", lambda device, array: map_it(device, array)),
]


def map_it(device: Device, array: Any) -> None:
    device.is_cpu = True  # of the copy that the test made
    with device.on_host(array):
        pass


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (cl.RuntimeError("clEnqueue failed: OUT_OF_RESOURCES"), "run `clplen devices --check`"),
        (cl.MemoryError("clEnqueue failed: MEM_OBJECT_ALLOCATION_FAILURE"), "more memory than"),
    ],
)
def test_every_step_of_memory(
    device: Device, monkeypatch: pytest.MonkeyPatch, error: cl.Error, words: str
) -> None:
    def failing(*args: Any, **options: Any) -> None:
        raise error

    for function, step in STEPS:
        fresh = Device(device.cl_device)
        if function == "Buffer" and not fresh.is_cpu:  # a GPU's copy is another step
            continue
        array = fresh.upload(np.arange(6, dtype=np.float32))
        with monkeypatch.context() as patch:
            patch.setattr(cl, function, failing)
            with pytest.raises(DeviceError) as caught:
                step(fresh, array)
        assert words in str(caught.value)
        assert device.name in str(caught.value)
        assert caught.value.__cause__ is error


def test_kept_plans_and_buffers_make_room(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """What one program keeps is given back before its own want of memory is an error."""
    fresh = Device(device.cl_device)
    kernel = fresh.kernel("multiply.cl", "multiply")
    one = fresh.upload(np.full((2, 3), 2 + 1j, np.complex64))
    size = np.int32(2), np.int32(3)
    steps: list[tuple[Any, str, Callable[[], Any]]] = [
        (cl, "Buffer", lambda: fresh.upload(np.ones(7, np.float32))),
        (cla, "empty", lambda: fresh.empty((3, 5), np.float32)),
    ]
    for owner, function, step in steps if fresh.is_cpu else steps[1:]:
        act = getattr(owner, function)
        errors = [cl.MemoryError("clCreateBuffer failed: MEM_OBJECT_ALLOCATION_FAILURE")]

        def refused(*args: Any, act: Any = act, errors: Any = errors, **more: Any) -> Any:
            if errors:
                raise errors.pop()
            return act(*args, **more)

        fresh.plans.keep("kept", "plan", 7)
        with monkeypatch.context() as patched:
            patched.setattr(owner, function, refused)
            step()
        assert len(fresh.plans) == 0
    errors = [cl.RuntimeError("clEnqueueNDRangeKernel failed: OUT_OF_HOST_MEMORY")]

    class Refused:
        function_name = "multiply"

        def __call__(self, *args: Any) -> Any:
            if errors:
                raise errors.pop()
            return kernel(*args)

    fresh.plans.keep("kept", "plan", 7)
    product = fresh.zeros((2, 3), np.complex64)
    fresh.launch_rows(cast(Any, Refused()), (2, 3), product, one, one, *size)
    assert len(fresh.plans) == 0
    assert np.allclose(fresh.download(product), 3 + 4j)


def test_the_command_line_says_one_sentence_of_what_nobody_expected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(*args: Any, **options: Any) -> None:
        raise cl.RuntimeError("clEnqueueTask failed: OUT_OF_RESOURCES")

    monkeypatch.setattr(Device, "open", failing)
    done = CliRunner().invoke(main, ["devices"])
    assert done.exit_code == 1
    (line,) = done.output.splitlines()
    assert line.startswith("Error: OpenCL failed (clEnqueueTask failed: OUT_OF_RESOURCES): run ")


def test_both_precisions_of_a_device_make_room(device: Device, precise: Device) -> None:
    one, other = Device.open(precise.place), precise
    other.plans.keep("kept by the other precision", "plan", 7)
    one.free_spare()
    assert len(other.plans) == len(one.plans) == 0
    assert device.download(device.upload(np.arange(3, dtype=np.float32))).tolist() == [0, 1, 2]


def test_a_context_is_made_once_more_without_devices_that_nobody_holds(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost_device() -> weakref.ref[Device]:
        lost = Device(device.cl_device)
        lost.plans.keep("plan", lost, 8)  # plans refer to their device
        return weakref.ref(lost)

    lost, made = lost_device(), cl.Context

    def context(devices: Any) -> Any:
        if lost() is not None:
            raise cl.RuntimeError("Context failed: OUT_OF_HOST_MEMORY")
        return made(devices)

    fresh = Device(device.cl_device)
    monkeypatch.setattr(cl, "Context", context)
    assert fresh.upload(np.ones(3, np.float32)).get().sum() == 3
