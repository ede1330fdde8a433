"""spectral_filter.cl: a mirrored quadrant times a batch of spectra."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.compute.fft.blocks import lanes_defines


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_mirrors_the_quadrant(wave):
    for shape in [(5, 7), (8, 6), (1, 9), (6, 1), (7, 67), (4, 64), (2, 65), (3, 79)]:
        for conjugate in [False, True]:
            rng = np.random.default_rng(3)
            u = rng.normal(size=(2, *shape)) + 1j * rng.normal(size=(2, *shape))
            quarter = tuple(n // 2 + 1 for n in shape)
            H = rng.normal(size=quarter) + 1j * rng.normal(size=quarter)
            full = np.array(
                [
                    [H[min(y, shape[0] - y), min(x, shape[1] - x)] for x in range(shape[1])]
                    for y in range(shape[0])
                ]
            )
            data = wave.upload(u.astype(wave.complex))
            form = {"CONJUGATE": True} if conjugate else {}
            kernel = wave.kernel(
                "spectral_filter.cl", "filter_spectrum", **lanes_defines(wave), **form
            )
            wave.launch_rows(
                kernel,
                data.shape,
                data,
                wave.upload(H.astype(wave.complex)),
                np.int32(shape[0]),
                np.int32(shape[1]),
            )
            full = full.conj() if conjugate else full
            assert relative_max(u * full, wave.download(data)) <= 8 * np.finfo(wave.real).eps
