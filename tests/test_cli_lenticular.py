"""lenticular: strips against a loop and whole numbers, the pitch against rays through a sheet."""

from __future__ import annotations

from fractions import Fraction
from math import floor
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import Result
from command_line import done, invoke_on, refused

import clplen
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.io import interlace, lens_pitch, pitch_test
from clplen.io.displays.lenticular import lens_views

Array = np.ndarray[Any, Any]


def run(device: Device, *words: object) -> Result:
    return invoke_on(device, "lenticular", *words)


def view_at(x: Fraction, pitch: Fraction, count: int, axis: Fraction) -> int:
    """The view at x: strips of equal width from lens to lens, the last view at the left."""
    strip = floor(((x - axis) / pitch + Fraction(1, 2)) * count) % count
    return count - 1 - strip


@pytest.mark.parametrize("lenses", ["vertical", "horizontal"])
@pytest.mark.parametrize(
    ("pitch", "count", "axis"),
    [(7.0, 7, None), (7.3, 7, None), (11.9375, 5, None), (2.0, 2, 0.0), (6.0, 3, 2.25)],
)
def test_strips_against_a_loop(pitch: float, count: int, axis: float | None, lenses: str) -> None:
    views = np.random.default_rng(7).integers(1, 256, (count, 23, 31, 3)).astype(np.uint8)
    found = interlace(views, pitch, lenses=lenses, centre=axis)
    wanted = np.zeros_like(found)
    across = 31 if lenses == "vertical" else 23
    middle = Fraction(across, 2) if axis is None else Fraction(axis)
    for n in range(across):
        k = view_at(Fraction(2 * n + 1, 2), Fraction(pitch), count, middle)
        place = (slice(None), n) if lenses == "vertical" else (n,)
        wanted[place] = views[k][place]
    np.testing.assert_array_equal(found, wanted)


def test_view_0_lies_at_the_right_under_each_lens() -> None:
    assert lens_views(12, 4, 4).tolist() == [3, 2, 1, 0] * 3  # an axis at 6
    assert lens_views(12, 4, 4, centre=4).tolist() == [1, 0, 3, 2] * 3
    assert lens_views(9, 3, 3).tolist() == [2, 1, 0] * 3
    for pixels in (30, 31):  # every middle of a pixel on a border, as rounding must not choose
        found = lens_views(pixels, 10, 10)
        assert (np.diff(found) % 10 == 9).all()


@pytest.mark.parametrize(("upper", "lower"), [(120_115, 10_000), (1200, 101), (7, 1)])
def test_no_drift_in_a_long_print(upper: int, lower: int) -> None:
    """100,003 columns against whole numbers: ((2x + 1 - W) q + p) N / (2p), pitch p/q."""
    pixels, count = 100_003, upper // lower
    x = np.arange(pixels, dtype=np.int64)
    strips = ((2 * x + 1 - pixels) * lower + upper) * count // (2 * upper)
    found = lens_views(pixels, upper / lower, count)
    np.testing.assert_array_equal(found, count - 1 - strips % count)
    starts = np.flatnonzero(np.diff(found) > 0)
    lenses = (starts[-1] - starts[0]) / (upper / lower)
    assert abs(lenses - round(lenses)) <= lower / upper  # a pixel, over 8,000 lenses
    assert len(starts) == round(lenses) + 1


def through_the_sheet(x: float, eye: tuple[float, float], sheet: tuple[float, float]) -> float:
    """Where the rays of an eye that fill the lens at x meet the print, in the mean: Snell's law
    at a circle whose focus lies on the print."""
    (across, distance), (thickness, index) = eye, sheet
    radius = thickness * (index - 1) / index
    heights = np.linspace(-0.3, 0.3, 41) * radius
    sag = radius - np.sqrt(radius**2 - heights**2)
    ray = np.stack([x + heights - across, sag + distance])
    ray /= np.linalg.norm(ray, axis=0)
    normal = np.stack([-heights, radius - sag]) / radius  # into the sheet
    cosine = (ray * normal).sum(0)
    inside = ray / index + (np.sqrt(1 - (1 - cosine**2) / index**2) - cosine / index) * normal
    return float(np.mean(x + heights + inside[0] / inside[1] * (thickness - sag)))


@pytest.mark.parametrize("sheet", [(0.6e-3, 1.57), (2e-3, 1.49)])
def test_the_pitch_for_a_near_eye(sheet: tuple[float, float]) -> None:
    """Rays from 0.4 m: strips meet them within 3 % of how far they move, as the slope is small."""
    x, distance = 0.03, 0.4
    moved = through_the_sheet(x, (0, distance), sheet) - x
    told = lens_pitch(60, 720, distance=distance, thickness=sheet[0], index=sheet[1]) / 12 - 1
    assert told * x == pytest.approx(moved, rel=0.03)
    assert lens_pitch(60, 720, distance=0.5, thickness=1e-3, index=1) == 12 * 0.501 / 0.5
    assert lens_pitch(75, 600) == 8


def test_each_eye_sees_one_view_across_the_print() -> None:
    """0.15 m wide and from 0.4 m: an eye amid the place of a view sees it under all 341 lenses,
    and the further to the left it is, the smaller the view."""
    distance, sheet, dpi, pixels = 0.4, (0.6e-3, 1.57), 2880, 17_008
    pixel = 0.0254 / dpi
    strip = 4 * pixel * distance * sheet[1] / sheet[0]  # the eye's way from view to view
    eyes = strip * np.array([-2.5, -0.5, 1.5])
    axes = 48 * pixel * np.arange(-170, 171)
    views = [np.full((1, pixels), n, np.uint8) for n in range(12)]

    def seen(pitch: float) -> list[set[int]]:
        owner = interlace(views, pitch)[0]
        meets = [[through_the_sheet(x, (eye, distance), sheet) for x in axes] for eye in eyes]
        places = np.floor(np.array(meets) / pixel + pixels / 2).astype(int)
        return [set(row.tolist()) for row in owner[places]]

    pitch = lens_pitch(60, dpi, distance=distance, thickness=sheet[0], index=sheet[1])
    assert seen(pitch) == [{3}, {5}, {7}]
    assert [len(views) for views in seen(48.0)] == [5, 5, 5]  # as for a far eye


def is_even(bars: Array, pitch: float) -> bool:
    """Whether each of ten far eyes sees one shade under all lenses of a pitch."""
    most = int(bars.size / 2 / pitch)
    eyes = (np.arange(10)[:, None] + 0.5) / 10
    seen = bars[np.floor(bars.size / 2 + (np.arange(-most, most) + eyes) * pitch).astype(int)]
    return bool((seen == seen[:, :1]).all())


def test_bars_and_labels_of_a_pitch_test() -> None:
    """Bars of (1000 + k)/1000 60 lpi by whole numbers, and a label beside each band."""
    picture = pitch_test(60, 720, 0.15)
    mm = 720 / 25.4
    left = round(20 * mm)
    tops = round(9 * mm) + (round(7 * mm)) * np.arange(21)
    bands = picture[tops + round(3 * mm), left:]
    size = bands.shape[1]
    x, k = np.arange(size, dtype=np.int64), np.arange(-10, 11, dtype=np.int64)[:, None]
    halves = ((2 * x + 1 - size) * (1000 + k) + 12_000) // 12_000
    np.testing.assert_array_equal(bands, np.where(halves % 2, 255, 0))
    for number in (2, 10, 13):  # under sheets of 59.52, 60 and 60.18 lpi
        sheet = 12_000 / (990 + number)
        assert [n for n, band in enumerate(bands) if is_even(band, sheet)] == [number]
    assert set(np.unique(picture[:, left:][tops[0] :])) == {0, 255}
    labels = picture[:, :left]
    for top in tops:  # each has a label, within its band
        rows = np.flatnonzero((labels[top : top + round(7 * mm)] < 128).any(1))
        assert rows.size > 2 * mm
        assert 0 < rows[0] < rows[-1] < 6 * mm
    assert (labels[-1] == 255).all()
    assert (labels[:, 0] == 255).all()


def numbered(folder: Path, views: tuple[int, int] = (3, 5)) -> Path:
    """uint8 views of one level each, 40 u + 10 v + 5."""
    v, u = np.indices(views)
    levels = (40 * u + 10 * v + 5).astype(np.uint8)
    np.save(folder / "views.npy", np.broadcast_to(levels[..., None, None], (*views, 30, 44)))
    return folder / "views.npy"


def flat(folder: Path, size: tuple[int, int], d: float = 0.0) -> Path:
    clplen.io.write_pfm(folder / "map.pfm", np.full(size, d, np.float32))
    return folder / "map.pfm"


def test_a_print(tmp_path: Path, device: Device) -> None:
    """Five views under lenses of 5 pixels, an inch: the rightmost at the left under each."""
    words = (numbered(tmp_path), "--disparity", flat(tmp_path, (30, 44)))
    words += ("--lpi", 20, "--dpi", 100, "--width", "25.4mm")
    said = done(run(device, *words, "-o", tmp_path / "a.tif"))
    assert "100 x 68 pixels, 2.54 x 1.73 cm" in said
    assert "5 views from u = 0 to 4 under each lens of 5 pixels" in said
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        page = file.pages[0]
        found = page.asarray()
        sizes = [page.tags[name].value for name in ("XResolution", "YResolution")]
        assert (sizes, page.tags["ResolutionUnit"].value) == ([(100, 1)] * 2, 2)
    assert found.shape == (68, 100)
    assert found[30, 47:57].tolist() == [175, 135, 95, 55, 15] * 2  # axes at 50 and 55
    assert np.ptp(found, axis=0).max() == 0
    words += ("--lenses", "horizontal", "--strips", 3, "--height", "1in")
    assert "'1in' is not a length" in refused(run(device, *words, "-o", tmp_path / "b.png"))
    words = (*words[:-1], "20.32mm")
    said = done(run(device, *words, "-o", tmp_path / "b.png"))
    assert "100 x 80 pixels" in said
    assert "3 views from v = 0 to 2" in said
    found = imageio.imread(tmp_path / "b.png")
    assert found.shape == (80, 100)
    owner = lens_views(80, 5, 3)
    np.testing.assert_array_equal(found[:, 50], 85 + 10 * owner)
    from PIL import Image

    with Image.open(tmp_path / "b.png") as image:
        np.testing.assert_allclose(image.info["dpi"], 100, atol=0.02)


def test_the_plane_of_the_print_stands_still(tmp_path: Path, device: Device) -> None:
    """A plane of disparity 1.2: with zero parallax there all views agree, and the print is one of
    them; else each strip shows another place."""
    y, x = np.indices((36, 50))
    at = [x + 1.2 * (u - 2) for u in range(5)]
    views = np.stack([127 + 90 * np.cos(0.5 * one + 0.2 * y) for one in at])[None]
    np.save(tmp_path / "views.npy", np.rint(views).astype(np.uint8))
    words = (tmp_path / "views.npy", "--disparity", flat(tmp_path, (36, 50), 1.2))
    words += ("--lpi", 6, "--dpi", 60, "--width", 0.1, "-o", tmp_path / "a.png", "--strips", 10)
    done(run(device, *words))
    found = imageio.imread(tmp_path / "a.png").astype(float)
    size, shown = found.shape[1], 50 - 1.2 * 4
    place = 24.5 + ((np.arange(size) + 0.5) / size - 0.5) * shown
    height = ((np.arange(found.shape[0]) + 0.5) / found.shape[0] - 0.5) * 36 + 17.5
    wanted = 127 + 90 * np.cos(0.5 * place + 0.2 * height[:, None])
    scale = np.cos(0.5 * place + 0.2 * height[:, None])
    fitted = 127 + np.sum((found - 127) * scale) / np.sum(scale**2) * scale
    assert np.abs(found - fitted)[20:-20, 20:-20].mean() < 4  # but for the blur of one lens
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.99
    result = run(device, *words, "--zero-parallax", 0)
    done(result)
    other = imageio.imread(tmp_path / "a.png").astype(float)
    assert np.abs(np.diff(other, axis=1)).mean() > 1.5 * np.abs(np.diff(found, axis=1)).mean()
    assert "move by more than 1 lens from view to view" not in result.stderr
    assert "1 lens" in run(device, *words, "--zero-parallax", -9).stderr


def test_a_pitch_test(tmp_path: Path, device: Device) -> None:
    words = ("--pitch-test", "--lpi", 40, "--dpi", 200, "--width", 0.05, "--spread", 2)
    said = done(run(device, *words, "-o", tmp_path / "a.tif"))
    assert "39.2 to 40.8 lpi" in said
    found = tifffile.imread(tmp_path / "a.tif")
    np.testing.assert_array_equal(found, pitch_test(40, 200, 0.05, spread=2))
    done(run(device, *words, "-o", tmp_path / "b.png", "--lenses", "horizontal"))
    np.testing.assert_array_equal(imageio.imread(tmp_path / "b.png"), np.rot90(found))


def test_refusals(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    source = numbered(tmp_path)
    known = (source, "--disparity", flat(tmp_path, (30, 44)))
    for words, code, said in (
        ((*known, "--lpi", 0), 2, "0.0 is not in the range 0<x"),
        ((*known, "--lpi", 400), 1, "got 1.8 at 720 dpi and 400 lpi: print at 800 dpi"),
        ((*known, "--lpi", 60, "--strips", 13), 2, "--strips must be 2 to 12"),
        ((*known, "--lpi", 60, "--strips", 1), 2, "--strips must be 2 to 12"),
        ((*known, "--lpi", 60, "--width", "1mm"), 2, "got 2.3 lenses"),
        ((*known, "--lpi", 60, "--distance", 0.4), 2, "give both or none"),
        ((*known, "--lpi", 60, "--spread", 2), 2, "--spread needs --pitch-test"),
        (known, 2, "Missing option '--lpi'"),
        (("--lpi", 60), 2, "give a light field, or --pitch-test"),
        ((source, "--lpi", 60, "--pitch-test"), 2, "INPUT cannot be combined with --pitch-test"),
        (
            ("--lpi", 60, "--pitch-test", "--strips", 4),
            2,
            "--strips cannot be combined with --pitch-test",
        ),
        (("--lpi", 60, "--pitch-test", "--width", "3cm"), 1, "width must be at least 0.04 m"),
        (("--lpi", 400, "--pitch-test"), 1, "A lens must cover at least 2 pixels"),
    ):
        text = refused(run(device, *words, "-o", tmp_path / "a.png"), code)
        assert said in text, (words, text)
    assert "end in .tif" in refused(run(device, *known, "--lpi", 60, "-o", tmp_path / "a.jpg"))
    for lenses, shape, line in (("vertical", (5, 1), "column"), ("horizontal", (1, 5), "row")):
        np.save(tmp_path / "line.npy", np.ones((*shape, 20, 30), np.uint8))
        words = (tmp_path / "line.npy", "--lpi", 60, "-o", tmp_path / "a.png", "--lenses", lenses)
        assert f"a single {line} of views" in refused(run(device, *words))
    computed: list[object] = []
    monkeypatch.setattr("clplen.io.displays.lenticular.free_memory", lambda: 10**9)
    monkeypatch.setattr("clplen.lightfield.focus_and_depth.depth_map", computed.append)
    words = (source, "--lpi", 60, "--width", 100_000 / 720 * 0.0254, "-o", tmp_path / "a.png")
    text = refused(run(device, *words), 1)
    assert "100,000 x 68,182 pixels needs 81,818,400,000 bytes" in text
    assert not computed  # said before the depth is computed
    text = refused(run(device, "--pitch-test", *words[1:]), 1)
    assert "too little memory" in text
    assert not list(tmp_path.glob("*a.*"))
    (tmp_path / "a.png").write_bytes(b"mine")
    text = refused(run(device, "--pitch-test", "--lpi", 60, "-o", tmp_path / "a.png"), 1)
    assert "clplen did not write it" in text


def test_views_that_do_not_fit() -> None:
    view = np.ones((4, 20), np.uint8)
    for views, words, error, said in (
        ([view], {}, ValueError, "2 to 6 views, got 1"),
        ([view] * 7, {}, ValueError, "2 to 6 views, got 7"),
        ([view] * 2, {"count": 3}, ShapeError, "must contain 3 views, got 2"),
        ([view] * 4, {"count": 3}, ShapeError, "3 views"),
        ([view, view[:3]], {}, ShapeError, r"got \(3, 20\) for view 1"),
        ([view, view * 1.0], {}, ValueError, "must be uint8, got float64"),
        (iter([view, view]), {}, ValueError, "count= is required"),
        ([view] * 2, {"lenses": "round"}, ValueError, "'vertical' or 'horizontal', got 'round'"),
        ([view] * 2, {"centre": np.nan}, ValueError, "finite number of pixels"),
        ([np.ones((4, 20, 2), np.uint8)] * 2, {}, ShapeError, r"\(y, x\) or \(y, x, 3\)"),
        ([], {"count": 2}, ShapeError, "2 views, got 0"),
    ):
        with pytest.raises(error, match=said):
            interlace(views, 6.5, **words)
    for pitch in (1.9, 0, np.inf, None):
        with pytest.raises(ValueError, match="at least 2 pixels"):
            interlace([view] * 2, pitch)
    for words in ((0, 720), (60, np.nan), (-1, 720), (400, 720)):
        with pytest.raises(ValueError, match=r"must be positive|at least 2 pixels"):
            lens_pitch(*words)
    for named in ({"distance": 0.0}, {"thickness": -1e-3}, {"index": 0.9}):
        with pytest.raises(ValueError, match=r"distance|thickness|index"):
            lens_pitch(60, 720, **named)
    for named in ({"spread": 0}, {"spread": 21}, {"bands": 2}, {"bands": 102}):
        with pytest.raises(ValueError, match=r"spread|bands"):
            pitch_test(60, 720, 0.1, **named)
    with pytest.raises(ValueError, match="dpi must be positive"):
        clplen.io.write_picture("a.png", view, dpi=0)
