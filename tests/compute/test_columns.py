"""Blocks of rows, and the zeros of windows."""

from __future__ import annotations

import numpy as np

from clplen.compute.fft import columns
from clplen.compute.fft.lines import Line, cropped_inverse, padded_spectrum
from clplen.compute.fft.routes import FFTRoute

ITEM = 8  # bytes of a complex64 sample


def test_blocks_of_rows_do_not_cross_fields_that_fill_them() -> None:
    for count, ny in [(3, 70), (40, 5), (1, 1), (2, 33)]:
        length = 2**14  # samples: a block is of sixteen rows
        parts = columns._row_ranges(count * ny, ny, ITEM * length)
        met = [row for chosen in parts for row in range(count * ny)[chosen]]
        assert met == list(range(count * ny))
        if ny >= 16:
            assert all(one.start // ny == (one.stop - 1) // ny for one in parts)


def test_zeros_of_a_window_outlive_blocks_of_other_shapes() -> None:
    """Windows of two lines and of several heights, in turn in one slot."""
    worker = columns._Worker(FFTRoute("scipy", 1))
    rng = np.random.default_rng(4)
    pads = [padded_spectrum(5, 12), padded_spectrum(7, 12), padded_spectrum(5, 12)]
    for turn in range(9):
        line: Line = pads[turn % 3]
        values = rng.normal(size=(1 + turn % 4, line.n)) + 0j
        window = np.zeros((len(values), 12), complex)
        window[:, line.offset : line.offset + line.n] = values
        got = worker.apply(values, (line, cropped_inverse(12, 12)), columns.INTO)
        np.testing.assert_allclose(got, window, atol=1e-15)
