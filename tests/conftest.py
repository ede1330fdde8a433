"""The `device` fixture: every OpenCL device that is there, or those that ``--device`` names."""

from __future__ import annotations

import inspect
import os
import signal
from functools import cache
from pathlib import Path

import launches
import pytest

from clplen.compute.device import Device
from clplen.errors import DeviceError


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--figures", action="store_true", help="run all figure scripts, not one in sixteen"
    )
    parser.addoption(
        "--device",
        action="append",
        default=None,
        help="OpenCL device to test (as for Device.open); may be repeated; default: every one",
    )

    parser.addoption(
        "--variant",
        default=None,
        help="form of shear.cl that is forced: blocks, staged or samples (as CLPLEN_SHEAR does)",
    )

    parser.addoption(
        "--mapping",
        choices=("row", "sample", "both"),
        default=None,
        help="mapping of work-items of the tests of kernels; default: the device's own, and the "
        "other one in the thorough tests",
    )

    parser.addoption(
        "--device-tests-only",
        action="store_true",
        help="leave out what does not depend on the device: references, files, scripts",
    )


def pytest_configure(config: pytest.Config) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells leave it in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    launches.watch()
    os.environ["CLPLEN_TUNING"] = "off"  # tests neither time kernels nor write the user's cache
    if config.getoption("--variant"):
        os.environ["CLPLEN_SHEAR"] = config.getoption("--variant")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--device-tests-only"):
        return
    chosen = [item for item in items if "device" in getattr(item, "fixturenames", ())]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen


@cache
def _devices(config: pytest.Config) -> list[Device]:
    selectors = config.getoption("--device")
    if selectors is None:
        selectors = [device.place for device in Device.all()]
    try:
        return [Device.open(selector) for selector in selectors]
    except DeviceError as error:
        raise pytest.UsageError(str(error)) from error


def _label(device: Device) -> str:
    return f"{device.platform}-{device.name}".replace(" ", "_")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        devices = _devices(metafunc.config)
        metafunc.parametrize("device", devices, ids=[_label(d) for d in devices], scope="session")


@pytest.fixture
def precise(device: Device, request: pytest.FixtureRequest) -> Device:
    """The same hardware in double precision; skipped where it has none.

    A test that names `device` beside it is not skipped, so that its single precision is tested on
    every device: there another device of this machine stands in, if one has double precision.
    """
    capable = [device] if device.has_fp64 else []
    if {"device", "precise"} <= set(inspect.signature(request.function).parameters):
        capable += [other for other in Device.all() if other.has_fp64]
    if not capable:
        pytest.skip(f"{device.name} has no double precision")
    return Device.open(capable[0].place, precision="double")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The real captures: ``$CLPLEN_DATA``, else the folder beside the project."""
    folder = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real captures in {folder}: set CLPLEN_DATA to their folder")
    return folder
