"""What public classes share: pickling, copies, arrays of NumPy, a short representation."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import objects
import pyopencl.array
import pytest
from public_names import public_classes

import clplen
from clplen.compute.device import Device
from clplen.reprs import MAX_LENGTH, OneLine

ROOT = Path(__file__).parents[1]
# Every public class that can be made, by its name alone; protocols cannot.
KINDS = {
    name.rpartition(".")[2]: kind
    for name, kind in public_classes().items()
    if not getattr(kind, "_is_protocol", False)
}
# One sentence in place of a copy: tiles that are made while they are read.
NEVER = {"StackTiles"}
ARRAYS = {
    "DeconvolutionResult": lambda one: one.volume,
    "DepthMap": lambda one: one.disparity,
    "Field": lambda one: one.data.get(),
    "FocalStack": lambda one: one.data.get(),
    "FocusedImage": lambda one: one.data.get(),
    "FocusedStack": lambda one: one.data.get(),
    "Image": lambda one: one.data.get(),
    "LightField": lambda one: one.data.get(),
    "MeanIntensity": lambda one: one.intensity.data.get(),
    "OTF": lambda one: one.values,
    "Occluder": lambda one: one.opacity,
    "PSF": lambda one: one.values,
    "PhaseSpace": lambda one: one.values,
    "PicturePlane": lambda one: one.image,
    "RawImage": lambda one: one.data.get(),
    "StoredLightField": lambda one: objects.samples(3, 3, 32, 32),
    "Texture": lambda one: one.samples,
    "Truth": lambda one: one.disparity,
}
SHARED = {  # arrays of the host, which NumPy takes without a copy
    "DepthMap", "PSF", "OTF", "Truth", "Texture", "PicturePlane", "PhaseSpace",
    "DeconvolutionResult", "Occluder",
}  # fmt: skip


@pytest.fixture(scope="module")
def examples(device: Device) -> dict[str, Any]:
    """An object of every public class."""
    return {name: make(device) for name, make in objects.EXAMPLES.items()}


def frozen(value: Any) -> Any:
    """Return the values of an object as nested tuples, arrays as their bytes."""
    if isinstance(value, pyopencl.array.Array):
        value = value.get()
    if isinstance(value, np.ndarray):
        return value.shape, str(value.dtype), value.tobytes()
    if isinstance(value, list | tuple):
        return tuple(frozen(one) for one in value)
    if isinstance(value, Mapping):
        return tuple((key, frozen(one)) for key, one in value.items())
    if isinstance(value, Device | type | FunctionType | None):
        return repr(value)
    if isinstance(value, Exception):
        return type(value), str(value)
    fields = {k: v for k, v in getattr(value, "__dict__", {}).items() if k[0] != "_"}
    if is_dataclass(value):
        names = [field.name for field in dataclass_fields(value)]
        fields |= {name: getattr(value, name, None) for name in names}
    return type(value), frozen(fields) if hasattr(value, "__dict__") or fields else repr(value)


def same(a: Any, b: Any) -> bool:
    """Whether two objects hold the same values, of arrays the same bits."""
    return bool(frozen(a) == frozen(b))


def test_there_is_an_example_of_every_public_class() -> None:
    assert set(objects.EXAMPLES) == set(KINDS)
    assert {name for name in KINDS if hasattr(KINDS[name], "to_numpy")} == set(ARRAYS)


def test_every_public_object_is_pickled_and_copied_or_raises(examples: dict[str, Any]) -> None:
    assert not same(objects.samples(3), 2 * objects.samples(3))
    for name, one in examples.items():
        if name in NEVER:
            for way in (pickle.dumps, copy.copy, copy.deepcopy):
                with pytest.raises(TypeError, match=r"cannot be copied or pickled: "):
                    way(one)
            continue
        for protocol in (2, pickle.HIGHEST_PROTOCOL):
            assert same(pickle.loads(pickle.dumps(one, protocol)), one), name
        assert same(copy.deepcopy(one), one), name
        assert same(copy.copy(one), one), name


def test_every_camera_is_pickled_and_copied(device: Device) -> None:
    scene = clplen.PointSources([(0.0, 0.0, 0.0)])
    for camera in (
        objects.camera(device),
        objects.focused(device),
        clplen.PlenopticCamera.microscope(**objects.MICROSCOPE, device=device),
    ):
        wanted = camera.expose(scene).to_numpy()
        for twin in (pickle.loads(pickle.dumps(camera)), copy.deepcopy(camera), copy.copy(camera)):
            assert twin == camera
            assert twin.device is device
            np.testing.assert_array_equal(twin.expose(scene).to_numpy(), wanted)


def test_plans_are_pickled_after_they_were_used(device: Device) -> None:
    field = objects.field(device)
    plan = objects.EXAMPLES["Propagator"](device)
    wanted = plan(field).to_numpy()
    for twin in (pickle.loads(pickle.dumps(plan)), copy.deepcopy(plan)):
        np.testing.assert_array_equal(twin(field).to_numpy(), wanted)
    projector = objects.EXAMPLES["Projector"](device)
    volume = objects.samples(*projector.volume_shape)
    frame = projector.forward(volume)
    for other in (pickle.loads(pickle.dumps(projector)), copy.deepcopy(projector)):
        np.testing.assert_array_equal(other.forward(volume), frame)


def test_a_deep_copy_has_samples_of_its_own_and_a_shallow_one_has_not(device: Device) -> None:
    lf = objects.lightfield(device)
    assert copy.copy(lf).data is lf.data
    twin = copy.deepcopy(lf)
    twin.data.fill(0)
    assert lf.to_numpy().any()
    assert copy.copy(device) is copy.deepcopy(device) is pickle.loads(pickle.dumps(device))
    assert twin.device is device


def test_a_light_field_keeps_its_raw_image_and_camera(device: Device) -> None:
    lf = clplen.LightField.from_raw(objects.raw(device))
    twin = pickle.loads(pickle.dumps(lf))
    assert twin.camera == lf.camera
    np.testing.assert_array_equal(twin.raw.to_numpy(), lf.raw.to_numpy())


def test_precision_is_pickled(precise: Device) -> None:
    field = pickle.loads(pickle.dumps(objects.field(precise)))
    assert field.device is precise
    assert field.data.dtype == np.complex128


def test_a_device_that_is_not_here_is_said_by_name(device: Device) -> None:
    remake, (place, _, platform, precision) = device.__reduce__()
    with pytest.raises(clplen.DeviceError, match=r"made on Other \(.*\), which this computer"):
        remake(place, "Other", platform, precision)
    assert remake("9:9", device.name, platform, precision) is device  # found by its name


def test_what_a_file_holds_is_not_pickled(device: Device, tmp_path: Path) -> None:
    objects.lightfield(device)
    np.save(tmp_path / "l.npy", objects.samples(3, 3, 32, 32))
    from clplen.io import write_views

    write_views(tmp_path / "views", objects.lightfield(device))
    with clplen.open_lightfield(tmp_path / "views", device=device) as stored:
        with pytest.raises(TypeError, match=r"open it in the other process"):
            pickle.dumps(stored)
        assert copy.copy(stored) is copy.deepcopy(stored) is stored


SPAWN = """
import multiprocessing, sys
import clplen, objects

def look(thing):
    return type(thing).__name__, thing.to_numpy().sum()

if __name__ == "__main__":
    device = clplen.Device.open(sys.argv[1])
    things = [objects.EXAMPLES[name](device) for name in ("LightField", "Field", "MeanIntensity")]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map(look, things)
    assert found == [look(thing) for thing in things], found
    print("alike")
"""


@pytest.mark.thorough
def test_objects_go_to_another_process_by_spawn(device: Device, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SPAWN)
    paths = [str(ROOT), str(ROOT / "tests"), *sys.path]
    done = subprocess.run(
        [sys.executable, str(tmp_path / "script.py"), device.place],
        # each process warns of the CPU name that PoCL was given
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONWARNINGS": "ignore::RuntimeWarning"},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("alike\n", "")


def test_numpy_takes_the_samples(examples: dict[str, Any]) -> None:
    for name, samples in ARRAYS.items():
        one = examples[name]
        values = np.asarray(samples(one))
        for array in (np.asarray(one), one.to_numpy(), np.array(one), np.from_dlpack(one)):
            assert type(array) is np.ndarray, name
            assert array.dtype == values.dtype, name
            np.testing.assert_array_equal(array, values, name)
        np.testing.assert_array_equal(np.array(one), np.array(one, copy=True), name)
        half = np.asarray(one, dtype=np.complex64)
        assert half.dtype == np.complex64, name
        np.testing.assert_array_equal(half, values.astype(np.complex64), name)
        assert one.__dlpack_device__() == (1, 0), name
        assert not np.shares_memory(one.__array__(copy=True), one.__array__()), name


def test_a_copy_is_not_promised_away(examples: dict[str, Any]) -> None:
    for name, samples in ARRAYS.items():
        one = examples[name]
        if name in SHARED:
            assert np.shares_memory(one.__array__(copy=False), samples(one)), name
        else:
            with pytest.raises(ValueError, match=r"without a copy; omit copy=False"):
                one.__array__(copy=False)
            with pytest.raises(BufferError, match=r"without a copy"):
                one.__dlpack__(copy=False)
        with pytest.raises(ValueError, match=r"array of dtype int8 without a copy"):
            one.__array__(np.int8, copy=False)


def test_every_representation_is_one_short_line(examples: dict[str, Any]) -> None:
    for name, one in examples.items():
        text = repr(one)
        assert 0 < len(text) <= MAX_LENGTH, name
        assert text.isprintable(), name
        assert KINDS[name].__name__ in text or name == "PlenopticCamera", name
    for name in ("Field", "FocalStack", "FocusedStack", "Image", "LightField", "RawImage"):
        one = examples[name]
        for word in (str(one.shape), str(one.data.dtype), one.device.name):
            assert word in repr(one)


def test_a_long_representation_is_cut() -> None:
    @dataclass(repr=False)
    class Thing(OneLine):
        a: Any
        b: Any
        c: Any

    assert repr(Thing(0.1 + 0.2, (1, 2.5), np.zeros((3, 4)))) == (
        "Thing(a=0.3, b=(1, 2.5), c=<float64 (3, 4)>)"
    )
    assert repr(Thing("x" * 300, [1] * 7, np.float64(2))) == "Thing(a=..., b=<7 of int>, c=2)"
    assert repr(Thing("a\n\nb", (1,), threading)).startswith("Thing(a='a\\n\\nb', b=(1,), c=<mod")
