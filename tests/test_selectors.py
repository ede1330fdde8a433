"""A selector is taken wherever a Device is; anything else is refused in one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import objects
import pytest
from public_names import public_objects

import clplen
from clplen.compute.device import Device
from clplen.io import write_image, write_lightfield, write_raw, write_stack

GRID, LAM, LATTICE = objects.GRID, objects.LAM, objects.LATTICE
FRAME = np.tile(np.float32([[1, 2], [3, 4]]), (205, 205))
STORED = clplen.StoredLightField.from_array(objects.samples(3, 3, 32, 32))
WAVE: dict[str, Any] = {"wavelength": LAM}
SNAPSHOT: dict[str, Any] = {"wavelength": LAM, "seed": 1, "index": 0}
OBJECTIVE = clplen.cameras.Objective(20.0, 0.5, 1.0, LAM)
POINT = clplen.PointSources([(0.0, 0.0, 0.0)])


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


def raw_preparation(device: Any) -> Any:
    stored = (np.ones((1, 8, 8), np.float32),)
    images = clplen.microscopy.PointImages(
        {"lenslet_pitch": 1e-4, "magnification": 20.0}, np.array([1e-5]), 1, 8, stored, np.ones(1)
    )
    wave = 1 + np.cos(np.pi * np.arange(64) / 4)
    white = 1000 * np.outer(wave, wave)
    return clplen.microscopy.raw_preparation(images, white=white, device=device)


def bare(name: str) -> Callable[[Path, Any], Any]:
    """The class itself on the fields of an example, with another device."""

    def make(_: Path, device: Any) -> Any:
        one = objects.EXAMPLES[name.rpartition(".")[2]](Device.open())
        kind = type(one)
        return kind(**(vars(one) | {"device": device}))

    return make


# Every public call with a parameter `device`, by its place and with a device or selector for it.
CALLS: dict[str, Callable[[Path, Any], Any]] = {
    "Coherence.light": lambda _, d: clplen.Coherence(None).light(GRID, index=0, device=d, **WAVE),
    "Coherence.snapshots": lambda _, d: next(
        clplen.Coherence(None).snapshots(GRID, device=d, **WAVE)
    ),
    "wave.ExtendedSource.field": lambda _, d: clplen.wave.ExtendedSource(1e-3, 0.1).field(
        GRID, device=d, **SNAPSHOT
    ),
    "Field": bare("Field"),
    "Field.from_array": lambda _, d: clplen.Field.from_array(
        np.ones((8, 8)), GRID, device=d, **WAVE
    ),
    "FocalStack": bare("FocalStack"),
    "lightfield.FocusedGeometry.lattice": lambda _, d: geometry().lattice((0.0, 0.0), d),
    "lightfield.FocusedGeometry.tables": lambda _, d: geometry().tables(d),
    "Image": bare("Image"),
    "wave.IncoherentLight.field": lambda _, d: clplen.wave.IncoherentLight().field(
        GRID, device=d, **SNAPSHOT
    ),
    "LightField": bare("LightField"),
    "OpticalSystem.operator": lambda _, d: objects.system().operator(GRID, device=d, **WAVE),
    "lightfield.RenderOperator": lambda _, d: clplen.lightfield.RenderOperator(
        (3, 3, 8, 8), device=d
    ),
    "lightfield.StackOperator": lambda _, d: clplen.lightfield.StackOperator(
        (3, 3, 8, 8), disparities=[0, 0.5], device=d
    ),
    "lightfield.ViewWarp": lambda _, d: clplen.lightfield.ViewWarp((3, 3, 8, 8), device=d),
    "wave.Space.plan": lambda _, d: clplen.wave.Space(1e-4).plan(GRID, LAM, d),
    "LightField.from_array": lambda _, d: clplen.LightField.from_array(
        objects.samples(3, 3, 8, 8), device=d
    ),
    "MicrolensArray.jacobian": lambda _, d: objects.MLA.jacobian(GRID, LAM, d),
    "MicrolensArray.lattice_tables": lambda _, d: objects.MLA.lattice_tables(GRID, d),
    "MicrolensArray.transmission": lambda _, d: objects.MLA.transmission(GRID, LAM, d),
    "cameras.FourierMicroscope": bare("cameras.FourierMicroscope"),
    "PlenopticCamera.fourier_microscope": lambda _, d: clplen.PlenopticCamera.fourier_microscope(
        **objects.FOURIER, device=d
    ),
    "microscopy.FourierProjector": lambda _, d: clplen.microscopy.FourierProjector(
        objects.fourier_images(), (3, 3), device=d
    ),
    "cameras.Microscope": bare("cameras.Microscope"),
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
    "wave.RandomPhaseMask.field": lambda _, d: clplen.wave.RandomPhaseMask(2e-6).field(
        GRID, device=d, **SNAPSHOT
    ),
    "RawImage": bare("RawImage"),
    "StoredLightField.load": lambda _, d: STORED.load(d),
    "StoredLightField.part": lambda _, d: STORED.part(objects.samples(3, 3, 32, 32), d),
    "SurfaceScene.light_field": lambda _, d: scene().light_field((3, 3), (8, 8), device=d)[0],
    "decode_raw": lambda _, d: clplen.decode_raw(FRAME[:41, :41], LATTICE, device=d),
    "wave.gaussian_beam": lambda _, d: clplen.wave.gaussian_beam(GRID, 1e-5, device=d, **WAVE),
    "open_lightfield": opened,
    "wave.plane_wave": lambda _, d: clplen.wave.plane_wave(GRID, device=d, **WAVE),
    "microscopy.FrameProjector": lambda _, d: objects.frame_projector(d),
    "microscopy.raw_preparation": lambda _, d: raw_preparation(d),
    "microscopy.preparation": lambda _, d: clplen.microscopy.preparation(10, device=d),
    "read_camera": lambda _, d: clplen.read_camera(
        Path(__file__).parents[1] / "examples/cameras/canon_50mm.toml", device=d, count=5
    ),
    "read_lightfield": lambda path, d: clplen.read_lightfield(path / "l.h5", device=d),
    "read_raw": lambda path, d: clplen.io.read_raw(path / "raw.h5", device=d),
    "lightfield.find_corners": lambda _, d: clplen.lightfield.find_corners(
        objects.samples(3, 3, 40, 40), (3, 4), device=d
    ),
    "lightfield.rectify_views": lambda _, d: clplen.lightfield.rectify_views(
        objects.samples(5, 5, 32, 32), objects.intrinsics(), device=d
    ),
    "microscopy.rectify": lambda _, d: clplen.microscopy.rectify(
        FRAME[:41, :41], LATTICE, device=d
    ),
    "wave.spherical_wave": lambda _, d: clplen.wave.spherical_wave(GRID, 1e-3, device=d, **WAVE),
    "lightfield.stack_tiles": lambda _, d: clplen.lightfield.stack_tiles(
        STORED, disparities=[0], device=d
    ),
    "all_in_focus": lambda _, d: clplen.all_in_focus(STORED, disparities=[-1, 0, 1], device=d),
    "microscopy.Deconvolver": lambda _, d: clplen.microscopy.Deconvolver(
        objects.point_images(), clplen.microscopy.DeconvolutionSettings(), device=d, force=True
    ),
    "cameras.Objective.fields": lambda _, d: OBJECTIVE.fields(POINT, GRID, d),
    "cameras.Objective.spectra": lambda _, d: OBJECTIVE.spectra(POINT, GRID, d),
    "cameras.Plenoptic1": bare("cameras.Plenoptic1"),
    "cameras.Plenoptic2": bare("cameras.Plenoptic2"),
    "depth_map": lambda _, d: clplen.depth_map(
        objects.samples(3, 3, 32, 32), disparities=[-1, 0, 1], cue="energy", device=d
    ),
    "focal_stack": lambda _, d: clplen.focal_stack(STORED, disparities=[0], device=d),
    "io.read_image": lambda path, d: clplen.io.read_image(path / "i.tif", device=d),
    "io.read_stack": lambda path, d: clplen.io.read_stack(path / "s.tif", device=d),
    "lightfield.check_light_field": lambda _, d: clplen.lightfield.check_light_field(
        objects.samples(3, 3, 32, 32), device=d
    ),
    "lightfield.fourier_stack": lambda _, d: clplen.lightfield.fourier_stack(
        objects.samples(3, 3, 32, 32), disparities=[0], device=d
    ),
    "lightfield.hyperfan": lambda _, d: clplen.lightfield.hyperfan(
        objects.samples(3, 3, 32, 32), -0.5, 0.5, device=d
    ),
    "lightfield.phase_space": lambda _, d: clplen.lightfield.phase_space(
        objects.samples(3, 3, 32, 32), y=3, v=1, device=d
    ),
    "lightfield.shift_views": lambda _, d: clplen.lightfield.shift_views(
        objects.samples(3, 3, 32, 32), np.zeros((3, 3, 2)), device=d
    ),
    "refocus": lambda _, d: clplen.refocus(objects.samples(3, 3, 32, 32), disparity=0, device=d),
    "lightfield.FocusedImage": bare("lightfield.FocusedImage"),
    "lightfield.FocusedStack": bare("lightfield.FocusedStack"),
    "microscopy.Preparation": bare("microscopy.Preparation"),
    "wave.LensletErrors.phase": lambda _, d: objects.EXAMPLES["LensletErrors"](Device.open()).phase(
        objects.MLA, GRID, LAM, d
    ),
}
# Classes that hold a device, or samples on one: other calls make them.
HOLDERS = {
    "Field",
    "FocalStack",
    "Image",
    "LightField",
    "RawImage",
    "cameras.FourierMicroscope",
    "cameras.Microscope",
    "cameras.Plenoptic1",
    "cameras.Plenoptic2",
    "lightfield.FocusedImage",
    "lightfield.FocusedStack",
    "microscopy.Preparation",
}
# Their `device` is a selector for other processes, the name of what was used, or a protocol's.
OTHERS = {
    "batch.Job",
    "batch.Job.run",
    "batch.Job.with_settings",
    "batch.Report",
    "batch.run_job",
    "lightfield.calibrate",  # needs pictures of boards, and opens them as find_corners does
    "wave.SpatialModel.field",
}


def takers() -> Iterator[tuple[str, inspect.Parameter]]:
    """The public functions, classes and methods with a parameter `device`, by name."""
    objects_by_name = public_objects()
    for name, value in list(objects_by_name.items()):
        if inspect.isclass(value):
            members = [member for member in dir(value) if not member.startswith("_")]
            objects_by_name |= {f"{name}.{member}": getattr(value, member) for member in members}
    for name, value in objects_by_name.items():
        try:
            known = inspect.signature(value).parameters if callable(value) else {}
        except ValueError:  # an exception's own method
            continue
        if "device" in known:
            yield name, known["device"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field and a raw image in files."""
    path = tmp_path_factory.mktemp("selectors")
    device = Device.open()
    write_lightfield(path / "l.h5", objects.lightfield(device))
    write_raw(path / "raw.h5", objects.raw(device))
    write_image(path / "i.tif", objects.EXAMPLES["Image"](device))
    write_stack(path / "s.tif", objects.EXAMPLES["FocalStack"](device))
    return path


def test_every_public_call_with_a_device_is_in_the_list() -> None:
    assert {name for name, _ in takers()} - OTHERS == set(CALLS)


def test_the_device_is_optional_but_for_classes_that_hold_one() -> None:
    asked = {name for name, parameter in takers() if parameter.default is inspect.Parameter.empty}
    assert asked == HOLDERS


def test_devices_opened_by_default_are_one(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    field = clplen.wave.plane_wave(GRID, wavelength=LAM)
    plan = clplen.Propagator(GRID, 1e-4, wavelength=LAM)
    assert field.device is plan.device is Device.open() is device
    assert plan(field).shape == GRID.shape


def device_of(result: Any) -> Device | None:
    """The device of what was made; None where it has none."""
    found = getattr(result, "device", None)
    return found if isinstance(found, Device) else None


def test_a_device_a_selector_or_none_is_taken(
    device: Device, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    for name, call in CALLS.items():
        by_selector = call(folder, device.place)
        assert device_of(by_selector) in (device, None)
        by_other = call(folder, device if name in HOLDERS else None)
        assert device_of(by_other) is device_of(by_selector)
        assert type(by_other) is type(by_selector)


def test_anything_else_is_refused(folder: Path) -> None:
    for name in CALLS:
        for wrong in (0, ["cpu"]):
            with pytest.raises(
                TypeError, match=r"^device must be a Device, .* or a selector such as 'cpu'"
            ):
                CALLS[name](folder, wrong)
        with pytest.raises(
            clplen.DeviceError, match=r"No OpenCL device matches 'nothing like it'\. Avail"
        ):
            CALLS[name](folder, "nothing like it")


def test_samples_on_a_device_say_which(folder: Path) -> None:
    for name in ["Field", "FocalStack", "Image", "LightField", "RawImage"]:
        with pytest.raises(TypeError, match=r"^device must be a Device, .*got None\.$"):
            CALLS[name](folder, None)


def test_open_takes_words() -> None:
    for wrong in [0, 1.5, b"cpu", ["cpu"]]:
        with pytest.raises(TypeError, match=r"^selector must be a string such as 'cpu'"):
            Device.open(wrong)
