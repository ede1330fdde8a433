"""White images of Lytro cameras: chosen among twelve, refused where none fits; levels, colours."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from lytro_files import (
    a_container,
    content,
    contents_of,
    described,
    f01,
    illum,
    modulation,
    write_archive,
    write_folder,
    write_volumes,
)
from reference_lattice import lattice, white

from clplen import read_lightfield
from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.lightfields import lenslet_frames
from clplen.io.raw import lytro_calibration
from clplen.io.raw.lytro_calibration import choose_white_image, read_white_images
from clplen.io.raw.lytro_container import read_lytro_frame

SHAPE = (124, 140)
SERIAL = "B5143300780"
ZOOMS, FOCUSES = (12, 480, 901, 1402), (3, 250, 777)
WRITERS = {"folder": write_folder, "archive": write_archive, "volumes": write_volumes}


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch):
    """No calibration is known from elsewhere."""
    monkeypatch.setattr(lytro_calibration, "cache_dir", lambda: tmp_path / "cache")
    monkeypatch.delenv("CLPLEN_LYTRO", raising=False)


@cache
def evenly_lit(origin: tuple[float, float]) -> np.ndarray:
    """A hexagonal array, 10 px apart, in even light, 0 to 1."""
    true = lattice("hexagonal", 10.0, degrees=0.1, origin=origin)
    return white(SHAPE, true, vignetting=0.2)


def flat(origin: tuple[float, float] = (61.3, 70.2), top: float = 800.0) -> np.ndarray:
    """White image, whole numbers."""
    return np.rint(top * evenly_lit(origin)).astype(np.uint16)


def twelve(camera=illum, **words: object) -> dict[str, bytes]:
    """A calibration with a white image for each of four zooms and three foci."""
    files: dict[str, bytes] = {}
    for number, (zoom, focus) in enumerate((z, f) for z in ZOOMS for f in FOCUSES):
        raw, metadata = camera(flat(top=500.0 + 20 * number))
        about = described(metadata, **{"serial": SERIAL, "zoom": zoom, "focus": focus, **words})
        files[f"MOD_{number:04d}.RAW"] = raw
        files[f"MOD_{number:04d}.TXT"] = modulation(about)
    return files


def a_picture(path: Path, frame: np.ndarray, *, camera=illum, **words: object) -> Path:
    raw, metadata = camera(frame)
    about = described(metadata, **{"serial": SERIAL, "zoom": 470, "focus": 700, **words})
    return a_container(path, raw, about, newer=camera is illum)


@pytest.mark.parametrize(
    ("kind", "zoom", "focus", "number", "missing"),
    [
        ("folder", 470, 700, 5, None),
        ("archive", 900, 777, 7, 8),  # zoom counts before focus
        ("volumes", 9999, 9999, 11, None),
    ],
)
def test_the_right_one_of_twelve(tmp_path: Path, kind, zoom, focus, number, missing):
    suffix = ".tar" if kind == "archive" else ""
    files = {name: data for name, data in twelve().items() if f"{missing}." not in name}
    place = WRITERS[kind](tmp_path / f"calibration{suffix}", files)
    images = read_white_images(place)
    assert len(images) == (12 if missing is None else 11)
    path = a_picture(tmp_path / "a.lfr", flat(), zoom=zoom, focus=focus)
    metadata = read_lytro_frame(path)[2]
    found = choose_white_image(metadata, images, picture=path, calibration=place)
    np.testing.assert_array_equal(found.read(), flat(top=500.0 + 20 * number))
    assert found.metadata.zoom_step == ZOOMS[number // 3]
    assert found.metadata.focus_step == FOCUSES[number % 3]


def test_what_the_camera_refers_to_is_taken(tmp_path: Path):
    """An Illum names the hash of a geometry file, which the manifest lists."""
    files = twelve() | {
        "cal_file_manifest.json": json.dumps(
            {"calibrationFiles": [{"hash": "sha1-geometry", "name": "MOD_0002.GCT"}]}
        ).encode()
    }
    place = write_archive(tmp_path / "caldata.tar", files)
    raw, metadata = illum(flat())
    sections = [content(raw), content(json.dumps(described(metadata, serial=SERIAL)).encode())]
    frame = {"imageRef": sections[0][1].decode(), "metadataRef": sections[1][1].decode()}
    table = {"frames": [{"frame": frame | {"geometryCorrectionRef": "sha1-geometry"}}]}
    head = (b"M", *content(json.dumps(table).encode())[1:])
    path = tmp_path / "a.lfr"
    path.write_bytes(contents_of([head, *sections]))
    metadata = read_lytro_frame(path)[2]
    found = choose_white_image(metadata, read_white_images(place), picture=path, calibration=place)
    assert found.name.endswith("MOD_0002.RAW")


def test_dark_images_and_copies_are_left_out(tmp_path: Path):
    dark = {f"DARK_{name}": data for name, data in twelve(f01, exposure=0.001).items()}
    images = read_white_images(write_volumes(tmp_path / "c", twelve(f01) | dark))
    assert len(images) == 12
    assert all("DARK" not in image.name for image in images)
    files = twelve()
    files |= {f"COPY_{name}": data for name, data in files.items()}
    place, path = write_folder(tmp_path / "d", files), a_picture(tmp_path / "a.lfr", flat())
    metadata = read_lytro_frame(path)[2]  # equal bytes are no doubt
    choose_white_image(metadata, read_white_images(place), picture=path, calibration=place)


def refused(tmp_path: Path, place: Path, match: str, **words: object) -> None:
    path = a_picture(tmp_path / "a.lfr", flat(), **words)
    with pytest.raises(FormatError, match=match):
        read_lightfield(path, calibration=place)


@pytest.mark.thorough
def test_calibrations_that_do_not_fit(tmp_path: Path):
    place = write_folder(tmp_path / "c", twelve())
    refused(
        tmp_path, place, rf"a\.lfr was taken by the camera X1, but .*c has .* of {SERIAL}",
        serial="X1",
    )  # fmt: skip
    refused(tmp_path, tmp_path / "none", "The calibration .*none does not exist")
    (tmp_path / "empty").mkdir()
    refused(tmp_path, tmp_path / "empty", "has no white images of a Lytro camera")
    (tmp_path / "text").write_text("no archive")
    refused(tmp_path, tmp_path / "text", "must be a folder, a tar archive or a volume")
    files = twelve()
    files["MOD_0099.RAW"] = illum(flat(top=900.0))[0]
    files["MOD_0099.TXT"] = files["MOD_0005.TXT"]
    alike = write_folder(tmp_path / "alike", files)
    refused(tmp_path, alike, r"Two different .* equally well, .*MOD_0005.*MOD_0099.*--white")
    files = twelve()
    files["MOD_0005.RAW"] = files["MOD_0005.RAW"][:-40]
    cut = write_archive(tmp_path / "cut.tar", files)
    refused(tmp_path, cut, r"MOD_0005\.RAW: .*the file is truncated")
    whole = cut.read_bytes()
    (tmp_path / "half.tar").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path, tmp_path / "half.tar", r"half\.tar is not a complete tar archive|truncated")
    files = twelve() | {"MOD_0003.TXT": b'{"master": ['}
    refused(tmp_path, write_folder(tmp_path / "json", files), "MOD_0003.TXT: the metadata is no")


@pytest.mark.thorough
def test_levels_and_colours(tmp_path: Path, device: Device):
    """An even scene: linear light in which 1 is white, balanced, through the matrix."""
    black, top = 64, 1023
    colour = {"R": 0.31, "G": 0.57, "B": 0.23}
    gains = (1.5, 1.0, 2.0)
    matrix = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0, -0.5, 1.5]])
    even = flat(top=900.0).astype(float) / 900
    tile = np.array([[colour[c] for c in "GR"], [colour[c] for c in "BG"]])
    frame = np.rint(black + (top - black) * even * np.tile(tile, (SHAPE[0] // 2, SHAPE[1] // 2)))
    words = {"black": black, "white": top, "gains": gains, "matrix": list(matrix.ravel())}
    files = {}
    raw, metadata = illum(np.rint(black + 900 * even).astype(np.uint16))
    files["MOD_0000.RAW"] = raw
    files["MOD_0000.TXT"] = modulation(described(metadata, serial=SERIAL, black=black))
    place = write_folder(tmp_path / "c", files)
    path = a_picture(tmp_path / "a.lfr", frame.astype(np.uint16), **words)
    lf = read_lightfield(path, calibration=place, device=device, views=(5, 5))
    assert lf.linear
    assert lf.spacing is not None
    assert lf.spacing[2] == pytest.approx(10 * 1.4e-6 * np.sqrt(3) / 2, rel=1e-3)
    wanted = matrix @ (np.array(list(colour.values())) * gains)
    found = np.median(lf.to_numpy()[:, :, 2:-2, 2:-2], axis=(0, 1, 2, 3))
    # levels are whole numbers of 959: half a level is .1 % of the dimmest colour
    np.testing.assert_allclose(found, wanted, rtol=0.01)


def test_a_calibration_is_named_once(tmp_path: Path, monkeypatch):
    place = write_folder(tmp_path / "c", twelve())
    noise = np.random.default_rng(3).integers(0, 1000, SHAPE).astype(np.uint16)
    path = a_picture(tmp_path / "a.lfr", noise)
    run = CliRunner()
    words = ["stack", str(path), "-o", str(tmp_path / "s.tif"), "--disparities", "-1:1:3"]
    assert "no calibration is known" in run.invoke(main, words).output
    given = run.invoke(main, [*words, "--calibration", str(place)])
    assert given.exit_code == 0, given.output
    again = run.invoke(main, [*words, "--force"])
    assert again.exit_code == 0, again.output
    other = a_picture(tmp_path / "b.lfr", noise, serial="A2")
    words[1] = str(other)
    assert "of the camera A2: no calibration" in run.invoke(main, [*words, "--force"]).output
    monkeypatch.setenv("CLPLEN_LYTRO", str(tmp_path / "away"))
    assert "$CLPLEN_LYTRO" in run.invoke(main, [*words, "--force"]).output


def test_a_bright_picture_shows_its_lattice(tmp_path: Path, device: Device, caplog):
    path = a_picture(tmp_path / "a.lfr", flat())
    with caplog.at_level("INFO", "clplen.io"):
        lf = read_lightfield(path, device=device)
    assert "of the picture itself, without a white image" in caplog.text
    assert "vignetting" in caplog.text
    assert lf.raw.lattice.neighbour == pytest.approx(10, abs=0.01)


@pytest.mark.thorough
def test_a_lattice_is_sought_once(tmp_path: Path, monkeypatch, device: Device):
    from clplen.io.raw import lattice_cache

    place = write_folder(tmp_path / "c", twelve())
    path = a_picture(tmp_path / "a.lfr", flat())
    monkeypatch.setattr(lattice_cache, "cache_dir", lambda: tmp_path / "lattices")
    first = read_lightfield(path, calibration=place, device=device)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("the lattice was sought again")

    monkeypatch.setattr(lattice_cache, "estimate_lattice", never)
    again = read_lightfield(path, device=device)
    assert again.raw.lattice == first.raw.lattice
    other = a_picture(tmp_path / "b.lfr", flat(), zoom=1402)
    with pytest.raises(AssertionError, match="sought again"):
        read_lightfield(other, device=device)
    next((tmp_path / "lattices").rglob("*.json")).write_text("{")
    with pytest.raises(AssertionError, match="sought again"):
        read_lightfield(path, device=device)
    assert lenslet_frames.cached_lattice is lattice_cache.cached_lattice


def test_a_damaged_note_of_a_calibration_is_ignored(tmp_path: Path):
    for note in [
        "[" * 100_000,
        "[]",
        "\xff",
        json.dumps({SERIAL: 5}),
        json.dumps({SERIAL: "x" * 5000}),
    ]:
        cache = tmp_path / "cache"
        cache.mkdir(exist_ok=True)
        (cache / "lytro-calibrations.json").write_text(note, encoding="latin-1")
        path = a_picture(tmp_path / "a.lfr", flat())
        metadata = read_lytro_frame(path)[2]
        assert metadata.serial == SERIAL
        assert lytro_calibration.find_calibration(metadata, None) is None
