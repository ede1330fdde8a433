"""One device for what reads files alike on every device."""

from __future__ import annotations

import pytest

from clplen.compute.device import Device


@pytest.fixture(scope="session")
def one_device(request: pytest.FixtureRequest) -> Device:
    """The first of --device, else the default."""
    chosen = request.config.getoption("--device")
    return Device.open(chosen[0] if chosen else None)
