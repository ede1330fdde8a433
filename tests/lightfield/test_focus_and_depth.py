"""The public functions make the same of a light field in a file as of one on the device."""

from __future__ import annotations

import numpy as np
import pytest

import clplen
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import DeviceError, ShapeError
from clplen.io import open_lightfield, write_lightfield
from clplen.lightfield.depth.depth_maps import CUES, DepthMap
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.lightfield.streaming import tile_reading

PLANES = np.linspace(-0.6, 0.8, 5)
SPACING = (-1e-3, -1.1e-3, 1.3e-4, 0.9e-4)
SHAPE = (3, 4, 90, 70)


@pytest.fixture(scope="module")
def samples():
    """Grey samples of a tilted, textured plane with a little noise."""
    rng = np.random.default_rng(3)
    texture = rng.random((130, 130))
    y, x = np.mgrid[: SHAPE[2], : SHAPE[3]]
    values = np.empty(SHAPE, np.float32)
    for v, u in np.ndindex(*SHAPE[:2]):
        rows = np.rint(y + 20 + x / 70 * (v - 1)).astype(int)
        columns = np.rint(x + 20 + x / 70 * (u - 1.5)).astype(int)
        values[v, u] = texture[rows, columns]
    return (250 * values + 5 * rng.random(SHAPE)).astype(np.uint8)


@pytest.fixture(scope="module", params=["hdf5", "numpy"])
def pair(request, samples, device, tmp_path_factory):
    """The same light field on the device, and stored in a file that is open."""
    folder = tmp_path_factory.mktemp("stored")
    if request.param == "numpy":
        np.save(folder / "lf.npy", samples)
        path, lf = folder / "lf.npy", LightField.from_array(samples, device=device)
    else:
        weights = np.random.default_rng(2).random(SHAPE[:2]) + 0.1
        lf = LightField.from_array(samples, device=device, spacing=SPACING, weights=weights)
        path = folder / "lf.h5"
        write_lightfield(path, lf)
    with open_lightfield(path, device=device) as source:
        assert isinstance(source, StoredLightField)
        yield lf, source


@pytest.fixture
def tiles(monkeypatch):
    """How many tiles each computation took; whole light fields are loaded and count as one."""
    counts = []
    read, load = tile_reading._read, StoredLightField.load

    def count(source, tile, buffer):
        counts.append(tile)
        return read(source, tile, buffer)

    def loaded(source, device):
        counts.append("everything")
        return load(source, device)

    monkeypatch.setattr(tile_reading, "_read", count)
    monkeypatch.setattr(StoredLightField, "load", loaded)
    return counts


def budget(call, memory=1000):
    """The least memory with which a computation runs, as its error says."""
    with pytest.raises(ValueError, match="smallest tile") as info:
        call(memory=memory)
    return int(str(info.value).split("needs ")[1].split(";")[0].replace(",", ""))


def equal_stacks(a, b):
    np.testing.assert_array_equal(a.to_numpy(), b.to_numpy())
    for name in ("disparities", "alphas", "weights", "positions"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
    assert (a.spacing, a.camera, a.device) == (b.spacing, b.camera, b.device)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("aperture", [None, 2])
def test_focal_stack(device, pair, tiles, interpolation, aperture):
    lf, source = pair
    words = {"disparities": PLANES, "interpolation": interpolation, "aperture": aperture}
    expected = focal_stack(lf, **words)
    result = focal_stack(source, **words, device=device)
    assert tiles == ["everything"]
    equal_stacks(result, expected)
    tiles.clear()
    least = budget(
        lambda **more: focal_stack(source, **words, **more, device=device), expected.data.nbytes
    )
    result = focal_stack(source, **words, memory=least, device=device)
    assert isinstance(result, FocalStack)
    assert len(tiles) > 2
    assert "everything" not in tiles
    equal_stacks(result, expected)


def test_focal_stack_by_alphas(device, pair, tiles):
    lf, source = pair
    if lf.spacing is None:
        with pytest.raises(ValueError, match="spacing"):
            focal_stack(source, alphas=[0.9, 1.1], device=device)
        return
    words = {"alphas": np.linspace(0.9, 1.1, 4)}
    expected = focal_stack(lf, **words)
    least = budget(
        lambda **more: focal_stack(source, **words, **more, device=device), expected.data.nbytes
    )
    equal_stacks(focal_stack(source, **words, memory=least, device=device), expected)
    assert len(tiles) > 1


@pytest.mark.parametrize("cue", CUES)
def test_depth_map(device, pair, tiles, cue):
    lf, source = pair
    words = {"disparities": PLANES, "cue": cue}
    expected = depth_map(lf, **words)
    least = budget(lambda **more: depth_map(source, **words, **more, device=device))
    tiles.clear()
    for memory in (least, None):
        result = depth_map(source, **words, memory=memory, device=device)
        assert isinstance(result, DepthMap)
        assert (tiles == ["everything"]) == (memory is None or len(tiles) == 1)
        for name in ("disparity", "alpha", "z", "confidence"):
            np.testing.assert_array_equal(getattr(result, name), getattr(expected, name), name)
        tiles.clear()


@pytest.mark.parametrize("surface", [False, True])
def test_all_in_focus(device, pair, tiles, surface):
    lf, source = pair
    words = {"disparities": PLANES}
    if surface:
        words = {"depth": np.mgrid[: SHAPE[2], : SHAPE[3]][1] / 70 - 0.5}
    expected = all_in_focus(lf, **words)
    least = budget(lambda **more: all_in_focus(source, **words, **more, device=device))
    tiles.clear()
    for memory in (least, None):
        result = all_in_focus(source, **words, memory=memory, device=device)
        assert isinstance(result, Image)
        assert result.device is device
        assert (tiles == ["everything"]) == (memory is None)
        np.testing.assert_array_equal(result.to_numpy(), expected.to_numpy())
        tiles.clear()


def test_a_stack_that_does_not_fit(device, pair):
    _, source = pair
    with pytest.raises(ValueError, match=r"itself.*memory=50,000: take stream_stack.*clplen stack"):
        focal_stack(source, disparities=PLANES, memory=50_000, device=device)
    with pytest.raises(ValueError, match="memory is a positive number of bytes"):
        focal_stack(source, disparities=PLANES, memory=0, device=device)


def test_whole_views_for_fourier(device, pair):
    lf, source = pair
    words = {"disparities": PLANES, "interpolation": "fourier"}
    result = focal_stack(source, **words, device=device)
    np.testing.assert_array_equal(result.to_numpy(), focal_stack(lf, **words).to_numpy())
    memory = 300_000 if device.rows else 450_000  # a GPU's form takes more planes at a time
    with pytest.raises(ValueError, match="'fourier', which needs every pixel"):
        focal_stack(source, **words, memory=memory, device=device)


def test_same_refusals(device, pair):
    lf, source = pair
    for wrong in (
        lambda lf: focal_stack(lf),
        lambda lf: focal_stack(lf, disparities=[0.0], interpolation="quartic"),
        lambda lf: focal_stack(lf, disparities=[0.0], aperture="none such"),
        lambda lf: depth_map(lf, cue="sonar"),
        lambda lf: depth_map(lf, disparities=[0.0, 1.0]),
        lambda lf: all_in_focus(lf, depth=np.zeros(SHAPE[2:]), disparities=PLANES),
    ):
        with pytest.raises(ValueError, match=r"\w"):
            wrong(lf)
        with pytest.raises(ValueError, match=r"\w"):
            wrong(source)
    with pytest.raises(ShapeError, match="one of every pixel"):
        all_in_focus(source, depth=np.zeros((3, 3)), device=device)


def test_arrays_and_devices(device, samples):
    lf = LightField.from_array(samples, device=device)
    expected = focal_stack(lf, disparities=[0.2]).to_numpy()
    result = focal_stack(samples, disparities=[0.2], device=device)
    assert result.device is device
    np.testing.assert_array_equal(result.to_numpy(), expected)
    other = Device.open(precision="double") if device.has_fp64 else None
    if other is not None and other is not device:
        with pytest.raises(DeviceError, match="two devices"):
            focal_stack(lf, disparities=[0.2], device=other)
    stack = focal_stack(lf, disparities=PLANES, memory=1, device=device)  # it is there already
    np.testing.assert_array_equal(
        depth_map(stack).disparity, depth_map(lf, disparities=PLANES, cue="energy").disparity
    )
    assert isinstance(all_in_focus(stack), Image)


def test_they_are_the_public_ones():
    assert clplen.focal_stack is focal_stack
    assert clplen.depth_map is depth_map
    assert clplen.all_in_focus is all_in_focus
