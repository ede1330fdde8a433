"""Exact methods against the reference values of set-up A."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fields import step
from reference_elements import rectangle_coverage
from reference_optics import axis
from setups import LAM, SetUp, set_up_a, slit_at
from tolerance import snr_db

pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")

S = 1024 * 2 * LAM
WAYS = {
    "AS pad 1": {"method": "as", "pad": 1},
    "AS pad 2": {"method": "as"},
    "BLAS": {"method": "blas"},
    "guard 0": {"method": "cblas", "guard": 0, "support": S / 2},
    "corrected": {"method": "cblas"},
    "RS": {"method": "rs"},
    "auto": {"method": "auto"},
}
SLIT = {  # z/S: snr_db of each of WAYS
    0.1: (33.95, 33.95, 33.95, 33.95, 33.95, 4.9, 33.95),
    2: (37.23, 39.25, 39.25, 39.25, 39.25, 36.6, 39.25),
    16: (24.78, 35.23, 61.13, 49.37, 65.14, 65.14, 65.14),
    1024: (6.59, 12.67, 27.42, 16.38, 120.94, 120.94, 120.94),
}
EVANESCENT = {  # z/lam: with and without the waves that decay
    0.05: (37.3, 18.1),
    0.2: (41.9, 24.6),
    0.5: (44.0, 34.3),
    1: (44.2, 42.5),
    3: (44.2, 44.2),
}

slit = lru_cache(set_up_a)


def of_axis(a: SetUp, device, along: str, **options) -> np.ndarray:
    """A 1-D set-up as a row (1, N) or as a column (N, 1), the result as a row."""
    if along == "x":
        return step(a.u, a.pitch, a.z, device, **options)
    return step(a.u.T, a.pitch, a.z, device, **options).T


@pytest.fixture(params=["double", "single"])
def either(request, device):
    """The device in both precisions, and how far a figure may be from the printed one in dB."""
    if request.param == "single":
        return device, 0.7
    return request.getfixturevalue("precise"), 0.5


@pytest.mark.parametrize("z", [0.1, 2, 16, 1024])
def test_slit(either, z):
    """Set-up A by every method; auto is as good as the best of them."""
    device, within = either
    a, along = slit(z), "xy"[z > 10]
    got = {name: snr_db(a.exact, of_axis(a, device, along, **way)) for name, way in WAYS.items()}
    assert got == pytest.approx(dict(zip(WAYS, SLIT[z], strict=True)), abs=within)
    best = max(got[name] for name in ("AS pad 2", "BLAS", "corrected", "RS"))
    assert got["auto"] >= best - 0.5
    if z >= 8:
        assert got["corrected"] >= got["BLAS"] >= got["AS pad 2"]


def test_narrow_slit_on_fine_samples(either):
    """Slit 2 lam, dx = lam/8: blas, whose band ends at grazing rays, drops the evanescent waves."""
    for along, z in zip("xyxyx", EVANESCENT, strict=True):
        device, within = either
        kept, dropped = EVANESCENT[z]
        n, dx = 1024, LAM / 8
        u = rectangle_coverage((1, n), dx, (dx, 2 * LAM))
        exact = slit_at(axis(n, dx), z * LAM, width=2 * LAM)[None]
        a = SetUp(u, (dx, dx), z * LAM, exact)
        for method, printed in (
            ("as", kept),
            ("auto", kept),
            ("cblas", kept),
            ("blas", dropped),
        ):
            got = of_axis(a, device, along, method=method)
            assert snr_db(exact, got) == pytest.approx(printed, abs=within), method
        periodic = of_axis(a, device, along, method="as", pad=1)
        assert snr_db(exact, periodic) == pytest.approx(kept, abs=within)
