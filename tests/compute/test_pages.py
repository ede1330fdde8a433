"""Large pages are asked for under large buffers of Linux's CPU devices; nothing else changes."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest

from clplen.compute import memory
from clplen.compute.device import Device

LARGE = memory.MIN_LARGE_BYTES + 12_345  # no multiple of a page
PAGE = 4096


@pytest.fixture(autouse=True)
def found_anew() -> Iterator[None]:
    """The C library's function is looked up in each test."""
    memory._madvise.cache_clear()
    yield
    memory._madvise.cache_clear()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int, int]]:
    """(start, length, advice) of every request, none of which is made."""
    calls: list[tuple[int, int, int]] = []
    monkeypatch.setattr(memory, "_madvise", lambda: lambda *call: calls.append(call) or -1)
    return calls


@pytest.fixture
def mapped(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Every mapping of a buffer."""
    made: list[np.ndarray] = []
    enqueue = cl.enqueue_map_buffer

    def watched(*arguments: object) -> tuple[np.ndarray, cl.Event]:
        array, event = enqueue(*arguments)
        made.append(array)
        return array, event

    monkeypatch.setattr(cl, "enqueue_map_buffer", watched)
    return made


def holds(device: Device, nbytes: int) -> None:
    """An array of so many bytes takes values and gives them back."""
    values = (np.arange(nbytes) % 251).astype(np.uint8)
    array = device.empty((nbytes,), np.uint8)
    cl.enqueue_copy(device.queue, array.base_data, values, is_blocking=True)
    np.testing.assert_array_equal(device.download(array), values)
    with device.on_host(array) as seen:
        seen[-1] = 255
    assert device.download(array)[-1] == 255


def test_whole_pages_within_the_buffer_are_asked_for(
    device: Device, asked: list[tuple[int, int, int]], mapped: list[np.ndarray]
) -> None:
    if not device.is_cpu:
        pytest.skip("a GPU's buffers are not host memory")
    buffer = cl.Buffer(device.context, cl.mem_flags.READ_WRITE, LARGE)
    memory.ask_for_large_pages(device.queue, buffer)
    (start, length, advice), begin = asked[0], mapped[0].ctypes.data
    assert (len(asked), len(mapped), advice) == (1, 1, 14)  # MADV_HUGEPAGE
    assert start % PAGE == length % PAGE == 0
    assert 0 <= start - begin < PAGE
    assert 0 <= begin + LARGE - (start + length) < PAGE
    device.finish()  # some drivers release when the queue comes to it
    with pytest.raises(cl.Error):  # it was released, whoever still holds it
        mapped[0].base.release(device.queue)
    device._spare.free_held()
    holds(device, LARGE)  # the refusal, -1, changes nothing
    assert len(asked) == 2
    holds(device, LARGE)  # the same buffer once more
    assert len(asked) == 2


def test_what_is_let_go_is_used_again_within_bounds(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    spare = device._spare
    gc.collect()  # what other tests left comes back now, not later
    spare.free_held()
    before = spare.managed_bytes
    rounding = before - spare.active_bytes  # of what other tests keep
    del_me = device.empty((LARGE,), np.uint8)
    taken = spare.managed_bytes
    assert before + LARGE <= taken <= before + LARGE * 9 // 8
    del del_me
    again = device.empty((LARGE,), np.uint8)
    assert spare.managed_bytes == taken
    small = device.empty((memory.MIN_LARGE_BYTES - 1,), np.uint8)
    if device.is_cpu:  # a GPU's small arrays are kept, too
        assert spare.managed_bytes == taken
    del again
    kept = device.plans.shared_bytes + device.workspace.nbytes
    monkeypatch.setattr(device, "spare_bytes", kept + LARGE // 2)
    other = device.empty((3 * LARGE,), np.uint8)  # more than half of LARGE would be held
    assert spare.managed_bytes - spare.active_bytes - rounding <= LARGE // 2
    assert (small.nbytes + 1, other.nbytes) == (memory.MIN_LARGE_BYTES, 3 * LARGE)


def test_a_small_buffer_is_left_alone(
    device: Device, asked: list[tuple[int, int, int]], mapped: list[np.ndarray]
) -> None:
    for nbytes in [1, PAGE, memory.MIN_LARGE_BYTES - 1]:
        memory.ask_for_large_pages(
            device.queue, cl.Buffer(device.context, cl.mem_flags.READ_WRITE, nbytes)
        )
        assert (asked, mapped) == ([], [])


def test_other_systems_and_libraries_are_left_alone(
    device: Device, monkeypatch: pytest.MonkeyPatch, mapped: list[np.ndarray]
) -> None:
    for system, library in (("win32", {}), ("linux", {"CDLL": lambda _: SimpleNamespace()})):
        memory._madvise.cache_clear()
        monkeypatch.setattr(memory, "sys", SimpleNamespace(platform=system))
        monkeypatch.setattr(memory, "ctypes", SimpleNamespace(**library))
        device.empty((LARGE,), np.uint8)
        assert mapped == []


def test_a_device_with_memory_of_its_own_is_left_alone(
    device: Device, asked: list[tuple[int, int, int]]
) -> None:
    other = Device(device.cl_device)
    other.is_cpu = False
    other.empty((LARGE,), np.uint8)
    assert asked == []
