"""OME-TIFF of stacks that come in parts, in any order."""

from __future__ import annotations

import os
import tracemalloc
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from stack_tiles import Tiles, full_disk, random_values

from clplen.errors import ShapeError
from clplen.io import write_depth, write_image, write_stack
from clplen.io.store.picture_blocks import checked_blocks

SPACING = (-1e-3, -1e-3, -2e-6, 3e-6)
CAMERA = SimpleNamespace(dz=lambda alpha: (alpha - 1) / 10)


def test_parts_come_to_their_places(tmp_path_factory: pytest.TempPathFactory):
    for shape, parts, axes in [
        ((5, 7, 11), (2, 3, 4), "ZYX"),
        ((3, 11, 7, 3), (3, 4, 5), "ZYXS"),
        ((2, 5, 4, 2), (2, 5, 3), "ZYXS"),
        ((4, 5, 6, 1), (1, 2, 6), "ZYX"),
    ]:
        tmp_path = tmp_path_factory.mktemp("case")
        values = random_values(*shape)
        path = tmp_path / "s.ome.tif"
        write_stack(path, Tiles(values, parts, SPACING, CAMERA), durable=True)
        again = tifffile.imread(path)
        assert again.dtype == np.float32
        np.testing.assert_array_equal(again, values.reshape(again.shape))
        with tifffile.TiffFile(path) as file:
            assert file.is_ome
            (series,) = file.series
            assert series.axes == axes
            assert series.dataoffset is not None  # contiguous
            assert len(file.pages) == shape[0]
        assert [file.name for file in tmp_path.iterdir()] == ["s.ome.tif"]


@pytest.mark.parametrize("suffix", [".tif", ".zarr"])
def test_parts_that_are_no_stack(tmp_path: Path, suffix: str):
    if suffix == ".zarr":
        pytest.importorskip("zarr")

    class Odd(Tiles):
        def __iter__(self):
            blocks = list(super().__iter__())
            yield from (blocks[1:] if self.fails_at == -2 else blocks + blocks[-1:])

    class Wrong(Tiles):
        def __iter__(self):
            yield slice(0, 2), slice(0, 3), slice(0, 4), self.values[:, :3, :5]

    path, values = tmp_path / f"s{suffix}", random_values(2, 5, 7)
    with pytest.raises(ValueError, match=r"cover all 70 samples of \(2, 5, 7\) once, got 56"):
        write_stack(path, Odd(values, (2, 4, 7), fails_at=-2))
    with pytest.raises(ValueError, match=r"cover all 70 samples of .* got 98"):
        write_stack(path, Odd(values, (2, 2, 7)))
    with pytest.raises(ShapeError, match=r"must have shape \(2, 3, 4\), got \(2, 3, 5\)"):
        write_stack(path, Wrong(values, (2, 5, 7)))
    assert list(tmp_path.iterdir()) == []


def test_a_writer_that_is_interrupted_leaves_nothing(tmp_path: Path):
    path = tmp_path / "s.tif"
    write_stack(path, Tiles(np.ones((2, 3, 4), np.float32), (2, 3, 4)))
    tiles = Tiles(random_values(4, 6, 5), (4, 2, 5), fails_at=2)
    with pytest.raises(KeyboardInterrupt):
        write_stack(path, tiles)
    assert tiles.closed == [True]
    assert [file.name for file in tmp_path.iterdir()] == ["s.tif"]
    assert (tifffile.imread(path) == np.ones((2, 3, 4))).all()


def test_a_full_disk_stops_the_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    tiles = Tiles(random_values(4, 160, 160), (4, 16, 160))
    with full_disk(tmp_path / "disk", monkeypatch) as disk:
        said = r"Cannot write .*s\.tif \(No space left on device\): if the disk is full"
        with pytest.raises(OSError, match=said):
            write_stack(disk / "s.tif", tiles)
        assert list(disk.iterdir()) == []
    assert tiles.closed == [True]


def test_no_room_is_found_out_before_the_first_part(tmp_path: Path):
    class Never(Tiles):
        @property
        def shape(self) -> tuple[int, ...]:
            return (10**6, 10**4, 10**4)

        def __iter__(self):
            raise AssertionError("asked for a part")

    with pytest.raises(OSError, match=r"s\.tif needs 400,000,000,000,000 bytes"):
        write_stack(tmp_path / "s.tif", Never(random_values(2, 3, 4), (2, 3, 4)))


def test_memory_does_not_grow_with_the_stack(tmp_path: Path):
    class Same(Tiles):
        def __iter__(self):
            for i in range(0, 256, 16):
                yield slice(None), slice(i, i + 16), slice(None), self.values

        @property
        def shape(self) -> tuple[int, ...]:
            return (30, 256, 256)

    tiles = Same(random_values(30, 16, 256), (30, 16, 256))
    tracemalloc.start()
    write_stack(tmp_path / "s.tif", tiles)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20  # of 7.5 MiB; tifffile's own and one row
    assert os.path.getsize(tmp_path / "s.tif") > 30 * 256 * 256 * 4


def test_durable_reaches_every_kind_of_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    synced: list[Path] = []
    monkeypatch.setattr("clplen.files._sync", synced.append)
    picture = random_values(4, 5)
    depth = SimpleNamespace(disparity=picture, confidence=picture, alpha=picture, z=picture)
    for durable in (False, True):
        for name in ("d.pfm", "d.tif", "d.ome.tif"):
            write_depth(tmp_path / name, depth, durable=durable)
        write_image(tmp_path / "a.tif", picture, durable=durable)
        write_image(tmp_path / "a.zarr", picture, durable=durable)
        files = {path.name for path in tmp_path.glob("a.zarr/**/*") if path.is_file()}
        assert len(synced) == (8 + len(list(tmp_path.glob("a.zarr/**/*"))) + 2 if durable else 0)
        assert not durable or files <= {path.name for path in synced}


def test_parts_are_told_that_no_more_are_wanted(tmp_path: Path):
    """Even where something else still holds the iterator, as a frame of a traceback may."""

    class Kept(Tiles):
        def __iter__(self):
            self.kept = super().__iter__()
            return self.kept

    tiles = Kept(random_values(4, 6, 5), (4, 2, 5))
    with closing(checked_blocks(tiles, (4, 6, 5))) as parts:
        next(parts)
        assert tiles.closed == []
    assert tiles.closed == [True]
