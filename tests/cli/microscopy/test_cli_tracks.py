"""``clplen microscope points``, ``regions``, ``track``, ``traces`` and ``views``."""

from __future__ import annotations

from pathlib import Path

import microscope_commands
import numpy as np
import pytest
import tifffile
from matplotlib.image import imread
from microscope_commands import run

from clplen.io import open_volumes
from clplen.microscopy import Points, Tracks
from clplen.microscopy.objects.activity import Traces

SHAPE = (9, 33, 44)
VOXEL = np.array([2.0, 0.6, 0.5])  # um
AT = np.array([(3.2, 9.0, 10.4), (5.1, 24.0, 31.0)])
MOVE = np.array([(0.1, 1.0, 0.7), (-0.1, -0.8, 0.4)])
UM = {f"PhysicalSize{axis}{end}": value for axis, size in zip("ZYX", VOXEL, strict=True)
      for end, value in (("", float(size)), ("Unit", "µm"))}  # fmt: skip


def volume(t: int, *, height: float = 50.0) -> np.ndarray:
    index = np.indices(SHAPE)
    values = 3 + np.random.default_rng(t).standard_normal(SHAPE)
    for centre in AT + t * MOVE:
        far = [(i - c) ** 2 / (2 * 1.3**2) for i, c in zip(index, centre, strict=True)]
        values += height * (1 + t) * np.exp(-sum(far))
    return values.astype(np.float32)


def done(*words: object) -> str:
    return microscope_commands.done(run(*words)).output


def said(*words: object) -> str:
    return microscope_commands.said(run(*words))


@pytest.fixture
def series(tmp_path: Path) -> Path:
    path = tmp_path / "s.ome.tif"
    volumes = np.stack([volume(t) for t in range(4)])
    tifffile.imwrite(path, volumes, metadata={"axes": "TZYX", **UM})
    return path


def test_points_of_a_volume(tmp_path: Path, series: Path) -> None:
    out = tmp_path / "p.csv"
    text = done("points", series, "-o", out, "--time", 2)
    assert "2 points" in text
    found = Points.from_csv(out).positions * 1e6 / VOXEL
    truth = AT + 2 * MOVE
    order = np.argsort(found[:, 0])
    assert found[order] == pytest.approx(truth, abs=0.1)
    done("points", series, "-o", out)  # its own file is replaced
    assert "volume 0 of 4" in run("points", series, "-o", out).stderr
    done("points", series, "-o", out, "--time", "max", "--voxel-um", "4,1,1")
    assert Points.from_csv(out).positions[:, 0].max() > 15e-6
    np.save(tmp_path / "one.npy", volume(0))
    done("points", tmp_path / "one.npy", "-o", out, "--voxel-um", "2,.6,.5")
    assert Points.from_csv(out).positions[:, 1].max() == pytest.approx(14.4e-6, abs=1e-7)


def test_tracks_of_one_file_and_of_several(tmp_path: Path, series: Path) -> None:
    out, array = tmp_path / "t.csv", tmp_path / "t.npy"
    text = done("track", series, "-o", out, "--step-um", 2, "--napari", array)
    assert "2 tracks with 8 points in all, over 4 frames" in text
    tracks = Tracks.from_csv(out)
    moved = np.diff(tracks.positions.reshape(2, 4, 3), axis=1) * 1e6 / VOXEL
    for k in range(2):
        which = int(np.abs(MOVE - moved[k].mean(0)).sum(1).argmin())
        assert moved[k] == pytest.approx(np.tile(MOVE[which], (3, 1)), abs=0.15)
    assert np.allclose(np.load(array), tracks.napari(), rtol=1e-6)
    paths = [tmp_path / f"t{t}.ome.tif" for t in range(4)]
    for t, path in enumerate(paths):
        tifffile.imwrite(path, volume(t), metadata={"axes": "ZYX", **UM})
    done("track", *paths, "-o", tmp_path / "u.csv", "--step-um", "3,2,2", "--gaps", 1)
    assert np.allclose(Tracks.from_csv(tmp_path / "u.csv").positions, tracks.positions)
    words = ("--regions", "--motion", "straight", "--shortest", 4)
    text = done("track", series, "-o", out, "--step-um", 3, *words)
    assert "2 tracks with 8 regions in all" in text
    assert "a single frame" in run("track", series, "-o", out, "--step-um", "0.01").stderr


def test_regions_and_traces(tmp_path: Path, series: Path) -> None:
    labels, out = tmp_path / "l.ome.tif", tmp_path / "r.csv"
    text = done("regions", series, "-o", out, "--labels", labels, "--time", "mean")
    assert "2 regions" in text
    numbers = open_volumes(labels)
    assert set(np.unique(numbers[0])) == {0, 1, 2}
    assert numbers.voxel == pytest.approx(VOXEL[1:] * 1e-6)
    traced = tmp_path / "tr.csv"
    text = done("traces", series, "--labels", labels, "-o", traced, "--window", 4)
    found = Traces.from_csv(traced)
    data = tifffile.imread(series)
    expected = [[frame[numbers[0] == k].mean() for frame in data] for k in (1, 2)]
    assert found.means == pytest.approx(np.array(expected), rel=1e-5)
    done("points", series, "-o", tmp_path / "p.csv", "--time", 1)
    words = ("--points", tmp_path / "p.csv", "--radius-um", 2, "--ring-um", "2,6")
    done("traces", series, *words, "-o", traced, "--percentile", 0, "--neuropil", 1)
    found = Traces.from_csv(traced)
    assert found.surround == pytest.approx(np.full((2, 4), 3.0), abs=1.0)
    assert (found.dff[:, -1] > 1).all()  # they become four times as bright, and move away


def test_views(tmp_path: Path, series: Path) -> None:
    out = tmp_path / "v.png"
    done("views", series, "-o", out, "--slices", "3,9,10", "--time", "mean", "--scale", "root")
    assert imread(out).shape[2] in (3, 4)
    assert "4 projections along y" in done("views", series, "-o", out, "--montage", "y")
    two, film = tmp_path / "two.ome.tif", tmp_path / "v.gif"
    tifffile.imwrite(two, tifffile.imread(series)[:2], metadata={"axes": "TZYX", **UM})
    done("track", two, "-o", tmp_path / "t.csv", "--step-um", 2)
    text = done("views", two, "-o", film, "--tracks", tmp_path / "t.csv", "--seconds", 0.1)
    assert "a film of 2 volumes of 18 x 19.8 x 22 um" in text
    assert film.read_bytes()[:6] == b"GIF89a"
    tifffile.imwrite(tmp_path / "flat.ome.tif", volume(0)[3], metadata={"axes": "YX", **UM})
    done("views", tmp_path / "flat.ome.tif", "-o", out)


def test_what_has_no_places(tmp_path: Path, series: Path) -> None:
    np.save(tmp_path / "a.npy", volume(0))
    one, out = tmp_path / "a.npy", tmp_path / "o.csv"
    asked = "does not store the distance of its planes: give --voxel-um Z,Y,X"
    assert asked in said("points", one, "-o", out)
    tifffile.imwrite(tmp_path / "f.tif", volume(0)[0])
    assert "size of its voxels" in said("points", tmp_path / "f.tif", "-o", out)
    for text in ("1,2", "0,1,1", "a,b,c"):
        assert "in micrometres: give for example 2,0.5,0.5" in said(
            "points", one, "-o", out, "--voxel-um", text
        )
    assert not out.exists()


def test_bad_volumes(tmp_path: Path, series: Path) -> None:
    out, words = tmp_path / "o.csv", ("--voxel-um", "2,.6,.5")
    np.save(tmp_path / "nan.npy", np.where(np.arange(44) == 3, np.nan, volume(0)))
    np.save(tmp_path / "dark.npy", np.zeros(SHAPE))
    np.save(tmp_path / "later.npy", np.stack([volume(0), np.full(SHAPE, np.inf)]))
    assert "297 samples are NaN" in said("points", tmp_path / "nan.npy", "-o", out, *words)
    assert "297 samples are NaN" in said("regions", tmp_path / "nan.npy", "-o", out, *words)
    text = said("track", tmp_path / "later.npy", "-o", out, "--step-um", 1, *words)
    assert "Volume 1: 13068 samples" in text
    assert "has no point above 6 times" in said("points", tmp_path / "dark.npy", "-o", out, *words)
    assert "No track has 9 points" in said(
        "track", series, "-o", out, "--step-um", 1, "--shortest", 9
    )
    np.save(tmp_path / "small.npy", volume(0)[:, 1:])
    text = said("track", tmp_path / "nan.npy", tmp_path / "small.npy", "-o", out, "--step-um", 1)
    assert "volumes of a series must have equal shapes" in text
    assert "--time must be below 4" in said("points", series, "-o", out, "--time", 7)
    assert "is not a time" in said("points", series, "-o", out, "--time", "last")
    assert not out.exists()


def test_outputs_of_others_stay(tmp_path: Path, series: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("track,frame,z_m\n1,2,3\n")
    for command in (("points",), ("regions",), ("track", "--step-um", 2)):
        text = said(command[0], series, "-o", other, *command[1:])
        assert "exists already, and clplen did not write it" in text
        assert "--force" in text
    assert other.read_text().startswith("track,frame")
    picture = tmp_path / "v.png"
    picture.write_bytes(b"mine")
    assert "clplen did not write it" in said("views", series, "-o", picture)
    done("points", series, "-o", other, "--force")
    assert len(Points.from_csv(other)) == 2


def test_words_that_do_not_go_together(tmp_path: Path, series: Path) -> None:
    out, table = tmp_path / "o.csv", tmp_path / "p.csv"
    assert "Give --labels" in said("traces", series, "-o", out)
    assert "must be given together" in said("traces", series, "-o", out, "--points", table)
    words = ("--points", table, "--radius-um")
    assert "--radius-um must be positive" in said("traces", series, "-o", out, *words, 0)
    assert "There is no table" in said("traces", series, "-o", out, *words, 1)
    table.write_text("z_m,y_m,x_m\n9,9,9\n")
    assert "No point of" in said("traces", series, "-o", out, *words, 1)
    table.write_text("z_m,y_m,x_m\n")
    assert "contains no points" in said("traces", series, "-o", out, *words, 1)
    assert "brightness, not regions" in said("traces", series, "-o", out, "--labels", series)
    assert "INNER,OUTER with INNER below" in said(
        "traces", series, "-o", out, "--labels", series, "--ring-um", "5,2"
    )
    png = tmp_path / "v.png"
    assert "lies outside" in said("views", series, "-o", png, "--slices", "9,0,0")
    assert "is not Z,Y,X of a voxel" in said("views", series, "-o", png, "--slices", "9,0")
    assert "--montage cannot" in said("views", series, "-o", png, "--montage", "z", "--time", 1)
    assert "A film shows all times" in said("views", series, "-o", tmp_path / "v.gif", "--time", 1)
    assert "cannot be combined with --slices" in said(
        "views", series, "-o", png, "--slices", "1,1,1", "--tracks", table
    )
    assert "is not LENGTH|Z,Y,X" in said("track", series, "-o", out, "--step-um", "1,2")
    assert "is not PLANES,VOXELS" in said("points", series, "-o", out, "--size", "1")
    assert not out.exists()
    assert not png.exists()
