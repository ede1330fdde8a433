"""Positions of views from a table and from file names."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clplen.errors import FormatError
from clplen.io.lightfields.layout import Layout
from clplen.io.lightfields.view_positions import positions_of, read_positions

VIEWS = (2, 3)
GRID = np.stack(np.indices(VIEWS) - np.array([0.5, 1.0])[:, None, None], axis=-1)


def places(seed: int = 1) -> np.ndarray:
    """Jittered, with mean 0."""
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, GRID.shape)
    return GRID + jitter - jitter.mean(axis=(0, 1))


def table(path, rows, header="v,u,y,x"):
    file = path / "positions.csv"
    file.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return file


def rows_of(p: np.ndarray) -> list[str]:
    return [f"{v},{u},{p[v, u, 0]},{p[v, u, 1]}" for v, u in np.ndindex(*VIEWS)]


def names_of(p: np.ndarray, first=(0, 0)) -> dict:
    """As the archive has them: millimetres of another sign, twice the underscore."""
    return {
        (v, u): f"rectified/out_{v + first[0]:02d}_{u + first[1]:02d}_{y:.6f}_{x:.6f}_.png"
        for (v, u) in np.ndindex(*VIEWS)
        for y, x in [p[v, u] * (-24.5, -24.5) + (-381.9, 1103.4)]
    }


def test_a_table_in_any_order_of_rows_and_columns(tmp_path):
    p = places()
    rows = [f"{y},{x},{v},{u}" for v, u in np.ndindex(*VIEWS) for y, x in [p[v, u] + (7.5, -3)]]
    file = table(tmp_path, reversed(rows), header="\ufeffY, X, V, U")
    assert np.allclose(read_positions(file, VIEWS), p, atol=1e-12)


def test_a_wrong_table_is_refused_with_its_line(tmp_path):
    for change, said in [
        (lambda rows: rows[:-1], r"no positions for 1 of 2 x 3 views.*\(v=1, u=2\)"),
        (lambda rows: [*rows, rows[2]], r"line 8: the view v=0, u=2 already occurs in line 4"),
        (lambda rows: [*rows, "2,0,1,1"], r"line 8: .*indices from 0 of 2 x 3 .* got v=2, u=0"),
        (lambda rows: [*rows, "0.5,0,1,1"], r"line 8: v and u must be indices .* got v=0.5"),
        (lambda rows: [*rows[:2], "0,2,1,north"], r"line 4: x must be a number, got 'north'"),
        (lambda rows: [*rows[:2], "0,2,nan,1"], r"line 4: y must be a number, got 'nan'"),
        (lambda rows: [*rows[:2], "0,2,1"], r"line 4: .*must have the columns v,u,y,x, got 3"),
    ]:
        file = table(tmp_path, change(rows_of(places())))
        with pytest.raises(FormatError, match=rf"positions\.csv.*{said}"):
            read_positions(file, VIEWS)


def test_what_is_no_table(tmp_path):
    with pytest.raises(FormatError, match=r"There is no table of positions .*or positions="):
        read_positions(tmp_path / "none.csv", VIEWS)
    with pytest.raises(FormatError, match=r"line 1: .*must be v,u,y,x, got 'a,b'"):
        read_positions(table(tmp_path, [], header="a,b"), VIEWS)
    file = tmp_path / "binary.csv"
    file.write_bytes(bytes(range(128, 256)))
    with pytest.raises(FormatError, match=r"binary\.csv is not a comma-separated table"):
        read_positions(file, VIEWS)
    file.write_bytes(b"1" * 100_000)
    with pytest.raises(FormatError, match=r"too large for the positions of 6 views"):
        read_positions(file, VIEWS)


def test_names_of_the_stanford_archive():
    """Sign and unit by least squares: the x step is 1, y is in the same unit."""
    p = places() * (1.02, 1.0)
    found = read_positions("names", VIEWS, names=names_of(p))
    step = np.polyfit(GRID[..., 1].ravel(), p[..., 1].ravel(), 1)[0]
    assert np.allclose(found, p / step, atol=1e-6)


def test_a_view_without_a_name_lies_on_the_grid():
    names = names_of(GRID)
    del names[1, 2]
    found = read_positions("names", VIEWS, names=names)
    assert np.allclose(found, GRID, atol=1e-6)


def test_one_row_and_one_column():
    row = {(0, u): f"out_00_{u:02d}_5.0_{-3.0 * u}.png" for u in range(3)}
    assert np.allclose(read_positions("names", (1, 3), names=row)[0], [[0, -1], [0, 0], [0, 1]])
    column = {(v, 0): f"out_{v:02d}_00_{4.0 * v}_9.5.png" for v in range(2)}
    found = read_positions("names", (2, 1), names=column)
    assert np.allclose(found[:, 0], [[-0.5, 0], [0.5, 0]])


def test_names_without_positions_are_refused():
    same = {(v, u): f"out_{v}_{u}_1.0_2.0.png" for v, u in np.ndindex(*VIEWS)}
    for names, message in (
        (None, "needs views in named files"),
        ({(0, 0): "view_0_0.png"}, r"view_0_0\.png has 2 numbers"),
        (same, "do not change with v"),
    ):
        with pytest.raises(FormatError, match=message):
            read_positions("names", VIEWS, names=names)


def test_layout_words(tmp_path):
    """Names take their sign from the final axes; a table is what it says."""
    for flip_u, flip_v, swap in itertools.product((False, True), repeat=3):
        words = {"swap_uv": swap, "flip_v": flip_v, "flip_u": flip_u}
        names = Layout(positions="names", **words)
        found = positions_of(names, VIEWS, names=names_of(GRID))
        final = names.shape(VIEWS)
        want = [i - (n - 1) / 2 for i, n in zip(np.indices(final), final, strict=True)]
        np.testing.assert_allclose(found, np.stack(want, -1), atol=1e-6)
        layout = Layout(positions=table(tmp_path, rows_of(places())), **words)
        stored = layout.stored(positions_of(layout, VIEWS))
        np.testing.assert_allclose(stored, places(), atol=1e-12)
        assert positions_of(Layout(**words), VIEWS) is None
