"""Raw lenslet frames in files: read, calibrated and decoded by the words of layout."""

from __future__ import annotations

import logging
import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from reference_lattice import lattice as drawn_lattice
from reference_lattice import white
from refusals import refused

from clplen.compute.device import Device
from clplen.errors import FormatError, SamplingWarning, ShapeError
from clplen.io import read_lightfield
from clplen.lightfield.calibration.lattice_fit import estimate_lattice
from clplen.lightfield.calibration.raw_decoding import decode_raw
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.refocusing.focal_stacks import refocus

SHAPE = (163, 171)
PITCH = 11.2
DARK = 200


def waves(y, x):
    return 1 + 0.4 * np.cos(0.035 * y - 0.3) * np.cos(0.05 * x)


def frames(
    kind: str = "square", pitch: float = PITCH, *, left: float = 85.2
) -> dict[str, np.ndarray]:
    """Raw frame, white image, dark frame: uint16."""
    true = drawn_lattice(kind, pitch, degrees=1.5, origin=(81.4, left))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    _, _, dy, dx = true.nearest(y, x)
    even = white(SHAPE, true, vignetting=0.2)
    scene = waves(y + 4 * dy, x + 4 * dx)
    dark = np.full(SHAPE, DARK) + np.random.default_rng(1).integers(0, 3, SHAPE)
    dark[50, 60] = 9000
    values = {"raw": 2e4 * even * scene + dark, "white": 3e4 * even + dark, "dark": dark}
    return {name: np.round(array).astype(np.uint16) for name, array in values.items()}


@pytest.fixture(scope="module")
def values() -> dict[str, np.ndarray]:
    return frames()


@pytest.fixture
def folder(tmp_path: Path, values: dict[str, np.ndarray]) -> Path:
    for name, array in values.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", array)
    return tmp_path


def words_of(folder: Path, *names: str) -> dict[str, Path]:
    return {name: folder / f"{name}.tif" for name in names}


def test_a_frame_with_its_white_image_and_dark_frame(
    folder: Path, values: dict[str, np.ndarray], device: Device, caplog: pytest.LogCaptureFixture
):
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(folder / "raw.tif", device=device, **words_of(folder, "white", "dark"))
    assert lf.shape[:2] == (11, 11)
    lattice = estimate_lattice(values["white"], dark=values["dark"])
    own = decode_raw(
        values["raw"], lattice, device=device, white=values["white"], dark=values["dark"]
    )
    np.testing.assert_array_equal(lf.to_numpy(), own.to_numpy())
    np.testing.assert_array_equal(lf.weights, own.weights)
    assert lf.raw.lattice == lattice
    at = lattice.at(*np.indices(lf.shape[2:]))  # the law: sharp at d = 5 pixels of 11.2 a lenslet
    at = at - at[0, 0] + lf.raw.sub_images.first
    sharp = refocus(lf, disparity=5 * lattice.view_steps((11, 11))[0][0] / PITCH).to_numpy()
    want = waves(at[..., 0], at[..., 1])
    assert np.corrcoef(sharp[3:-3, 3:-3].ravel(), want[3:-3, 3:-3].ravel())[0, 1] > 0.99
    said = caplog.messages[-1]
    assert "11 x 11 views (V x U)" in said
    for text in ("divided by the white image", "white.tif", "pitch 11.2", "rotation 1.5", "px rms"):
        assert text in said


def test_a_lattice_is_kept_for_the_next_frame(
    folder: Path, values: dict[str, np.ndarray], device: Device
):
    kind = "hexagonal"
    for name, array in frames(kind).items():
        tifffile.imwrite(folder / f"{name}.tif", array)
    beside = words_of(folder, "white", "dark")
    first = read_lightfield(folder / "raw.tif", device=device, lattice=kind, **beside)
    first.raw.lattice.save(folder / "grid.json")
    again = read_lightfield(folder / "raw.tif", device=device, grid=folder / "grid.json", **beside)
    np.testing.assert_array_equal(again.to_numpy(), first.to_numpy())
    alone = read_lightfield(
        folder / "raw.tif", device=device, grid=folder / "grid.json", dark=beside["dark"]
    )
    assert alone.shape == first.shape
    assert (alone.weights == 1).all()
    assert alone.raw.lattice == first.raw.lattice


def test_words_of_layout(folder: Path, values: dict[str, np.ndarray], device: Device):
    words = {"device": device, "views": (7, 5), "step": 1.2}
    read = partial(
        read_lightfield, folder / "raw.tif", device=device, **words_of(folder, "white", "dark")
    )
    plain = read(views=(7, 5), step=1.2)
    known = {name: values[name] for name in ("white", "dark")}
    own = decode_raw(values["raw"], plain.raw.lattice, **known, **words)
    np.testing.assert_array_equal(plain.to_numpy(), own.to_numpy())
    turned = read(views=(7, 5), step=1.2, swap_uv=True, flip_u=True)
    np.testing.assert_array_equal(turned.to_numpy(), plain.to_numpy().swapaxes(0, 1)[:, ::-1])
    np.testing.assert_array_equal(turned.weights, plain.weights.T[:, ::-1])
    dim = read(views=(7, 5), step=1.2, devignette=False)
    assert (dim.weights == 1).all()
    np.testing.assert_array_equal(
        dim.to_numpy(),
        decode_raw(values["raw"], plain.raw.lattice, dark=values["dark"], **words).to_numpy(),
    )
    assert read(bayer="GRBG", demosaic="after", lattice="square").shape[4:] == (3,)
    never = {"bayer": "GRBG", "demosaic": "not at all"}
    refused(
        (ValueError, "demosaic must be 'within', 'after' or 'before'", lambda: read(**never)),
        (ValueError, "order= does not apply", lambda: read(order="vuyx")),
        (ValueError, "lattice must be 'square' or 'hexagonal'", lambda: read(lattice="round")),
    )


def test_pictures_that_do_not_belong(folder: Path, values: dict[str, np.ndarray], device: Device):
    tifffile.imwrite(folder / "small.tif", values["white"][:-1])
    tifffile.imwrite(folder / "colour.tif", np.stack([values["raw"]] * 3, -1))
    white = words_of(folder, "white")
    for frame, words, message in (
        *(
            ("raw", {**white, word: folder / f"{name}.tif"}, said)
            for word in ("white", "dark")
            for name, said in (
                ("small", r"small\.tif must have the shape .* got \(162, 171\)"),
                ("none", r"none\.tif"),
            )
        ),
        ("colour", white, "must have one channel, got 3"),
    ):
        with pytest.raises(FormatError, match=message):
            read_lightfield(folder / f"{frame}.tif", device=device, **words)


def test_pictures_that_stand_in_for_one_another(folder: Path, device: Device):
    """A frame, its white image and its dark frame in every wrong place that brightness tells."""

    def read(frame: str, white: str, black: str, **words: Any) -> Any:
        given = {"white": folder / f"{white}.tif", "dark": folder / f"{black}.tif"}
        return read_lightfield(folder / f"{frame}.tif", device=device, **given, **words)

    read("raw", "white", "dark")
    for swapped, said in {
        ("dark", "white", "raw"): r"dark\.tif is darker than its dark frame .*raw\.tif: check",
        ("raw", "white", "raw"): r"dark frame .*raw\.tif is identical to .*raw\.tif",
        ("raw", "dark", "white"): r"dark\.tif must be brighter than the dark frame .*white\.tif",
    }.items():
        with pytest.raises(FormatError, match=said) as error:
            read(*swapped)
        assert "\n" not in str(error.value)
    with pytest.warns(SamplingWarning, match=r"white\.tif are identical"):
        read("white", "white", "dark")
    with pytest.warns(SamplingWarning, match="low trust"):
        assert read("dark", "white", "raw", force=True)


def test_a_dim_frame_over_a_drifting_offset_is_read(tmp_path: Path, device: Device):
    """Its mean lies below that of the dark frame; a few bright places tell that it is none."""
    random = np.random.default_rng(6)
    white = frames()["white"]
    frame = 97 + 4 * random.standard_normal(SHAPE)
    frame[40:70, 40:70] += 60
    dark = 100 + 4 * random.standard_normal(SHAPE)
    assert frame.mean() < 0.99 * dark.mean()
    for name, values in {"white": white, "frame": frame, "dark": dark}.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", values.clip(0, 65535).round().astype(np.uint16))
    words = {"white": tmp_path / "white.tif", "dark": tmp_path / "dark.tif"}
    assert read_lightfield(tmp_path / "frame.tif", device=device, **words)


def test_a_white_image_of_another_camera(
    folder: Path, values: dict[str, np.ndarray], device: Device
):
    estimate_lattice(values["white"], dark=values["dark"]).save(folder / "grid.json")
    words = words_of(folder, "white", "dark") | {"grid": folder / "grid.json"}
    for flat in (frames(pitch=11.6)["white"], frames(left=89.2)["white"]):  # another pitch, moved
        tifffile.imwrite(folder / "white.tif", flat)
        with pytest.raises(FormatError, match=r"grid\.json and the white .*different cameras"):
            read_lightfield(folder / "raw.tif", device=device, **words)


def test_a_frame_without_white_image(
    folder: Path, values: dict[str, np.ndarray], device: Device, caplog: pytest.LogCaptureFixture
):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    scene = 2000 + 1500 * np.sin(y / 5) * np.sin(x / 7 + y / 30) + 300 * ((x // 23 + y // 17) % 2)
    tifffile.imwrite(folder / "scene.tif", scene.astype(np.uint16))
    with pytest.raises(FormatError, match=r"scene\.tif are unknown: give white=.*grid="):
        read_lightfield(folder / "scene.tif", device=device)
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(folder / "white.tif", device=device)  # even light on a plain object
    assert lf.shape[:2] == (11, 11)
    assert "of the frame itself, without a white image" in caplog.messages[-1]


def test_a_lattice_that_does_not_fit(folder: Path, device: Device):
    read = partial(read_lightfield, folder / "raw.tif", device=device, grid=folder / "grid.json")
    (folder / "grid.json").write_text("{")
    refused((FormatError, r"grid\.json is not valid JSON", read))
    Lattice("square", (81.4, 85.2), (11, 0), (0, 11), (160, 171)).save(folder / "grid.json")
    refused((FormatError, r"grid\.json .* got \(160, 171\)", read))
    Lattice("square", (81.4, 85.2), (400, 0), (0, 400), SHAPE).save(folder / "grid.json")
    refused((ShapeError, r"raw\.tif: No lenslet of pitch 400", read))


def test_a_frame_that_would_take_too_much_memory(tmp_path: Path, one_device: Device):
    path, needed = tmp_path / "a.tif", "3,000,000 pixels needs 72,000,000 bytes"
    tifffile.imwrite(path, np.zeros((2000, 1500), np.uint8), compression="zlib", tile=(512, 512))
    tracemalloc.start()
    try:
        with pytest.raises(
            FormatError,
            match=rf"a\.tif: detecting the lenslets among {needed}, more than 50,000,000 ",
        ):
            read_lightfield(path, device=one_device, max_bytes=50_000_000)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000  # nothing was decoded
        with pytest.raises(FormatError, match="no repeated pattern"):
            read_lightfield(path, device=one_device)
        assert tracemalloc.get_traced_memory()[1] < 12_000_000  # a frame of zeros is not converted
    finally:
        tracemalloc.stop()


def test_more_views_than_memory(folder: Path, one_device: Device):
    path = folder / "raw.tif"
    words = {**words_of(folder, "white"), "device": one_device}
    nbytes = 24 * tifffile.imread(path).size  # detecting the lenslets
    read_lightfield(path, max_bytes=nbytes, **words)
    with pytest.raises(FormatError, match=r"raw\.tif: decoding .* samples needs .* bytes"):
        read_lightfield(path, views=(90, 90), step=0.1, max_bytes=nbytes, **words)
