"""Regions of simulated cells, spheres about points, and traces of known dF/F."""

import numpy as np
import pytest
from scipy.ndimage import label

from clplen import ShapeError
from clplen.errors import FormatError
from clplen.microscopy.objects.activity import Traces, rolling_percentile, traces
from clplen.microscopy.objects.regions import find_regions, sphere_labels
from clplen.outputs import is_ours

SHAPE = (13, 41, 58)
SIDES = np.array([2e-6, 0.7e-6, 0.5e-6])
AXES = tuple(side * np.arange(n) for side, n in zip(SIDES, SHAPE, strict=True))
CENTRES = np.array([(5.5, 12.0, 14.0), (6.5, 12.5, 29.5), (7.0, 30.0, 45.0)])  # two of them touch
RADII = (2.2, 8.0, 9.0)  # samples along z, y, x
BRIGHT = np.array([60.0, 80.0, 40.0])


def cells(noise=2.0, seed=5, bright=BRIGHT):
    """Ellipsoids with soft rims on a level of 20."""
    index = np.indices(SHAPE)
    volume = 20 + noise * np.random.default_rng(seed).standard_normal(SHAPE)
    for centre, height in zip(CENTRES, bright, strict=True):
        far = [((i - c) / r) ** 2 for i, c, r in zip(index, centre, RADII, strict=True)]
        volume += height * np.clip(1.5 - 1.5 * np.sqrt(sum(far)), 0, 1)
    return volume


def order_of(regions):
    """Which region is which cell."""
    off = (regions.positions[:, None] / SIDES - CENTRES) / RADII
    return np.linalg.norm(off, axis=2).argmin(axis=0)


def test_cells_that_touch_are_told_apart():
    volume = cells()
    regions = find_regions(volume, axes=AXES, size=(0.7, 1.5))
    found_at = regions.threshold
    assert len(regions) == 3
    order = order_of(regions)
    assert sorted(order) == [0, 1, 2]
    off = regions.positions[order] / SIDES - CENTRES
    assert (np.abs(off) < (0.3, 1.0, 1.0)).all()  # of two that touch the seam cuts a part away
    assert (np.diff(regions.volumes) <= 0).all()
    voxels = np.bincount(regions.labels.ravel())[1:]
    assert np.allclose(regions.volumes, voxels * SIDES.prod())
    for k in range(3):
        inside = volume[regions.labels == k + 1]
        assert regions.means[k] == pytest.approx(inside.mean())
        assert regions.peaks[k] == inside.max()
        assert label(regions.labels == k + 1, np.ones((3, 3, 3)))[1] == 1  # in one piece
    assert regions.labels.dtype == np.int32
    one = find_regions(volume, axes=AXES, size=(0.7, 1.5), split=0)
    assert len(one) == 2  # what touches is one
    assert ((one.labels > 0) == (regions.labels > 0)).all()
    many = find_regions(volume, size=(0, 0), threshold=found_at, split=1, min_voxels=1)
    assert len(many) > 6  # each maximum of the noise is one


def test_the_threshold():
    volume = cells()
    found = find_regions(volume, size=(0.7, 1.5))
    # between the level of 20 and the dimmest cell of 60
    assert 30 < found.threshold < 50
    given = find_regions(volume, size=(0, 0), threshold=90.5, min_voxels=1, split=0)
    assert ((given.labels > 0) == (volume > 90.5)).all()
    assert len(find_regions(volume, size=(0.7, 1.5), min_voxels=100_000)) == 0


def test_nothing_to_find():
    noise = np.random.default_rng(3).normal(5, 1, SHAPE)
    for volume in (noise, np.zeros(SHAPE), np.full(SHAPE, 7.0), noise[:1]):
        regions = find_regions(volume, size=(0.7, 1.5))
        assert len(regions) == 0
        assert regions.positions.shape == (0, 3)
        assert not regions.labels.any()


def test_a_picture_and_unequal_planes():
    flat = find_regions(cells()[6:7], size=(0, 1.5))
    assert len(flat) == 3
    assert (flat.positions[:, 0] == 0).all()
    planes = np.array([0, 1, 2, 3, 4, 5, 6, 8, 11, 12, 13, 14, 15]) * 1e-6
    regions = find_regions(cells(), axes=(planes, *AXES[1:]), size=(0.7, 1.5))
    thick = np.gradient(planes)
    inside = regions.labels == 1
    weight = thick[:, None, None] * inside
    assert regions.volumes[0] == pytest.approx(weight.sum() * SIDES[1] * SIDES[2])
    centre = (weight.sum((1, 2)) * planes).sum() / weight.sum()
    assert regions.positions[0, 0] == pytest.approx(centre)


def test_plateaus_are_one_region_each():
    volume = np.zeros((5, 12, 20))
    volume[1:4, 2:6, 2:9] = 3.0
    volume[1:4, 7:10, 12:19] = 5.0
    regions = find_regions(volume, size=(0, 0), threshold=1.0, split=1.0)
    assert np.bincount(regions.labels.ravel()).tolist()[1:] == [84, 63]
    assert regions.positions.tolist() == [[2, 3.5, 5], [2, 8, 15]]


def test_regions_are_written(tmp_path):
    found = [find_regions(cells(), axes=AXES, size=(0.7, 1.5))]
    found[0].to_csv(tmp_path / "r.csv")
    lines = (tmp_path / "r.csv").read_text().splitlines()
    assert lines[0] == '"region","z_m","y_m","x_m","volume_m3","mean","peak","snr"'
    assert len(lines) == 4
    assert is_ours(tmp_path / "r.csv")
    with pytest.raises(ValueError, match='"m" or "voxel"'):
        found[0].to_csv(tmp_path / "r.csv", unit="px")


def test_what_regions_are_not_found_with():
    for options, words in [
        ({"size": (-1, 1)}, "size must not be negative"),
        ({"snr": 0}, "size must not be negative"),
        ({"split": 1.1}, "split from 0 to 1"),
        ({"min_voxels": 0}, "min_voxels at least 1"),
        ({"threshold": np.nan}, "finite number"),
        ({"axes": (None, None)}, "planes, y and x"),
    ]:
        with pytest.raises((ValueError, ShapeError), match=words):
            find_regions(cells(), **options)


def test_spheres_about_points():
    at = np.array([(8.1e-6, 14.2e-6, 13.1e-6), (12e-6, 14.2e-6, 15.9e-6), (3e-6, 1e-7, 1e-7)])
    radius = 3.1e-6
    labels = sphere_labels(at, radius, AXES)
    mesh = np.stack(np.meshgrid(*AXES, indexing="ij"), axis=-1)
    far = np.linalg.norm(mesh[..., None, :] - at, axis=-1)
    expected = np.where(far.min(-1) <= radius, far.argmin(-1) + 1, 0)
    assert (labels == expected).all()
    assert sorted(np.unique(labels)) == [0, 1, 2, 3]
    tiny = sphere_labels(at[:1], 1e-9, AXES)  # the nearest voxel is always in it
    assert np.argwhere(tiny).tolist() == [[4, 20, 26]]
    outside = sphere_labels([(9e-6, -5e-6, 1e-6)], 1e-6, AXES)
    assert not outside.any()


def test_spheres_about_nothing():
    for positions, radius, words in [
        (np.zeros((2, 2)), 1e-6, "n > 0"),
        (np.zeros((1, 3)), 0.0, "radius must be positive"),
        (np.full((1, 3), np.nan), 1e-6, "not finite"),
    ]:
        with pytest.raises((ValueError, ShapeError), match=words):
            sphere_labels(positions, radius, AXES)


# ---- traces

FRAMES = 150
LABELS = sphere_labels(CENTRES * SIDES, 3e-6, AXES)


def activity():
    """dF/F of each region: steps and decays, at rest most of the time."""
    t = np.arange(FRAMES)
    found = np.zeros((3, FRAMES))
    for region, (start, height) in enumerate([(30, 0.8), (70, 1.5), (110, 0.4)]):
        found[region] += np.where(t >= start, height * np.exp(-(t - start) / 8.0), 0)
    return found


def series(known, *, haze=0.0, noise=0.0, seed=1):
    """Volumes whose regions are 30, 50 and 20 at rest, with light about them that varies."""
    rng = np.random.default_rng(seed)
    rest = np.array([0.0, 30, 50, 20])
    for t in range(known.shape[1]):
        bright = rest * (1 + np.concatenate([[0], known[:, t]]))
        volume = bright[LABELS] + haze * (1 + 0.5 * np.sin(t / 9))
        yield volume + noise * rng.standard_normal(SHAPE)


def test_known_traces_without_noise():
    known = activity()
    found = traces(series(known), LABELS, window=60)
    assert found.regions.tolist() == [1, 2, 3]
    assert found.means[:, 0] == pytest.approx([30, 50, 20])
    # the 8th percentile of a window that begins right after a peak is its tail
    assert np.abs(found.dff - known).max() < 0.01
    assert np.isnan(found.surround).all()
    assert (found.baseline > 0).all()


def test_a_ring_takes_haze_away():
    known = activity()
    ring = traces(
        series(known, haze=40.0), LABELS, window=60, ring=(1e-6, 5e-6), axes=AXES, neuropil=1.0
    )
    assert np.abs(ring.dff - known).max() < 0.01
    t = np.arange(FRAMES)
    assert ring.surround == pytest.approx(np.tile(40 * (1 + 0.5 * np.sin(t / 9)), (3, 1)))


def test_the_ring_is_that_of_the_distance():
    labels = np.zeros(SHAPE, int)
    labels[6, 20, 30] = 7
    labels[6, 20, 33] = 9  # in the ring of 7, and left out
    mesh = np.stack(np.meshgrid(*AXES, indexing="ij"), axis=-1)
    far = np.linalg.norm(mesh - mesh[6, 20, 30], axis=-1)
    inside = (far > 1.1e-6) & (far <= 4.3e-6) & (labels == 0)
    volume = np.random.default_rng(7).random(SHAPE)
    found = traces([volume, volume + 1], labels, ring=(1.1e-6, 4.3e-6), axes=AXES)
    middle = np.median(volume[inside])
    assert found.surround[0] == pytest.approx([middle, middle + 1])
    assert found.regions.tolist() == [7, 9]


def test_rolling_percentiles():
    values = np.random.default_rng(2).random((2, 41))
    found = rolling_percentile(values, 6, 20)
    assert found[0, 20] == pytest.approx(np.percentile(values[0, 17:23], 20))
    assert found[1, 0] == pytest.approx(np.percentile(values[1, :3], 20))
    assert found[1, -1] == pytest.approx(np.percentile(values[1, -4:], 20))
    assert rolling_percentile(values, 500, 30)[0] == pytest.approx(np.percentile(values[0], 30))


def test_a_baseline_that_is_not_positive():
    labels = np.zeros((3, 5, 5), int)
    labels[1, 2, 2] = 1
    found = traces([np.full((3, 5, 5), v) for v in (0.0, 0, 4)], labels, percentile=0)
    assert np.isnan(found.dff).all()
    assert found.means.tolist() == [[0, 0, 4]]


def test_traces_are_read_back(tmp_path):
    found = traces(series(activity()[:, :9], noise=1.0), LABELS)
    found.to_csv(tmp_path / "t.csv")
    text = (tmp_path / "t.csv").read_text().splitlines()
    assert text[0] == '"region","frame","mean","surround","baseline","dff"'
    assert text[1].split(",")[3] == ""
    again = Traces.from_csv(tmp_path / "t.csv")
    for name in ("regions", "means", "surround", "baseline", "dff"):
        expected = getattr(found, name)
        assert np.allclose(getattr(again, name), expected, rtol=1e-8, equal_nan=True)
    assert is_ours(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("\n".join(text[:-1]))
    with pytest.raises(ShapeError, match="every region must have each frame"):
        Traces.from_csv(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("region,frame,mean\n1,0,3")
    with pytest.raises(FormatError, match="no column 'surround'"):
        Traces.from_csv(tmp_path / "t.csv")


VOLUMES = [np.ones(SHAPE)] * 3


def test_what_has_no_traces():
    for volumes, labels, options, words in [
        (VOLUMES, np.zeros(SHAPE), {}, "must contain a region"),
        (VOLUMES, LABELS[0], {}, r"\(planes, y, x\)"),
        (VOLUMES, LABELS + 0.5, {}, "brightness, not regions"),
        (VOLUMES, LABELS[:, :-1], {}, "of the labels"),
        ([*VOLUMES, np.ones((3, 3, 3))], LABELS, {}, "in frame 3"),
        ([*VOLUMES, np.full(SHAPE, np.nan)], LABELS, {}, "not finite in frame 3"),
        (VOLUMES[:1], LABELS, {}, "at least 2 frames, got 1"),
        (VOLUMES, LABELS, {"window": 0}, "window must be an integer"),
        (VOLUMES, LABELS, {"percentile": 101}, "from 0 to 100"),
        (VOLUMES, LABELS, {"neuropil": -0.1}, "share from 0 to 1"),
        (VOLUMES, LABELS, {"ring": (2, 1)}, r"\(inner, outer\)"),
        (VOLUMES, LABELS, {"ring": (0, 1e-9), "axes": AXES}, "has no voxel"),
    ]:
        with pytest.raises((ValueError, ShapeError), match=words):
            traces(volumes, labels, **options)
