"""A selector is taken wherever a Device is; anything else is refused in one sentence."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import objects
import pytest

import clplen
from clplen.compute.device import Device
from clplen.io import write_lightfield, write_raw

GRID, LAM, LATTICE = objects.GRID, objects.LAM, objects.LATTICE
FRAME = np.tile(np.float32([[1, 2], [3, 4]]), (205, 205))
STORED = clplen.StoredLightField.from_array(objects.samples(3, 3, 32, 32))
WAVE: dict[str, Any] = {"wavelength": LAM}
SNAPSHOT: dict[str, Any] = {"wavelength": LAM, "seed": 1, "index": 0}


def geometry() -> clplen.lightfield.FocusedGeometry:
    """Of 5 x 5 lenslets."""
    device = Device.open()
    raw = objects.focused(device).expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    return clplen.lightfield.FocusedGeometry.of(raw)


def opened(path: Path, device: Any) -> Any:
    """What `open_lightfield` yields."""
    with clplen.open_lightfield(path / "l.h5", device=device) as stored:
        return stored


def scene() -> clplen.SurfaceScene:
    return clplen.SurfaceScene([clplen.cameras.Plane(0.5, texture=objects.texture())])


def bare(name: str) -> Callable[[Path, Any], Any]:
    """The class itself on the fields of an example, with another device."""

    def make(_: Path, device: Any) -> Any:
        kind = getattr(clplen, name)
        one = objects.EXAMPLES[name](Device.open())
        return kind(**(vars(one) | {"device": device}))

    return make


# Every public call with a parameter `device`, by its place and with a device or selector for it.
CALLS: dict[str, Callable[[Path, Any], Any]] = {
    "Coherence.light": lambda _, d: clplen.Coherence(None).light(GRID, index=0, device=d, **WAVE),
    "Coherence.snapshots": lambda _, d: next(
        clplen.Coherence(None).snapshots(GRID, device=d, **WAVE)
    ),
    "ExtendedSource.field": lambda _, d: clplen.wave.ExtendedSource(1e-3, 0.1).field(
        GRID, device=d, **SNAPSHOT
    ),
    "Field": bare("Field"),
    "Field.from_array": lambda _, d: clplen.Field.from_array(
        np.ones((8, 8)), GRID, device=d, **WAVE
    ),
    "FocalStack": bare("FocalStack"),
    "FocusedGeometry.lattice": lambda _, d: geometry().lattice((0.0, 0.0), d),
    "FocusedGeometry.tables": lambda _, d: geometry().tables(d),
    "Image": bare("Image"),
    "IncoherentLight.field": lambda _, d: clplen.wave.IncoherentLight().field(
        GRID, device=d, **SNAPSHOT
    ),
    "LightField": bare("LightField"),
    "LightField.from_array": lambda _, d: clplen.LightField.from_array(
        objects.samples(3, 3, 8, 8), device=d
    ),
    "MicrolensArray.lattice_tables": lambda _, d: objects.MLA.lattice_tables(GRID, d),
    "MicrolensArray.transmission": lambda _, d: objects.MLA.transmission(GRID, LAM, d),
    "Microscope": bare("Microscope"),
    "PlenopticCamera.microscope": lambda _, d: clplen.PlenopticCamera.microscope(
        **objects.MICROSCOPE, device=d
    ),
    "PlenopticCamera.type1": lambda _, d: objects.camera(d),
    "PlenopticCamera.type2": lambda _, d: objects.focused(d),
    "Projector": lambda _, d: clplen.Projector(objects.point_images(), (3, 3), device=d),
    "Propagator": lambda _, d: clplen.Propagator(GRID, 1e-4, device=d, **WAVE),
    "Propagator.of": lambda _, d: clplen.Propagator.of(
        clplen.Propagator(GRID, 1e-4, device=Device.open(), **WAVE).request, d
    ),
    "RandomPhaseMask.field": lambda _, d: clplen.wave.RandomPhaseMask(2e-6).field(
        GRID, device=d, **SNAPSHOT
    ),
    "RawImage": bare("RawImage"),
    "StoredLightField.load": lambda _, d: STORED.load(d),
    "StoredLightField.part": lambda _, d: STORED.part(objects.samples(3, 3, 32, 32), d),
    "SurfaceScene.light_field": lambda _, d: scene().light_field((3, 3), (8, 8), device=d)[0],
    "decode_raw": lambda _, d: clplen.decode_raw(FRAME[:41, :41], LATTICE, device=d),
    "gaussian_beam": lambda _, d: clplen.wave.gaussian_beam(GRID, 1e-5, device=d, **WAVE),
    "open_lightfield": opened,
    "plane_wave": lambda _, d: clplen.wave.plane_wave(GRID, device=d, **WAVE),
    "preparation": lambda _, d: clplen.microscopy.preparation(10, device=d),
    "read_lightfield": lambda path, d: clplen.read_lightfield(path / "l.h5", device=d),
    "read_raw": lambda path, d: clplen.io.read_raw(path / "raw.h5", device=d),
    "rectify": lambda _, d: clplen.microscopy.rectify(FRAME[:41, :41], LATTICE, device=d),
    "spherical_wave": lambda _, d: clplen.wave.spherical_wave(GRID, 1e-3, device=d, **WAVE),
    "stream_all_in_focus": lambda _, d: clplen.lightfield.stream_all_in_focus(
        STORED, disparities=[-1, 0, 1], device=d
    ),
    "stream_depth": lambda _, d: clplen.lightfield.stream_depth(
        STORED, disparities=[-1, 0, 1], cue="energy", device=d
    ),
    "stream_stack": lambda _, d: clplen.lightfield.stream_stack(STORED, disparities=[0], device=d),
}
OPTIONAL = {"open_lightfield", "read_lightfield", "read_raw"}


def takers() -> Iterator[str]:
    """The public functions, classes and methods with a parameter `device`, by name."""
    found = {name: getattr(clplen, name) for name in clplen.__all__}
    for room in ("analysis", "io", "microscopy", "plot"):
        module = importlib.import_module(f"clplen.{room}")
        found |= {name: getattr(module, name) for name in getattr(module, "__all__", ())}
    for name, one in list(found.items()):
        if inspect.isclass(one):
            more = [each for each in dir(one) if not each.startswith("_")]
            found |= {f"{name}.{each}": getattr(one, each) for each in more}
    for name, one in found.items():
        try:
            known = inspect.signature(one).parameters if callable(one) else {}
        except ValueError:  # an exception's own method
            continue
        if "device" in known:
            yield name


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field and a raw image in files."""
    path = tmp_path_factory.mktemp("selectors")
    device = Device.open()
    write_lightfield(path / "l.h5", objects.lightfield(device))
    write_raw(path / "raw.h5", objects.raw(device))
    return path


def test_every_public_call_with_a_device_is_in_the_list() -> None:
    assert set(takers()) == set(CALLS)


def device_of(result: Any) -> Device | None:
    """The device of what was made; None where it has none."""
    found = getattr(result, "device", None)
    return found if isinstance(found, Device) else None


@pytest.mark.parametrize("name", CALLS)
def test_a_selector_is_taken(name: str, device: Device, folder: Path) -> None:
    by_device, by_selector = (CALLS[name](folder, one) for one in (device, device.place))
    assert device_of(by_device) is device_of(by_selector)
    assert device_of(by_selector) in (device, None)
    assert type(by_device) is type(by_selector)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("wrong", [0, 1.5, True, b"cpu", ["cpu"], Device], ids=repr)
def test_anything_else_is_refused(name: str, wrong: Any, folder: Path) -> None:
    with pytest.raises(TypeError, match=r"^device is a Device, .* or a selector such as 'cpu'"):
        CALLS[name](folder, wrong)


@pytest.mark.parametrize("name", CALLS)
def test_none_is_the_default_device_where_that_is_said(name: str, folder: Path) -> None:
    if name in OPTIONAL:
        assert device_of(CALLS[name](folder, None)) in (Device.open(), None)
        return
    with pytest.raises(TypeError, match=r"^device is a Device, .*not None\.$"):
        CALLS[name](folder, None)


@pytest.mark.parametrize("name", CALLS)
def test_a_selector_that_fits_nothing_lists_what_is_there(name: str, folder: Path) -> None:
    with pytest.raises(clplen.DeviceError, match=r"No OpenCL device fits 'nothing like it'\. Here"):
        CALLS[name](folder, "nothing like it")


@pytest.mark.parametrize("wrong", [0, 1.5, b"cpu", ["cpu"]])
def test_open_takes_words(wrong: Any) -> None:
    with pytest.raises(TypeError, match=r"^A selector of devices is a string such as 'cpu'"):
        Device.open(wrong)
