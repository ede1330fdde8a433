"""quilt on the command line: the published layout and names, what lies in the display's plane."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from command_line import done, refused
from command_line import invoke_on as run

import clplen
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.io import QuiltLayout, write_quilt
from clplen.io.displays.quilt import DISPLAYS

Array = np.ndarray[Any, Any]


def stored(folder: Path, samples: Array, name: str = "views.npy") -> Path:
    np.save(folder / name, samples)
    return folder / name


def flat(folder: Path, size: tuple[int, int], d: float = 0.0) -> Path:
    clplen.io.write_pfm(folder / "map.pfm", np.full(size, d, np.float32))
    return folder / "map.pfm"


def numbered(folder: Path, views: tuple[int, int] = (3, 6)) -> Path:
    """uint8 views of one level each, 10 (u + 1) + v."""
    v, u = np.indices(views)
    levels = (10 * (u + 1) + v).astype(np.uint8)
    return stored(folder, np.broadcast_to(levels[..., None, None], (*views, 30, 44)))


def moving(d: float, views: tuple[int, int] = (3, 5), size: tuple[int, int] = (40, 56)) -> Array:
    """uint8 views of a textured plane of disparity d, in colour."""
    random = np.random.default_rng(3)
    waves = [(random.uniform(-0.5, 0.5, 2), random.uniform(0, 6)) for _ in range(30)]
    y, x = np.indices(size)
    made = np.empty((*views, *size, 3), np.uint8)
    for v, u in np.ndindex(views):
        at_y, at_x = y + d * (v - (views[0] - 1) / 2), x + d * (u - (views[1] - 1) / 2)
        value = 120 + 9 * sum(np.cos(a * at_y + b * at_x + phase) for (a, b), phase in waves)
        grey = np.clip(np.rint(value), 0, 255).astype(np.uint8)
        made[v, u] = np.stack([grey, grey // 2, 255 - grey], -1)
    return made


def test_the_published_layout(tmp_path: Path, device: Device) -> None:
    """Bottom left is the leftmost view; then to the right, then up; the last is top right."""
    source = numbered(tmp_path)
    words = ("--columns", 3, "--rows", 2, "--size", "96x40", "--aspect", 1.5)
    words += ("--disparity", flat(tmp_path, (30, 44)))
    said = done(run(device, "quilt", source, "-o", tmp_path / "n.png", *words))
    assert "6 views from u = 0 to 5 in 3 x 2 tiles of 32 x 20" in said
    assert not (tmp_path / "n.png").exists()
    found = imageio.imread(tmp_path / "n_qs3x2a1.5.png")
    assert found.shape == (40, 96)
    rows = [[int(found[y, x]) for x in (16, 48, 80)] for y in (10, 30)]
    assert rows == [[41, 51, 61], [11, 21, 31]]  # of the middle row of views, v = 1
    for y, x in np.ndindex(2, 3):
        assert np.ptp(found[20 * y : 20 * y + 20, 32 * x : 32 * x + 32]) == 0


def test_what_no_whole_tile_fills_is_black(tmp_path: Path) -> None:
    layout = QuiltLayout(3, 2, (41, 98), 1.0)
    tiles = [np.full(layout.tile, 100 + n, np.uint8) for n in range(6)]
    found = imageio.imread(write_quilt(tmp_path / "a.png", tiles, layout))
    assert (layout.tile, found.shape) == ((20, 32), (41, 98))
    assert (found[0] == 0).all()
    assert (found[:, 96:] == 0).all()
    assert (found[1:, :96] >= 100).all()


def test_published_presets() -> None:
    """docs.lookingglassfactory.com/keyconcepts/quilts, columns, rows, width, height."""
    published = {
        "go": (11, 6, 4092, 4092, 0.5625),
        "portrait": (8, 6, 3360, 3360, 0.75),
        "16-landscape": (7, 7, 5999, 5999, 1.77778),
        "16-portrait": (11, 6, 5995, 6000, 0.5625),
        "32-landscape": (7, 7, 8190, 8190, 1.77778),
        "32-portrait": (11, 6, 8184, 8184, 0.5625),
        "65": (8, 9, 8192, 8192, 1.77778),
    }
    found = {
        name: (one.columns, one.rows, one.size[1], one.size[0], round(one.aspect, 5))
        for name, one in DISPLAYS.items()
    }
    assert found == published
    assert DISPLAYS["portrait"].name("a/b.png") == Path("a/b_qs8x6a0.75.png")
    assert DISPLAYS["go"].name("b.png").name == "b_qs11x6a0.5625.png"
    assert DISPLAYS["65"].name("b.png").name == "b_qs8x9a1.77778.png"
    assert DISPLAYS["65"].name("b_qs8x9a1.777.png").name == "b_qs8x9a1.777.png"


def test_the_plane_of_the_display_stands_still(tmp_path: Path, device: Device) -> None:
    d = -0.8
    source = stored(tmp_path, moving(d))
    words = ("--columns", 4, "--rows", 2, "--size", "160x96", "--aspect", 0.8)
    words += ("--disparity", flat(tmp_path, (40, 56), d))
    out = tmp_path / "q_qs4x2a0.8.png"
    done(run(device, "quilt", source, "-o", out, *words))

    def tile(n: int) -> Array:
        y, x = 1 - n // 4, n % 4
        return imageio.imread(out)[48 * y : 48 * y + 48, 40 * x : 40 * x + 40].astype(float)

    assert np.abs(tile(0) - tile(7)).max() < 12  # of 255
    assert np.abs(tile(0) - tile(3)).mean() < 1.5
    done(run(device, "quilt", source, "-o", out, *words, "--zero-parallax", 0))
    assert np.abs(tile(0) - tile(7)).mean() > 10


def test_near_things_move_to_the_left_from_view_to_view(tmp_path: Path, device: Device) -> None:
    """Who goes to the right sees what is before the display further to the left."""
    x = np.indices((40, 64))[1]
    views = [np.where(np.abs(x + 2.0 * (u - 2) - 31.5) < 4, 255, 20) for u in range(5)]
    source = stored(tmp_path, np.stack([views] * 2).astype(np.uint8))
    near = np.where(np.abs(x - 31.5) < 4, 2.0, 0.0).astype(np.float32)
    clplen.io.write_pfm(tmp_path / "map.pfm", near)
    words = ("--columns", 5, "--rows", 1, "--size", "320x40", "--aspect", 1.6)
    words += ("--disparity", tmp_path / "map.pfm")
    result = run(device, "quilt", source, "-o", tmp_path / "q.png", *words)
    done(result)
    found = imageio.imread(tmp_path / "q_qs5x1a1.6.png")
    middles = [(found[20, 64 * n : 64 * n + 64] > 130).nonzero()[0].mean() for n in range(5)]
    np.testing.assert_allclose(np.diff(middles), -2, atol=0.3)
    noted = "12 % of the pixels move by more than 1 pixel of a tile from view to view, by up to 2.0"
    assert noted in " ".join(result.stderr.split())


def test_a_part_of_the_baseline(tmp_path: Path, device: Device) -> None:
    words = ("--columns", 3, "--rows", 1, "--size", "96x20", "--aspect", 1.5, "--span", 0.4)
    words += ("--disparity", flat(tmp_path, (30, 44)))
    said = done(run(device, "quilt", numbered(tmp_path), "-o", tmp_path / "n.png", *words))
    assert "from u = 1.5 to 3.5" in said
    found = imageio.imread(tmp_path / "n_qs3x1a1.5.png")
    assert [int(found[10, x]) for x in (16, 48, 80)] == [26, 36, 46]


def test_refusals(tmp_path: Path, device: Device) -> None:
    source = numbered(tmp_path)
    small = ("--size", "96x40", "--aspect", 1.5)
    known = ("--disparity", flat(tmp_path, (30, 44)))
    for words, code, said in (
        (("-o", "q.jpg"), 2, "end in .png"),
        (("-o", "q.png", "--columns", 1, "--rows", 1, *small), 1, "at least 2 views"),
        (("-o", "q.png", "--columns", 0, *small), 1, "whole number from 1 on, got 0"),
        (("-o", "q.png", "--columns", 33, "--rows", 2), 1, "columns must be 1 to 32, got 33"),
        (("-o", "q.png", "--size", "16385x40"), 1, "pixels along each side, got 16,385"),
        (("-o", "q.png", "--size", "96"), 2, "WIDTHxHEIGHT"),
        (("-o", "q.png", "--size", "96x40"), 1, "got 12 x 6 for"),
        (("-o", "q.png", "--aspect", 0), 1, "0.1 to 10, got 0"),
        (("-o", "q_qs5x9a1.777.png"), 1, "contains another layout than qs8x6a0.75"),
        (("-o", "q.png", "--span", 1.5), 2, "0<x<=1"),
        (("-o", "q.png", "--zero-parallax", 9, *known), 1, "moves by 45 of 44 pixels along x"),
        (("-o", "q.png", *known, "--disparities", "0:1:3"), 2, "--disparity"),
        (("-o", "none/q.png"), 1, "the folder none does not exist"),
    ):
        where = tmp_path / str(words[1])
        text = refused(run(device, "quilt", source, "-o", where, *words[2:]), code)
        assert said in text.replace(f"{tmp_path}/", ""), (words, text)
    column = stored(tmp_path, np.ones((5, 1, 20, 30), np.uint8), "column.npy")
    assert "a single column of views" in refused(
        run(device, "quilt", column, "-o", tmp_path / "q.png")
    )
    clplen.io.write_pfm(tmp_path / "other.pfm", np.ones((30, 43), np.float32))
    words = ("-o", tmp_path / "q.png", "--disparity", tmp_path / "other.pfm")
    assert "30 x 43 pixels" in refused(run(device, "quilt", source, *words), 1)
    assert not list(tmp_path.glob("*q*.png"))


def test_tiles_that_do_not_fit(tmp_path: Path) -> None:
    layout = QuiltLayout(2, 1, (20, 40), 1.0)
    tile = np.ones((20, 20), np.uint8)
    for tiles, error in (
        ([tile], ShapeError),
        ([tile] * 3, ShapeError),
        ([tile, tile[1:]], ShapeError),
        ([tile, np.stack([tile] * 3, -1)], ShapeError),
        ([tile, tile.astype(float)], ValueError),
    ):
        with pytest.raises(error):
            write_quilt(tmp_path / "a.png", tiles, layout)
    with pytest.raises(ValueError, match=r"must end in \.png"):
        write_quilt(tmp_path / "a.jpg", [tile] * 2, layout)
    assert not list(tmp_path.iterdir())
