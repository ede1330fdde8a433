"""Light fields opened part by part are those that are read whole."""

from __future__ import annotations

import zipfile

import click
import h5py
import imageio.v3 as iio
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from clplen.cli import main
from clplen.cli.shared.options import Size
from clplen.errors import FormatError
from clplen.io import open_lightfield, read_lightfield, write_lightfield
from clplen.io.lightfields import array_sources
from clplen.io.lightfields.array_sources import blocks
from clplen.lightfield.model import stored_light_field
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.stacks import stack_tiles

SPACING = (-1e-3, 1.2e-3, 2e-5, 3e-5)
PARTS = [
    (slice(0, 3), slice(0, 4), slice(0, 41), slice(0, 23)),
    (slice(0, 3), slice(0, 4), slice(5, 22), slice(0, 23)),
    (slice(1, 2), slice(1, 4), slice(40, 41), slice(7, 9)),
]
LAYOUTS = [{}, {"flip_v": True}, {"swap_uv": True}, {"swap_uv": True, "flip_u": True}]


def samples(dtype=np.uint8, colours=(3,), views=(3, 4)):
    rng = np.random.default_rng(5)
    values = rng.integers(1, 255, (*views, 41, 23, *colours))
    values[1, 2] = 0
    return values.astype(dtype)


def same(path, device, parts=(), **layout):
    """Compare what is opened with what is read."""
    lf = read_lightfield(path, device=device, **layout)
    whole = lf.to_numpy()
    with open_lightfield(path, device=device, **layout) as found:
        assert isinstance(found, StoredLightField)
        assert (found.shape, found.dtype) == (lf.shape, lf.dtype)
        assert (found.spacing, found.decode) == (lf.spacing, lf.decode)
        assert found.parametrisation == lf.parametrisation
        np.testing.assert_array_equal(found.weights, lf.weights)
        if lf.positions is None:
            assert found.positions is None
        else:
            np.testing.assert_array_equal(found.positions, lf.positions)
        for part in parts:
            part = tuple(slice(*p.indices(n)) for p, n in zip(part, lf.shape, strict=False))
            np.testing.assert_array_equal(found.read(part), whole[part])
        np.testing.assert_array_equal(found.load(device).to_numpy(), whole)
        return found


def test_numpy(device, tmp_path):
    for dtype in [">u2", np.float64]:
        for layout in LAYOUTS:
            np.save(tmp_path / "lf.npy", samples(dtype))
            same(tmp_path / "lf.npy", device, PARTS, **layout)


def test_numpy_of_other_axes(device, tmp_path):
    values = samples(np.uint16)
    np.save(tmp_path / "lf.npy", values.transpose(4, 3, 0, 2, 1))
    same(tmp_path / "lf.npy", device, PARTS, order="cxvyu", flip_u=True)
    np.save(tmp_path / "f.npy", np.asfortranarray(values))
    same(tmp_path / "f.npy", device, PARTS)
    np.save(tmp_path / "s.npy", samples())
    same(tmp_path / "s.npy", device, PARTS, srgb=True)


def test_own_files(device, tmp_path_factory):
    for suffix in ["h5", "zarr"]:
        for layout in LAYOUTS:
            tmp_path = tmp_path_factory.mktemp("case")
            if suffix == "zarr":
                pytest.importorskip("zarr")
            words = {"spacing": SPACING, "weights": np.arange(12).reshape(3, 4)}
            if not layout:
                words["positions"] = np.random.default_rng(1).standard_normal((3, 4, 2))
            lf = LightField.from_array(samples(np.float32, ()), device=device, **words)
            write_lightfield(tmp_path / f"lf.{suffix}", lf)
            same(tmp_path / f"lf.{suffix}", device, PARTS, **layout)


def test_hdf5_in_chunks(device, tmp_path, monkeypatch):
    for chunks in [None, (2, 3, 7, 23, 1)]:
        monkeypatch.setattr(array_sources, "_BLOCK_BYTES", 500)
        with h5py.File(tmp_path / "lf.h5", "w") as file:
            packed = {} if chunks is None else {"compression": "gzip"}
            file.create_dataset("any", data=samples(), chunks=chunks, **packed)
        found = same(tmp_path / "lf.h5", device, PARTS, swap_uv=True)
        assert found.chunks == ((1, 23) if chunks is None else chunks[2:4])
        assert found.views_at_once == ((1, 1) if chunks is None else (chunks[1], chunks[0]))


def test_weights_in_the_last_channel(device, tmp_path):
    values = samples(np.uint8, (4,))
    with h5py.File(tmp_path / "lf.mat", "w", userblock_size=512) as file:
        turned = values.transpose(4, 3, 2, 1, 0)
        file.create_dataset("LF", data=turned).attrs["MATLAB_class"] = np.bytes_("uint8")
    found = same(tmp_path / "lf.mat", device, PARTS)
    assert len(np.unique(found.weights)) > 3
    assert found.weights[1, 2] == 0


def test_blocks_lie_on_chunks():
    """Each sample once, each block in whole chunks of the larger array."""
    for first, shape in (
        ((50, 3), (40, 9)),
        ((64, 0), (64, 5)),
        ((63, 4), (3, 1)),
        ((1, 1), (200, 8)),
    ):
        seen = np.zeros(shape, int)
        for block in blocks(shape, (64, 5), 1 << 20, first=first):
            assert all(part.start < part.stop for part in block)
            seen[block] += 1
            for part, start, chunk in zip(block, first, (64, 5), strict=True):
                inside = part.start + start, part.stop - 1 + start
                assert inside[0] // chunk == inside[1] // chunk  # these blocks are one chunk
        assert (seen == 1).all()


def folder(path, values, skip=()):
    path.mkdir()
    for v, u in np.ndindex(*values.shape[:2]):
        if (v, u) not in skip:
            iio.imwrite(path / f"view_{v}_{u}.png", values[v, u])
    return path


def test_folder(device, tmp_path_factory):
    for layout in [LAYOUTS[3], {"srgb": True}]:
        tmp_path = tmp_path_factory.mktemp("case")
        words = {"pattern": "view_{v}_{u}.png", "allow_missing": True}
        found = same(folder(tmp_path / "lf", samples(), [(0, 3)]), device, PARTS, **words, **layout)
        assert found.chunks == (41, 23)
        assert (found.weights == 0).sum() == 2


def test_archives_and_mosaics(device, tmp_path):
    files = folder(tmp_path / "lf", samples(np.uint16, ()))
    with zipfile.ZipFile(tmp_path / "lf.zip", "w") as archive:
        for file in files.iterdir():
            archive.write(file, f"inside/{file.name}")
    same(tmp_path / "lf.zip", device, PARTS)
    mosaic = samples().transpose(2, 0, 3, 1, 4).reshape(41 * 3, 23 * 4, 3)
    iio.imwrite(tmp_path / "lf.png", mosaic)
    same(tmp_path / "lf.png", device, PARTS, views=(3, 4), order="yvxu")  # read as a whole


def test_damage_in_the_middle(device, tmp_path, monkeypatch):
    monkeypatch.setattr(stored_light_field, "_BAND", 1)  # so that light is found before the damage
    values = np.concatenate([samples(np.float32)] * 3, axis=2)
    values[2, 1, 120, 4, 0] = np.inf
    np.save(tmp_path / "lf.npy", values)
    with pytest.raises(FormatError) as info:
        read_lightfield(tmp_path / "lf.npy", device=device)
    with open_lightfield(tmp_path / "lf.npy", device=device) as found:
        found.read(PARTS[1])
        memory = (found.overhead + 300_000) * 16 // 15
        tiles = iter(stack_tiles(found, disparities=[0.5], memory=memory, device=device))
        next(tiles)
        with pytest.raises(FormatError) as streamed:
            list(tiles)
    assert str(streamed.value) == str(info.value)


def test_a_file_that_is_cut_short(device, tmp_path):
    np.save(tmp_path / "lf.npy", samples())
    with open_lightfield(tmp_path / "lf.npy", device=device) as found:
        size = (tmp_path / "lf.npy").stat().st_size
        with (tmp_path / "lf.npy").open("r+b") as file:
            file.truncate(size - 1000)
        found.read((slice(0, 1), *PARTS[0][1:]))
        with pytest.raises(FormatError, match="truncated or damaged"):
            found.read(PARTS[0])


def test_errors_of_the_user_stay_what_they_are(device, tmp_path):
    """What goes wrong inside the block is not said to be a damaged file."""
    with h5py.File(tmp_path / "lf.h5", "w") as file:
        file["lightfield"] = samples()
    pytest.importorskip("zarr")
    write_lightfield(tmp_path / "lf.zarr", read_lightfield(tmp_path / "lf.h5", device=device))
    for name in ("lf.h5", "lf.zarr"):
        with pytest.raises(KeyError), open_lightfield(tmp_path / name, device=device):
            raise KeyError("mine")


def test_larger_than_may_be_read_whole(device, tmp_path):
    """The bound of a whole allocation is none of a file that is read part by part."""
    values = np.ones((2, 2, 700, 600), np.uint8)
    np.save(tmp_path / "lf.npy", values)
    with pytest.raises(FormatError, match="max_bytes"):
        read_lightfield(tmp_path / "lf.npy", device=device, max_bytes=1 << 20)
    with open_lightfield(tmp_path / "lf.npy", device=device, max_bytes=1 << 20) as found:
        assert found.nbytes == values.nbytes


@pytest.mark.thorough
def test_commands_with_a_budget(device, tmp_path):
    values = np.random.default_rng(3).integers(0, 255, (3, 4, 131, 73, 3)).astype(np.uint8)
    np.save(tmp_path / "lf.npy", values)
    planes = ("--disparities=-0.5:0.5:4", "--device", device.place)
    for name, words in (("whole", ()), ("part", ("--memory", "3MiB"))):
        for command, suffix, more in (
            ("stack", "tif", ()),
            ("depth", "npy", ("--cue", "correspondence", "--ply", tmp_path / f"{name}.ply")),
        ):
            words_of = [command, tmp_path / "lf.npy", "-o", tmp_path / f"{name}.{suffix}"]
            done = CliRunner().invoke(main, [str(w) for w in (*words_of, *planes, *words, *more)])
            assert done.exit_code == 0, done.output
    for suffix in ("npy", "ply"):
        part, whole = (tmp_path / f"{name}.{suffix}" for name in ("part", "whole"))
        assert part.read_bytes() == whole.read_bytes()
    part, whole = (tifffile.imread(tmp_path / f"{name}.tif") for name in ("part", "whole"))
    np.testing.assert_array_equal(part, whole)


def test_sizes():
    for text, size in [("512MiB", 512 << 20), ("4 GB", 4 * 10**9), ("1.5k", 1500), ("77", 77)]:
        assert Size().convert(text, None, None) == size
    for text in ["", "-3MB", "3x", "0", "nan"]:
        with pytest.raises(click.BadParameter, match="512MiB"):
            Size().convert(text, None, None)
