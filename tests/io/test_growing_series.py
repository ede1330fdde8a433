"""Series of volumes that grow: what is there is of unknown origin when a run goes on."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.errors import FormatError
from clplen.io import read_volume_series, series_in
from clplen.io.results.volume_series import VolumeSeries, count_complete

SHAPE = (3, 7, 9)
VOLUMES = np.random.default_rng(3).random((4, *SHAPE), np.float32)
SUFFIXES = (".ome.tif", ".ome.zarr")


def series(path: Path) -> VolumeSeries:
    if path.suffix == ".zarr":
        pytest.importorskip("zarr", reason="the extra zarr is not installed")
    words: dict[str, Any] = {"planes": [-1e-6, 0.0, 1e-6], "voxel": (1e-6, 2e-6)}
    return VolumeSeries(path, frames=4, shape=SHAPE, description={"job": {}}, **words)


def begun(path: Path) -> Path:
    """A series of two volumes of four; the file that says so."""
    file = series(path)
    file.open(resume=False)
    file.append(VOLUMES[:2], [{"name": "a"}, {"name": "b"}])
    if path.suffix == ".zarr":
        return path / ".zattrs"
    return path.with_name(f".{path.stem}.unfinished.json")


def ended(path: Path) -> int:
    """Go on to the end, as a later run does; how many volumes were there."""
    file = series(path)
    done = file.open(resume=bool(series_in(path)[1]))
    for t in range(done, 4):
        file.append(VOLUMES[t : t + 1], [{"name": str(t)}])
    file.end()
    for t in range(4):
        assert np.array_equal(read_volume_series(path, t), VOLUMES[t])
    return done


def test_a_damaged_description_is_none(tmp_path_factory: pytest.TempPathFactory):
    """The series is begun anew."""
    for damage in [
        "[" * 100_000,
        "",
        {"records": [{}, {}]},
        {"records": [{"range": [10**400, 1]}] * 2},
        {"shape": [-3, 7, 9]},
        {"batch": "x"},
    ]:
        for suffix in SUFFIXES:
            tmp_path = tmp_path_factory.mktemp("case")
            path = tmp_path / f"series{suffix}"
            said = begun(path)
            if isinstance(damage, dict):
                content = json.loads(said.read_text())
                content.get("clplen", content).update(damage)
                damage = json.dumps(content)
            said.write_text(damage)
            assert series_in(path) == ({}, [])
            assert count_complete(path) == 0
            with pytest.raises(FormatError, match="not a series of volumes"):
                read_volume_series(path, 1)
            assert ended(path) == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_shape_that_the_file_cannot_hold(tmp_path: Path, suffix: str):
    path = tmp_path / f"series{suffix}"
    said = begun(path)
    content = json.loads(said.read_text())
    content.get("clplen", content)["shape"] = [1, 10**9, 10**9]
    said.write_text(json.dumps(content))
    with pytest.raises(FormatError, match="is truncated or damaged"):
        read_volume_series(path, 1)
    assert count_complete(path) == 0
    assert ended(path) == 2  # the shape of this run is known


def linked_file(path: Path, precious: Path) -> None:
    hidden = path.with_name(f".{path.stem}.unfinished.tif")
    hidden.unlink()
    hidden.symlink_to(precious / "5" / "a")


def linked_level(path: Path, precious: Path) -> None:
    shutil.copytree(path / "0", precious, dirs_exist_ok=True)
    shutil.rmtree(path / "0")
    (path / "0").symlink_to(precious)


def linked_time(path: Path, precious: Path) -> None:
    (path / "0" / "2").symlink_to(precious)


@pytest.mark.skipif(os.name != "posix", reason="links need no rights on POSIX")
@pytest.mark.parametrize(
    ("suffix", "change"),
    [(".ome.tif", linked_file), (".ome.zarr", linked_level), (".ome.zarr", linked_time)],
)
def test_links_do_not_lead_to_files_of_others(
    tmp_path: Path, suffix: str, change: Callable[[Path, Path], None]
):
    """Times after the last one go, and so did folders with numbers for names."""
    precious = tmp_path / "precious"
    (precious / "5").mkdir(parents=True)
    (precious / "5" / "a").write_text("precious")
    path = tmp_path / f"series{suffix}"
    begun(path)
    change(path, precious)
    if change is linked_time:
        with pytest.raises(OSError, match="Cannot write"):
            ended(path)
    else:
        assert ended(path) == 0
    assert (precious / "5" / "a").read_text() == "precious"


def test_a_damaged_level_is_made_anew(tmp_path_factory: pytest.TempPathFactory):
    for content in ["{}", '{"shape": "abc"}']:
        tmp_path = tmp_path_factory.mktemp("case")
        path = tmp_path / "series.ome.zarr"
        begun(path)
        (path / "0" / ".zarray").write_text(content)
        assert ended(path) == 0
