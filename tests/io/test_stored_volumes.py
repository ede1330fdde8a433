"""Series of volumes: files of other programs and of this one, read one time at a time."""

import numpy as np
import pytest
import tifffile
from refusals import refused

from clplen.errors import FormatError
from clplen.io import open_volumes, write_volume
from clplen.io.formats import tiff

SHAPE = (4, 3, 7, 9)  # t, z, y, x
VALUES = np.random.default_rng(1).random(SHAPE, np.float32)
UM = {
    "PhysicalSizeZ": 2.5, "PhysicalSizeZUnit": "µm", "PhysicalSizeY": 0.4,
    "PhysicalSizeYUnit": "µm", "PhysicalSizeX": 0.5, "PhysicalSizeXUnit": "µm",
}  # fmt: skip


def same(series, expected=VALUES):
    assert series.shape == expected.shape
    assert len(series) == len(expected)
    for found, known in zip(series, expected, strict=True):
        assert np.array_equal(found, known)
    assert np.array_equal(series[2], expected[2])
    assert np.array_equal(series[-1], expected[-1])
    with pytest.raises(IndexError, match=f"must be less than {len(expected)}"):
        series[len(expected)]


def test_ome_tiff_with_times(tmp_path):
    path = tmp_path / "s.ome.tif"
    tifffile.imwrite(path, VALUES, metadata={"axes": "TZYX", **UM})
    series = open_volumes(path)
    same(series)
    assert series.planes == pytest.approx([0, 2.5e-6, 5e-6])
    assert series.voxel == pytest.approx((4e-7, 5e-7))
    z, y, x = series.axes
    assert (len(z), y[-1], x[-1]) == (3, pytest.approx(6 * 4e-7), pytest.approx(8 * 5e-7))


def test_orders_of_the_axes(tmp_path):
    path = tmp_path / "s.ome.tif"
    for axes in ["ZTYX", "TCZYX"]:
        moved = VALUES.swapaxes(0, 1) if axes == "ZTYX" else VALUES[:, None]
        tifffile.imwrite(path, moved, metadata={"axes": axes}, compression="zlib")
        same(open_volumes(str(path)))
    path = tmp_path / "s.tif"
    tifffile.imwrite(path, VALUES[:, :, None], imagej=True, metadata={"axes": "TZCYX"})
    series = open_volumes([path])
    same(series)
    assert series.planes is None
    assert series.axes is None


def test_arrays_and_pages(tmp_path):
    np.save(tmp_path / "s.npy", VALUES)
    same(open_volumes(tmp_path / "s.npy"))
    np.save(tmp_path / "one.npy", VALUES[0])
    assert open_volumes(tmp_path / "one.npy").shape == (1, 3, 7, 9)
    tifffile.imwrite(tmp_path / "pages.tif", VALUES[0], photometric="minisblack")
    assert np.array_equal(open_volumes(tmp_path / "pages.tif")[0], VALUES[0])
    tifffile.imwrite(tmp_path / "flat.tif", VALUES[0, 0])
    flat = open_volumes(tmp_path / "flat.tif")
    assert flat.shape == (1, 1, 7, 9)
    assert flat.planes.tolist() == [0]


@pytest.mark.parametrize("suffix", [".ome.tif", ".ome.zarr"])
def test_files_of_one_time_each(tmp_path, suffix):
    if suffix == ".ome.zarr":
        pytest.importorskip("zarr")
    planes = np.array([-3e-6, -1e-6, 1e-6])
    paths = [tmp_path / f"t{t}{suffix}" for t in range(4)]
    for path, volume in zip(paths, VALUES, strict=True):
        write_volume(path, volume, planes=planes, voxel=(4e-7, 5e-7))
    series = open_volumes(paths)
    same(series)
    assert series.planes == pytest.approx(planes)
    assert series.voxel == pytest.approx((4e-7, 5e-7))
    write_volume(paths[2], VALUES[2], planes=planes, voxel=(4e-7, 5.1e-7))
    with pytest.raises(FormatError, match="have different voxels"):
        open_volumes(paths)
    write_volume(paths[2], VALUES[2], planes=planes + 1e-7, voxel=(4e-7, 5e-7))
    with pytest.raises(FormatError, match=r"have different planes \(-2.9 to 1.1 and -3 to 1 um"):
        open_volumes(paths)
    write_volume(paths[2], VALUES[2, :, :6], planes=planes, voxel=(4e-7, 5e-7), replace=True)
    with pytest.raises(FormatError, match="must have equal shapes"):
        open_volumes(paths)
    np.save(tmp_path / "a.npy", VALUES[0])
    with pytest.raises(FormatError, match=r"Only one of .* states its voxels"):
        open_volumes([paths[0], tmp_path / "a.npy"])


@pytest.mark.parametrize(("axes", "version"), [("tczyx", 2), ("tzyx", 3)])
def test_ome_zarr_with_times(tmp_path, axes, version):
    zarr = pytest.importorskip("zarr")
    path = tmp_path / "s.ome.zarr"
    group = zarr.open_group(path, mode="w", zarr_format=version)
    stored = VALUES[:, None] if "c" in axes else VALUES
    array = group.create_array(
        "full", shape=stored.shape, dtype="<f4", chunks=(1,) * len(axes[:-2]) + (7, 9)
    )
    array[...] = stored
    size, shift = {"z": 2.5, "y": 0.4, "x": 0.5}, {"z": -4.0}
    scales = {
        "axes": [{"name": a, "type": "space", "unit": "micrometer"} if a in size else {"name": a}
                 for a in axes],
        "datasets": [{"path": "full", "coordinateTransformations": [
            {"type": "scale", "scale": [size.get(a, 1.0) for a in axes]},
            {"type": "translation", "translation": [shift.get(a, 0.0) for a in axes]}]}],
    }  # fmt: skip
    multiscales = {"multiscales": [scales]}
    group.attrs.update(multiscales if version == 2 else {"ome": multiscales})
    series = open_volumes(path)
    same(series)
    assert series.planes == pytest.approx([-4e-6, -1.5e-6, 1e-6])
    assert series.voxel == pytest.approx((4e-7, 5e-7))


def test_one_volume_is_read_at_a_time(tmp_path, monkeypatch):
    path = tmp_path / "s.ome.tif"
    tifffile.imwrite(path, VALUES, metadata={"axes": "TZYX"})
    read = []
    original = tiff._stack_shape

    def counted(pages, *rest):
        read.append(len(pages))
        return original(pages, *rest)

    monkeypatch.setattr(tiff, "_stack_shape", counted)
    series = open_volumes(path)
    volumes = iter(series)
    next(volumes)
    assert read == [1, 3]  # the first page tells the size, then one time
    assert np.array_equal(series[3], VALUES[3])
    assert read == [1, 3, 3]


def test_what_is_no_series(tmp_path):
    def opened(name):
        return lambda: open_volumes(tmp_path / name)

    (tmp_path / "text.tif").write_text("no tiff")
    (tmp_path / "empty.tif").touch()
    (tmp_path / "a.png").touch()
    np.save(tmp_path / "six.npy", np.zeros((1,) * 6))
    np.save(tmp_path / "zero.npy", np.zeros((0, 3, 7, 9)))
    np.save(tmp_path / "complex.npy", np.zeros((3, 7, 9), complex))
    tifffile.imwrite(tmp_path / "rgb.tif", np.zeros((2, 7, 9, 3), np.uint8), photometric="rgb")
    tifffile.imwrite(tmp_path / "c.ome.tif", VALUES, metadata={"axes": "CZYX"})
    whole = tmp_path / "whole.ome.tif"
    tifffile.imwrite(whole, VALUES, metadata={"axes": "TZYX"})
    (tmp_path / "cut.ome.tif").write_bytes(whole.read_bytes()[:-1200])
    refused(
        (FormatError, "There is no volume", opened("none.tif")),
        (ValueError, "at least one file", lambda: open_volumes([])),
        (FormatError, "not a readable volume", opened("text.tif")),
        (FormatError, "not a readable volume", opened("empty.tif")),
        (FormatError, r"volumes are \.tif, \.zarr and \.npy", opened("a.png")),
        (FormatError, r"must have axes \(t, z, y, x\)", opened("six.npy")),
        (FormatError, "not a volume of numbers", opened("zero.npy")),
        (FormatError, "not a volume of numbers", opened("complex.npy")),
        (FormatError, "is a colour picture", opened("rgb.tif")),
        (FormatError, "has 4 channels", opened("c.ome.tif")),
        (FormatError, "readable|damaged", lambda: list(open_volumes(tmp_path / "cut.ome.tif"))),
        (FormatError, "needs 252 bytes, more", lambda: open_volumes(whole, max_bytes=100)[0]),
    )
