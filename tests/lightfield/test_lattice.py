"""Lattices of lenslets: drawn white images whose lattice is known, real ones, and what is none."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from reference_lattice import Drawn, lattice, white
from scipy.ndimage import map_coordinates

from clplen.errors import FormatError, ShapeError
from clplen.lightfield.calibration.lattice_fit import estimate_lattice
from clplen.lightfield.calibration.reciprocal import reduced_basis
from clplen.lightfield.raw.lenslet_lattice import Lattice

SHAPE = (250, 230)
PITCH = 1e-3  # relative
CLEAN, NOISY = 0.02, 0.2  # pixels rms, over all centres


def rms(away: np.ndarray) -> float:
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def drawn(kind: str, pitch: float, degrees: float, shape: tuple[int, int] = SHAPE) -> Drawn:
    """A lattice stretched by 0.2 % along y, off the middle and off the pixels' centres."""
    origin = (shape[0] / 2 + 0.3, shape[1] / 2 - 1.7)
    return lattice(kind, pitch, degrees=degrees, stretch=1.002, origin=origin)


def count(true: Drawn, shape: tuple[int, int]) -> int:
    """Lenslets whose centre lies on the picture."""
    i, k = np.mgrid[-150:151, -150:151].reshape(2, -1, 1)
    at = true.origin + i * true.first + k * true.second
    return int(((at >= -0.5) & (at < np.array(shape) - 0.5)).all(axis=1).sum())


def check(found: Lattice, true: Drawn, shape: tuple[int, int], *, within: float) -> None:
    """Both primitive vectors, all centres, and none between them."""
    half = [0.0, 0.0] if found.kind == "square" else [0.5, 0.5]
    half[found.turned] = 0.0
    row, column = np.array(found.row), np.array(found.column)
    steps = np.array([row + half[1] * column, column + half[0] * row])
    multiples = steps @ np.linalg.inv([true.first, true.second])
    assert np.abs(multiples - np.rint(multiples)).max() <= PITCH
    assert abs(np.linalg.det(np.rint(multiples))) == pytest.approx(1)
    assert rms(true.off(found.centres())) <= within
    assert len(found.centres()) == pytest.approx(count(true, shape), abs=3)


# White images

CASES = [
    ("square", 9.3, "disc", 0, "random"),
    # Square lenslets of small whole pitches alias: 5.00 px, unturned, leaves .26 px.
    ("square", 14.0, "gauss", -9, "second"),
    ("square", 9.3, "square", 0, "second"),
    ("hexagonal", 9.3, "gauss", 0, "random"),
    ("hexagonal", 14.0, "disc", -9, "second"),
    ("turned", 9.3, "disc", 0, "second"),
    ("turned", 14.0, "gauss", -9, "random"),
    ("square", 5.03, "disc", 3, "none"),
    ("hexagonal", 30.7, "gauss", 3, "rows"),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "pitch", "name", "degrees", "dim"), CASES)
def test_white_images(kind, pitch, name, degrees, dim):
    """Vignetted, of several profiles, half of the lenslets dim; clean, and with 1/10 of noise."""
    side = max(200, round(12 * pitch))
    shape = (side + 20, side + 40)
    true = drawn(kind, pitch, degrees, shape)
    finer = 3 if degrees else 6  # unturned, all lenslets in a row are drawn with the same error
    clean = white(shape, true, name=name, dim=dim, level=0.5, samples=finer)
    found = estimate_lattice(clean)
    check(found, true, shape, within=CLEAN)
    assert found.kind == ("square" if kind == "square" else "hexagonal")
    assert found.turned == (kind == "turned")
    assert math.degrees(found.rotation) == pytest.approx(degrees, abs=0.05)
    noise = 0.1 * np.random.default_rng(3).standard_normal(shape)
    found = estimate_lattice(clean + noise)
    assert rms(true.off(found.centres())) <= NOISY


@pytest.mark.thorough
def test_a_pitch_of_sixty_pixels():
    shape = (560, 590)
    true = drawn("square", 60.0, -9, shape)
    picture = white(shape, true, dim="second", level=0.5, samples=2)
    check(estimate_lattice(picture), true, shape, within=CLEAN)


@pytest.mark.parametrize(
    ("kind", "pitch", "degrees", "dim"),
    [("square", 14.0, 0, "random"), ("hexagonal", 9.3, -9, "second")],
)
def test_sharp_borders_of_bright_and_dim_lenslets_are_trusted(kind, pitch, degrees, dim):
    """Pixels of two lenslets are of neither's brightness; lenslets that the picture cuts of none"""
    true = lattice(kind, pitch, degrees=degrees, origin=(100.3, 105))
    clean = white((200, 231), true, dim=dim)
    noise = 0.1 * np.random.default_rng(7).standard_normal(clean.shape)
    found = estimate_lattice(clean)
    check(found, true, clean.shape, within=CLEAN)
    noisy = estimate_lattice(clean + noise)
    assert rms(true.off(noisy.centres())) <= NOISY
    for one in (found, noisy):
        assert one.trust == "high", one.verdict
        assert one.neighbour == pytest.approx(pitch, rel=PITCH)


@pytest.mark.parametrize(
    ("kind", "pitch", "name"),
    [("square", 5.0, "disc"), ("hexagonal", 5.0, "gauss"), ("turned", 6.0, "disc")],
)
def test_small_pitches_of_whole_pixels(kind, pitch, name):
    """All lenslets are sampled alike, which moves the phases of discs by up to .05 px."""
    shape = (110, 131)
    true = lattice(kind, pitch, origin=(55.3, 65.8))
    picture = white(shape, true, name=name, samples=7)
    found = estimate_lattice(picture)
    check(found, true, shape, within=CLEAN)
    assert found.trust == "high", found.verdict


@pytest.mark.parametrize(("pitch", "level", "noise"), [(5.0, 0.25, 0), (10.0, 0.4, 0.1)])
def test_chessboards_of_lenslets(pitch, level, noise):
    """The bright lenslets alone make a lattice that is turned by 45 degrees."""
    shape = (120, 131)
    true = lattice("square", pitch, origin=(60.3, 65))
    clean = white(shape, true, dim="second", level=level, samples=5)
    found = estimate_lattice(clean + noise * np.random.default_rng(4).standard_normal(shape))
    assert rms(true.off(found.centres())) <= (NOISY if noise else CLEAN)
    assert found.neighbour == pytest.approx(pitch, rel=2 * PITCH)  # of 12 lenslets, with noise
    assert found.trust == "high", found.verdict


@pytest.mark.parametrize(("name", "pitch"), [("disc", 14), ("square", 7.07)])
def test_gaps_are_no_dim_lenslets(name, pitch):
    """A lattice that is turned by 45 degrees is no chessboard if its gaps are dark."""
    true = lattice("square", pitch, degrees=45, origin=(60.3, 65))
    found = estimate_lattice(white((120, 131), true, name=name))
    assert found.trust == "low"
    assert found.neighbour == pytest.approx(pitch, rel=PITCH)


def fallen(law: str, r2: np.ndarray) -> np.ndarray:
    """Brightness at the square of a distance, 1 in the corners: cos^4 to .3, Gaussian to .15."""
    return 0.15**r2 if law == "gauss" else (1 + (0.3**-0.5 - 1) * r2) ** -2


@pytest.mark.parametrize(
    ("kind", "pitch", "degrees", "law", "whole"),
    [("square", 7.3, 0, "gauss", False), ("hexagonal", 15.4, 2, "cos4", True)],
)
def test_strong_vignetting(kind, pitch, degrees, law, whole):
    """Of lenslets dimmed as a whole, and of the sensor's pixels: neither moves the centres.

    To take a fall for the other one changes the pitch by .14 to .5 %.
    """
    shape = (round(12.5 * pitch), round(17 * pitch))
    true = lattice(kind, pitch, degrees=degrees, origin=(shape[0] / 2 + 0.3, shape[1] / 2 - 1.7))
    y, x = np.indices(shape).astype(float)
    _, _, dy, dx = true.nearest(y, x)
    at = (y - dy, x - dx) if whole else (y, x)
    half = (np.array(shape) - 1) / 2
    r2 = sum((a - h) ** 2 for a, h in zip(at, half, strict=True)) / (half @ half)
    clean = white(shape, true, vignetting=0) * fallen(law, r2)
    noise = 0.03 * np.random.default_rng(3).standard_normal(shape)
    for picture, within in ((clean, 0.1), (clean + noise, NOISY)):
        found = estimate_lattice(picture)
        check(found, true, shape, within=within)
        assert found.trust == "high", found.verdict


def test_shortest_vectors_end():
    for basis, area in (
        # of which the last two vectors have a quotient of a half, and of -a half after a step
        ([[0.14279919, 0.07139892], [0.07139892, 0.14279919]], 0.0152938),
        ([[2.0, 1.0], [9.0, 4.0]], 1.0),
        ([[0, 0.07138817], [0, 0.14283632]], 0.0),
        ([[0.14285987, 0.14285987], [0.07149066, 0.07149066]], 0.0),
        ([[0.0, 0.0], [1.0, 2.0]], 0.0),
        ([[1e-160, 0.0], [1.0, 1.0]], 0.0),
        ([[np.nan, 1.0], [1.0, 2.0]], np.nan),
    ):
        a, b = reduced_basis(np.array(basis))
        assert abs(a[0] * b[1] - a[1] * b[0]) == pytest.approx(
            area, rel=1e-5, abs=1e-12, nan_ok=True
        )
        if area > 0:
            assert abs(a @ b) <= 0.5 * min(a @ a, b @ b) * (1 + 1e-9)


def test_the_sign_of_the_rotation():
    """Positive turns +x towards +y, which is down."""
    found = estimate_lattice(white(SHAPE, drawn("square", 14, 3)))
    assert math.degrees(found.rotation) == pytest.approx(3, abs=0.02)
    assert found.column[0] > 0  # along +x the row of lenslets sinks
    assert found.row[1] < 0


def test_a_dark_frame_and_colours_do_not_move_it():
    true = drawn("hexagonal", 9.3, 3)
    clean = 1000 * white(SHAPE, true)
    dark = 500 + 20 * np.arange(SHAPE[1]) + 300 * np.random.default_rng(5).random(SHAPE)
    mosaic = clean.copy()
    mosaic[0::2, 0::2] *= 0.4
    mosaic[1::2, 1::2] *= 0.7
    check(estimate_lattice(clean + dark, dark=dark), true, SHAPE, within=CLEAN)
    check(estimate_lattice(mosaic, bayer="RGGB"), true, SHAPE, within=0.03)


# What is no white image


def lenslets(texture: np.ndarray, *, pitch: float, patch: float, gaps: bool) -> np.ndarray:
    """A focused (2.0) raw image: every lenslet shows its part of a texture, ``patch`` apart."""
    at = np.arange(int(14 * pitch))
    cell = np.floor(at / pitch)
    inside = at - (cell + 0.5) * pitch
    place = (cell + 0.5) * patch + inside + 20
    places = np.meshgrid(place, place, indexing="ij")
    picture = map_coordinates(texture, places, order=1, mode="mirror")
    r = np.hypot(inside[:, None], inside[None, :]) / pitch
    return picture * (np.clip((0.47 - r) / 0.1 + 0.5, 0, 1) if gaps else 1)


def texture(name: str) -> np.ndarray:
    random = np.random.default_rng(9)
    y, x = np.mgrid[:300, :300]
    fy, fx = np.fft.fftfreq(300)[:, None], np.fft.fftfreq(300)
    spectrum = np.fft.fft2(random.standard_normal((300, 300)))
    cloud = np.fft.ifft2(spectrum / np.maximum(np.hypot(fy, fx), 1 / 300)).real
    bricks = (y // 12 % 3 > 0) & ((x + 17 * (y // 36)) // 12 % 4 > 0)
    return {
        "blank": np.full((300, 300), 7.0),
        "noise": random.random((300, 300)),
        "cloud": cloud - cloud.min(),
        "repeated": 1.2 + np.cos(2 * np.pi * x / 11) * np.cos(2 * np.pi * y / 13),
        "bricks": bricks + 0.1,
        "photograph": cloud - cloud.min() + 3 * (np.hypot(y - 150, x - 90) < 60) + (x > 200),
    }[name]


@pytest.mark.parametrize(("name", "gaps"), [("repeated", False), ("bricks", True)])
def test_a_textured_scene_is_not_trusted(name, gaps):
    found = estimate_lattice(lenslets(texture(name), pitch=23.0, patch=16.0, gaps=gaps))
    assert found.trust == "low"
    assert "low trust, because" in found.verdict or "no repeated pattern" in found.verdict


@pytest.mark.parametrize("name", ["blank", "noise", "photograph"])
def test_what_is_no_lattice_is_not_trusted(name):
    found = estimate_lattice(texture(name))
    assert found.trust == "low"
    if name == "blank":
        assert found.verdict.startswith("No lattice: the picture has no repeated pattern")
        assert math.isnan(found.residual)


def test_bad_input_is_refused():
    even, holed = np.ones((40, 40)), np.where(np.eye(40) * np.arange(40) == 5, np.nan, 1)
    for frame, words, error, message in (
        (np.ones((3, 40, 40)), {}, ShapeError, r"shape \(ny, nx\), got \(3, 40, 40\)"),
        (np.ones((31, 40)), {}, ShapeError, "at least 32 pixels a side"),
        (even, {"dark": np.ones((40, 41))}, ShapeError, "dark frame must have the picture's shape"),
        (holed, {}, ValueError, "1 pixels that are NaN"),
        (even, {"kind": "round"}, ValueError, "square or hexagonal, got 'round'"),
        (even, {"pitch": 2}, ValueError, "pitch must be 3 to 200 pixels, got 2"),
        (even, {"bayer": "RGB"}, ValueError, "bayer must be 'RGGB'"),
    ):
        with pytest.raises(error, match=message):
            estimate_lattice(frame, **words)


# The lattice itself

ROWS = Lattice("hexagonal", (50.2, 40.7), (8.66, 0.1), (-0.1, 10.0), (101, 83))
COLUMNS = Lattice("hexagonal", (50.2, 40.7), (10.0, 0.1), (-0.1, 8.66), (101, 83))
SQUARE = Lattice("square", (50.2, 40.7), (15.41, 0.03), (-0.03, 15.39), (101, 83))


def nearest(points: np.ndarray, among: np.ndarray) -> np.ndarray:
    """The way to every point from the nearest of others."""
    away = points[:, None] - among[None]
    best = np.hypot(*away.transpose(2, 0, 1)).argmin(axis=1)
    return away[np.arange(len(points)), best]


@pytest.mark.parametrize("given", [ROWS, COLUMNS])
def test_hexagonal_centres(given):
    """Neighbours are a pitch apart, every lenslet of the picture once; (0, 0) is the origin."""
    centres = given.centres()
    apart = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    apart[np.diag_indices(len(centres))] = np.inf
    np.testing.assert_allclose(np.sort(apart, axis=1)[:, :2], 10, rtol=0.012)  # it is sheared
    assert len(centres) == pytest.approx(101 * 83 / (10 * 8.66), abs=8)
    np.testing.assert_allclose(given.at(0, 0), given.origin)
    assert given.turned == (given is COLUMNS)
    assert given.neighbour == pytest.approx(10, rel=1e-3)
    assert given.views() == (10, 10)


def test_pitch_and_rotation():
    c, s = math.cos(0.1), math.sin(0.1)
    given = Lattice("square", (5, 5), (15 * c, -15 * s), (12 * s, 12 * c), (40, 40))
    assert given.pitch == pytest.approx((12, 15))
    assert given.rotation == pytest.approx(0.1)
    assert given.views() == (15, 12)
    down, right = given.view_steps((5, 4))
    np.testing.assert_allclose(down, (3 * c, -3 * s))
    np.testing.assert_allclose(right, (3 * s, 3 * c))
    np.testing.assert_allclose(given.view_steps((5, 4), 2.0), [(2 * c, -2 * s), (2 * s, 2 * c)])


@pytest.mark.parametrize(
    ("given", "complete"), [(ROWS, True), (COLUMNS, False), (SQUARE, True)]
)
def test_a_grid_of_views_is_a_full_rectangle_on_the_picture(given, complete):
    grid = given.grid((7, 9), step=0.9, complete=complete)
    i, k = np.mgrid[: grid.count[0], : grid.count[1]][..., None]
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    at = grid.first + i * np.array(grid.row_step) + k * np.array(grid.column_step)
    assert rms(nearest(at.reshape(-1, 2), given.centres())) < 1e-9
    reach = 0.9 * (np.array([7, 9]) - 1) / 2 if complete else np.zeros(2)
    low, high = at.min(axis=(0, 1)) - reach, at.max(axis=(0, 1)) + reach
    assert (low >= -0.6).all()
    assert (high <= np.array([101, 83]) - 0.4).all()
    # no row or column of whole lenslets is left out
    room = 1.2 * np.array(given.pitch[::-1])
    assert (low < room).all()
    assert (high > np.array([101, 83]) - room).all()
    assert grid.exchanged == given.turned
    assert grid.shape[:2] == (7, 9)


@pytest.mark.parametrize("given", [COLUMNS, replace(SQUARE, shape=None)])
def test_files_keep_the_lattice(given, tmp_path: Path):
    full = replace(given, residual=0.023, trust="low", verdict="a sentence, with quotes \"'")
    full.save(tmp_path / "grid.json")
    assert Lattice.load(tmp_path / "grid.json") == full
    again = Lattice.from_json(given.to_json())
    assert math.isnan(again.residual)
    assert (again.row, again.column, again.shape) == (given.row, given.column, given.shape)


@pytest.mark.parametrize(("orientation", "first"), [("horz", 1), ("vert", 2)])
def test_a_calibration_of_lf_toolbox(orientation, first):
    """The centres of LFBuildHexGrid, whose pixels and rows begin at 1."""
    model = {"HSpacing": 10.0, "VSpacing": 8.66, "HOffset": 3.2, "VOffset": 1.7, "Rot": 0.01}
    model |= {"Orientation": orientation, "FirstPosShiftRow": first, "UMax": 5, "VMax": 4}
    found = Lattice.from_json(json.dumps({"LensletGridModel": model, "other": 1}))
    i, k = np.mgrid[:4, :5].reshape(2, -1)
    x = k * 10.0 + np.where(i % 2 == (first - 1) % 2, 5.0, 0.0)
    y = i * 8.66
    c, s = math.cos(0.01), math.sin(0.01)
    want = np.stack([1.7 + s * x + c * y - 1, 3.2 + c * x - s * y - 1], axis=1)
    if orientation == "vert":
        want = want[:, ::-1]
    assert found.turned == (orientation == "vert")
    centres = replace(found, shape=(60, 70)).centres()
    assert rms(nearest(want, centres)) < 1e-9


def test_the_calibration_of_a_lytro_camera(data_folder: Path):
    found = Lattice.load(data_folder / "lytro_f01_flower" / "CalInfo.json")
    assert found.kind == "hexagonal"
    assert found.pitch == pytest.approx((10.00389654, 8.665739129), rel=1e-9)
    assert math.degrees(found.rotation) == pytest.approx(-0.0519, abs=1e-3)


def changed(**entries: object) -> str:
    return json.dumps(json.loads(SQUARE.to_json()) | entries)


def test_broken_files_are_refused(tmp_path: Path):
    path = tmp_path / "grid.json"
    for text, message in (
        ("{", "is not valid JSON"),
        ("[1, 2]", "does not describe a lattice of lenslets"),
        (changed(version=2), "version 1 .*got 2"),
        (changed(origin=[1]), "'origin'"),
        (changed(row=[True, 0]), "'row'"),
        (changed(column=["wide", 1]), "'column'"),
        (changed(shape=[0, 4]), "'shape'"),
        (changed(kind="odd"), "square or hexagonal"),
        (changed(trust="some"), "high or low"),
        (changed(row=[0, 0]), "must follow along"),
        (json.dumps({"LensletGridModel": {"HSpacing": "wide"}}), "'HSpacing'"),
    ):
        path.write_text(text)
        with pytest.raises(FormatError, match=rf"grid\.json.*{message}"):
            Lattice.load(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path):
    with pytest.raises(FormatError, match=r"none\.json"):
        Lattice.load(tmp_path / "none.json")
    with pytest.raises(FormatError, match="is not a file"):
        Lattice.load(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.json")
        with pytest.raises(FormatError, match="is not a file"):
            Lattice.load(tmp_path / "pipe.json")


def distance(found: Lattice, point: tuple[float, float]) -> float:
    """How far a point lies from the nearest centre."""
    return float(np.hypot(*(found.centres() - point).T).min())


@pytest.mark.thorough
def test_vesicle(data_folder: Path):
    folder = data_folder / "lfm_guv"
    flat, dark = (
        tifffile.imread(folder / f"{name}_GUVExperim1.tif") for name in ("Radiometry", "DarkFrame")
    )
    found = estimate_lattice(flat, dark=dark)
    assert (found.kind, found.trust) == ("square", "high")
    assert found.pitch == pytest.approx((15.387, 15.410), rel=5e-4)
    assert math.degrees(found.rotation) == pytest.approx(-0.12, abs=0.03)
    assert distance(found, (210.05, 224.64)) < 0.2
    scene = estimate_lattice(tifffile.imread(folder / "Lightfield_GUVExperim1.tif"), dark=dark)
    assert scene.trust == "low"  # a bright vesicle, no white image
