"""Every kernel test runs with both mappings: an item a row (CPUs) and an item a sample (GPUs)."""

from __future__ import annotations

import pytest

from clplen.compute.device import Device


@pytest.fixture(autouse=True, params=["row", "sample"])
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
