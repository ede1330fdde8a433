"""Folders of views: orientation, types, gaps and damage."""

from __future__ import annotations

import shutil
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile

from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError
from clplen.io import (
    open_lightfield,
    read_lightfield,
    write_lightfield,
    write_mosaic,
    write_views,
)
from clplen.io.lightfields.lightfield_files import files_of
from clplen.lightfield.model.light_field import LightField

SHAPE = (3, 4, 7, 11)  # V, U, y, x: all different


def samples(dtype: type = np.uint8, channels: int = 3) -> np.ndarray:
    random = np.random.default_rng(5)
    values = random.integers(1, 250, SHAPE + ((channels,) if channels > 1 else ()))
    return values.astype(dtype) * (1 if dtype == np.uint8 else 7)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """views/ holds samples() as p_{v}_{u}.png, numbered from 1."""
    path = tmp_path / "views"
    path.mkdir()
    for v, u in np.ndindex(*SHAPE[:2]):
        imageio.imwrite(path / f"p_{v + 1}_{u + 1}.png", samples()[v, u])
    return path


def test_values_are_the_file_s_own(folder: Path, device: Device):
    lf = read_lightfield(folder, device=device, pattern="p_{v}_{u}.png")
    assert lf.dtype == np.uint8
    assert lf.spacing is None
    np.testing.assert_array_equal(lf.to_numpy(), samples())
    np.testing.assert_array_equal(lf.weights, np.ones(SHAPE[:2]))
    lf = read_lightfield(folder, device=device, swap_uv=True, flip_v=True)  # swapped first
    np.testing.assert_array_equal(lf.to_numpy(), samples().swapaxes(0, 1)[::-1])


def test_views_in_folders(tmp_path: Path, device: Device):
    for v, u in np.ndindex(2, 3):
        (tmp_path / f"row{v}").mkdir(exist_ok=True)
        imageio.imwrite(tmp_path / f"row{v}" / f"{u}.png", samples()[v, u])
    lf = read_lightfield(tmp_path, device=device, pattern="row{v}/{u}.png")
    np.testing.assert_array_equal(lf.to_numpy(), samples()[:2, :3])


def test_written_and_read_again(tmp_path: Path, device: Device):
    for dtype, channels, suffix in [
        (np.uint8, 3, "png"),
        (np.uint16, 1, "tif"),
        (np.float32, 3, "tif"),
    ]:
        values = samples(dtype, channels)
        out = tmp_path / f"{suffix}{channels}" / "out"
        out.parent.mkdir()
        write_lightfield(out, LightField.from_array(values, device=device))
        names = sorted(file.name for file in out.iterdir())
        assert names[-1] == f"view_02_03.{suffix}"
        assert len(names) == 12
        assert list(out.parent.iterdir()) == [out]
        again = read_lightfield(out, device=device)
        assert again.dtype == dtype
        np.testing.assert_array_equal(again.to_numpy(), values)


@pytest.mark.parametrize("form", ["views", "stanford", "zip", "tif"])
def test_axes_of_length_1_are_kept(tmp_path: Path, device: Device, form: str):
    shape = (1, 3, 1, 5) if form in ("views", "tif") else (3, 1, 7, 1, 1)
    dtype = np.float32 if form == "tif" else np.uint8
    values = np.random.default_rng(1).integers(1, 200, shape).astype(dtype)
    lf = LightField.from_array(values, device=device)
    path, words = tmp_path / f"a.{form}", {"views": shape[:2]}
    if form == "tif":
        write_mosaic(path, lf, order="vyux")
        words["order"] = "vyux"
    else:
        folder = tmp_path / "folder"
        write_views(folder, lf, **({"pattern": form} if form == "stanford" else {}))
        path = Path(shutil.make_archive(str(path), "zip", folder)) if form == "zip" else folder
    found = read_lightfield(path, device=device, **words)
    assert found.shape == shape
    np.testing.assert_array_equal(found.to_numpy(), values)
    with open_lightfield(path, device=device, **words) as stored:
        assert stored.shape == shape


def test_missing_views_are_listed_or_get_weight_zero(folder: Path, device: Device):
    (folder / "p_2_3.png").unlink()
    with pytest.raises(FormatError, match=r"1 of 3 x 4 views are missing .*\(v=1, u=2\)"):
        read_lightfield(folder, device=device)
    lf = read_lightfield(folder, device=device, allow_missing=True, flip_v=True, swap_uv=True)
    expected = np.ones((3, 4), np.float32)
    expected[1, 2] = 0
    np.testing.assert_array_equal(lf.weights, expected.T[::-1])
    assert not lf.to_numpy()[::-1].swapaxes(0, 1)[1, 2].any()


def test_every_unusable_picture_is_listed(folder: Path, device: Device):
    whole = (folder / "p_1_2.png").read_bytes()
    (folder / "p_1_2.png").write_bytes(whole[: len(whole) // 2])
    (folder / "p_2_2.png").write_bytes(b"no picture at all")
    imageio.imwrite(folder / "p_1_1.png", samples()[0, 0, :-1])  # of another size, though first
    imageio.imwrite(folder / "p_3_3.png", samples()[0, 0, ..., 0])
    with pytest.raises(FormatError) as caught:
        read_lightfield(folder, device=device)
    text = str(caught.value)
    assert "4 of 12 views" in text
    assert all(f"{name}.png is unreadable" in text for name in ("p_1_2", "p_2_2"))
    assert "p_1_1.png is 6 x 11 x 3 uint8, most are 7 x 11 x 3 uint8" in text
    assert "p_3_3.png is 7 x 11 uint8, most are 7 x 11 x 3 uint8" in text


def test_one_cause_is_told_once(folder: Path, device: Device):
    for file in folder.iterdir():
        imageio.imwrite(file, np.full((4, 5, 4), 200, np.uint8))
    with pytest.raises(FormatError) as caught:
        read_lightfield(folder, device=device)
    names = [f"p_{v + 1}_{u + 1}.png" for v, u in np.ndindex(*SHAPE[:2])][:10]
    assert str(caught.value) == (
        f"12 of 12 views in {folder} cannot be used: {', '.join(names)} and 2 more have "
        "transparent pixels: flatten it first."
    )


def test_the_files_of_a_light_field(folder: Path):
    (folder / "notes.txt").touch()
    assert sorted(files_of(folder)) == sorted(folder.glob("p_*.png"))
    few = files_of(folder, pattern="p_1_{i}.png")
    assert sorted(few) == sorted(folder.glob("p_1_*.png"))
    assert files_of(folder / "notes.txt") == [folder / "notes.txt"]


def test_truncated_pictures(tmp_path: Path, device: Device):
    for suffix, kept in [("png", 0), ("jpg", 0.6), ("tif", 0.95)]:
        picture = np.random.default_rng(1).integers(0, 255, (40, 50, 3)).astype(np.uint8)
        for u in range(3):
            imageio.imwrite(tmp_path / f"0_{u}.{suffix}", picture)
        damaged = tmp_path / f"0_1.{suffix}"
        whole = damaged.read_bytes()
        damaged.write_bytes(whole[: int(kept * len(whole)) if isinstance(kept, float) else kept])
        with pytest.raises(FormatError, match=rf"1 of 3 views .*0_1\.{suffix} is unreadable"):
            read_lightfield(tmp_path, device=device, pattern="{v}_{u}." + suffix)


def test_srgb_is_decoded(folder: Path, device: Device):
    flips = {"swap_uv": True, "flip_u": True}
    raw = read_lightfield(folder, device=device, **flips).to_numpy()
    lf = read_lightfield(folder, device=device, srgb=True, **flips)
    s = raw / 255  # IEC 61966-2-1:1999
    expected = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    assert lf.dtype == np.float32
    np.testing.assert_allclose(lf.to_numpy(), expected, rtol=1e-6)  # float32: 6e-8


def test_lawnmower(tmp_path: Path, device: Device):
    places = [(v, u if v % 2 == 0 else 3 - u) for v in range(3) for u in range(4)]
    for i, (v, u) in enumerate(places):
        imageio.imwrite(tmp_path / f"shot{i + 5}.png", samples()[v, u])
    lf = read_lightfield(tmp_path, device=device, order="lawnmower", views=(3, 4))
    np.testing.assert_array_equal(lf.to_numpy(), samples())
    with pytest.raises(ValueError, match=r"must be order='lawnmower' or omitted .* order='vuyx'"):
        read_lightfield(tmp_path, device=device, order="vuyx", views=(3, 4))


@pytest.fixture
def hci_folder(tmp_path: Path) -> Path:
    """A scene as the HCI 4D benchmark stores it, with 3 x 3 views."""
    for i in range(9):
        imageio.imwrite(tmp_path / f"input_Cam{i:03d}.png", samples()[i // 3, i % 3])
    for name in ("mask_edges.png", "objectids_lowres.png", "depth_01.png", "gt_disp_1_2.png"):
        imageio.imwrite(tmp_path / name, np.zeros((3, 3), np.uint8))
    (tmp_path / "gt_disp_lowres.pfm").touch()
    (tmp_path / "parameters.cfg").touch()
    return tmp_path


def test_hci_takes_only_the_views(hci_folder: Path, device: Device):
    expected = samples()[:3, :3]
    np.testing.assert_array_equal(read_lightfield(hci_folder, device=device).to_numpy(), expected)
    any_number = read_lightfield(hci_folder, device=device, pattern="*{i}.png")
    np.testing.assert_array_equal(any_number.to_numpy(), expected)
    assert len(files_of(hci_folder)) == 9


def test_stanford_names_and_positions(tmp_path: Path, device: Device):
    places = np.random.default_rng(4).uniform(-0.2, 0.2, (3, 4, 2))
    places += np.stack(np.indices((3, 4)), axis=-1)
    for v, u in np.ndindex(3, 4):
        y, x = 1000 - 40 * places[v, u, 0], 40 * places[v, u, 1] - 7  # y of the names grows upwards
        end = "__" if u == 2 else "_"
        name = f"out_{v + 3:02d}_{u:02d}_{y:.6f}_{x:.6f}{end}.png"
        imageio.imwrite(tmp_path / name, samples()[v, u])
    lf = read_lightfield(tmp_path, device=device, positions="names")
    np.testing.assert_array_equal(lf.to_numpy(), samples())
    places -= places.mean(axis=(0, 1))
    assert lf.positions is not None
    # The step is that of the straight line through the places, not exactly one.
    step = np.polyfit(np.indices((3, 4))[1].ravel(), places[..., 1].ravel(), 1)[0]
    np.testing.assert_allclose(lf.positions, places / step, atol=1e-6)
    assert read_lightfield(tmp_path, device=device).positions is None


def test_names_of_others_are_written(tmp_path: Path, device: Device):
    for pattern, last in [
        ("hci", "input_Cam011.png"),
        ("stanford", "out_02_03_-1.000000_1.500000_.png"),
        ("row{v}x{u:03d}", "row2x003.png"),
    ]:
        out = tmp_path / last
        write_views(out, LightField.from_array(samples(), device=device), pattern=pattern)
        names = sorted(file.name for file in out.iterdir())
        assert names[-1] == last
        lf = read_lightfield(out, device=device, views=(3, 4))
        np.testing.assert_array_equal(lf.to_numpy(), samples())


def test_positions_are_written_in_names(tmp_path: Path, device: Device):
    places = np.stack(np.indices((3, 4)), axis=-1).astype(float)
    places += [[[0.1, -0.2]], [[0, 0]], [[-0.1, 0.2]]]
    places -= places.mean(axis=(0, 1))
    lf = LightField.from_array(samples(), device=device, positions=places)
    write_views(tmp_path / "out", lf, pattern="stanford")
    again = read_lightfield(tmp_path / "out", device=device, positions="names")
    np.testing.assert_allclose(again.positions, places, atol=2e-6)  # six decimals


def test_what_is_not_written(folder: Path, device: Device):
    lf = LightField.from_array(samples(), device=device)
    for pattern in ["a_{v}", "a_{v}_{u}_{n}", "{v}/{u}"]:
        with pytest.raises(ValueError, match="pattern must"):
            write_views(folder / "out", lf, pattern=pattern)
        assert not (folder / "out").exists()
    with pytest.raises(FileExistsError, match="exists already and is not empty"):
        write_lightfield(folder, lf)


def test_more_than_max_bytes(folder: Path, device: Device, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(FormatError, match=r"light field needs 2,772 bytes, more than 2,771 \(the"):
        read_lightfield(folder, device=device, max_bytes=2771)
    with pytest.raises(FormatError, match=r"12 of 12 views .* need \d+ bytes, more than 230"):
        read_lightfield(folder, device=device, max_bytes=230)
    assert read_lightfield(folder, device=device, max_bytes=2772).shape == (*SHAPE, 3)
    monkeypatch.setattr(device, "memory_bytes", 1000)
    with pytest.raises(DeviceError, match=r"This light field needs 2,772 bytes .* has 1,000 bytes"):
        read_lightfield(folder, device=device)


def test_nan_in_a_picture_is_refused(tmp_path: Path, device: Device):
    picture = np.ones((4, 5), np.float32)
    picture[2, 3] = np.nan
    tifffile.imwrite(tmp_path / "0_0.tif", picture)
    with pytest.raises(ValueError, match=f"^{tmp_path}: .* 1 samples that are NaN or infinite"):
        read_lightfield(tmp_path, device=device, pattern="{v}_{u}.tif")


def test_words_that_do_not_apply(folder: Path, device: Device):
    with pytest.raises(ValueError, match="white= does not apply to a folder of views"):
        read_lightfield(folder, device=device, white="x")
    with pytest.raises(TypeError, match="flip_w"):
        read_lightfield(folder, device=device, flip_w=True)


def test_other_types_become_float32(tmp_path: Path, device: Device):
    values = samples(np.float64, 1) / 7
    for v, u in np.ndindex(2, 3):
        tifffile.imwrite(tmp_path / f"{v}_{u}.tif", values[v, u])
    lf = read_lightfield(tmp_path, device=device, pattern="{v}_{u}.tif")
    assert lf.dtype == np.float32
    np.testing.assert_array_equal(lf.to_numpy(), values[:2, :3].astype(np.float32))
