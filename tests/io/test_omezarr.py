"""OME-Zarr: what the reference reader makes of it, its pyramid, and what may be replaced."""

from __future__ import annotations

import json
import tracemalloc
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stack_tiles import Tiles, random_values

from clplen.compute.device import Device
from clplen.io import write_depth, write_image, write_lightfield, write_stack
from clplen.io.store.digest import digest
from clplen.lightfield.model.light_field import LightField

zarr = pytest.importorskip("zarr")
SPACING = (-1e-3, -1e-3, -2e-6, 3e-6)
CAMERA = SimpleNamespace(dz=lambda alpha: (alpha - 1) / 10)


def attributes(path: Path) -> dict[str, Any]:
    return json.loads((path / ".zattrs").read_text())


def levels(path: Path) -> list[np.ndarray]:
    group = zarr.open_group(str(path), mode="r")
    datasets = attributes(path)["multiscales"][0]["datasets"]
    return [np.asarray(group[item["path"]][...]) for item in datasets]


def halved(values: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 in float64; an odd last row or column is averaged with itself."""
    ny, nx = values.shape[-2:]
    rows = np.minimum(np.arange(0, ny + ny % 2), ny - 1)
    columns = np.minimum(np.arange(0, nx + nx % 2), nx - 1)
    even = values.astype(np.float64)[..., rows, :][..., columns]
    return even.reshape(*values.shape[:-2], rows.size // 2, 2, columns.size // 2, 2).mean((-3, -1))


def require_pyramid(found: list[np.ndarray], values: np.ndarray) -> None:
    np.testing.assert_array_equal(found[0], values)
    for finer, coarser in pairwise(found):
        assert coarser.dtype == np.float32
        # Three sums of float32, relative to the largest sample.
        np.testing.assert_allclose(coarser, halved(finer), rtol=0, atol=4e-7 * abs(values).max())
    assert max(found[-1].shape[-2:]) <= 256
    assert all(max(level.shape[-2:]) > 256 for level in found[:-1])


def require_valid(path: Path) -> None:
    """By the reference models of the format, where they are installed."""
    models = pytest.importorskip("ome_zarr_models.v04")
    image = models.Image.from_zarr(zarr.open_group(str(path), mode="r"))
    assert image.attributes.multiscales[0].version == "0.4"
    assert image.attributes.omero is not None


@pytest.mark.parametrize(
    ("shape", "parts", "axes"),
    [
        ((3, 301, 613), (2, 100, 400), "zyx"),
        ((2, 600, 40), (2, 77, 40), "zyx"),
        ((2, 261, 150, 3), (1, 90, 71), "czyx"),
    ],
)
def test_the_reference_reader_finds_everything(
    tmp_path: Path, shape: tuple[int, ...], parts: tuple[int, int, int], axes: str
):
    io = pytest.importorskip("ome_zarr.io")
    reader = pytest.importorskip("ome_zarr.reader")
    values = random_values(*shape)
    path = tmp_path / "s.ome.zarr"
    write_stack(path, Tiles(values, parts, SPACING, CAMERA), durable=True)
    (node,) = reader.Reader(io.parse_url(path, mode="r"))()
    found = node.metadata["axes"]
    assert [axis["name"] for axis in found] == list(axes)
    kinds = {"c": "channel", "z": "space", "y": "space", "x": "space"}
    assert [axis["type"] for axis in found] == [kinds[letter] for letter in axes]
    units = {"y": "micrometer", "x": "micrometer"}
    assert [axis.get("unit") for axis in found] == [units.get(letter) for letter in axes]
    stored = np.moveaxis(values, -1, 0) if values.ndim == 4 else values
    read = [np.asarray(level) for level in node.data]
    require_pyramid(read, stored)
    for level, moves in enumerate(node.metadata["coordinateTransformations"]):
        leading = len(axes) - 2
        assert moves[0]["scale"] == pytest.approx([1] * leading + [2 * 2**level, 3 * 2**level])
    assert node.metadata["name"] == "s"
    require_valid(path)
    for level, array in enumerate(node.data):
        assert array.chunksize[:-2] == (1,) * (len(axes) - 2)
        assert max(array.chunksize[-2:]) <= 512, level
    assert [file.name for file in tmp_path.iterdir()] == ["s.ome.zarr"]


def test_pixels_of_all_levels_lie_where_their_means_do(tmp_path: Path):
    """Each sample is its own place in micrometres, and so is each mean: by axis and sign."""
    y, x = np.meshgrid(2.0 * np.arange(520), 3.0 * np.arange(1040), indexing="ij")
    for axis, values in enumerate((y, x)):
        path = tmp_path / f"{axis}.zarr"
        write_image(path, values, spacing=SPACING)
        found, datasets = levels(path), attributes(path)["multiscales"][0]["datasets"]
        assert len(found) == 4
        for level, dataset in zip(found, datasets, strict=True):
            moves = {m["type"]: m[m["type"]] for m in dataset["coordinateTransformations"]}
            shift = moves.get("translation", [0, 0])[axis]
            places = shift + moves["scale"][axis] * np.arange(level.shape[axis])
            expected = np.broadcast_to(places[:, None] if axis == 0 else places, level.shape)
            np.testing.assert_allclose(level, expected, rtol=1e-6)


def test_what_planes_are_is_said(tmp_path: Path):
    write_stack(tmp_path / "s.zarr", Tiles(random_values(3, 4, 5), (3, 2, 5), None, CAMERA))
    said = attributes(tmp_path / "s.zarr")
    assert said["clplen"]["disparities"] == [-1.0, 0.5, 2.0]
    assert said["clplen"]["alphas"] == [1.25, 0.875, None]
    assert said["clplen"]["dz_m"] == pytest.approx([0.025, -0.0125, None])
    assert "nearer" in said["clplen"]["disparity"]
    (image,) = said["multiscales"]
    assert image["axes"] == [{"name": letter, "type": "space"} for letter in "zyx"]
    (dataset,) = image["datasets"]
    moves = [{"type": "scale", "scale": [1, 1, 1]}]
    assert dataset == {"path": "0", "coordinateTransformations": moves}


def windows(path: Path) -> list[tuple[str, str, float, float]]:
    channels = attributes(path)["omero"]["channels"]
    return [(c["label"], c["color"], c["window"]["min"], c["window"]["max"]) for c in channels]


def test_colours_share_a_window(tmp_path: Path):
    values = np.zeros((2, 4, 5, 3), np.float32)
    values[1, 3, 4, 2], values[0, 0, 0, 0], values[0, 1, 1, 1] = 7, -2, np.nan
    write_stack(tmp_path / "s.zarr", Tiles(values, (1, 2, 5)))
    colours = (("red", "FF0000"), ("green", "00FF00"), ("blue", "0000FF"))
    assert windows(tmp_path / "s.zarr") == [(*colour, -2, 7) for colour in colours]
    write_image(tmp_path / "a.zarr", np.full((3, 4), 2.5))
    assert windows(tmp_path / "a.zarr") == [("intensity", "FFFFFF", 2.5, 3.5)]
    write_image(tmp_path / "b.zarr", np.full((3, 4), np.inf))
    assert windows(tmp_path / "b.zarr") == [("intensity", "FFFFFF", 0, 1)]
    write_stack(tmp_path / "two.zarr", Tiles(values[..., 1:], (1, 2, 5)))
    assert [name for name, *_ in windows(tmp_path / "two.zarr")] == ["intensity 0", "intensity 1"]
    for name in ("s", "a", "b", "two"):
        require_valid(tmp_path / f"{name}.zarr")


def test_depth_has_named_channels(tmp_path: Path):
    disparity, confidence, z = random_values(3, 6, 5)
    z[2, 3] = np.inf
    depth = SimpleNamespace(disparity=disparity, confidence=confidence, alpha=z * np.nan, z=z)
    path = tmp_path / "d.ome.zarr"
    write_depth(path, depth, spacing=SPACING, durable=True)
    np.testing.assert_array_equal(levels(path)[0], [disparity, confidence, z])
    said = attributes(path)
    assert [axis["name"] for axis in said["multiscales"][0]["axes"]] == ["c", "y", "x"]
    finite = z[np.isfinite(z)]
    assert windows(path) == [
        (name, "FFFFFF", values.min(), values.max())
        for name, values in (("disparity", disparity), ("confidence", confidence), ("z", finite))
    ]
    assert [c["active"] for c in said["omero"]["channels"]] == [True, False, False]
    require_valid(path)


def test_unknown_pixels_do_not_disturb_their_level(tmp_path: Path):
    values = random_values(20, 300)
    values[4, 6], values[10, 20], values[11, 20] = np.nan, np.inf, -np.inf
    write_image(tmp_path / "a.zarr", values)
    assert np.argwhere(~np.isfinite(levels(tmp_path / "a.zarr")[1])).tolist() == [[2, 3], [5, 10]]


def write_ones(path: Path, shape: tuple[int, ...], **words: bool) -> None:
    write_stack(path, Tiles(np.ones(shape, np.float32), (1, 2, 3)), **words)


def test_another_shape_is_replaced_only_on_demand(tmp_path: Path):
    path = tmp_path / "s.zarr"
    write_stack(path, Tiles(random_values(2, 4, 5), (2, 4, 5)))
    write_ones(path, (2, 4, 5))
    assert levels(path)[0].shape == (2, 4, 5)
    assert (levels(path)[0] == 1).all()
    said = r"s\.zarr exists already with shape \(2, 4, 5\) instead of \(3, 2, 4, 5\): replace it"
    with pytest.raises(FileExistsError, match=said):
        write_ones(path, (2, 4, 5, 3))
    assert levels(path)[0].shape == (2, 4, 5)
    write_ones(path, (2, 4, 5, 3), replace=True)
    assert levels(path)[0].shape == (3, 2, 4, 5)
    assert [file.name for file in tmp_path.iterdir()] == ["s.zarr"]


def test_other_things_are_never_replaced(tmp_path: Path, device: Device):
    lf = LightField.from_array(random_values(3, 3, 4, 5), device=device)
    write_lightfield(tmp_path / "lf.zarr", lf)
    (tmp_path / "file.zarr").write_text("x")
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "thesis.txt").write_text("x")
    (tmp_path / "damaged.zarr").mkdir()
    (tmp_path / "damaged.zarr" / ".zattrs").write_text("{")
    (tmp_path / "damaged.zarr" / ".zgroup").write_text("{}")
    before = digest(tmp_path)
    for name in ("lf", "file", "folder", "damaged"):
        for replace in (False, True):
            with pytest.raises(FileExistsError, match=rf"{name}\.zarr exists already and is not"):
                write_ones(tmp_path / f"{name}.zarr", (2, 4, 5), replace=replace)
    assert digest(tmp_path) == before
    (tmp_path / "empty.zarr").mkdir()
    write_ones(tmp_path / "empty.zarr", (2, 4, 5))
    assert levels(tmp_path / "empty.zarr")[0].shape == (2, 4, 5)


def test_memory_does_not_grow_with_the_stack(tmp_path: Path):
    class Same(Tiles):
        def __iter__(self):
            for i in range(0, 384, 16):
                yield slice(None), slice(i, i + 16), slice(None), self.values

        @property
        def shape(self) -> tuple[int, ...]:
            return (30, 384, 384)

    tiles = Same(random_values(30, 16, 384), (30, 16, 384))
    write_ones(tmp_path / "first.zarr", (2, 4, 300))  # imports what the package needs
    tracemalloc.start()
    write_stack(tmp_path / "s.zarr", tiles)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 4 * 384 * 384  # of 30 planes; the copies of one that is read and halved
