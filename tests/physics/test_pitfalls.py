"""The usual mistakes of diffraction codes: each is made in NumPy, and not by the package.

What a mistake costs is stated, so that a set-up in which it would not show is found out. Distances
and grids are those of the table of pitfalls where it
names them.
"""

from __future__ import annotations

import numpy as np
import pytest
from fields import field_of, go
from numpy.fft import fft, fftfreq, fftshift, ifft, ifftshift
from reference_closed import gaussian_exact, gaussian_paraxial, lens_focus
from reference_corrected import corrected
from reference_optics import Complex, Real, axis
from scipy.special import j1
from setups import LAM, gaussian_a, set_up_a, slit_fresnel
from tolerance import err_db, snr_db

from clplen import Coherence, Grid, Propagator, SamplingError, SamplingWarning, propagate, thin_lens
from clplen.wave import ExtendedSource, RandomPhaseMask
from clplen.wave.elements.beams import spherical_wave
from clplen.wave.elements.hard_apertures import rectangular_aperture
from clplen.wave.systems.components import Lens
from clplen.wave.systems.optical_system import OpticalSystem

pytestmark = pytest.mark.thorough  # tests/wave shows that each of them is avoided

TABLE = 0.5  # dB, to which the design's printed figures are reproduced


def helmholtz(f: Real, z: float) -> Complex:
    """H of one axis, s < 1, without the carrier."""
    s = (LAM * f) ** 2
    return np.exp(-2j * np.pi * z / LAM * s / (1 + np.sqrt(1 - s)))


def gaussian(n: int, dx: float, z: float, waist: float) -> tuple[Complex, Complex]:
    """A 1-D Gaussian before and after z, exact, as (1, n)."""
    x = axis(n, dx)
    end = gaussian_exact(np.abs(x), z, waist=waist, wavelength=LAM, dim=1)
    return (np.exp(-((x / waist) ** 2)) + 0j)[None], end[None]


# Centres, coordinates and frequencies -----------------------------------------------------------


@pytest.mark.parametrize(("n", "cost"), [(255, 17.6), (256, None)])
def test_fftshift_before_the_transform(device, precise, n, cost):
    dx = 2 * LAM
    # A waist of 8 samples, which one sample aside costs 18 dB.
    u, end = gaussian(n, dx, 2e-4, 8 * dx)
    wrong = fftshift(ifft(fft(fftshift(u[0])) * helmholtz(fftfreq(n, dx), 2e-4)))[None]
    if cost is None:
        assert err_db(end, wrong) > 200
    else:
        assert err_db(end, wrong) == pytest.approx(cost, abs=1)
    for method in ("auto", "as", "cblas"):
        assert err_db(end, go(u, Grid((1, n), dx), 2e-4, precise, method=method)) >= 200
        assert err_db(end, go(u, Grid((1, n), dx), 2e-4, device, method=method)) >= 120


@pytest.mark.parametrize(("n", "cost"), [(255, 49), (256, 34)])
def test_coordinates_by_linspace(precise, n, cost):
    dx, z = 2 * LAM, 1e-3
    waist = n * dx / 10
    grid = Grid((1, n), dx)
    _, end = gaussian(n, dx, z, waist)
    at = {"linspace": np.linspace(-n * dx / 2, n * dx / 2, n), "grid": grid.x}
    got = {
        name: err_db(end, go(np.exp(-((x / waist) ** 2))[None] + 0j, grid, z, precise))
        for name, x in at.items()
    }
    assert got["linspace"] == pytest.approx(cost, abs=TABLE)
    assert got["grid"] >= 175


@pytest.mark.parametrize(("z", "cost"), [(0.010, 54), (0.050, 40)])
def test_frequencies_by_linspace(device, precise, z, cost):
    n, dx = 512, 6.6e-6
    u, end = gaussian(n, dx, z, n * dx / 8)
    nyquist = 1 / (2 * dx)
    f = ifftshift(np.linspace(-nyquist, nyquist, n))
    wrong = fftshift(ifft(fft(ifftshift(u[0])) * helmholtz(f, z)))[None]
    assert err_db(end, wrong) == pytest.approx(cost, abs=TABLE)
    # exp(-16) of the beam is cut off by the window: 150 dB.
    assert err_db(end, go(u, Grid((1, n), dx), z, precise)) >= 150
    assert err_db(end, go(u, Grid((1, n), dx), z, device)) >= 120


# Edges ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("z_over_s", "binary", "weighted"), [(0.1, 28.6, 33.95), (8, 36.1, 56.05), (64, 45.1, 83.25)]
)
def test_binary_apertures(device, z_over_s, binary, weighted):
    a = set_up_a(z_over_s)
    n, grid = a.u.shape[1], Grid(a.u.shape, a.pitch)
    x = axis(n, a.pitch[1])
    cut = ((x >= -n / 4 * a.pitch[1]) & (x < n / 4 * a.pitch[1]))[None] + 0j
    assert snr_db(a.exact, go(cut, grid, a.z, device)) == pytest.approx(binary, abs=TABLE)
    ones = field_of(np.ones(grid.shape), grid, device)
    slit = rectangular_aperture(ones, (a.pitch[0], n / 2 * a.pitch[1]))
    got = propagate(slit, a.z).to_numpy()
    assert snr_db(a.exact, got) == pytest.approx(weighted, abs=TABLE)


@pytest.mark.parametrize("z_units", [48, 64])
def test_many_steps_without_a_border(device, z_units):
    a = slit_fresnel(z_units)
    grid = Grid(a.u.shape, a.pitch)
    bare = go(a.u, grid, a.z, device, method="fresnel-multistep", border=0, pad=1)
    assert 12 <= err_db(a.exact, bare) <= 20
    got = go(a.u, grid, a.z, device, method="fresnel-multistep")
    assert err_db(a.exact, got) >= 70


@pytest.mark.parametrize("n", [254, 255])
def test_steps_of_odd_length(precise, n):
    """One step of an even window is the transfer function (a Gauss sum), of an odd one it is not.

    The package steps in even windows: 255 samples in one of 256.
    """
    dx, even = 6.6e-6, n + n % 2
    rng = np.random.default_rng(n)
    u = rng.normal(size=(1, n)) + 1j * rng.normal(size=(1, n))
    z = even * dx**2 / LAM
    window = np.zeros(even, complex)
    window[even // 2 - n // 2 :][:n] = u[0]
    f = fftfreq(even, dx)
    exact = ifft(fft(window) * np.exp(-1j * np.pi * LAM * z * f**2))[even // 2 - n // 2 :][:n]
    options = {"method": "fresnel-multistep", "pad": 1, "border": 0}
    assert err_db(exact[None], go(u, Grid((1, n), dx), z, precise, **options)) >= 220
    if n % 2:
        x, dz = axis(n, dx), n * dx**2 / LAM
        chirp = np.exp(1j * np.pi * x**2 / (LAM * dz))
        step = dx / np.sqrt(1j * LAM * dz) * chirp * fftshift(fft(ifftshift(u[0] * chirp)))
        circular = ifft(fft(u[0]) * np.exp(-1j * np.pi * LAM * dz * fftfreq(n, dx) ** 2))
        assert err_db(circular[None], step[None]) < 3


# Bands ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("z_over_s", "cost", "kept"), [(64, 40.92, 83.25), (1024, 16.38, 120.94)])
def test_a_band_cut_where_geometry_says(device, z_over_s, cost, kept):
    a = set_up_a(z_over_s)
    grid, width = Grid(a.u.shape, a.pitch), a.u.shape[1] * a.pitch[1] / 2
    hard = go(a.u, grid, a.z, device, method="cblas", guard=0, support=width)
    assert snr_db(a.exact, hard) == pytest.approx(cost, abs=TABLE)
    soft = go(a.u, grid, a.z, device, method="cblas", support=width)
    assert snr_db(a.exact, soft) == pytest.approx(kept, abs=TABLE)


def test_a_shifted_band_that_ends_on_the_main_lobe(device):
    """The output's edge lies opposite the input's: the geometric band ends at f = 0."""
    n, dx, z = 256, 2e-6, 0.08
    waist = n * dx / 16
    grid, beside = Grid((1, n), dx), Grid((1, n), dx, origin=(0, n * dx))
    u, _ = gaussian(n, dx, z, waist)
    end = gaussian_exact(np.abs(beside.x), z, waist=waist, wavelength=LAM, dim=1)[None]
    hard = go(u, grid, z, device, method="cblas", out_grid=beside, guard=0)
    assert err_db(end, hard) < 20
    assert err_db(end, go(u, grid, z, device, out_grid=beside)) >= 120


@pytest.mark.parametrize("z", [-1e-6, -5e-5])
def test_evanescent_waves_on_the_way_back(device, z):
    grid = Grid((3, 64), LAM / 8)
    u = np.zeros(grid.shape, complex)
    u[:, 28:37] = 1
    s = LAM**2 * (grid.fy[:, None] ** 2 + grid.fx**2)
    with np.errstate(over="ignore", invalid="ignore"):
        wrong = np.exp(2j * np.pi * z / LAM * np.sqrt(1 - s + 0j))
        assert not np.abs(np.fft.ifft2(np.fft.fft2(u) * wrong)).max() < 1e9
    for method in ("auto", "as", "blas", "cblas", "rs"):
        assert np.abs(go(u, grid, z, device, method=method)).max() < 1.5


def test_convolution_near_and_angular_spectrum_far(device):
    cost = {(0.1, "rs"): 4.9, (1, "rs"): 3.9, (64, "as"): 26.22, (1024, "as"): 12.67}
    kept = {0.1: 33.95, 1: 36.53, 64: 83.25, 1024: 120.94}
    device.plans.clear()  # warnings come once a plan
    for (z_over_s, method), printed in cost.items():
        a = set_up_a(z_over_s)
        grid = Grid(a.u.shape, a.pitch)
        with pytest.warns(SamplingWarning, match="Use method='auto'"):
            wrong = propagate(field_of(a.u, grid, device), a.z, method=method).to_numpy()
        assert snr_db(a.exact, wrong) == pytest.approx(printed, abs=TABLE)
        best = propagate(field_of(a.u, grid, device), a.z).to_numpy()
        assert snr_db(a.exact, best) == pytest.approx(kept[z_over_s], abs=TABLE)


# Windows and lenses that are too small ----------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.2, 1.5])
def test_a_lens_beyond_its_largest_radius(device, ratio):
    """Its ghosts take their part: the focus keeps R_max/R of its amplitude."""
    n, dx = 2048, 1e-5
    radius = 512 * dx
    f = 2 * radius * dx / LAM / ratio
    grid = Grid((1, n), dx)
    ones = field_of(np.ones(grid.shape), grid, device)
    with pytest.raises(SamplingError, match="R_max"):
        thin_lens(ones, f, diameter=2 * radius)
    lit = rectangular_aperture(ones, (dx, 2 * radius))
    aliased = thin_lens(lit, f, aliasing="allow")
    peak = abs(propagate(aliased, f).to_numpy()[0, n // 2])
    ideal = 2 * radius / np.sqrt(LAM * f)
    # 10 %: the ripples of the aliased edge; the table's own figures are .833 and .667.
    assert peak / ideal == pytest.approx(1 / ratio, rel=0.1)


def test_a_point_that_lights_more_than_the_window_and_a_lens_that_exceeds_it(device):
    grid = Grid((64, 64), 1e-5)
    with pytest.warns(SamplingWarning, match=r"aliased .* a distance of at least"):
        spherical_wave(grid, 5e-3, wavelength=LAM, device=device)
    with pytest.warns(SamplingWarning, match=r"lens .* 101 samples"):
        OpticalSystem([Lens(1.0, diameter=1e-3 + 1e-5)])(
            field_of(np.ones(grid.shape), grid, device)
        )


# Constants, axes and metrics --------------------------------------------------------------------

GRID = Grid((48, 61), (4e-6, 3e-6))
Z = 2.0013e-3  # z/lam = 3638.73: a carrier that is left over shows
EXACT = ("auto", "as", "blas", "cblas", "rs")
PARAXIAL = ("fresnel-tf", "fresnel-ir", "fresnel-multistep")


def beam() -> Complex:
    y, x = GRID.y[:, None] - 5e-6, GRID.x + 8e-6
    return np.exp(-(x**2 + y**2) / 18e-6**2) + 0j


def ratio(reference: Complex, got: Complex) -> complex:
    """The constant a of got = a reference."""
    return complex(np.vdot(reference, got) / np.vdot(reference, reference))


def test_constant_phase_and_amplitude_are_equal_in_all_methods(device, precise):
    y, x = GRID.y[:, None] - 5e-6, GRID.x + 8e-6
    r = np.hypot(y, x)
    radii, back = np.unique(r, return_inverse=True)
    exact = gaussian_exact(radii, Z, waist=18e-6, wavelength=LAM)[back].reshape(r.shape)
    paraxial = gaussian_paraxial(r, Z, waist=18e-6, wavelength=LAM)
    for d, limit in ((device, 1e-6), (precise, 1e-9)):
        for method in EXACT + PARAXIAL:
            truth = exact if method in EXACT else paraxial
            assert abs(ratio(truth, go(beam(), GRID, Z, d, method=method)) - 1) <= limit, method
        one = propagate(field_of(beam(), GRID, d), Z, method="fresnel-1fft")
        same = go(beam(), GRID, Z, d, out_grid=one.grid)
        # The two theories differ by a mean phase of pi z lam^3 <f^4>/4, 1.3e-5 here.
        assert abs(ratio(same, one.to_numpy()) - 1) <= 2e-5
    assert abs(ratio(exact, paraxial) - 1) <= 2e-5


def test_what_a_lost_constant_costs(device):
    kept = go(beam(), GRID, Z, device)
    for lost in (np.exp(2j * np.pi * Z / LAM), 1j, -1j, np.sqrt(1j)):
        assert err_db(kept, kept * np.complex64(lost)) < 6
        assert abs(ratio(kept, kept * np.complex64(lost)) - 1) > 0.5


@pytest.mark.parametrize("method", [*EXACT, *PARAXIAL])
def test_axes_swapped(device, method):
    got = go(beam(), GRID, Z, device, method=method)
    assert err_db(corrected(beam(), GRID.pitch, Z, wavelength=LAM), got) >= 90
    swapped = corrected(beam(), GRID.pitch[::-1], Z, wavelength=LAM)
    assert err_db(swapped, got) < 15
    turned = Grid(GRID.shape[::-1], GRID.pitch[::-1])
    assert err_db(got, go(beam().T, turned, Z, device, method=method).T) >= 120


def test_signal_to_noise_alone_hides_a_constant(device):
    a = gaussian_a(1, n=256)
    got = go(a.u, Grid(a.u.shape, a.pitch), a.z, device)
    wrong = 0.5j * got
    assert snr_db(a.exact, wrong) == pytest.approx(snr_db(a.exact, got), abs=0.1)
    assert err_db(a.exact, wrong) < 0
    assert err_db(a.exact, got) >= 120


@pytest.mark.parametrize("diameter", [1.5e-3, 2e-3])
def test_the_constant_of_a_focus(device, diameter):
    """-i lost in a Fresnel constant: the focus of a lens is D^2 pi/4 over i lam f."""
    f, dx, n = 0.06, 1e-5, 256
    grid = Grid((n, n), dx)
    lit = thin_lens(field_of(np.ones(grid.shape), grid, device), f, diameter=diameter)
    focus = lens_focus(0.0, f=f, diameter=diameter, wavelength=LAM)
    for method in ("auto", "fresnel-tf"):
        got = propagate(lit, f, method=method).to_numpy()[n // 2, n // 2]
        # The paraxial lens aberrates by D^4/(64 f^3) = 1.2e-3 um at most: 1e-2 rad.
        assert abs(got / focus - 1) <= 1.5e-2, method


@pytest.mark.parametrize(("share", "least", "most"), [(1.0, 35, 70), (0.75, 250, np.inf)])
def test_full_band_fields_in_comparisons_of_padding(precise, share, least, most):
    """Energy at the Nyquist frequency: H breaks off there and rings; up to 75 % nothing does."""
    n, dx = 256, 2e-6
    grid = Grid((1, n), dx)
    rng = np.random.default_rng(0)
    f = share * rng.uniform(-1, 1, 40) / (2 * dx)
    f[0] = share / (2 * dx)
    tilts = np.exp(2j * np.pi * np.outer(grid.x, f)) @ rng.normal(size=40)
    u = (np.exp(-((10 * grid.x / grid.extent[1]) ** 2)) * tilts)[None]
    two, four = (go(u, grid, 2e-4, precise, method="as", pad=pad) for pad in (2, 4))
    assert least <= err_db(four, two) <= most


def test_the_report_says_what_is_aliased(device):
    grid = Grid((1, 256), 2 * LAM)
    for z, method, sampled in (
        (1e-4, "rs", "kernel"),
        (0.1, "as", "transfer function"),
        (1e-4, "fresnel-ir", "kernel"),
        (0.1, "fresnel-tf", "transfer function"),
        (1e-4, "fresnel-1fft", "chirp"),
    ):
        with pytest.warns(SamplingWarning, match="aliased"):
            plan = Propagator(grid, z, wavelength=LAM, method=method, device=device)
        assert plan.report.sampled == sampled
        assert plan.report.phase_step > 1


# Coherence --------------------------------------------------------------------------------------


def test_coherence_averaged_with_the_curvature_on(device):
    grid, light = Grid((96, 96), 4e-6), ExtendedSource(2e-3, 0.1, points=200)
    lags = np.arange(48)
    v = np.pi * 2e-3 * lags * 4e-6 / (LAM * 0.1)
    law = np.divide(2 * j1(v), v, out=np.ones(48), where=v > 0)
    fields = [
        light.field(grid, wavelength=LAM, device=device, seed=1, index=index).to_numpy()
        for index in range(250)
    ]
    bend = np.exp(1j * np.pi * (grid.y[:, None] ** 2 + grid.x**2) / (LAM * 0.1))
    flat, curved = (
        np.sqrt(np.mean(np.abs(degree_along_x([u * with_ for u in fields]) - law) ** 2))
        for with_ in (1, bend)
    )
    assert flat <= 0.008
    assert curved == pytest.approx(0.012, abs=0.002)  # a floor that more snapshots do not lower


def degree_along_x(fields):
    """Mean of u*(x) u(x + lag) over window and fields, over that of lag 0."""
    n = fields[0].shape[1]
    sums = [sum((u[:, : n - k].conj() * u[:, k:]).mean() for u in fields) for k in range(n // 2)]
    return np.array(sums) / sums[0].real


@pytest.mark.parametrize("cells", [4, 5, 8])
def test_a_lattice_without_jitter(device, cells):
    grid, snapshots = Grid((64, 40), (4e-6, 6.4e-6)), 300
    side = 256e-6 / cells
    residual = {}
    for jitter in (True, False):
        # a quarter of p^2/lam: from 4 p^2/lam on only windows of few cells show what remains
        mask = RandomPhaseMask(side, distance=0.25 * side**2 / LAM, jitter=jitter)
        fields = (
            mask.field(grid, wavelength=LAM, device=device, seed=2, index=index).to_numpy()
            for index in range(snapshots)
        )
        mean = sum(np.abs(u) ** 2 for u in fields) / snapshots
        residual[jitter] = mean.std() / mean.mean()
    assert residual[True] <= 1.2 / np.sqrt(snapshots)
    assert residual[False] > 0.14


def test_a_distance_too_short_for_few_cells(device):
    grid, side = Grid((120, 120), 4e-6), 480e-6 / 10
    fields, contrast = {}, {}
    for factor in (0.1, 4):
        mask = RandomPhaseMask(side, distance=factor * side**2 / LAM)
        fields[factor] = [
            mask.field(grid, wavelength=LAM, device=device, seed=3, index=index).to_numpy()
            for index in range(20)
        ]
        intensities = [np.abs(u) ** 2 for u in fields[factor]]
        contrast[factor] = np.mean([i.std() / i.mean() for i in intensities])
    assert contrast[0.1] < 0.7  # blocks with fringes at their edges
    assert contrast[4] == pytest.approx(0.985, abs=0.06)
    short = Coherence(RandomPhaseMask(side, distance=0.1 * side**2 / LAM))
    with pytest.warns(SamplingWarning, match=r"at least 4 p\^2/lam = 16.7564 mm"):
        short.snapshots(grid, wavelength=LAM, device=device)
