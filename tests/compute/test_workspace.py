"""Host memory that is lent, kept and given back, to threads, too; parts of arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Barrier, Event
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
from reference_lines import apply
from tolerance import fft_tolerance, relative_max

from clplen.compute.device import Device
from clplen.compute.fft import columns
from clplen.compute.fft.blocks import Spectrum, run
from clplen.compute.fft.lines import Separable, padded_spectrum
from clplen.compute.fft.plans import Slots, Workspace
from clplen.compute.fft.routes import FFTRoute
from clplen.errors import DeviceError

BYTE, COMPLEX = np.dtype(np.uint8), np.dtype(np.complex64)


def lent(workspace: Workspace, *shape: int, dtype: np.dtype = BYTE) -> int:
    """Borrow and give back; the address of what was lent."""
    with workspace.borrow(shape, dtype) as array:
        assert (array.shape, array.dtype) == (shape, dtype)
        array[...] = 1
        return array.ctypes.data


def test_what_came_back_is_lent_again() -> None:
    workspace = Workspace(1000)
    assert workspace.nbytes == 0
    place = lent(workspace, 3, 5, 8, dtype=COMPLEX)
    assert workspace.nbytes == 960
    assert lent(workspace, 7) == place  # less fits into it
    assert workspace.nbytes == 960
    lent(workspace, 961)
    assert workspace.nbytes == 961
    lent(workspace, 1001)  # more than the limit is not kept
    assert workspace.nbytes == 0
    with workspace.borrow((50,), BYTE) as array:
        workspace.clear()
        array[...] = 7
    assert workspace.nbytes == 50
    workspace.clear()
    assert workspace.nbytes == 0


def test_two_borrowers_never_share() -> None:
    workspace = Workspace(1000)
    lent(workspace, 100)
    with workspace.borrow((100,), BYTE) as one, workspace.borrow((100,), BYTE) as other:
        assert workspace.nbytes == 0  # all of it is out
        assert not np.may_share_memory(one, other)
    assert workspace.nbytes == 100


def test_a_failure_gives_memory_back() -> None:
    workspace = Workspace(1000)
    with pytest.raises(MemoryError), workspace.borrow((50,), BYTE):
        raise MemoryError
    assert workspace.nbytes == 50


def test_slots_are_apart_and_grow() -> None:
    slots = Slots()
    one, other = slots.take(0, (2, 3), COMPLEX), slots.take(1, (2, 3), COMPLEX)
    assert not np.may_share_memory(one, other)
    assert np.shares_memory(one, slots.take(0, (6,), COMPLEX))
    assert slots.take(0, (5, 3), COMPLEX).shape == (5, 3)


class Watched(Workspace):
    """Remembers how many threads were at work whenever memory came back."""

    def __init__(self, at_work: list[int]) -> None:
        super().__init__(10**6)
        self.at_work = at_work
        self.found: list[int] = []
        self.given_back = Event()

    @contextmanager
    def borrow(self, shape: Sequence[int], dtype: np.dtype) -> Iterator[np.ndarray]:
        try:
            with super().borrow(shape, dtype) as array:
                yield array
        finally:
            self.found.append(len(self.at_work))
            self.given_back.set()


@pytest.mark.parametrize("failing", [0, 1], ids=["the caller", "the other"])
def test_a_failing_thread_stops_the_others_before_their_memory_is_lent_again(
    device: Device, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """Of two threads one fails while the other is in the midst of its first block."""
    on = Device(device.cl_device)
    on.fft = FFTRoute("scipy", 2)
    maps = Separable((padded_spectrum(6, 13),), (padded_spectrum(7, 10),))
    both, at_work, parts, slots = Barrier(2, timeout=10), [1, 1], [], []
    workspace = Watched(at_work)

    def numbered() -> Slots:
        slots.append(Slots())
        return slots[-1]

    def one_fails(worker: columns._Worker, *arguments: object, **options: object) -> int:
        parts.append(arguments)
        if len(parts) <= 2:  # each thread's first block
            both.wait()
            if worker.slots is slots[failing]:
                at_work.pop()
                raise MemoryError("no room for a block")
            workspace.given_back.wait(0.3)  # in this time nothing may come back
            at_work.pop()
        return 0

    u = (np.arange(3 * 6 * 7) ** 2 % 17 + 1j).reshape(3, 6, 7).astype(on.complex)
    with monkeypatch.context() as patch:
        patch.setattr(columns, "BLOCK_BYTES", 1)
        patch.setattr(columns, "MIN_BLOCK_LINES", 1)
        patch.setattr(columns, "Slots", numbered)
        patch.setattr(columns._Worker, "apply", one_fails)
        patch.setattr(on, "workspace", workspace)
        patch.setattr(on, "retry_with_room", lambda act: act())  # once only
        with pytest.raises(DeviceError, match="no room"):
            run(on.upload(u), maps, [], [], on)
    assert workspace.found == [0]
    assert len(parts) == 2  # of 18
    (result,) = run(on.upload(u), maps, [], [], on)  # and right again
    tolerance = 2 * fft_tolerance((13, 10), on.complex)
    assert relative_max(apply(u, maps.y, maps.x), on.download(result)) <= tolerance


def test_two_threads_take_factors_to_the_host_once() -> None:
    """From a device that is no CPU."""
    first, second = Event(), Event()
    values = np.arange(20.0).reshape(4, 5)

    def slow(array: np.ndarray) -> np.ndarray:
        (second if first.is_set() else first).set()
        second.wait(0.2)  # time enough for another thread to come here, too
        return array.copy()

    gpu = SimpleNamespace(is_cpu=False, download=slow)
    spectrum = Spectrum(values, (8, 6), turned=True)

    def taken() -> np.ndarray:
        with spectrum.on_host(gpu) as factors:
            return factors.values

    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(taken)
        assert first.wait(10)
        other = pool.submit(taken)
        assert one.result() is other.result()
    assert not second.is_set()
    np.testing.assert_array_equal(one.result(), values)


def test_what_is_only_read_is_mapped_to_be_read(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A map that may be written makes the runtime bring every page back."""
    asked, enqueue = [], cl.enqueue_map_buffer

    def watched(queue: cl.CommandQueue, buffer: cl.Buffer, flags: int, *rest: object) -> object:
        asked.append(flags)
        return enqueue(queue, buffer, flags, *rest)

    values = np.arange(6.0)
    array = device.upload(values)
    monkeypatch.setattr(cl, "enqueue_map_buffer", watched)
    with device.on_host(array, write=False) as seen:
        np.testing.assert_array_equal(seen, values)
    with device.on_host(array) as seen:
        seen[2] = 9
    if device.is_cpu:
        assert asked == [cl.map_flags.READ, cl.map_flags.READ | cl.map_flags.WRITE]
    np.testing.assert_array_equal(device.download(array), [0, 1, 9, 3, 4, 5])


def test_the_larger_of_two_is_kept() -> None:
    workspace = Workspace(1000)
    for first, second in ((100, 300), (300, 100)):
        with workspace.borrow((first,), BYTE), workspace.borrow((second,), BYTE):
            pass
        assert workspace.nbytes == 300
        workspace.clear()


def test_parts_of_arrays_are_copied_where_they_belong(device: Device) -> None:
    """From the second of three rows to the third of four rows of part of an array."""
    values = np.arange(15, dtype=np.float32).reshape(3, 5)
    source, target = device.upload(values), device.zeros((5, 5), np.float32)
    device.copy_into(target[1:], source[1], 2 * values[0].nbytes)
    expected = np.zeros((5, 5), np.float32)
    expected[3] = values[1]
    np.testing.assert_array_equal(device.download(target), expected)
