"""Volumes in files: sizes of voxels, what other programs wrote, and what is no volume."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile

from clplen.errors import FormatError
from clplen.io.results.volume_files import read_volume, write_volume
from clplen.io.store.picture_series import describe_series

VOLUME = np.arange(3 * 4 * 5, dtype=np.float32).reshape(3, 4, 5)


def test_voxels_have_their_sizes(tmp_path: Path) -> None:
    for planes, step in [((-3, -1, 1), "2"), ((4, 2, 0), None), ((0, 1, 3), None)]:
        path = tmp_path / "a.ome.tif"
        z = np.array(planes) * 1e-6
        write_volume(path, VOLUME, planes=z, voxel=(0.5e-6, 0.25e-6), description={"more": 1})
        values, about = read_volume(path)
        assert np.array_equal(values, VOLUME)
        assert about == {"more": 1, "planes_um": list(planes)}
        with tifffile.TiffFile(path) as file:
            text = file.ome_metadata
        assert 'PhysicalSizeY="0.5"' in text
        assert 'PhysicalSizeX="0.25"' in text
        assert ("PhysicalSizeZ=" in text) == (step is not None)
        assert step is None or f'PhysicalSizeZ="{step}' in text
        for number, one in enumerate(planes):
            assert re.search(f'TheZ="{number}"[^>]* PositionZ="{one}(.0)?"', text)


def test_an_omezarr_lies_where_its_first_plane_does(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")
    z = np.array([-3e-6, -1e-6, 1e-6])
    write_volume(tmp_path / "a.zarr", VOLUME, planes=z, voxel=(0.5e-6, 0.25e-6))
    (scales,) = zarr.open_group(str(tmp_path / "a.zarr"), mode="r").attrs["multiscales"]
    scale, shift = scales["datasets"][0]["coordinateTransformations"]
    assert scale["scale"] == pytest.approx([2, 0.5, 0.25])
    assert shift["translation"] == pytest.approx([-3, 0, 0])


def test_an_omezarr_without_its_voxels_says_nothing(tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the extra zarr is not installed")
    write_volume(tmp_path / "a.zarr", VOLUME, planes=np.arange(3.0), voxel=(1e-6, 1e-6))
    assert describe_series(tmp_path / "a.zarr")["planes_um"] == [0, 1e6, 2e6]
    shutil.rmtree(tmp_path / "a.zarr" / "0")
    assert describe_series(tmp_path / "a.zarr") == {}


def test_volumes_of_other_programs(tmp_path: Path) -> None:
    for name, more in (("a", {"imagej": True}), ("b", {"compression": "zlib"}), ("c", {})):
        path = tmp_path / f"{name}.tif"
        tifffile.imwrite(path, VOLUME, photometric="minisblack", **more)
        values, about = read_volume(path)
        assert np.array_equal(values, VOLUME)
        assert about == {}
    with tifffile.TiffWriter(tmp_path / "d.tif") as file:
        file.write(VOLUME[0])
        file.write(VOLUME[0, :, :3])
    with pytest.raises(FormatError, match="its 2 pages have 2 different shapes or types"):
        read_volume(tmp_path / "d.tif")
    tifffile.imwrite(tmp_path / "e.tif", np.zeros((4, 5, 3), np.uint8), photometric="rgb")
    with pytest.raises(FormatError, match=r"shape \(z, y, x\), got"):
        read_volume(tmp_path / "e.tif")
    with pytest.raises(FormatError, match=r"868 bytes, more than 60 \(the given limit"):
        read_volume(tmp_path / "c.tif", max_bytes=60)
    assert describe_series(tmp_path / "none.tif") == {}
    tifffile.imwrite(tmp_path / "f.tif", np.zeros((8, 64, 64), np.float32), compression="zlib")
    with pytest.raises(FormatError, match=r"the stack needs 131,072 bytes, more than 50,000"):
        read_volume(tmp_path / "f.tif", max_bytes=50000)
