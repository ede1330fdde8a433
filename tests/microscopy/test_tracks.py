"""Tracks of simulated points whose links are known, and of beads rendered into volumes."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from clplen.errors import FormatError
from clplen.microscopy.objects import linking
from clplen.microscopy.objects.points import Points, find_points
from clplen.microscopy.objects.tracks import Tracks, track_points
from clplen.outputs import is_ours

BOX = np.array([12.0, 40.0, 55.0])


@dataclass
class Frame:
    """Positions, and whose they are, which linking does not see."""

    positions: np.ndarray
    owner: np.ndarray

    @property
    def peaks(self):
        return 10.0 + self.owner

    @property
    def snr(self):
        return 1.0 + self.owner


def moving(count, frames, *, step=0.4, velocity=(0, 0, 0), missing=0.0, seed=1):
    """Brownian points with a drift, each seen or not, in random order."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(0, 1, (count, 3)) * BOX
    series = []
    for _ in range(frames):
        owner = rng.permutation(count)[: count - rng.binomial(count, missing)]
        series.append(Frame(at[owner], owner))
        at = at + rng.normal(0, step, at.shape) + velocity
    return series


def links(tracks, gaps=0):
    """(right, wrong) links of tracks whose peaks tell their owner, and how many were possible."""
    same = np.diff(tracks.ids) == 0
    owner = np.round(tracks.peaks - 10).astype(int)
    right = same & (np.diff(owner) == 0)
    possible = 0
    for one in np.unique(owner):
        seen = np.sort(tracks.frames[owner == one])
        possible += np.count_nonzero(np.diff(seen) <= gaps + 1)
    return int(right.sum()), int((same & ~right).sum()), possible


def test_sparse_points_keep_their_tracks():
    series = moving(17, 9)
    tracks = track_points(iter(series), step=2.5)
    assert links(tracks) == (17 * 8, 0, 17 * 8)
    assert len(tracks) == 17
    assert (np.diff(tracks.ids) >= 0).all()
    assert (tracks.frames == np.tile(np.arange(9), 17)).all()
    first = series[0].positions[tracks.ids[::9]]  # numbered as the first frame has them
    assert tracks.positions[::9].tolist() == first.tolist()
    assert (tracks.snr == tracks.peaks - 9).all()


def test_brute_force_finds_no_better_links():
    """Every assignment of few points, by hand."""
    rng = np.random.default_rng(4)
    for _ in range(40):
        n, m = rng.integers(1, 5, 2)
        one, two = rng.uniform(0, 1.6, (n, 3)), rng.uniform(0, 1.6, (m, 3))
        reach = rng.uniform(0.6, 1.5, n)
        pairs = linking.link(one, reach, two)
        cost = (((one[:, None] - two) / reach[:, None, None]) ** 2).sum(-1)

        def best(k, free, cost=cost, n=n):
            if k == n:
                return 0.0
            options = [best(k + 1, free)]
            options += [cost[k, j] - 1 + best(k + 1, free - {j}) for j in free if cost[k, j] < 1]
            return min(options)

        found = sum(cost[i, j] - 1 for i, j in pairs)
        assert found == pytest.approx(best(0, frozenset(range(m))))
        assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)


def test_steps_are_no_longer_than_the_ellipsoid():
    a = Frame(np.array([(5.0, 5, 5), (5, 20, 20), (5, 35, 40)]), np.arange(3))
    moves = np.array([(1.9, 0, 0), (0, 1.1, 0), (1.5, 0.7, 0)])  # in, out, (.75, .7): out
    b = Frame(a.positions + moves, np.arange(3))
    tracks = track_points([a, b], step=(2, 1, 1))
    assert links(tracks) == (1, 0, 3)
    assert len(tracks) == 5
    assert links(track_points([a, b], step=2.0)) == (3, 0, 3)


def test_gaps_births_and_deaths():
    at = np.array([(1.0, 2, 3), (1, 20, 3), (1, 2, 33), (8, 30, 50)])
    seen = [(0, 1), (0, 1, 2), (1, 2), (1, 2, 3), (0, 1, 3), ()]  # of each frame
    series = [Frame(at[list(k)] if k else np.empty((0, 3)), np.array(k, int)) for k in seen]
    tracks = track_points(series, step=1.0, gaps=2)
    assert links(tracks, gaps=2) == (9, 0, 9)
    assert len(tracks) == 4
    assert tracks.frames[tracks.peaks == 10].tolist() == [0, 1, 4]
    tracks = track_points(series, step=1.0, gaps=1)  # the first one is born again
    assert len(tracks) == 5
    assert len(track_points(series, step=1.0, gaps=1, shortest=3)) == 2
    assert track_points(series, step=1.0, gaps=1, shortest=3).ids.max() == 1
    for step, expected in ((1.4, 1), (1.42, 2)):  # a gap of 1 is reached by the root of 2
        at = [np.array([(0, 0, 0.0)]), np.empty((0, 3)), np.array([(0, 0, step)])]
        series = [Frame(one, np.zeros(len(one), int)) for one in at]
        assert len(track_points(series, step=1.0, gaps=1)) == expected


def test_a_flow_is_followed_from_the_first_step_of_a_track():
    # a drift of 3 a frame, points some 4 apart: nearest ones are wrong
    series = moving(60, 12, step=0.15, velocity=(0, 3.0, 0), missing=0.03)
    right, wrong, possible = links(track_points(series, step=3.6, gaps=1), 1)
    assert wrong > 0.05 * possible
    right, wrong, possible = links(track_points(series, step=3.6, gaps=1, motion="straight"), 1)
    assert right > 0.97 * possible
    assert wrong < 0.02 * possible


def beads(centres, shape, sigma, noise, seed):
    index = np.indices(shape)
    volume = noise * np.random.default_rng(seed).standard_normal(shape)
    for centre in centres:
        far = [((i - c) / s) ** 2 / 2 for i, c, s in zip(index, centre, sigma, strict=True)]
        volume += 100 * np.exp(-sum(far))
    return volume


def test_beads_in_volumes_of_asymmetric_voxels():
    shape, sides = (11, 37, 53), np.array([3e-6, 0.6e-6, 0.45e-6])
    axes = [side * np.arange(n) for side, n in zip(sides, shape, strict=True)]
    axes[0] = axes[0] - 2e-5
    rng = np.random.default_rng(2)
    at = np.array([(3.3, 9, 11), (7.2, 28, 41), (4.6, 27, 14), (6.1, 8, 43)])
    path = [at]
    for _ in range(5):
        path.append(path[-1] + rng.normal(0, (0.2, 0.9, 1.1), at.shape))
    volumes = (beads(p, shape, (1.2, 1.4, 1.7), 2.0, k) for k, p in enumerate(path))
    found = (find_points(v, axes=axes, size=(1, 1.5), snr=12) for v in volumes)
    tracks = track_points(found, step=(2e-6, 2e-6, 2e-6), unit="m")
    assert len(tracks) == 4
    truth = np.stack(path, axis=1) * sides + (axes[0][0], 0, 0)
    order = [int(np.linalg.norm(truth[:, 0] - tracks.positions[6 * k], axis=1).argmin())
             for k in range(4)]  # fmt: skip
    off = tracks.positions.reshape(4, 6, 3) - truth[order]
    # sigma over snr of some 50 is .03 samples; .1 leaves room for the background that is taken off
    assert (np.abs(off) < 0.12 * sides).all()
    napari = tracks.napari()
    assert napari.shape == (24, 5)
    assert np.allclose(napari[:, 2:], tracks.positions * 1e6)
    assert (napari[:, 0] == tracks.ids).all()
    assert (napari[:, 1] == tracks.frames).all()


def test_the_table_is_read_back(tmp_path):
    tracks = track_points(moving(5, 4), step=2.5, unit="m")
    path = tmp_path / "tracks.csv"
    tracks.to_csv(path)
    assert path.read_text().splitlines()[0] == '"track","frame","z_m","y_m","x_m","peak","snr"'
    again = Tracks.from_csv(path)
    assert again.unit == "m"
    for name in ("ids", "frames", "positions", "peaks", "snr"):
        assert np.allclose(getattr(again, name), getattr(tracks, name), rtol=1e-8)
    assert is_ours(path)
    lines = path.read_text().splitlines()
    (tmp_path / "other.csv").write_text("\n".join([lines[0].replace('"', ""), *lines[:0:-1]]))
    assert not is_ours(tmp_path / "other.csv")  # as another program would write it
    assert np.allclose(Tracks.from_csv(tmp_path / "other.csv").positions, tracks.positions)
    voxels = replace(tracks, unit="voxel")
    voxels.to_csv(path)
    assert Tracks.from_csv(path).unit == "voxel"
    assert np.allclose(Tracks.from_csv(path).napari()[:, 2:], tracks.positions)


def test_a_table_of_points_is_read_back(tmp_path):
    rng = np.random.default_rng(3)
    points = Points(rng.random((2, 3)), rng.random(2), rng.random(2), rng.random((2, 3)))
    for unit in ("m", "voxel"):
        points.to_csv(tmp_path / "points.csv", unit=unit)
        again = Points.from_csv(tmp_path / "points.csv")
        for name in ("positions", "peaks", "snr", "widths"):
            expected = getattr(points, name)
            assert np.allclose(getattr(again, name), expected, rtol=1e-8, equal_nan=True)
    with pytest.raises(ValueError, match='"m" or "voxel"'):
        points.to_csv(tmp_path / "points.csv", unit="um")
    with pytest.raises(ValueError, match=r"must end in \.csv"):
        points.to_csv(tmp_path / "points.txt")


HEAD = "track,frame,z_m,y_m,x_m,peak,snr"


def test_tables_that_hold_no_tracks(tmp_path):
    for text, words in [
        (None, "There is no table"),
        ("a,b\n1,2\n", "no column z_m or z_voxel"),
        (HEAD.replace("peak", "top") + "\n0,0,1,1,1,1,1\n", "no column 'peak'"),
        (HEAD + "\n0,0,=1+1,1,1,1,1\n", "'=1.1' in the column 'z_m' is not a number"),
        (HEAD + "\n0,0,1,1\n", "line 2 has 4 cells, the header 7"),
        (HEAD + "\n0.5,0,1,1,1,1,1\n", "'track' must contain integers from 0 on, got 0.5"),
        (HEAD + "\n0,0,,1,1,1,1\n", "a point has no position"),
        (HEAD + "\n0,2,1,1,1,1,1\n0,2,1,1,1,1,1\n", "track 0 has frame 2 twice"),
    ]:
        path = tmp_path / "t.csv"
        if text is not None:
            path.write_text(text)
        with pytest.raises(FormatError, match=words):
            Tracks.from_csv(path)


SERIES = moving(3, 3)


def test_what_is_not_tracked():
    for found, options, error, words in [
        (SERIES, {"step": 0}, ValueError, "a positive number or three"),
        (SERIES, {"gaps": -1}, ValueError, "gaps must be an integer"),
        (SERIES, {"motion": "drift"}, ValueError, '"random" or "straight"'),
        (SERIES, {"shortest": 0}, ValueError, "from 1 on"),
        (SERIES, {"unit": "um"}, ValueError, '"m" or "voxel"'),
        (SERIES[:1], {}, ValueError, "at least 2 volumes, got 1"),
        (np.zeros((3, 4, 4, 4)), {}, TypeError, "find_points or find_regions"),
        ([SERIES[0], Frame(np.full((1, 3), np.inf), np.zeros(1))], {}, ValueError, "of frame 1"),
    ]:
        with pytest.raises(error, match=words):
            track_points(found, **({"step": 1.0} | options))


def test_too_many_points_that_could_be_exchanged(monkeypatch):
    monkeypatch.setattr(linking, "MAX_GROUP_SIZE", 20)
    with pytest.raises(ValueError, match="give a smaller step"):
        track_points(moving(21, 2), step=100.0)
    assert len(track_points(moving(20, 2), step=100.0)) == 20


def test_crowded_points():
    series = moving(300, 8, step=0.3, missing=0.05)
    right, wrong, possible = links(track_points(series, step=1.5))
    assert right > 0.97 * possible
    assert wrong < 0.03 * possible


def test_points_that_cross_need_their_velocity():
    t = np.arange(20) - 9.5
    positions = np.stack([np.stack([0 * t, t, 2 * t], 1), np.stack([0 * t, -t, 2 * t + 0.1], 1)])
    series = [Frame(positions[:, k], np.arange(2)) for k in range(20)]
    right, wrong, possible = links(track_points(series, step=3.0))
    assert (right, wrong, possible) == (36, 2, 38)  # they bounce off each other
    assert links(track_points(series, step=3.0, motion="straight")) == (38, 0, 38)
