"""Stored light fields: the same bits in tiles as whole, in the memory that is given."""

from __future__ import annotations

import os
import threading
import weakref
from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import DeviceError, ShapeError
from clplen.io import open_lightfield, write_lightfield
from clplen.lightfield.depth.combined_cue import combined_disparity
from clplen.lightfield.depth.depth_maps import CUES
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.stacks import focal_stack, stack_tiles
from clplen.lightfield.streaming import tile_reading

PLANES = np.linspace(-0.9, 1.3, 6)
SPACING = (-1e-3, -1.1e-3, 1.3e-4, 0.9e-4)


class Camera:
    """What depth needs of a camera."""

    def dz(self, alpha):
        return 0.1 * (alpha - 1)


def scene(views, size, channels=None, dtype=np.uint8, seed=1):
    """Samples of a wavy surface with noise that is strong on the right."""
    rng = np.random.default_rng(seed)
    colours = () if channels is None else (channels,)
    texture = gaussian_filter(rng.random((size[0] + 20, size[1] + 20, channels or 1)), (1, 1, 0))
    texture = (texture - texture.min()) / np.ptp(texture)
    y, x = np.mgrid[: size[0], : size[1]]
    d = 0.6 * np.sin(x / 17) + 0.3 * np.cos(y / 11)
    values = np.empty((*views, *size, channels or 1))
    for v, u in np.ndindex(*views):
        at = (y + 10 + d * (v - (views[0] - 1) / 2), x + 10 + d * (u - (views[1] - 1) / 2))
        for c in range(values.shape[-1]):
            values[v, u, :, :, c] = map_coordinates(texture[..., c], at, order=1)
    noise = np.where(x > 0.7 * size[1], 0.3, 0.01)[..., None]
    values = np.clip(values + noise * rng.standard_normal(values.shape), 0, 1)
    values = values.reshape(*views, *size, *colours)
    full = np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 1
    return (full * values).astype(dtype)


def cases():
    """Samples and words: even and odd views, colours, weights with zeros, spacing, positions."""
    rng = np.random.default_rng(7)
    weights = rng.random((4, 3)).astype(np.float32)
    weights[1, 2] = 0
    dark = scene((3, 4), (97, 83))
    dark[0, 1] = 0
    return {
        "grey": (dark, {}),
        "colours": (
            scene((4, 3), (71, 61), 3, np.float32),
            {"weights": weights, "spacing": SPACING, "camera": Camera()},
        ),
        "places": (
            scene((3, 5), (79, 91), None, np.uint16),
            {"positions": 1.3 * rng.standard_normal((3, 5, 2))},
        ),
    }


CASES = cases()


@pytest.fixture(scope="module", params=list(CASES))
def pair(request, device):
    """The same light field on the device and stored."""
    values, words = CASES[request.param]
    return LightField.from_array(values, device=device, **words), stored(request.param)


def stored(name):
    values, words = CASES[name]
    return StoredLightField.from_array(values, **words)


@pytest.fixture
def tiles(monkeypatch):
    """How many tiles each computation took; a whole light field is loaded and counts as one."""
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


def least(call, memory=1000):
    """The least memory with which a computation runs, as its error says."""
    with pytest.raises(ValueError, match="smallest tile") as info:
        call(memory=memory)
    return int(str(info.value).split("needs ")[1].split(";")[0].replace(",", ""))


def joined(parts):
    """Every picture of a stack in its place, each sample once."""
    out = np.full(parts.shape, np.nan, np.float32)
    for planes, rows, columns, pictures in parts:
        assert np.isnan(out[planes, rows, columns]).all()
        assert pictures.dtype == np.float32
        out[planes, rows, columns] = pictures
    return out


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
def test_focal_stack(device, pair, tiles, interpolation):
    lf, source = pair
    words = {"disparities": PLANES, "interpolation": interpolation, "aperture": 2}
    whole = focal_stack(lf, **words)
    (one,) = stack_tiles(lf, **words)
    on_device = words | {"device": device}
    np.testing.assert_array_equal(one[3], whole.to_numpy())
    found = set()
    for memory in (None, 4 * source.nbytes, least(partial(stack_tiles, source, **on_device))):
        parts = stack_tiles(source, memory=memory, **on_device)
        found.add(len(parts.plan.tiles))
        np.testing.assert_array_equal(joined(parts), whole.to_numpy())
        np.testing.assert_array_equal(parts.disparities, whole.disparities)
        np.testing.assert_array_equal(parts.alphas, whole.alphas)
        assert (parts.shape, parts.spacing) == (whole.shape, lf.spacing)
        assert parts.camera is lf.camera
    assert len(found) > 1
    tiles.clear()
    for memory in (None, least(partial(focal_stack, source, **on_device), whole.data.nbytes)):
        stack = focal_stack(source, memory=memory, **on_device)
        np.testing.assert_array_equal(stack.to_numpy(), whole.to_numpy())
        for name in ("disparities", "alphas", "weights", "positions"):
            np.testing.assert_array_equal(getattr(stack, name), getattr(whole, name), name)
        assert (stack.spacing, stack.camera, stack.device) == (lf.spacing, lf.camera, device)
    assert tiles[0] == "everything"
    assert len(tiles) > 2


def test_planes_in_groups_and_parts_of_rows(device):
    lf = LightField.from_array(CASES["grey"][0], device=device)
    parts = stack_tiles(stored("grey"), disparities=PLANES, memory=60_000, device=device)
    assert len(parts.plan.planes) > 1
    assert len({tile.columns.start for tile in parts.plan.tiles}) > 1
    np.testing.assert_array_equal(joined(parts), focal_stack(lf, disparities=PLANES).to_numpy())


@pytest.mark.parametrize("cue", CUES)
def test_depth(device, pair, tiles, cue):
    lf, source = pair
    if cue == "structure-tensor" and source.positions is not None:
        pytest.skip("these positions lie in no rows")
    words = {"disparities": PLANES, "cue": cue}
    whole = depth_map(lf, **words)
    for memory in (None, least(partial(depth_map, source, **words, device=device))):
        tiles.clear()
        found = depth_map(source, **words, memory=memory, device=device)
        assert (tiles == ["everything"]) == (memory is None or len(tiles) == 1)
        for name in ("disparity", "confidence", "alpha", "z"):
            np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), name)


def test_combined_of_what_is_lost_in_noise(device, tiles):
    """More than one tile, with vignetting, pixels that are lost, and others that are not."""
    values = scene((3, 3), (40, 640), None, np.float32, seed=3)
    values *= 1 - 0.3 * np.hypot(*np.mgrid[-1:2, -1:2])[..., None, None] / np.sqrt(2)
    values = (255 * values).astype(np.uint8)
    whole = depth_map(values, disparities=PLANES, device=device)
    _, confidence = combined_disparity(LightField.from_array(values, device=device), PLANES)
    np.testing.assert_array_equal(whole.confidence, confidence)
    source = StoredLightField.from_array(values)
    words = {"disparities": PLANES, "device": device}
    memory = int(1.05 * least(partial(depth_map, source, **words)))
    found = depth_map(source, memory=memory, **words)
    assert len(tiles) > 2
    np.testing.assert_array_equal(found.disparity, whole.disparity)
    np.testing.assert_array_equal(found.confidence, whole.confidence)
    assert 0.01 < (found.confidence < 0.02).mean() < 0.9


@pytest.mark.parametrize("surface", [False, True])
def test_all_in_focus(device, pair, tiles, surface):
    lf, source = pair
    words = {"disparities": PLANES}
    if surface:
        rows, columns = np.mgrid[: lf.shape[2], : lf.shape[3]]
        words = {"depth": 0.02 * (rows - 30) - 0.01 * columns}
    whole = all_in_focus(lf, **words).to_numpy()
    for memory in (None, least(partial(all_in_focus, source, **words, device=device))):
        tiles.clear()
        found = all_in_focus(source, **words, memory=memory, device=device)
        assert isinstance(found, Image)
        assert found.device is device
        assert (tiles == ["everything"]) == (memory is None or len(tiles) == 1)
        np.testing.assert_array_equal(found.to_numpy(), whole)


def test_one_tile_is_on_the_device_at_a_time(device, monkeypatch):
    made, alive, part = [], set(), StoredLightField.part

    def counted(source, samples, where=None):
        alive.update(index for index, data in enumerate(made) if data() is not None)
        lf = part(source, samples, where)
        made.append(weakref.ref(lf.data))
        return lf

    monkeypatch.setattr(StoredLightField, "part", counted)
    words = {"disparities": PLANES, "device": device}
    for call in (
        lambda **more: list(stack_tiles(stored("grey"), **words, **more)),
        partial(depth_map, stored("grey"), cue="energy", **words),
        partial(all_in_focus, stored("grey"), **words),
    ):
        made.clear()
        call(memory=least(call))
        assert len(made) > 2
    assert not alive


def test_a_file_and_an_array(device, tmp_path):
    values, words = CASES["colours"]
    lf = LightField.from_array(values, device=device, **(words | {"camera": None}))
    write_lightfield(tmp_path / "lf.h5", lf)
    alphas = np.linspace(0.9, 1.1, 4)
    whole = focal_stack(lf, alphas=alphas)
    with open_lightfield(tmp_path / "lf.h5", device=device) as source:
        assert isinstance(source, StoredLightField)
        parts = stack_tiles(source, alphas=alphas, memory=2 * source.nbytes, device=device)
        assert len(parts.plan.tiles) > 1
        np.testing.assert_array_equal(joined(parts), whole.to_numpy())
    of_array = focal_stack(values, disparities=[0.2], device=device)
    assert of_array.device is device
    plain = LightField.from_array(values, device=device)
    np.testing.assert_array_equal(of_array, focal_stack(plain, disparities=[0.2]))
    other = Device.open(precision="double") if device.has_fp64 else None
    if other is not None and other is not device:
        with pytest.raises(DeviceError, match="two devices"):
            focal_stack(lf, disparities=[0.2], device=other)
    stack = focal_stack(lf, disparities=PLANES, memory=1, device=device)  # it is there already
    of_light = depth_map(lf, disparities=PLANES, cue="energy")
    np.testing.assert_array_equal(depth_map(stack).disparity, of_light.disparity)
    assert isinstance(all_in_focus(stack), Image)


def by_views(source):
    """The same light field as if its views were unpacked as a whole; counts its reads."""
    reads = []

    def fill(block, out):
        reads.append(block)
        source.fill(block, out)

    words = {name: getattr(source, name) for name in ("spacing", "positions")}
    made = StoredLightField(
        source.shape, source.dtype, fill, source.weights, source.shape[2:4], (1, 2), **words
    )
    return made, reads


def readers():
    return [t for t in threading.enumerate() if t.name.startswith("clplen-reading")]


def test_views_are_copied_once_and_nothing_is_left(device, tmp_path, monkeypatch):
    monkeypatch.setattr(tile_reading.tempfile, "tempdir", str(tmp_path))
    lf = LightField.from_array(CASES["places"][0], device=device, **CASES["places"][1])
    source, reads = by_views(stored("places"))
    words = {"disparities": PLANES, "memory": source.nbytes, "device": device}
    parts = stack_tiles(source, **words)
    assert parts.plan.bytes_scratch == source.nbytes
    np.testing.assert_array_equal(joined(parts), focal_stack(lf, disparities=PLANES).to_numpy())
    assert len(reads) == 3 * 3  # 3 rows of 5 views, two at a time
    assert list(tmp_path.iterdir()) == []
    before = set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()
    parts = stack_tiles(source, **words)
    for _ in parts:  # left early
        assert readers()
        break
    del parts, _
    assert readers() == []
    assert list(tmp_path.iterdir()) == []
    if before:
        assert set(os.listdir("/proc/self/fd")) <= before
    usage = type("Usage", (), {"free": 1000})()
    monkeypatch.setattr(tile_reading.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(OSError, match=r"temporary file of [\d,]+ bytes.*1,000 bytes free; set"):
        next(iter(stack_tiles(source, **words)))


def test_progress_and_errors_of_the_reader(device):
    words = {"disparities": PLANES, "device": device}
    done = []
    parts = stack_tiles(stored("grey"), **words, memory=300_000, progress=lambda *n: done.append(n))
    for _ in parts:
        pass
    count = len(parts.plan.tiles)
    assert count > 2
    assert done == [(i, count) for i in range(1, count + 1)]
    assert list(parts) == []  # once
    values = CASES["colours"][0].copy()
    values[2, 1, 60, 3, 1] = np.nan
    source = StoredLightField.from_array(values)
    done.clear()
    words |= {"cue": "correspondence", "memory": 5 * source.nbytes // 2}
    with pytest.raises(ValueError, match="1 samples that are NaN or infinite"):
        depth_map(source, **words, progress=lambda *n: done.append(n))
    assert done
    assert readers() == []


def test_what_is_refused(device):
    source = stored("grey")
    lf = LightField.from_array(CASES["grey"][0], device=device)
    size = source.shape[2:4]
    for call, error, message in (
        (lambda lf: stack_tiles(lf, disparities=[0], aperture="none"), ValueError, "'none'"),
        (lambda lf: focal_stack(lf, disparities=[0], interpolation="q"), ValueError, "got 'q'"),
        (lambda lf: focal_stack(lf, disparities=[0, 1e3]), ValueError, "no two views overlap"),
        (lambda lf: depth_map(lf, cue="sonar"), ValueError, "cue must be 'energy'"),
        (lambda lf: depth_map(lf, disparities=[0.0, 1.0]), ValueError, "at least three"),
        (
            lambda lf: all_in_focus(lf, depth=np.zeros(size), disparities=PLANES),
            ValueError,
            "disparities cannot be combined",
        ),
        (lambda lf: all_in_focus(lf, depth=np.zeros((3, 3))), ShapeError, "must be a number or an"),
    ):
        for given in (lf, source):
            with pytest.raises(error, match=message):
                call(given)
    words = {"disparities": PLANES, "device": device}
    with pytest.raises(ValueError, match=r"more than memory=50,000; call stack_tiles"):
        focal_stack(source, **words, memory=50_000)
    with pytest.raises(ValueError, match="memory must be a positive number of bytes"):
        focal_stack(source, **words, memory=0)
    whole = focal_stack(lf, disparities=PLANES, interpolation="fourier")
    found = focal_stack(source, **words, interpolation="fourier")
    np.testing.assert_array_equal(found.to_numpy(), whole.to_numpy())
    for call in (focal_stack, stack_tiles):
        with pytest.raises(ValueError, match="'fourier', which needs every pixel"):
            call(source, **words, interpolation="fourier", memory=whole.data.nbytes + 120_000)


def test_stored(device):
    values, words = CASES["colours"]
    source = stored("colours")
    assert (source.shape, source.dtype, source.nbytes) == (values.shape, np.float32, values.nbytes)
    assert repr(source).startswith("<StoredLightField (4, 3, 71, 61, 3) float32")
    lf = source.load(device)
    np.testing.assert_array_equal(lf.to_numpy(), values)
    np.testing.assert_array_equal(lf.weights, words["weights"])
    np.testing.assert_array_equal(source.disparity([0.9, 1.2]), lf.disparity([0.9, 1.2]))
    np.testing.assert_array_equal(source.alpha([0.9, 1.2]), lf.alpha([0.9, 1.2]))
    block = (slice(1, 3), slice(0, 1), slice(5, 9), slice(2, 60))
    np.testing.assert_array_equal(source.read(block), values[block])
    again = StoredLightField.from_light_field(lf)
    np.testing.assert_array_equal(again.read(block), values[block])
    with pytest.raises(ShapeError, match="four non-empty slices of step 1"):
        source.read((slice(0, 4, 2), *block[1:]))
    with pytest.raises(ShapeError, match="C-contiguous"):
        source.read(block, out=np.empty((2, 1, 4, 68)))
    with pytest.raises(ShapeError):
        StoredLightField.from_array(values[0, 0, 0])
    with pytest.raises(TypeError, match="real"):
        StoredLightField.from_array(values.astype(complex))


def test_black_views_get_no_weight(device):
    values = np.zeros((2, 3, 5000, 9), np.uint16)
    values[0, 1, 4999, 8] = 1
    values[1, :, 0, 0] = 7
    lf = LightField.from_array(values, device=device)
    np.testing.assert_array_equal(StoredLightField.from_array(values).weights, lf.weights)
    none = StoredLightField.from_array(0 * values)
    assert (none.weights == 1).all()


def test_raw_samples(tmp_path):
    values = np.random.default_rng(2).integers(0, 1000, (3, 4, 7, 5, 2)).astype(">u2")
    file = tmp_path / "raw"
    file.write_bytes(b"abc" + values.tobytes())
    with file.open("rb") as opened:
        samples = tile_reading.RawSamples(opened.fileno(), 3, values.shape, values.dtype)
        for ends in (
            [(0, 3), (0, 4), (0, 7), (0, 5), (0, 2)],
            [(1, 3), (2, 3), (1, 6), (0, 5), (0, 2)],
            [(2, 3), (0, 4), (0, 7), (4, 5), (1, 2)],
        ):
            selection = tuple(slice(*pair) for pair in ends)
            np.testing.assert_array_equal(samples.read(selection), values[selection])
        longer = tile_reading.RawSamples(opened.fileno(), 4, values.shape, values.dtype)
        with pytest.raises(EOFError, match="ends after"):
            longer.read(tuple(slice(0, n) for n in values.shape))
