"""llvmpipe is taken last, works like a GPU, and says that it ends long loops."""

from __future__ import annotations

from types import SimpleNamespace

import pyopencl as cl
import pytest

from clplen.compute.device import Device
from clplen.compute.drivers import pocl, selection

CPU, GPU = cl.device_type.CPU, cl.device_type.GPU


def fake(name: str, kind: int, platform: str) -> SimpleNamespace:
    """An OpenCL device as far as `Device` and `select` look at it."""
    words = SimpleNamespace(name=platform, vendor="somebody", version="OpenCL 3.0")
    return SimpleNamespace(
        name=name, type=kind, platform=words, vendor="Mesa", driver_version="22.3.6",
        extensions="", global_mem_size=2**31,
    )  # fmt: skip


LLVMPIPE = fake("llvmpipe (LLVM 15.0.6, 256 bits)", CPU, "rusticl")
POCL = fake("pthread-Intel(R) Xeon", CPU, "Portable Computing Language")
RADEON = fake("AMD Radeon RX 6800 (navi21)", GPU, "rusticl")


def test_llvmpipe_is_last_unless_it_is_named():
    for there, selector, names in [
        ([LLVMPIPE, POCL], None, [POCL, LLVMPIPE]),
        ([LLVMPIPE, POCL, RADEON], None, [RADEON, POCL, LLVMPIPE]),
        ([LLVMPIPE, POCL], "cpu", [POCL, LLVMPIPE]),
        ([POCL, LLVMPIPE, RADEON], "rusticl", [LLVMPIPE, RADEON]),
        ([POCL, LLVMPIPE], "llvmpipe", [LLVMPIPE]),
        ([LLVMPIPE, POCL], "0:0", [LLVMPIPE]),
        ([LLVMPIPE], None, [LLVMPIPE]),
    ]:
        found = selection.select([(f"{n}:0", d) for n, d in enumerate(there)], selector)
        assert [d for _, d in found] == names


def test_llvmpipe_gets_an_item_a_sample_and_other_cpus_an_item_a_row():
    assert Device(LLVMPIPE).is_cpu
    assert not Device(LLVMPIPE).rows
    assert Device(POCL).rows
    assert not Device(RADEON).rows


@pytest.mark.parametrize("cut", [True, False])
def test_a_loop_that_ends_early_is_found(device, monkeypatch, cut):
    if cut:
        monkeypatch.setattr(selection, "_PROBE", selection._PROBE.replace("i < n", "i < n - 1"))
    monkeypatch.setattr(selection, "is_llvmpipe", lambda cl_device: True)
    measured = selection.loops_are_cut.__wrapped__(device.cl_device)
    assert measured or not cut
    if "llvmpipe" not in device.name:
        assert measured == cut


def test_a_device_that_is_not_llvmpipe_is_not_tried():
    assert not selection.loops_are_cut.__wrapped__(
        POCL
    )  # which has nothing that could run a kernel


def test_what_is_cut_is_said_once(monkeypatch):
    monkeypatch.setattr(pocl, "ensure_usable", lambda cl_device: "")
    monkeypatch.setattr(selection, "loops_are_cut", lambda cl_device: cl_device is LLVMPIPE)
    opened = Device(LLVMPIPE)
    with pytest.warns(RuntimeWarning, match="llvmpipe ends the loops of a work-item after 65535"):
        opened.ensure_usable()
    opened.ensure_usable()
    assert opened.note.endswith("use it for trials only.")


def test_a_new_name_for_pocl_is_a_note_without_a_warning(monkeypatch):
    monkeypatch.setattr(pocl, "ensure_usable", lambda cl_device: "A new name.")
    monkeypatch.setattr(selection, "warning", lambda cl_device: "")
    opened = Device(POCL)
    opened.ensure_usable()  # warnings are errors in tests
    assert opened.note == "A new name."
