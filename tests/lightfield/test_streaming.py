"""What is streamed tile by tile has the bits of what is made in core."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from clplen.errors import ShapeError
from clplen.lightfield.depth.depth_maps import CUES, cue_named
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.streaming import tile_reading
from clplen.lightfield.streaming.streamed_results import (
    stream_all_in_focus,
    stream_depth,
    stream_stack,
)
from clplen.lightfield.streaming.tile_plan import plan_tiles

PLANES = np.linspace(-0.9, 1.3, 8)
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
            scene((4, 3), (101, 71), 3, np.float32),
            {"weights": weights, "spacing": SPACING, "camera": Camera()},
        ),
        "places": (
            scene((3, 5), (79, 131), None, np.uint16),
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


def budgets(source, works, device, *shares):
    """Budgets between the least that works and what takes everything in one tile."""
    with pytest.raises(ValueError, match="smallest tile") as info:
        plan_tiles(source, works, memory=1000, device=device)
    least = int(str(info.value).split("needs ")[1].split(";")[0].replace(",", ""))
    most = plan_tiles(source, works, memory=1 << 40, device=device).bytes_peak
    return [least, *(int(least + share * max(most - least, 0)) for share in shares)]


def joined(tiles):
    """Every picture of a stack in its place, each sample once."""
    out = np.full(tiles.shape, np.nan, np.float32)
    for planes, rows, columns, pictures in tiles:
        assert np.isnan(out[planes, rows, columns]).all()
        assert pictures.dtype == np.float32
        out[planes, rows, columns] = pictures
    return out


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
def test_stack(device, pair, interpolation):
    lf, source = pair
    whole = focal_stack(lf, disparities=PLANES, interpolation=interpolation)
    words = {"disparities": PLANES, "interpolation": interpolation, "device": device}
    samples = source.nbytes
    found = set()
    for memory in (None, 4 * samples, 2 * samples, 2 * samples // 3):
        tiles = stream_stack(source, memory=memory, **words)
        found.add(len(tiles.plan.tiles))
        np.testing.assert_array_equal(joined(tiles), whole.to_numpy())
        np.testing.assert_array_equal(tiles.disparities, whole.disparities)
        np.testing.assert_array_equal(tiles.alphas, whole.alphas)
        assert (tiles.shape, tiles.spacing) == (whole.shape, lf.spacing)
        assert tiles.camera is lf.camera
    assert len(found) > 2


def test_planes_in_groups_and_parts_of_rows(device):
    lf = LightField.from_array(CASES["grey"][0], device=device)
    tiles = stream_stack(stored("grey"), disparities=PLANES, memory=60_000, device=device)
    assert len(tiles.plan.planes) > 1
    assert len({tile.columns.start for tile in tiles.plan.tiles}) > 1
    np.testing.assert_array_equal(joined(tiles), focal_stack(lf, disparities=PLANES).to_numpy())


def test_aperture_and_alphas(device):
    values, words = CASES["colours"]
    lf, source = LightField.from_array(values, device=device, **words), stored("colours")
    alphas = np.linspace(0.9, 1.1, 4)
    whole = focal_stack(lf, alphas=alphas, aperture=2).to_numpy()
    tiles = stream_stack(source, alphas=alphas, aperture=2, memory=2 * source.nbytes, device=device)
    assert len(tiles.plan.tiles) > 1
    np.testing.assert_array_equal(joined(tiles), whole)


@pytest.mark.parametrize("cue", CUES)
def test_depth(device, pair, cue):
    lf, source = pair
    if cue == "structure-tensor" and source.positions is not None:
        pytest.skip("these positions lie in no rows")
    whole = depth_map(lf, disparities=PLANES, cue=cue)
    works = [cue_named(cue).memory(source, PLANES)]
    for memory in budgets(source, works, device, 0.3):
        plan = plan_tiles(source, works, memory=memory, device=device)
        assert not plan.in_core or cue == "combined"
        found = stream_depth(source, disparities=PLANES, cue=cue, memory=memory, device=device)
        for name in ("disparity", "confidence", "alpha", "z"):
            np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), name)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_combined_of_what_is_lost_in_noise(device, dtype):
    """More than one tile, with vignetting, pixels that are lost, and others that are not."""
    values = scene((3, 3), (60, 700), None, np.float32, seed=3)
    values *= 1 - 0.3 * np.hypot(*np.mgrid[-1:2, -1:2])[..., None, None] / np.sqrt(2)
    if dtype == np.uint8:
        values = (255 * values).astype(np.uint8)
    lf = LightField.from_array(values, device=device)
    whole = depth_map(lf, disparities=PLANES)
    source = StoredLightField.from_array(values)
    works = [cue_named("combined").memory(source, PLANES)]
    memory = int(0.8 * plan_tiles(source, works, memory=1 << 40, device=device).bytes_peak)
    assert len(plan_tiles(source, works, memory=memory, device=device).tiles) > 1
    found = stream_depth(source, disparities=PLANES, memory=memory, device=device)
    np.testing.assert_array_equal(found.disparity, whole.disparity)
    np.testing.assert_array_equal(found.confidence, whole.confidence)
    lost = found.confidence < 0.02
    assert 0.01 < lost.mean() < 0.9


@pytest.mark.parametrize("surface", [False, True])
def test_all_in_focus(device, pair, surface):
    lf, source = pair
    words = {"disparities": PLANES}
    if surface:
        rows, columns = np.mgrid[: lf.shape[2], : lf.shape[3]]
        words = {"depth": 0.02 * (rows - 30) - 0.01 * columns}
    whole = all_in_focus(lf, **words).to_numpy()
    for share in (30, 6, 1) if surface else (30, 11):
        memory = share * source.nbytes
        try:
            found = stream_all_in_focus(source, memory=memory, device=device, **words)
        except ValueError as error:
            memory = int(str(error).split("needs ")[1].split(";")[0].replace(",", ""))
            found = stream_all_in_focus(source, memory=memory, device=device, **words)
        np.testing.assert_array_equal(found, whole)


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


def test_views_are_copied_once(device, tmp_path, monkeypatch):
    monkeypatch.setattr(tile_reading.tempfile, "tempdir", str(tmp_path))
    lf = LightField.from_array(CASES["places"][0], device=device, **CASES["places"][1])
    source, reads = by_views(stored("places"))
    tiles = stream_stack(source, disparities=PLANES, memory=source.nbytes, device=device)
    assert tiles.plan.bytes_scratch == source.nbytes
    assert len({tile.columns.start for tile in tiles.plan.tiles}) > 1
    np.testing.assert_array_equal(joined(tiles), focal_stack(lf, disparities=PLANES).to_numpy())
    assert len(reads) == 3 * 3  # 3 rows of 5 views, two at a time
    assert list(tmp_path.iterdir()) == []


def test_no_room_for_a_copy(device, monkeypatch):
    source, _ = by_views(stored("places"))
    usage = type("Usage", (), {"free": 1000})()
    monkeypatch.setattr(tile_reading.shutil, "disk_usage", lambda _: usage)
    tiles = stream_stack(source, disparities=PLANES, memory=source.nbytes, device=device)
    with pytest.raises(OSError, match=r"temporary file of [\d,]+ bytes.*1,000 free: point TMPDIR"):
        next(iter(tiles))


def readers():
    return [t for t in threading.enumerate() if t.name.startswith("clplen-reading")]


def test_leaving_early_leaves_nothing(device, tmp_path, monkeypatch):
    monkeypatch.setattr(tile_reading.tempfile, "tempdir", str(tmp_path))
    before = set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()
    source, _ = by_views(stored("places"))
    tiles = stream_stack(source, disparities=PLANES, memory=source.nbytes, device=device)
    for _ in tiles:
        assert readers()
        break
    del tiles, _
    assert readers() == []
    assert list(tmp_path.iterdir()) == []
    if before:
        assert set(os.listdir("/proc/self/fd")) <= before


def test_errors_of_the_reader_come_through(device):
    values = CASES["colours"][0].copy()
    values[2, 1, 90, 3, 1] = np.nan
    source = StoredLightField.from_array(values)
    done = []
    with pytest.raises(ValueError, match="1 samples that are NaN or infinite"):
        stream_depth(
            source,
            disparities=PLANES,
            cue="correspondence",
            memory=source.nbytes * 2,
            device=device,
            progress=lambda *n: done.append(n),
        )
    assert done
    assert readers() == []


def test_progress_counts_tiles(device):
    done = []
    tiles = stream_stack(
        stored("grey"),
        disparities=PLANES,
        memory=300_000,
        device=device,
        progress=lambda *n: done.append(n),
    )
    for _ in tiles:
        pass
    count = len(tiles.plan.tiles)
    assert count > 2
    assert done == [(i, count) for i in range(1, count + 1)]
    assert list(tiles) == []  # once


def test_what_is_refused(device):
    source = stored("grey")
    with pytest.raises(ValueError, match="'fourier', which needs every pixel"):
        stream_stack(source, disparities=PLANES, interpolation="fourier", device=device)
    with pytest.raises(ValueError, match="exactly one of alphas"):
        stream_stack(source, device=device)
    with pytest.raises(ValueError, match="cues of depth_map"):
        stream_depth(source, cue="sonar", device=device)
    depth = np.zeros(source.shape[2:4])
    with pytest.raises(ValueError, match="disparities= only"):
        stream_all_in_focus(source, depth=depth, disparities=PLANES, device=device)
    with pytest.raises(ShapeError, match="one of every pixel"):
        stream_all_in_focus(source, depth=np.zeros((3, 3)), device=device)
    lf = LightField.from_array(CASES["grey"][0], device=device)
    with pytest.raises(TypeError, match=r"StoredLightField.*not LightField"):
        stream_depth(lf, device=device)


def test_stored(device):
    values, words = CASES["colours"]
    source = stored("colours")
    assert (source.shape, source.dtype, source.nbytes) == (values.shape, np.float32, values.nbytes)
    assert repr(source).startswith("<StoredLightField (4, 3, 101, 71, 3) float32")
    lf = source.load(device)
    np.testing.assert_array_equal(lf.to_numpy(), values)
    np.testing.assert_array_equal(lf.weights, words["weights"])
    np.testing.assert_array_equal(source.disparity([0.9, 1.2]), lf.disparity([0.9, 1.2]))
    np.testing.assert_array_equal(source.alpha([0.9, 1.2]), lf.alpha([0.9, 1.2]))
    block = (slice(1, 3), slice(0, 1), slice(5, 9), slice(2, 70))
    np.testing.assert_array_equal(source.read(block), values[block])
    again = StoredLightField.from_light_field(lf)
    np.testing.assert_array_equal(again.read(block), values[block])
    with pytest.raises(ShapeError, match="four slices of step 1"):
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
            [(0, 1), (1, 4), (2, 3), (1, 4), (0, 2)],
            [(2, 3), (0, 4), (0, 7), (4, 5), (1, 2)],
        ):
            selection = tuple(slice(*pair) for pair in ends)
            np.testing.assert_array_equal(samples.read(selection), values[selection])
        longer = tile_reading.RawSamples(opened.fileno(), 4, values.shape, values.dtype)
        with pytest.raises(EOFError, match="ends after"):
            longer.read(tuple(slice(0, n) for n in values.shape))
