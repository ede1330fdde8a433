"""Free-space propagation against plane waves, Gaussian beams and a float64 twin."""

import math
import warnings

import numpy as np
import pytest
import reference
from tolerance import err_db

from clplen import DeviceError, Field, Grid, Propagator, SamplingError, SamplingWarning, propagate
from clplen.errors import ShapeError

LAM = 550e-9


def field_of(u, grid, device, wavelength=LAM):
    return Field.from_array(u, grid, wavelength=wavelength, device=device)


def band_limited(shape, seed, share=0.75):
    """Random, asymmetric, non-zero mean, below 75 % of Nyquist."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.fft2(rng.normal(size=shape) + 1j * rng.normal(size=shape))
    keep = np.multiply.outer(*(np.abs(np.fft.fftfreq(n)) <= share / 2 for n in shape))
    return np.fft.ifft2(spectrum * keep) + 0.2


GRIDS = [((16, 22), (6.6e-6, 5e-6)), ((17, 31), (2e-6, 3e-6)), ((1, 64), 2e-6), ((29, 1), 4e-6)]


@pytest.mark.parametrize(("shape", "pitch"), GRIDS)
@pytest.mark.parametrize("method", ["as", "blas"])
@pytest.mark.parametrize("pad", [1, 2, 1.5])
@pytest.mark.parametrize("z", [3e-4, -2e-4])
def test_against_twin(device, shape, pitch, method, pad, z):
    grid = Grid(shape, pitch)
    u = band_limited(shape, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        got = propagate(field_of(u, grid, device), z, method=method, pad=pad).to_numpy()
    expected = reference.propagate(u, grid.pitch, z, LAM, method=method, pad=pad)
    assert err_db(expected, got) >= 120


@pytest.mark.parametrize("n", [(16, 20), (15, 21), (16, 15)])
@pytest.mark.parametrize("index", [(2, 3), (-2, 3), (2, -3), (-2, -3)])
def test_tilted_plane_waves(device, precise, n, index):
    grid = Grid(n, (3e-6, 2e-6))
    fy, fx = (i / (m * d) for i, m, d in zip(index, n, grid.pitch, strict=True))
    z = 0.013
    y, x = grid.y[:, None], grid.x[None, :]
    start, end = (
        reference.tilted_plane_wave(y, x, d, fy=fy, fx=fx, wavelength=LAM) for d in (0, z)
    )
    exact = propagate(field_of(start, grid, precise), z, method="as", pad=1).to_numpy()
    assert np.abs(exact - end).max() <= 1e-12
    single = propagate(field_of(start, grid, device), z, method="as", pad=1).to_numpy()
    assert err_db(end, single) >= 120


@pytest.mark.parametrize("n", [64, 63])
def test_talbot_self_image(device, precise, n):
    period = n * 2e-6 / 8 if n % 8 == 0 else n * 2e-6 / 7
    grid = Grid((3, n), (5e-6, 2e-6))
    u = np.broadcast_to(1 + 0.5 * np.cos(2 * np.pi * grid.x / period), grid.shape)
    z = reference.talbot_distance(period, LAM)
    for d, floor in ((precise, 230), (device, 120)):
        far = propagate(field_of(u, grid, d), z, method="as", pad=1).to_numpy()
        turned = far * np.exp(-1j * np.angle(far.sum() * np.conj(u.sum())))
        assert err_db(u.astype(complex), turned) >= floor


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
@pytest.mark.parametrize("method", ["as", "blas"])
@pytest.mark.parametrize("z", [0.010, 0.240])
def test_complex64_keeps_the_phase_at_camera_distances(device, precise, method, z):
    grid = Grid((1010, 1010), 6.6e-6)
    r2 = grid.y[:, None] ** 2 + grid.x[None, :] ** 2
    rng = np.random.default_rng(2)
    square = (np.abs(grid.y)[:, None] < grid.extent[0] / 4) & (np.abs(grid.x) < grid.extent[1] / 4)
    starts = {
        "gaussian": np.exp(-r2 / (grid.extent[0] / 16) ** 2),
        "random square": np.fft.ifft2(
            np.fft.fft2(square * np.exp(2j * np.pi * rng.random(grid.shape)))
        ),
    }
    for name, u in starts.items():
        one, two = (propagate(field_of(u, grid, d), z, method=method) for d in (device, precise))
        assert err_db(two.to_numpy(), one.to_numpy()) >= 120, name


def test_residual_above_one_turn_leaves_the_tables(device):
    grid = Grid((256, 256), 0.5e-6)
    u = band_limited(grid.shape, 3)
    with pytest.warns(SamplingWarning, match="is aliased"):
        one = Propagator(grid, 1e-3, wavelength=LAM, method="as", device=device)
    assert one.report.residual_turns > 1
    assert one.phase == ("fp64" if device.has_fp64 else "twofloat")
    for phase in ("twofloat", "fp64") if device.has_fp64 else ("twofloat",):
        with pytest.warns(SamplingWarning):
            forced = Propagator(grid, 1e-3, wavelength=LAM, method="as", device=device, phase=phase)
        expected = reference.propagate(u, grid.pitch, 1e-3, LAM, method="as", pad=2)
        assert err_db(expected, forced(field_of(u, grid, device)).to_numpy()) >= 120


@pytest.mark.parametrize(
    ("shape", "pitch"), [((128, 128), 1.1e-6), ((127, 160), (1.1e-6, 1.3e-6)), ((96, 131), 1.2e-6)]
)
def test_exact_gaussian(device, precise, shape, pitch):
    grid = Grid(shape, pitch)
    waist, z = min(grid.extent) / 16, min(grid.extent)
    r = np.hypot(grid.y[:, None], grid.x[None, :])
    start = np.exp(-(r**2) / waist**2)
    radii, back = np.unique(r, return_inverse=True)
    end = reference.gaussian_exact(radii, z, waist=waist, wavelength=LAM)[back].reshape(shape)
    assert err_db(end, propagate(field_of(start, grid, precise), z).to_numpy()) >= 175
    assert err_db(end, propagate(field_of(start, grid, device), z).to_numpy()) >= 120


@pytest.mark.parametrize("shape", [(96, 100), (97, 101), (96, 101)])
@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_tilted_beam_walks_where_it_should(device, shape, signs):
    grid = Grid(shape, (3e-6, 2e-6))
    fy, fx = signs[0] * 2.0e4, signs[1] * 3.1e4
    z, waist = 1.2e-3, 30e-6
    y, x = grid.y[:, None], grid.x[None, :]
    u = np.exp(-(x**2 + y**2) / waist**2) * np.exp(2j * np.pi * (fy * y + fx * x))
    power = np.abs(propagate(field_of(u, grid, device), z, method="as").to_numpy()) ** 2.0
    got = ((power * y).sum() / power.sum(), (power * x).sum() / power.sum())
    # exact centroid: z times the spectrum's mean slope lam f/sqrt(1 - s), by quadrature
    spread = 1 / (math.sqrt(2) * np.pi * waist)
    t, w = np.polynomial.hermite_e.hermegauss(41)
    gy, gx = fy + spread / math.sqrt(2) * t[:, None], fx + spread / math.sqrt(2) * t[None, :]
    c = np.sqrt(1 - LAM**2 * (gy**2 + gx**2))
    weight = w[:, None] * w[None, :] / w.sum() ** 2
    expected = (z * (weight * LAM * gy / c).sum(), z * (weight * LAM * gx / c).sum())
    for g, e, d in zip(got, expected, grid.pitch, strict=True):
        assert abs(g - e) <= 1e-3 * d


@pytest.mark.parametrize("method", ["as", "blas"])
def test_transposed_input_gives_transposed_output(device, method):
    u = band_limited((24, 37), 4)
    grid, turned = Grid((24, 37), (3e-6, 2e-6)), Grid((37, 24), (2e-6, 3e-6))
    a = propagate(field_of(u, grid, device), 4e-4, method=method).to_numpy()
    b = propagate(field_of(u.T.copy(), turned, device), 4e-4, method=method).to_numpy()
    assert err_db(a, b.T) >= 125


def test_group_laws(device, precise):
    grid = Grid((32, 45), (3e-6, 2e-6))
    u = band_limited(grid.shape, 5)
    for d, floor in ((device, 120), (precise, 250)):
        start = field_of(u, grid, d)
        there = propagate(start, 2e-4, method="as", pad=1)
        assert err_db(u, propagate(there, -2e-4, method="as", pad=1).to_numpy()) >= floor
        once = propagate(start, 5e-4, method="as", pad=1).to_numpy()
        assert err_db(once, propagate(there, 3e-4, method="as", pad=1).to_numpy()) >= floor
        assert there.power() == pytest.approx(start.power(), rel=1e-6)
        assert propagate(start, 0) is start


def test_batches_equal_single_fields(device):
    grid = Grid((12, 17), 3e-6)
    u = np.stack([[band_limited(grid.shape, s) for s in (1, 2, 3)] for _ in range(2)])
    u[1] *= 2j
    batch = propagate(field_of(u, grid, device), 3e-4).to_numpy()
    assert batch.shape == (2, 3, 12, 17)
    alone = propagate(field_of(u[1, 2], grid, device), 3e-4).to_numpy()
    np.testing.assert_allclose(batch[1, 2], alone, atol=2e-6)


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
@pytest.mark.parametrize("method", ["as", "blas"])
@pytest.mark.parametrize("shape", [(33, 64), (40, 51)])
def test_energy_closes(device, precise, method, shape):
    grid = Grid(shape, (1.0e-6, 1.5e-6))
    u = band_limited(shape, 7, share=0.98)
    for d, closure in ((device, 1e-6), (precise, 1e-13)):
        plan = Propagator(grid, 3e-4, wavelength=LAM, method=method, device=d)
        energy = plan.energy(field_of(u, grid, d))
        assert energy.outside > 0.05 * energy.into
        assert (energy.cut > 0.01 * energy.into) == (method == "blas")
        parts = energy.window + energy.outside + energy.cut
        assert parts == pytest.approx(energy.into, rel=closure)
        assert energy.window == pytest.approx(plan(field_of(u, grid, d)).power(), rel=1e-5)


def test_plans_are_kept(device):
    grid = Grid((12, 18), 3e-6)
    field = field_of(band_limited(grid.shape, 1), grid, device)
    propagate(field, 3.21e-4)
    hits = device.plans.hits
    propagate(field, 3.21e-4)
    assert device.plans.hits == hits + 1


def test_input_is_untouched(device):
    grid = Grid((12, 18), 3e-6)
    u = band_limited(grid.shape, 1).astype(np.complex64)
    field = field_of(u, grid, device)
    propagate(field, 3e-4, pad=1)
    np.testing.assert_array_equal(field.to_numpy(), u)


class TestBadInput:
    grid = Grid((8, 9), 3e-6)

    def field(self, device):
        return field_of(np.ones((8, 9)), self.grid, device)

    def test_unknown_method_lists_them(self, device):
        with pytest.raises(ValueError, match="no method 'asm'; use one of auto, as, blas"):
            propagate(self.field(device), 1e-3, method="asm")

    def test_z_is_finite(self, device):
        for z in (math.nan, math.inf):
            with pytest.raises(ValueError, match="distance z is one finite number"):
                propagate(self.field(device), z)

    def test_pad_is_at_least_one(self, device):
        for pad in (0.5, math.inf):
            with pytest.raises(ValueError, match="pad is at least 1"):
                propagate(self.field(device), 1e-3, pad=pad)

    def test_another_grid(self, device):
        with pytest.raises(SamplingError, match="'as' keeps the grid .* method='cblas' gives any"):
            propagate(self.field(device), 1e-3, method="as", out_grid=Grid((8, 9), 4e-6))

    def test_plan_of_another_grid(self, device):
        plan = Propagator(Grid((9, 8), 3e-6), 1e-3, wavelength=LAM, device=device)
        with pytest.raises(ShapeError, match="The plan is for"):
            plan(self.field(device))

    def test_plan_of_another_device(self, device, precise):
        plan = Propagator(self.grid, 1e-3, wavelength=LAM, device=precise)
        with pytest.raises(DeviceError, match="two devices"):
            plan(self.field(device))

    def test_too_large_a_window(self, device, monkeypatch):
        monkeypatch.setattr(device, "memory_bytes", 1000)
        with pytest.raises(DeviceError, match=r"This propagation needs [\d,]+ bytes.*1,000 bytes"):
            Propagator(self.grid, 1e-3, wavelength=LAM, device=device)(self.field(device))

    def test_aliased_as_warns_with_the_distance(self, device):
        with pytest.warns(SamplingWarning, match=r"up to .* m. Use method='auto'"):
            propagate(self.field(device), 0.5, method="as")
