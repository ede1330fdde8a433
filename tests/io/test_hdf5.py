"""Light fields in HDF5: everything comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from tolerance import relative_max

from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, write_lightfield
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.wave.elements.lenslets import MicrolensArray

SHAPE = (3, 4, 5, 7, 2)


def light_field(device: Device, dtype: type = np.uint16) -> LightField:
    values = np.random.default_rng(3).integers(1, 200, SHAPE).astype(dtype)
    weights = np.linspace(0.5, 1, 12, dtype=np.float32).reshape(SHAPE[:2])
    weights[2, 1] = 0
    return LightField.from_array(
        values,
        device=device,
        spacing=(-1e-4, -2e-4, 3e-5, 4e-5),
        weights=weights,
        positions=np.random.default_rng(5).normal(size=(*SHAPE[:2], 2)),
    )


def a_camera(device: Device):
    lenslets = MicrolensArray(
        140e-6,
        9e-3,
        count=(31, 33),
        lattice="hexagonal",
        fill="circular",
        diameter=120e-6,
        offset=(3e-6, -2e-6),
        rotation=0.01,
    )
    return PlenopticCamera.type1(
        focal_length=0.1,
        mla=lenslets,
        wavelength=633e-9,
        pixels_per_lenslet=28.5,
        device=device,
        object_distance=0.3,
        aperture_diameter=2e-3,
        field_lens=True,
    )


def everything(lf: LightField) -> tuple[object, ...]:
    """What is no array."""
    return lf.shape, lf.dtype, lf.spacing, lf.decode, lf.camera


def test_everything_comes_back(tmp_path: Path, device: Device):
    for dtype in [np.uint16, np.float16]:
        lf = replace(light_field(device, dtype), camera=a_camera(device), decode="naive")
        write_lightfield(tmp_path / "a.h5", lf)
        again = read_lightfield(tmp_path / "a.h5", device=device)
        assert again.dtype == dtype
        assert everything(again) == everything(lf)
        np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy())
        np.testing.assert_array_equal(again.weights, lf.weights)
        np.testing.assert_array_equal(again.positions, lf.positions)
        assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_layout_of_the_file(tmp_path: Path, device: Device):
    lf = replace(light_field(device), camera=a_camera(device))
    write_lightfield(tmp_path / "a.h5", lf)
    with h5py.File(tmp_path / "a.h5") as file:
        data = file["lightfield"]
        assert data.attrs["axes"] == "v:u:y:x:c"
        np.testing.assert_array_equal(data.attrs["spacing"], lf.spacing)
        np.testing.assert_array_equal(data.attrs["centre"], (1.0, 1.5))
        assert data.attrs["wavelength"] == 633e-9
        assert file["weights"].shape == SHAPE[:2]
        assert file["positions"].shape == (*SHAPE[:2], 2)
        assert file["camera"].attrs["mla_f"] == 9e-3


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
                pressed = {"compression": "gzip", "shuffle": True} if chunks else {}
                file.create_dataset(
                    "lightfield", data=values.astype(dtype), chunks=chunks, **pressed
                )
            lf = read_lightfield(tmp_path / "a.h5", device=device)
            assert lf.dtype == (np.uint16 if dtype == ">u2" else np.float32)
            np.testing.assert_array_equal(lf.to_numpy(), values.astype(dtype).astype(np.float32))


def test_axes_that_do_not_fit(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["lightfield"] = np.ones((2, 2, 3, 3), np.uint8)
        file["lightfield"].attrs["axes"] = "v:u:y:x:c"
    with pytest.raises(FormatError, match=r"a\.h5: .* shape \(2, 2, 3, 3\)\. The order 'vuyxc'"):
        read_lightfield(tmp_path / "a.h5", device=device)
    with pytest.raises(FormatError, match="The order 'vuyz' does not fit"):
        read_lightfield(tmp_path / "a.h5", device=device, order="vuyz")


def test_which_dataset(tmp_path: Path, device: Device):
    ones = np.ones((2, 2, 3, 3), np.uint8)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["some/views"] = ones
        file["picture"] = ones[0, 0]
    lf = read_lightfield(tmp_path / "a.h5", device=device)
    assert lf.shape == (2, 2, 3, 3)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["other"] = 2 * ones
    with pytest.raises(FormatError, match=r"several .* other \(2, 2, 3, 3\) uint8, .* by dataset="):
        read_lightfield(tmp_path / "a.h5", device=device)
    lf = read_lightfield(tmp_path / "a.h5", device=device, dataset="other")
    assert (lf.to_numpy() == 2).all()
    with pytest.raises(FormatError, match=r"'nope' of real numbers; it holds other \(2, 2"):
        read_lightfield(tmp_path / "a.h5", device=device, dataset="nope")
    with pytest.raises(FormatError, match=r"'picture' has shape \(3, 3\); a light field has 4 or"):
        read_lightfield(tmp_path / "a.h5", device=device, dataset="picture")


def test_a_group_and_words_are_no_samples(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("lightfield/x")
    with pytest.raises(FormatError, match="it holds no dataset"):
        read_lightfield(tmp_path / "a.h5", device=device)
    for values, kind in (
        (np.full((1, 1, 2, 2), "a", h5py.string_dtype()), "object"),
        (np.ones((1, 1, 2, 2), complex), "complex128"),
    ):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["lightfield"] = values
        with pytest.raises(FormatError, match=rf"a\.h5: .* holds {kind}, no real numbers"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_what_is_wrong_inside_names_the_file(tmp_path: Path, device: Device):
    for name, value, message in [
        ("spacing", [1, 2], r"spacing is \(dv, du, dy, dx\) .* not \(1, 2\)"),
        ("spacing", [1.0, 0.0, 1.0, 1.0], r"spacing is \(dv, du, dy, dx\)"),
        ("spacing", "wide", "spacing is"),
        ("decode", "other", "'decode' is 'other'"),
        ("axes", np.zeros(6000), "does not fit"),
    ]:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["lightfield"] = np.ones((2, 2, 3, 3), np.float32)
            file["lightfield"].attrs[name] = value
        with pytest.raises(FormatError, match=rf"^.*a\.h5.*{message}"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_arrays_beside_that_do_not_fit(tmp_path: Path, device: Device):
    for name, values, message in [
        ("weights", np.ones((3, 2)), r"weights have shape \(3, 2\), the views \(2, 3\)"),
        ("weights", np.zeros((2, 3)), "not all 0"),
        ("weights", np.ones((40, 50)), r"'weights' of shape \(40, 50\)"),
        ("positions", np.ones((2, 3, 1)), r"shape \(2, 3, 2\), not \(2, 3, 1\)"),
    ]:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["lightfield"] = np.ones((2, 3, 3, 3), np.float32)
            file[name] = values
        with pytest.raises(FormatError, match=rf"a\.h5: .*{message}"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_a_camera_that_is_none(tmp_path: Path, device: Device):
    write_lightfield(tmp_path / "a.h5", replace(light_field(device), camera=a_camera(device)))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["camera"].attrs["mla_pitch"] = -1.0
    with pytest.raises(FormatError, match=r"The camera in .*a\.h5 is none: "):
        read_lightfield(tmp_path / "a.h5", device=device)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["camera"].attrs["mla_pitch"]
    with pytest.raises(FormatError, match=r"camera in .* lacks 'mla_pitch'"):
        read_lightfield(tmp_path / "a.h5", device=device)


def test_a_truncated_file(tmp_path: Path, device: Device):
    for part in [0.05, 0.95]:
        write_lightfield(tmp_path / "a.h5", light_field(device))
        whole = (tmp_path / "a.h5").read_bytes()
        (tmp_path / "a.h5").write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(FormatError, match=r"a\.h5 is truncated or damaged"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_more_is_declared_than_stored(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("lightfield", (9, 9, 999, 999, 3), np.uint8, chunks=(1, 1, 9, 9, 3))
    with pytest.raises(FormatError, match="declares 242,514,243 bytes, more than 0 stored"):
        read_lightfield(tmp_path / "a.h5", device=device)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "lightfield",
            data=np.ones((1, 1, 2, 2), np.uint8),
            chunks=(50, 10, 20, 20),
            maxshape=(None, None, None, None),
            compression="gzip",
        )
    with pytest.raises(FormatError, match="a chunk of '/lightfield' needs 200,000 bytes, more"):
        read_lightfield(tmp_path / "a.h5", device=device, max_bytes=1000)


def test_weights_of_which_most_chunks_are_missing(tmp_path: Path, device: Device):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, kind in (("lightfield", np.uint8), ("weights", np.float32)):
            shape, ones = (3000, 2000), (1, 1) if kind == np.uint8 else ()
            chunks = (100, 100, *ones)
            words = {"chunks": chunks, "compression": "gzip"}
            data = file.create_dataset(name, (*shape, *ones), kind, **words)
            data[:100, :100] = 0
        file["lightfield"].attrs["axes"] = "vuyx"
    with pytest.raises(FormatError, match=r"'weights' declares 24,000,000 bytes, more than"):
        read_lightfield(path, device=device)


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
    with pytest.raises(FormatError, match=r"compressed by .*\(32999\), a filter that is not inst"):
        read_lightfield(tmp_path / "a.h5", device=device)
