"""What every propagation obeys whatever the field: shifts, the adjoint, one common sum (T13)."""

from __future__ import annotations

import numpy as np
import pytest
from fields import LAM, band_limited, go
from reference_closed import rayleigh_sommerfeld
from tolerance import err_db

from clplen import Grid

SUMMED, FAR_ENOUGH = Grid((64, 64), (2e-6, 2.5e-6)), 2.5e-3  # h is sampled from 1.5 mm on


def test_a_periodic_window_turns_with_its_field(device, precise):
    for shape in [(15, 32)]:
        for method in ["as", "blas", "fresnel-tf", "fresnel-ir"]:
            grid = Grid(shape, (3e-6, 2e-6))
            u, moved = band_limited(shape, 1), (5, -7)
            for d, least in ((device, 125), (precise, 270)):
                there = go(u, grid, 4e-4, d, method=method, pad=1)
                turned = go(np.roll(u, moved, (0, 1)), grid, 4e-4, d, method=method, pad=1)
                assert err_db(np.roll(there, moved, (0, 1)), turned) >= least


def test_a_field_that_is_moved_by_samples_arrives_moved(device, precise):
    """Light that stays inside the window, 6 samples up and 9 to the left."""
    for method in ["as", "rs", "fresnel-tf", "fresnel-ir", "cblas"]:
        for shape in [(43, 57)]:
            grid = Grid(shape, (3e-6, 2e-6))
            y, x = grid.y[:, None], grid.x
            here, there = (
                np.exp(-(((y - a) / 1.2e-5) ** 2) - ((x - b) / 1e-5) ** 2 + 2e4j * np.pi * (x - b))
                for a, b in ((1.2e-5, 1.6e-5), (-6e-6, -2e-6))
            )
            z = 3e-4
            # Light at the edge of the window: exp(-(40/17)^2) in y.
            one, two = (go(u, grid, z, device, method=method) for u in (here, there))
            assert err_db(one[6:, 9:], two[:-6, :-9]) >= 110
            one, two = (go(u, grid, z, precise, method=method) for u in (here, there))
            assert err_db(one[6:, 9:], two[:-6, :-9]) >= 110


def test_output_and_input_may_move_together_or_apart(device, precise):
    """cblas: only the difference of the two origins counts; whole samples only renumber."""
    for z in [2e-3, -0.03]:
        grid = Grid((53, 60), (3e-6, 2e-6))
        u = compact(grid, 2)
        out = Grid((20, 31), (2e-6, 2.5e-6), origin=(1e-5, -2e-5))
        far = Grid(grid.shape, grid.pitch, origin=(2e-4, 7e-4))
        beyond = Grid((20, 31), (2e-6, 2.5e-6), origin=(2.1e-4, 6.8e-4))
        a = go(u, grid, z, device, out_grid=out)
        assert err_db(a, go(u, far, z, device, out_grid=beyond)) >= 120
        # Sample 5 of one output is sample 0 of the other; each has a band of its own.
        shifted = Grid(
            (20, 31), out.pitch, origin=(out.origin[0] + 5 * out.pitch[0], out.origin[1])
        )
        b, c = (go(u, grid, z, precise, out_grid=g, guard=8) for g in (out, shifted))
        assert err_db(b[5:], c[:-5]) >= 140


def compact(grid: Grid, seed: int) -> np.ndarray:
    """A random field under a Gaussian that ends inside the window, below 75 % of Nyquist."""
    parts = [((v - v.mean()) / (v[-1] - v[0])) ** 2 for v in (grid.y, grid.x)]
    envelope = np.exp(-100 * np.add.outer(*parts))
    return band_limited(grid.shape, seed, share=0.4) * envelope


@pytest.fixture(scope="module")
def sums() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Two fields and the Rayleigh-Sommerfeld sum over their samples."""
    fields = {"inside": compact(SUMMED, 8), "filling": band_limited(SUMMED.shape, 9)}
    return {
        name: (u, rayleigh_sommerfeld(u, SUMMED.pitch, FAR_ENOUGH, LAM))
        for name, u in fields.items()
    }


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("method", "options"),
    [("auto", {}), ("rs", {}), ("cblas", {}), ("blas", {"pad": 8}), ("as", {"pad": 8})],
)
def test_the_direct_sum(device, sums, method, options):
    u, expected = sums["inside"]
    assert err_db(expected, go(u, SUMMED, FAR_ENOUGH, device, method=method, **options)) >= 120
    # Light cut off at the window's edge reaches Nyquist, where a transfer function breaks off.
    u, expected = sums["filling"]
    least = 125 if method in ("auto", "rs") else 60
    assert err_db(expected, go(u, SUMMED, FAR_ENOUGH, device, method=method, **options)) >= least
