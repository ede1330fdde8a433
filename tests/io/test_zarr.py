"""Light fields in Zarr."""

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

import numpy as np
import pytest

from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, write_lightfield
from clplen.io.lightfields import container_lightfields
from clplen.lightfield.model.light_field import LightField
from clplen.wave.elements.lenslets import MicrolensArray

zarr = pytest.importorskip("zarr")
SHAPE = (3, 5, 7, 11, 2)
FORMATS = [2, 3]


def values_of(dtype: Any = np.uint16) -> np.ndarray:
    return np.random.default_rng(8).integers(1, 250, SHAPE).astype(dtype)


def light_field(device: Device, dtype: Any = np.uint16) -> LightField:
    weights = np.linspace(0, 1, 15).reshape(3, 5)
    positions = np.random.default_rng(5).normal(size=(3, 5, 2))
    camera = PlenopticCamera.type1(
        focal_length=0.1,
        mla=MicrolensArray(140e-6, 9e-3, count=(31, 33), offset=(3e-6, -2e-6)),
        wavelength=633e-9,
        pixels_per_lenslet=28.5,
        device=device,
    )
    lf = LightField.from_array(
        values_of(dtype),
        device=device,
        spacing=(-1e-4, -2e-4, 3e-5, 4e-5),
        weights=weights,
        positions=positions,
    )
    return replace(lf, camera=camera, decode="naive")


def write(path: Path, form: int, name: str, values: np.ndarray, **words: Any) -> Any:
    """An array by the package alone."""
    chunks = words.pop("chunks", values.shape)
    array = zarr.create(
        values.shape,
        dtype=values.dtype,
        store=str(path),
        path=name,
        chunks=chunks,
        zarr_format=form,
        **words,
    )
    array[...] = values
    return array


def group(path: Path, form: int) -> None:
    zarr.open_group(str(path), mode="a", zarr_format=form)


def test_everything_comes_back(tmp_path: Path, device: Device):
    for dtype in [np.float16]:
        lf = light_field(device, dtype)
        write_lightfield(tmp_path / "a.zarr", lf)
        shutil.make_archive(str(tmp_path / "packed"), "zip", tmp_path / "a.zarr")
        for name in ("a.zarr", "packed.zip"):
            again = read_lightfield(tmp_path / name, device=device)
            assert (again.dtype, again.spacing, again.decode) == (dtype, lf.spacing, "naive")
            assert again.camera == lf.camera
            for kept in ("weights", "positions"):
                np.testing.assert_array_equal(getattr(again, kept), getattr(lf, kept))
            np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy())
        assert sorted(file.name for file in tmp_path.iterdir()) == ["a.zarr", "packed.zip"]


def test_layout_of_the_folder(tmp_path: Path, device: Device):
    write_lightfield(tmp_path / "a.zarr", light_field(device))
    root = zarr.open(str(tmp_path / "a.zarr"), mode="r")
    assert root["lightfield"].chunks == (1, 5, 7, 11, 2)
    attributes = dict(root["lightfield"].attrs)
    assert attributes["axes"] == "v:u:y:x:c"
    assert attributes["spacing"] == [-1e-4, -2e-4, 3e-5, 4e-5]
    assert attributes["centre"] == [1.0, 2.0]
    assert attributes["wavelength"] == 633e-9
    assert dict(root["camera"].attrs)["mla_f"] == 9e-3
    assert root["weights"].shape == (3, 5)


def test_a_folder_that_holds_something_stays(tmp_path: Path, device: Device):
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr" / "note").touch()
    with pytest.raises(FileExistsError, match=r"a\.zarr is there already and not empty"):
        write_lightfield(tmp_path / "a.zarr", light_field(device))
    assert [file.name for file in tmp_path.rglob("*")] == ["a.zarr", "note"]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("chunks", [(2, 2, 3, 4, 1)])
def test_by_the_package_alone(
    tmp_path: Path,
    device: Device,
    form: int,
    chunks: tuple[int, ...],
    caplog: pytest.LogCaptureFixture,
):
    values = values_of(">f8")
    group(tmp_path / "a.zarr", form)
    turned = values.transpose(4, 2, 1, 0, 3)
    array = write(tmp_path / "a.zarr", form, "lightfield", turned, chunks=chunks[::-1])
    array.attrs.update({"axes": "c:y:u:v:x", "spacing": [1, 2, 3, 4]})
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "a.zarr", device=device, flip_u=True)
    np.testing.assert_array_equal(lf.to_numpy(), values[:, ::-1])
    assert lf.spacing == (1, -2, 3, 4)
    assert "float32 (stored as" in caplog.text
    assert "'lightfield' with axes c:y:u:v:x (as the file says), flip_u" in caplog.text


def test_which_array(tmp_path: Path, device: Device):
    form = 3
    values = values_of()
    write(tmp_path / "root.zarr", form, "", values)
    lf = read_lightfield(tmp_path / "root.zarr", device=device, order="uvyxc")
    np.testing.assert_array_equal(lf.to_numpy(), values.swapaxes(0, 1))
    with pytest.raises(FormatError, match="one array, with no dataset 'a'"):
        read_lightfield(tmp_path / "root.zarr", device=device, dataset="a")
    group(tmp_path / "a.zarr", form)
    group(tmp_path / "a.zarr" / "deep", form)
    write(tmp_path / "a.zarr", form, "deep/one", values)
    write(tmp_path / "a.zarr", form, "picture", values[0, 0])
    lf = read_lightfield(tmp_path / "a.zarr", device=device)
    np.testing.assert_array_equal(lf.to_numpy(), values)
    write(tmp_path / "a.zarr", form, "two", 2 * values)
    with pytest.raises(FormatError, match=r"several datasets .*two \(3, 5, 7, 11, 2\) uint16"):
        read_lightfield(tmp_path / "a.zarr", device=device)
    lf = read_lightfield(tmp_path / "a.zarr", device=device, dataset="two")
    np.testing.assert_array_equal(lf.to_numpy(), 2 * values)
    with pytest.raises(FormatError, match=r"'nope' of real numbers; it holds .*picture \(7, 11"):
        read_lightfield(tmp_path / "a.zarr", device=device, dataset="nope")
    with pytest.raises(FormatError, match=r"'picture' has shape \(7, 11, 2\); a light field has"):
        read_lightfield(tmp_path / "a.zarr", device=device, dataset="picture")


@pytest.mark.parametrize("form", FORMATS)
def test_more_is_declared_than_stored(tmp_path: Path, device: Device, form: int):
    write(tmp_path / "a.zarr", form, "", values_of("u1"))
    name = "zarr.json" if form == 3 else ".zarray"
    declared = json.loads((tmp_path / "a.zarr" / name).read_text())
    declared["shape"][2] = 10**9
    (tmp_path / "a.zarr" / name).write_text(json.dumps(declared))
    with pytest.raises(FormatError, match=r"142,857,143 chunks, of which at most \d+ are there"):
        read_lightfield(tmp_path / "a.zarr", device=device)
    big = [10**9] * 5
    declared["shape"] = big
    if form == 3:
        declared["chunk_grid"]["configuration"]["chunk_shape"] = big
    else:
        declared["chunks"] = big
    (tmp_path / "a.zarr" / name).write_text(json.dumps(declared))
    with pytest.raises(FormatError, match="a chunk of its array declares 1,000,000,000,000,000"):
        read_lightfield(tmp_path / "a.zarr", device=device)


def test_what_is_wrong_inside_names_the_folder(tmp_path: Path, device: Device):
    def damaged(message: str) -> None:
        with pytest.raises(FormatError, match=rf"a\.zarr.*{message}"):
            read_lightfield(tmp_path / "a.zarr", device=device)
        shutil.rmtree(tmp_path / "a.zarr")

    def written() -> Path:
        write_lightfield(tmp_path / "a.zarr", light_field(device))
        return tmp_path / "a.zarr"

    (written() / ".zgroup").write_text("{")
    damaged("is truncated or damaged")
    (written() / "lightfield" / ".zattrs").write_text('{"axes": "v:u:y:x"}')
    damaged("'lightfield' has shape .* 'vuyx' does not fit")
    (written() / "lightfield" / ".zattrs").write_text('{"spacing": [1, 2, 3, "a"]}')
    damaged("spacing is")
    (written() / "lightfield" / ".zattrs").write_text('{"decode": "x"}')
    damaged("'decode' is 'x'")
    (written() / "camera" / ".zattrs").write_text('{"kind": "type1"}')
    damaged("lacks 'mla_pitch'")
    shutil.rmtree(written() / "weights")
    shutil.copytree(tmp_path / "a.zarr" / "positions", tmp_path / "a.zarr" / "weights")
    damaged("weights have shape")
    shutil.rmtree(written() / "weights")
    shutil.copytree(tmp_path / "a.zarr" / "lightfield", tmp_path / "a.zarr" / "weights")
    damaged("'weights' of shape .* not up to 30 real numbers")
    chunk = written() / "lightfield" / "1.0.0.0.0"
    chunk.write_bytes(chunk.read_bytes()[:40])
    damaged("is truncated or damaged")
    (written() / "lightfield" / ".zarray").write_text("{}")
    damaged("")


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
    with pytest.raises(FormatError, match=r"needs the package zarr 3 .*, not 2\.18\.3"):
        read_lightfield(tmp_path / "a.zarr", device=device)


def test_members_of_an_archive_that_are_too_large(tmp_path: Path, device: Device):
    write(tmp_path / "a.zarr", 2, "", values_of())
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted((tmp_path / "a.zarr").iterdir()):
            archive.write(file, file.name)
    whole = (tmp_path / "a.zip").read_bytes()
    entry = whole.rindex(b"PK\1\2")  # of the last member in the directory at the end
    for offset, message in ((20, "is larger than the file"), (24, "declares 2,130,706,432 bytes")):
        lies = bytearray(whole)
        lies[entry + offset : entry + offset + 4] = b"\0\0\0\x7f"
        (tmp_path / "a.zip").write_bytes(lies)
        with pytest.raises(FormatError, match=rf"a\.zip: its member .*{message}"):
            read_lightfield(tmp_path / "a.zip", device=device)


def test_files_of_a_store_with_a_long_hole(tmp_path: Path, device: Device):
    for form in [2]:
        good = tmp_path / "good.zarr"
        write(good, form, "", values_of())
        for file in sorted(file for file in good.rglob("*") if file.is_file()):
            bad = tmp_path / f"bad {file.name}.zarr"
            shutil.copytree(good, bad)
            os.truncate(bad / file.relative_to(good), 1 << 30)
            with pytest.raises(
                FormatError, match=r"member .* declares 1,073,741,824 bytes.*at most"
            ):
                read_lightfield(bad, device=device)


def test_long_metadata_in_an_archive(tmp_path: Path, device: Device):
    write(tmp_path / "a.zarr", 2, "", values_of())
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for file in sorted((tmp_path / "a.zarr").iterdir()):
            archive.write(file, file.name)
        archive.writestr(".zgroup", b" " * (5 << 20))
    with pytest.raises(FormatError, match=r"'\.zgroup' declares 5,242,880 bytes, metadata"):
        read_lightfield(tmp_path / "a.zip", device=device)


def test_large_rows_of_views_are_cut(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(container_lightfields, "_CHUNK", 3 * 5 * 13 * 2 + 1)
    values = np.random.default_rng(1).integers(0, 999, (2, 3, 11, 13), np.uint16)
    write_lightfield(tmp_path / "lf.zarr", LightField.from_array(values, device=device))
    root = zarr.open_group(str(tmp_path / "lf.zarr"), mode="r")
    assert root["lightfield"].chunks == (1, 3, 5, 13)
    assert np.array_equal(read_lightfield(tmp_path / "lf.zarr", device=device).to_numpy(), values)
