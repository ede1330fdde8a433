"""abbe.cl: shifted spectra behind a pupil, cropped to its box."""

import numpy as np
import pytest
from tolerance import relative_max


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_spectra_are_shifted_filtered_and_cropped(wave):
    for shape, size, window in [
        ((7, 11), (3, 5), (5, 9)),
        ((7, 11), (7, 11), (7, 11)),
        ((1, 13), (1, 4), (1, 7)),
    ]:
        rng = np.random.default_rng(3)
        spectrum, pupil = (
            (rng.normal(size=s) + 1j * rng.normal(size=s)).astype(wave.complex)
            for s in (shape, size)
        )
        first = np.array([[0, 0], [shape[0] - 1, shape[1] - 1], [shape[0] // 2, 3]], np.int32)
        out = wave.upload(np.full((3, *window), np.nan, wave.complex))
        wave.launch_rows(
            wave.kernel("abbe.cl", "shifted_spectra", **wave.wave_defines()),
            out.shape,
            out,
            wave.upload(spectrum),
            wave.upload(pupil),
            wave.upload(first),
            *(np.int32(n) for n in (*size, *window, *shape)),
        )
        expected = np.zeros((3, *window), np.complex128)
        for b, (y, x) in enumerate(first):
            rolled = np.roll(spectrum.astype(np.complex128), (-y, -x), (0, 1))
            expected[b, : size[0], : size[1]] = rolled[: size[0], : size[1]] * pupil
        # one complex product of samples that are given as they are
        assert (
            relative_max(expected, wave.download(out).astype(np.complex128))
            <= 4 * np.finfo(wave.real).eps
        )
