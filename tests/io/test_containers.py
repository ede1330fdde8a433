"""Light fields in HDF5 and Zarr: everything comes back, and damage has a name."""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from refusals import refused
from tolerance import relative_max

from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, write_lightfield
from clplen.io.lightfields import container_lightfields
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.wave.elements.lenslets import MicrolensArray

zarr = pytest.importorskip("zarr")
SHAPE = (3, 5, 7, 11, 2)
FORMATS = ["a.h5", "a.zarr"]


def values_of(dtype: Any = np.uint16) -> np.ndarray:
    return np.random.default_rng(8).integers(1, 200, SHAPE).astype(dtype)


def light_field(device: Device, dtype: Any = np.uint16) -> LightField:
    weights = np.linspace(0.5, 1, 15, dtype=np.float32).reshape(SHAPE[:2])
    weights[2, 1] = 0
    return LightField.from_array(
        values_of(dtype),
        device=device,
        spacing=(-1e-4, -2e-4, 3e-5, 4e-5),
        weights=weights,
        positions=np.random.default_rng(5).normal(size=(*SHAPE[:2], 2)),
    )


def with_camera(lf: LightField) -> LightField:
    lenslets = MicrolensArray(
        140e-6, 9e-3, count=(31, 33), lattice="hexagonal", fill="circular", diameter=120e-6,
        offset=(3e-6, -2e-6), rotation=0.01,
    )  # fmt: skip
    camera = PlenopticCamera.type1(
        focal_length=0.1, mla=lenslets, wavelength=633e-9, pixels_per_lenslet=28.5,
        device=lf.device, object_distance=0.3, aperture_diameter=2e-3, field_lens=True,
    )  # fmt: skip
    return replace(lf, camera=camera, decode="naive")


def put(path: Path, name: str, values: np.ndarray, *, form: int = 2, **attributes: Any) -> Any:
    """Add an array to a container by the package of its format alone."""
    if path.suffix == ".h5":
        with h5py.File(path, "a") as file:
            file[name] = values
            file[name].attrs.update(attributes)
        return None
    if name:
        zarr.open_group(str(path), mode="a", zarr_format=form)
    array = zarr.create(
        values.shape, dtype=values.dtype, store=str(path), path=name, chunks=values.shape,
        zarr_format=form,
    )  # fmt: skip
    array[...] = values
    array.attrs.update(attributes)
    return array


def change(path: Path, name: str, **attributes: Any) -> None:
    """Change attributes of an array or group; None takes one away."""
    if path.suffix == ".h5":
        with h5py.File(path, "a") as file:
            found = file[name].attrs
            for key, value in attributes.items():
                found.pop(key) if value is None else found.update({key: value})
        return
    known = json.loads((path / name / ".zattrs").read_text()) | attributes
    kept = {key: value for key, value in known.items() if value is not None}
    (path / name / ".zattrs").write_text(json.dumps(kept))


def remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


@pytest.mark.parametrize("name", FORMATS)
def test_everything_comes_back(tmp_path: Path, device: Device, name: str):
    lf = with_camera(light_field(device, np.float16))
    write_lightfield(tmp_path / name, lf)
    assert [file.name for file in tmp_path.iterdir()] == [name]
    paths = [tmp_path / name]
    if name == "a.zarr":
        paths.append(Path(shutil.make_archive(str(tmp_path / "packed"), "zip", paths[0])))
    for path in paths:
        again = read_lightfield(path, device=device)
        for word in ("shape", "dtype", "spacing", "decode", "camera"):
            assert getattr(again, word) == getattr(lf, word)
        for word in ("weights", "positions"):
            np.testing.assert_array_equal(getattr(again, word), getattr(lf, word))
        np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy())


@pytest.mark.parametrize("name", FORMATS)
def test_layout_of_the_container(tmp_path: Path, device: Device, name: str):
    write_lightfield(tmp_path / name, with_camera(light_field(device)))
    root = (h5py.File if name == "a.h5" else zarr.open)(str(tmp_path / name), mode="r")
    known = dict(root["lightfield"].attrs)
    assert known["axes"] == "v:u:y:x:c"
    np.testing.assert_array_equal(known["spacing"], (-1e-4, -2e-4, 3e-5, 4e-5))
    np.testing.assert_array_equal(known["centre"], (1.0, 2.0))
    assert known["wavelength"] == 633e-9
    assert root["weights"].shape == SHAPE[:2]
    assert root["positions"].shape == (*SHAPE[:2], 2)
    assert dict(root["camera"].attrs)["mla_f"] == 9e-3
    assert root["lightfield"].chunks == (None if name == "a.h5" else (1, 5, 7, 11, 2))


def test_words_of_layout_turn_everything(tmp_path: Path, device: Device):
    lf = light_field(device)
    write_lightfield(tmp_path / "a.h5", lf)
    again = read_lightfield(tmp_path / "a.h5", device=device, swap_uv=True, flip_v=True)
    for name in ("weights", "positions"):
        kept = getattr(lf, name).swapaxes(0, 1)[::-1]
        np.testing.assert_array_equal(getattr(again, name), kept)
    np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy().swapaxes(0, 1)[::-1])
    assert again.spacing == lf.spacing  # the unit of the positions, which stay
    want = refocus(lf, disparity=0.7).to_numpy()
    assert relative_max(want, refocus(again, disparity=0.7).to_numpy()) <= 1e-6
    write_lightfield(tmp_path / "b.h5", replace(lf, positions=None))
    again = read_lightfield(tmp_path / "b.h5", device=device, swap_uv=True, flip_v=True)
    assert again.spacing == (2e-4, -1e-4, 3e-5, 4e-5)  # the file's u, reversed, then its v
    again = read_lightfield(tmp_path / "b.h5", device=device, flip_v=True)
    want = refocus(replace(lf, positions=None), disparity=0.7).to_numpy()
    assert relative_max(want, refocus(again, disparity=0.7).to_numpy()) <= 1e-6


def test_other_types_and_chunks(tmp_path: Path, device: Device):
    for chunks in [None, (2, 1, 3, 5, 2)]:
        values = np.random.default_rng(4).integers(0, 250, SHAPE)
        for dtype in (">u2", "<f8", "<i4", "?"):
            with h5py.File(tmp_path / "a.h5", "w") as file:
                packed = {"compression": "gzip", "shuffle": True} if chunks else {}
                file.create_dataset(
                    "lightfield", data=values.astype(dtype), chunks=chunks, **packed
                )
            lf = read_lightfield(tmp_path / "a.h5", device=device)
            assert lf.dtype == (np.uint16 if dtype == ">u2" else np.float32)
            np.testing.assert_array_equal(lf.to_numpy(), values.astype(dtype).astype(np.float32))


@pytest.mark.parametrize("form", [2, 3])
def test_both_formats_of_zarr(
    tmp_path: Path, device: Device, form: int, caplog: pytest.LogCaptureFixture
):
    values = values_of(">f8")
    turned = values.transpose(4, 2, 1, 0, 3)
    zarr.open_group(str(tmp_path / "a.zarr"), mode="a", zarr_format=form)
    array = zarr.create(
        turned.shape, dtype=turned.dtype, store=str(tmp_path / "a.zarr"), path="lightfield",
        chunks=(1, 4, 3, 2, 2), zarr_format=form,
    )  # fmt: skip
    array[...] = turned
    array.attrs.update({"axes": "c:y:u:v:x", "spacing": [1, 2, 3, 4]})
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "a.zarr", device=device, flip_u=True)
    np.testing.assert_array_equal(lf.to_numpy(), values[:, ::-1])
    assert lf.spacing == (1, -2, 3, 4)
    assert "float32 (stored as" in caplog.text
    assert "'lightfield' with axes c:y:u:v:x (as stored), flip_u" in caplog.text


@pytest.mark.parametrize("name", FORMATS)
def test_which_array(tmp_path: Path, device: Device, name: str):
    path, values = tmp_path / name, values_of()

    def read(**words: Any) -> np.ndarray:
        return read_lightfield(path, device=device, **words).to_numpy()

    put(path, "deep/one" if name == "a.h5" else "one", values)
    put(path, "picture", values[0, 0, ..., 0])
    np.testing.assert_array_equal(read(), values)
    put(path, "two", 2 * values)
    np.testing.assert_array_equal(read(dataset="two"), 2 * values)
    refused(
        (FormatError, r"several .*two \(3, 5, 7, 11, 2\) uint16.* by dataset=", read),
        (FormatError, r"'no' of real numbers; it has .*picture \(7", lambda: read(dataset="no")),
        (
            FormatError,
            r"'picture' must have 4 or 5 .* got shape \(7, 11\)",
            lambda: read(dataset="picture"),
        ),
        (FormatError, "order must have .* got 'vuyz'", lambda: read(dataset="two", order="vuyz")),
    )


def test_a_store_that_is_one_array(tmp_path: Path, device: Device):
    path, values = tmp_path / "a.zarr", values_of()
    put(path, "", values, form=3)
    lf = read_lightfield(path, device=device, order="uvyxc")
    np.testing.assert_array_equal(lf.to_numpy(), values.swapaxes(0, 1))
    with pytest.raises(FormatError, match="single array without a dataset 'a'"):
        read_lightfield(path, device=device, dataset="a")
    group = tmp_path / "g.zarr"
    zarr.open_group(str(group), mode="a", zarr_format=3)
    zarr.open_group(str(group / "deep"), mode="a", zarr_format=3)
    put(group, "deep/one", values, form=3)
    np.testing.assert_array_equal(read_lightfield(group, device=device).to_numpy(), values)


def test_a_group_and_words_are_no_samples(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("lightfield/x")
    with pytest.raises(FormatError, match="it has no dataset"):
        read_lightfield(tmp_path / "a.h5", device=device)
    for values, kind in (
        (np.full((1, 1, 2, 2), "a", h5py.string_dtype()), "object"),
        (np.ones((1, 1, 2, 2), complex), "complex128"),
    ):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["lightfield"] = values
        with pytest.raises(FormatError, match=rf"a\.h5: .* must hold real numbers, got {kind}"):
            read_lightfield(tmp_path / "a.h5", device=device)


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_wrong_inside_names_the_container(tmp_path: Path, device: Device, name: str):
    path = tmp_path / name
    for words, message in [
        ({"spacing": [1, 2]}, r"spacing must be \(dv, du, dy, dx\) .* got \(1, 2\)"),
        ({"spacing": [1.0, 0.0, 1.0, 1.0]}, r"spacing .*\(dv, du, dy, dx\)"),
        ({"spacing": "wide"}, "spacing must be"),
        ({"decode": "other"}, "'decode' must be .* got 'other'"),
        ({"axes": "v:u:y:x:c"}, r"shape \(2, 3, 3, 3\)\. order must .* 'vuyxc'"),
    ]:
        put(path, "lightfield", np.ones((2, 3, 3, 3), np.float32), **words)
        with pytest.raises(FormatError, match=rf"{name}.*{message}"):
            read_lightfield(path, device=device)
        remove(path)
    for beside, values, message in [
        ("weights", np.ones((3, 2)), r"weights must have the shape \(2, 3\) .* got \(3, 2\)"),
        ("weights", np.zeros((2, 3)), "not all 0"),
        ("weights", np.ones((40, 50)), r"'weights' must hold at most 12 real .* shape \(40, 50\)"),
        ("positions", np.ones((2, 3, 1)), r"shape \(2, 3, 2\), got \(2, 3, 1\)"),
    ]:
        put(path, "lightfield", np.ones((2, 3, 3, 3), np.float32))
        put(path, beside, values)
        with pytest.raises(FormatError, match=rf"{name}: .*{message}"):
            read_lightfield(path, device=device)
        remove(path)
    write_lightfield(path, with_camera(light_field(device)))
    for pitch, message in ((-1.0, "is invalid: "), (None, "has no parameter 'mla_pitch'")):
        change(path, "camera", mla_pitch=pitch)
        with pytest.raises(FormatError, match=rf"The camera in .*{name} {message}"):
            read_lightfield(path, device=device)


def test_a_truncated_file(tmp_path: Path, device: Device):
    for part in [0.05, 0.95]:
        write_lightfield(tmp_path / "a.h5", light_field(device))
        whole = (tmp_path / "a.h5").read_bytes()
        (tmp_path / "a.h5").write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(FormatError, match=r"a\.h5 is truncated or damaged"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_more_is_declared_than_hdf5_stores(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("lightfield", (9, 9, 999, 999, 3), np.uint8, chunks=(1, 1, 9, 9, 3))
    with pytest.raises(FormatError, match="declares 242,514,243 bytes, more than 0 stored"):
        read_lightfield(tmp_path / "a.h5", device=device)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "lightfield", data=np.ones((1, 1, 2, 2), np.uint8), chunks=(50, 10, 20, 20),
            maxshape=(None,) * 4, compression="gzip",
        )  # fmt: skip
    with pytest.raises(FormatError, match="a chunk of '/lightfield' needs 200,000 bytes, more"):
        read_lightfield(tmp_path / "a.h5", device=device, max_bytes=1000)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, kind, ones in (("lightfield", np.uint8, (1, 1)), ("weights", np.float32, ())):
            words = {"chunks": (100, 100, *ones), "compression": "gzip"}
            data = file.create_dataset(name, (3000, 2000, *ones), kind, **words)
            data[:100, :100] = 0
    with pytest.raises(FormatError, match=r"'weights' declares 24,000,000 bytes, more than"):
        read_lightfield(tmp_path / "a.h5", device=device, order="vuyx")


def test_chunks_that_were_never_written_are_dark(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        shape = (2, 3, 900, 700)
        data = file.create_dataset("lightfield", shape, np.uint8, chunks=(1, 1, 900, 700))
        data[:, 2] = 7
    lf = read_lightfield(tmp_path / "a.h5", device=device)
    np.testing.assert_array_equal(lf.weights, [[0, 0, 1], [0, 0, 1]])


def test_filters_that_are_not_installed(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk((1, 1, 2, 2))
        made.set_filter(32000 + 999, h5py.h5z.FLAG_OPTIONAL)
        space = h5py.h5s.create_simple((1, 1, 2, 2))
        h5py.h5d.create(file.id, b"lightfield", h5py.h5t.NATIVE_UINT8, space, made)
    with pytest.raises(FormatError, match=r"compressed with .*\(32999\), a filter that is not"):
        read_lightfield(tmp_path / "a.h5", device=device)


# Zarr


def test_a_folder_that_holds_something_stays(tmp_path: Path, device: Device):
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr" / "note").touch()
    with pytest.raises(FileExistsError, match=r"a\.zarr exists already and is not empty"):
        write_lightfield(tmp_path / "a.zarr", light_field(device))
    assert [file.name for file in tmp_path.rglob("*")] == ["a.zarr", "note"]


@pytest.mark.parametrize("form", [2, 3])
def test_more_is_declared_than_zarr_stores(tmp_path: Path, device: Device, form: int):
    put(tmp_path / "a.zarr", "", values_of("u1"), form=form)
    file = tmp_path / "a.zarr" / ("zarr.json" if form == 3 else ".zarray")
    declared = json.loads(file.read_text())
    declared["shape"][2] = 10**9
    file.write_text(json.dumps(declared))
    with pytest.raises(FormatError, match=r"142,857,143 chunks, but at most \d+ are stored"):
        read_lightfield(tmp_path / "a.zarr", device=device)
    declared["shape"] = [10**9] * 5
    grid = declared["chunk_grid"]["configuration"] if form == 3 else declared
    grid["chunk_shape" if form == 3 else "chunks"] = [10**9] * 5
    file.write_text(json.dumps(declared))
    with pytest.raises(FormatError, match="a chunk of its array declares 1,000,000,000,000,000"):
        read_lightfield(tmp_path / "a.zarr", device=device)


def test_files_of_a_store_that_are_damaged(tmp_path: Path, device: Device):
    path = tmp_path / "a.zarr"
    for name, content in (
        (".zgroup", b"{"),
        ("lightfield/1.0.0.0.0", b"x" * 40),
        ("lightfield/.zarray", b"{}"),
    ):
        write_lightfield(path, light_field(device))
        (path / name).write_bytes(content)
        with pytest.raises(FormatError, match=r"a\.zarr"):
            read_lightfield(path, device=device)
        shutil.rmtree(path)


def test_without_the_package(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch):
    lf = light_field(device)
    write_lightfield(tmp_path / "a.zarr", lf)
    monkeypatch.setitem(sys.modules, "zarr", None)
    for act in (
        lambda: write_lightfield(tmp_path / "b.zarr", lf),
        lambda: read_lightfield(tmp_path / "a.zarr", device=device),
    ):
        with pytest.raises(FormatError, match=r'pip install "clplen\[zarr\]", or use \.h5'):
            act()
    assert [file.name for file in tmp_path.iterdir()] == ["a.zarr"]
    monkeypatch.setitem(sys.modules, "zarr", zarr)
    monkeypatch.setattr(zarr, "__version__", "2.18.3")
    with pytest.raises(FormatError, match=r"needs the package zarr 3 .*, got 2\.18\.3"):
        read_lightfield(tmp_path / "a.zarr", device=device)


def archive_of(folder: Path, **more: bytes) -> Path:
    with zipfile.ZipFile(folder.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.iterdir()):
            archive.write(file, file.name)
        for name, content in more.items():
            archive.writestr(name, content)
    return folder.with_suffix(".zip")


def test_members_of_an_archive_that_are_too_large(tmp_path: Path, device: Device):
    put(tmp_path / "a.zarr", "", values_of())
    path = archive_of(tmp_path / "a.zarr")
    whole = path.read_bytes()
    entry = whole.rindex(b"PK\1\2")  # of the last member in the directory at the end
    for offset, message in ((20, "is larger than the file"), (24, "declares 2,130,706,432 bytes")):
        lies = bytearray(whole)
        lies[entry + offset : entry + offset + 4] = b"\0\0\0\x7f"
        path.write_bytes(lies)
        with pytest.raises(FormatError, match=rf"a\.zip: its member .*{message}"):
            read_lightfield(path, device=device)
    path = archive_of(tmp_path / "a.zarr", **{".zgroup": b" " * (5 << 20)})
    with pytest.raises(FormatError, match=r"'\.zgroup' declares 5,242,880 bytes, but metadata"):
        read_lightfield(path, device=device)


def test_files_of_a_store_with_a_long_hole(tmp_path: Path, device: Device):
    good = tmp_path / "good.zarr"
    put(good, "", values_of())
    for file in sorted(file for file in good.rglob("*") if file.is_file()):
        bad = tmp_path / f"bad {file.name}.zarr"
        shutil.copytree(good, bad)
        os.truncate(bad / file.relative_to(good), 1 << 30)
        with pytest.raises(FormatError, match=r"member .* declares 1,073,741,824 bytes.*at most"):
            read_lightfield(bad, device=device)


def test_large_rows_of_views_are_cut(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(container_lightfields, "_MAX_CHUNK_BYTES", 3 * 5 * 13 * 2 + 1)
    values = np.random.default_rng(1).integers(0, 999, (2, 3, 11, 13), np.uint16)
    write_lightfield(tmp_path / "lf.zarr", LightField.from_array(values, device=device))
    root = zarr.open_group(str(tmp_path / "lf.zarr"), mode="r")
    assert root["lightfield"].chunks == (1, 3, 5, 13)
    assert np.array_equal(read_lightfield(tmp_path / "lf.zarr", device=device).to_numpy(), values)
