"""Kernel tests have two mappings: an item a row (CPUs) and an item a sample (GPUs).

Quick are those with the mapping that the device uses by itself; the other is marked thorough.
``--mapping`` chooses instead: row, sample or both, and nothing is marked. Every launch of a kernel
is compared with what its file declares.
"""

from __future__ import annotations

from typing import Any

import pyopencl as cl
import pytest
from launches import complaints

from clplen.compute.device import Device
from clplen.compute.launcher import Launcher

BUILT: dict[cl.Kernel, tuple[str, dict[str, Any]]] = {}  # file and definitions of each kernel


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "mapping" in metafunc.fixturenames:
        chosen = metafunc.config.getoption("--mapping")
        mappings = [chosen] if chosen in ("row", "sample") else ["row", "sample"]
        metafunc.parametrize("mapping", mappings, indirect=True)


@pytest.hookimpl(tryfirst=True)  # before tests are left out by their marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--mapping"):
        return
    for item in items:
        parameters = getattr(item, "callspec", None) and item.callspec.params
        if parameters and {"mapping", "device"} <= set(parameters):
            own = "row" if parameters["device"].rows else "sample"
            if parameters["mapping"] != own:
                item.add_marker(pytest.mark.thorough)


@pytest.fixture(autouse=True)
def mapping(request: pytest.FixtureRequest, device: Device, monkeypatch: pytest.MonkeyPatch) -> str:
    """Force the mapping of work-items."""
    monkeypatch.setattr(device, "rows", request.param == "row")
    return str(request.param)


@pytest.fixture(autouse=True)
def _launches_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare the arguments of every launch with the kernel's."""
    build, launch = Launcher.kernel, Launcher.launch

    def kernel(self: Launcher, file: str, name: str, **defines: Any) -> cl.Kernel:
        built = build(self, file, name, **defines)
        BUILT[built] = (file, defines)
        return built

    def checked(self: Launcher, built: cl.Kernel, size: Any, *args: Any, **more: Any) -> None:
        if built in BUILT:
            file, defines = BUILT[built]
            assert list(complaints(file, built.function_name, args, defines)) == []
        launch(self, built, size, *args, **more)

    monkeypatch.setattr(Launcher, "kernel", kernel)
    monkeypatch.setattr(Launcher, "launch", checked)


@pytest.fixture
def wave(device: Device, request: pytest.FixtureRequest) -> Device:
    """The device in single or in double precision (indirect parameter)."""
    double = request.param == "double"
    return request.getfixturevalue("precise") if double else device


@pytest.fixture
def precise(precise: Device, mapping: str, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device in double precision, same mapping."""
    monkeypatch.setattr(precise, "rows", mapping == "row")
    return precise
