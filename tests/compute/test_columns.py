"""Blocks of rows and columns, and the factors of mirrored columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_lines import unfolded

from clplen.compute.fft import columns
from clplen.compute.fft.columns import Factors
from clplen.compute.fft.lines import Line, cropped_inverse, padded_spectrum
from clplen.compute.fft.routes import FFTRoute

ITEM = 8  # bytes of a complex64 sample


def factors(shape: tuple[int, int], quadrant: bool) -> Factors:
    """Turned, asymmetric and all different."""
    my, mx = shape
    stored = (mx // 2 + 1, my // 2 + 1) if quadrant else (mx, my)
    rng = np.random.default_rng(my * mx)
    return Factors((rng.normal(size=stored) + 1j * rng.normal(size=stored)), shape)


def test_blocks_of_columns_meet_every_column_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for quadrant in [True, False]:
        for mx in [1, 2, 3, 4, 7, 8, 63, 64, 65, 130]:
            monkeypatch.setattr(columns, "SMALL_BYTES", 1)
            parts = columns._column_ranges([factors((2**12, mx), quadrant)], ITEM)
            met = [k for part in parts for chosen in part for k in range(mx)[chosen]]
            assert sorted(met) == list(range(mx))
            assert all(len(range(mx)[chosen]) <= columns.MOST for part in parts for chosen in part)


def test_the_second_range_of_a_block_mirrors_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a block loads are the factors of both its ranges, the second read backwards."""
    for shape in [(5, 7), (6, 9), (4, 130), (3, 131), (1, 6), (6, 1), (2, 2)]:
        monkeypatch.setattr(columns, "SMALL_BYTES", 1)
        made = factors(shape, True)
        whole = unfolded(made.values.T, shape).T  # (mx, my)
        for own, *mirrored in columns._column_ranges([made], ITEM * 2**12):
            out = np.empty((own.stop - own.start, shape[0]), complex)
            made.load(own, out)
            np.testing.assert_array_equal(out, whole[own])
            for chosen in mirrored:
                first = shape[1] - chosen.stop + 1 - own.start
                again = out[first : first + chosen.stop - chosen.start][::-1]
                np.testing.assert_array_equal(again, whole[chosen])


def test_blocks_meet_lit_columns_and_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    for quadrant in [True, False]:
        monkeypatch.setattr(columns, "BLOCK_BYTES", 1)
        monkeypatch.setattr(columns, "FEWEST", 2)
        whole = factors((4, 11), quadrant)
        lit = np.array([True, True, True, False, False, True, False, True, False, False, True])
        made = replace(whole, lit=lit[: len(whole.values)])
        parts = columns._column_ranges([made], ITEM)
        met = [k for part in parts for chosen in part for k in range(11)[chosen]]
        dark = [k for chosen in columns._dark_ranges([made], ITEM) for k in range(11)[chosen]]
        expected = [0, 1, 2, 5, 6, 9, 10] if quadrant else [0, 1, 2, 5, 7, 10]
        assert sorted(met) == expected
        assert sorted(met + dark) == list(range(11))
        assert columns._dark_ranges([made, whole], ITEM) == []


def test_blocks_of_rows_do_not_cross_fields_that_fill_them() -> None:
    for count, ny in [(3, 70), (40, 5), (1, 1), (2, 33)]:
        length = 2**14  # samples: a block is of sixteen rows
        parts = columns._row_ranges(count * ny, ny, ITEM * length)
        met = [row for chosen in parts for row in range(count * ny)[chosen]]
        assert met == list(range(count * ny))
        if ny >= 16:
            assert all(one.start // ny == (one.stop - 1) // ny for one in parts)


def test_short_lines_come_in_larger_blocks() -> None:
    assert columns._size(ITEM) > 1000
    assert columns._size(2**14) == columns.MOST
    assert columns._size(2**17) == 16
    assert columns._size(2**30) == columns.FEWEST


def test_zeros_of_a_window_outlive_blocks_of_other_shapes() -> None:
    """Windows of two lines and of several heights, in turn in one slot."""
    worker = columns._Worker(FFTRoute("scipy", 1))
    rng = np.random.default_rng(4)
    pads = [padded_spectrum(5, 12), padded_spectrum(7, 12), padded_spectrum(5, 12)]
    for turn in range(9):
        line: Line = pads[turn % 3]
        values = rng.normal(size=(1 + turn % 4, line.n)) + 0j
        window = np.zeros((len(values), 12), complex)
        window[:, line.place : line.place + line.n] = values
        got = worker.apply(values, (line, cropped_inverse(12, 12)), columns.INTO)
        np.testing.assert_allclose(got, window, atol=1e-15)
