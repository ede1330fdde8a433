"""What every public class shares: pickling, copies, arrays of NumPy, a short representation."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import objects
import pyopencl.array as cla
import pytest
from public_names import public_classes

import clplen
from clplen.compute.device import Device
from clplen.reprs import LONGEST, OneLine

ROOT = Path(__file__).parents[1]
# Every public class that can be made, by its name alone; protocols cannot.
KINDS = {
    name.rpartition(".")[2]: kind
    for name, kind in public_classes().items()
    if not getattr(kind, "_is_protocol", False)
}
CLASSES = sorted(KINDS)
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


def same(a: Any, b: Any) -> bool:
    """Compare two objects value by value, arrays bit by bit."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray | cla.Array):
        left, right = (x if isinstance(x, np.ndarray) else x.get() for x in (a, b))
        return left.dtype == right.dtype and left.tobytes() == right.tobytes()
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[name], b[name]) for name in a)
    if isinstance(a, Exception):
        return str(a) == str(b)
    if isinstance(a, Device | FunctionType | type):
        return a is b
    fields = {name: x for name, x in getattr(a, "__dict__", {}).items() if name[0] != "_"}
    if not fields:  # numbers, texts, and what has no public state
        return a == b or type(a).__repr__ is object.__repr__ or repr(a) == repr(b)
    return all(same(x, b.__dict__[name]) for name, x in fields.items())


def test_there_is_an_example_of_every_public_class() -> None:
    assert set(objects.EXAMPLES) == set(CLASSES)


@pytest.mark.parametrize("name", CLASSES)
def test_every_public_object_is_pickled_and_copied_or_says_why_not(
    name: str, device: Device
) -> None:
    one = objects.EXAMPLES[name](device)
    if name in NEVER:
        for way in (pickle.dumps, copy.copy, copy.deepcopy):
            with pytest.raises(TypeError, match=r"cannot be copied or pickled: "):
                way(one)
        return
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        assert same(pickle.loads(pickle.dumps(one, protocol)), one)
    assert same(copy.deepcopy(one), one)
    assert same(copy.copy(one), one)


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
    with pytest.raises(clplen.DeviceError, match=r"pickled on Other \(.*\), which is not here"):
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
        # that PoCL was given another CPU name is said by each process
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONWARNINGS": "ignore::RuntimeWarning"},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("alike\n", "")


def test_every_class_with_samples_is_in_the_list() -> None:
    assert {name for name in CLASSES if hasattr(KINDS[name], "to_numpy")} == set(ARRAYS)


@pytest.mark.parametrize("name", sorted(ARRAYS))
def test_numpy_takes_the_samples(name: str, device: Device) -> None:
    one, wanted = objects.EXAMPLES[name](device), ARRAYS[name]
    values = np.asarray(wanted(one))
    for found in (np.asarray(one), one.to_numpy(), np.array(one), np.from_dlpack(one)):
        assert type(found) is np.ndarray
        assert found.dtype == values.dtype
        np.testing.assert_array_equal(found, values)
    np.testing.assert_array_equal(np.array(one), np.array(one, copy=True))
    half = np.asarray(one, dtype=np.complex64)
    assert half.dtype == np.complex64
    np.testing.assert_array_equal(half, values.astype(np.complex64))
    assert one.__dlpack_device__() == (1, 0)
    assert not np.shares_memory(one.__array__(copy=True), one.__array__())


@pytest.mark.parametrize("name", sorted(ARRAYS))
def test_a_copy_is_not_promised_away(name: str, device: Device) -> None:
    one = objects.EXAMPLES[name](device)
    if name in ("DepthMap", "PSF", "OTF", "Truth", "Texture", "PicturePlane", "PhaseSpace",
                "DeconvolutionResult", "Occluder"):  # fmt: skip
        assert np.shares_memory(one.__array__(copy=False), ARRAYS[name](one))
    else:
        with pytest.raises(ValueError, match=r"only by a copy: leave out copy=False"):
            one.__array__(copy=False)
        with pytest.raises(BufferError, match=r"only by a copy"):
            one.__dlpack__(copy=False)
    with pytest.raises(ValueError, match=r"array of int8 only by a copy"):
        one.__array__(np.int8, copy=False)


@pytest.mark.parametrize("name", CLASSES)
def test_every_representation_is_one_short_line(name: str, device: Device) -> None:
    text = repr(objects.EXAMPLES[name](device))
    assert 0 < len(text) <= LONGEST
    assert text.isprintable()
    assert KINDS[name].__name__ in text or name in ("PlenopticCamera",)


@pytest.mark.parametrize(
    "name", ["Field", "FocalStack", "FocusedStack", "Image", "LightField", "RawImage"]
)
def test_representations_tell_shape_type_and_device(name: str, device: Device) -> None:
    one = objects.EXAMPLES[name](device)
    for word in (str(one.shape), str(one.data.dtype), device.name):
        assert word in repr(one)


def test_a_line_is_cut_where_it_is_longest() -> None:
    from dataclasses import dataclass

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
