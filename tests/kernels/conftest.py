"""Kernel tests have two mappings: an item a row (CPUs) and an item a sample (GPUs).

Quick are those with the mapping that the device uses by itself; the other is marked thorough.
``--mapping`` chooses instead: row, sample or both, and nothing is marked.
"""

from __future__ import annotations

import pytest

from clplen.compute.device import Device


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
