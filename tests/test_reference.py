"""The optics twins against closed forms, quadrature and the printed reference values."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from reference_optics import centred_slice
from tolerance import err_db, relative_max, snr_db

pytestmark = pytest.mark.nightly

LAM = 550e-9
SETUP_A = (1024, 2 * LAM)


# Grid and transfer function ------------------------------------------------------------------


@pytest.mark.parametrize(("n", "first", "last"), [(4, -2, 1), (5, -2, 2), (1, 0, 0)])
def test_axis_puts_the_origin_on_sample_n_half(n, first, last):
    x = ref.axis(n, 0.5, 0.25)
    assert x[0] == 0.5 * first + 0.25
    assert x[-1] == 0.5 * last + 0.25
    assert x[n // 2] == 0.25


@pytest.mark.parametrize("shape", [(16, 21), (21, 16), (1, 9)])
@pytest.mark.parametrize("z", [3e-4, -3e-4])
def test_tilted_plane_waves_are_eigenfunctions(shape, z):
    pitch = (0.9e-6, 1.1e-6)
    fy, fx = (np.fft.fftfreq(n, d)[n // 3] for n, d in zip(shape, pitch, strict=True))
    y, x = ref.axis(shape[0], pitch[0])[:, None], ref.axis(shape[1], pitch[1])[None, :]
    tilt = {"fy": fy, "fx": fx, "wavelength": LAM}
    start = ref.tilted_plane_wave(y, x, 0.0, **tilt)
    exact = ref.tilted_plane_wave(y, x, z, **tilt)
    assert err_db(exact, ref.propagate(start, pitch, z, LAM, pad=1)) > 240
    assert err_db(exact, start) < 20


def test_evanescent_waves_decay_forwards_and_vanish_backwards():
    pitch, z = LAM / 8, 0.3 * LAM
    h = ref.transfer_function((1, 64), pitch, z, LAM)[0]
    s = (LAM * np.fft.fftfreq(64, pitch)) ** 2
    k = 2 * np.pi / LAM
    exact = np.exp(-1j * k * z) * np.exp(1j * k * z * np.sqrt(1 - s + 0j))
    assert np.count_nonzero(s > 1) == 47
    assert relative_max(exact, h) < 1e-13
    back = ref.transfer_function((1, 64), pitch, -z, LAM)[0]
    assert relative_max(np.where(s <= 1, exact.conj(), 0), back) < 1e-13


def test_blas_cuts_at_the_geometric_limit_of_the_window():
    shape, pitch, z = (40, 63), (1.0e-6, 1.2e-6), 2e-4
    h = ref.transfer_function(shape, pitch, z, LAM, band="blas")
    assert ref.blas_limit(40e-6, z, LAM) == pytest.approx(np.sin(np.arctan(40e-6 / 2 / z)) / LAM)
    for n, d, side in ((40, 1.0e-6, h[:, 0]), (63, 1.2e-6, h[0])):
        limit = np.sin(np.arctan(n * d / (2 * z))) / LAM
        assert np.array_equal(side != 0, np.abs(np.fft.fftfreq(n, d)) < limit)
        assert 0 < np.count_nonzero(side) < n
    assert np.all(ref.transfer_function((4, 4), pitch, 0.0, LAM, band="blas") == 1)


def test_padding_keeps_the_centre_sample_and_is_smooth():
    assert [ref.padded_length(n, 2) for n in (1, 5, 11, 1024, 1010)] == [1, 10, 22, 2048, 2020]
    assert ref.padded_length(1019, 1) == 1019
    for small, large in ((5, 12), (5, 13), (6, 13), (6, 12), (7, 7)):
        kept = np.arange(large)[centred_slice(small, large)]
        assert kept[small // 2] == large // 2
        assert len(kept) == small
    u = np.zeros((3, 7, 6), complex)
    u[1, 3, 3] = 1
    for z in (0.0, 1e-12):
        got = ref.propagate(u, 1e-6, z, LAM, pad=2)
        assert got.shape == u.shape
        assert np.abs(got[1, 3, 3]) == pytest.approx(1, abs=1e-4)
        assert np.abs(got[[0, 2]]).max() == 0


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="method"):
        ref.propagate(np.ones((4, 4), complex), 1e-6, 1.0, LAM, method="rs")
    with pytest.raises(ValueError, match="band"):
        ref.transfer_function((4, 4), 1e-6, 1.0, LAM, band="hard")


# Propagation against closed forms ------------------------------------------------------------


@pytest.mark.parametrize("shape", [(64, 81), (81, 64)])
@pytest.mark.parametrize("method", ["as", "blas"])
@pytest.mark.parametrize("z", [30e-6, -30e-6])
def test_gaussian_matches_the_quadrature(shape, method, z):
    pitch, centre, waist = (0.8e-6, 0.7e-6), (2.1e-6, -3.3e-6), 3.5e-6
    y = ref.axis(shape[0], pitch[0])[:, None] - centre[0]
    x = ref.axis(shape[1], pitch[1])[None, :] - centre[1]
    r = np.hypot(y, x)
    exact = ref.gaussian_exact(r, z, waist=waist, wavelength=LAM)
    start = ref.gaussian_exact(r, 0.0, waist=waist, wavelength=LAM)
    assert err_db(np.exp(-((r / waist) ** 2)), start.real) > 240
    assert err_db(exact, ref.propagate(start, pitch, z, LAM, method=method)) > 240


def test_forth_and_back_and_two_steps_make_one():
    rng = np.random.default_rng(3)
    u = rng.normal(size=(15, 22)) + 1j * rng.normal(size=(15, 22))
    step = {"pitch": (0.7e-6, 0.5e-6), "wavelength": LAM, "pad": 1}
    there = ref.propagate(u, z=5e-5, **step)
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(u), rel=1e-13)
    assert relative_max(u, ref.propagate(there, z=-5e-5, **step)) < 1e-13
    twice = ref.propagate(ref.propagate(u, z=2e-5, **step), z=3e-5, **step)
    assert relative_max(there, twice) < 1e-12


def test_talbot_image():
    period, n = 8 * LAM, 45
    x = ref.axis(n, period * 5 / n)
    grating = (1 + 0.5 * np.cos(2 * np.pi * x / period) + 0j)[None, :]
    z = 10 * ref.talbot_distance(period, LAM)
    got = ref.propagate(grating, period * 5 / n, z, LAM, pad=1)
    assert relative_max(grating, got) < 1e-11
    paraxial = ref.propagate(grating, period * 5 / n, 20 * period**2 / LAM, LAM, pad=1)
    assert relative_max(grating, paraxial) > 0.05


def test_direct_sum_and_quadrature_agree():
    shape, pitch, z, waist = (24, 27), (1.1e-6, 1.0e-6), 150e-6, 2.6e-6
    y, x = ref.axis(shape[0], pitch[0])[:, None], ref.axis(shape[1], pitch[1])[None, :]
    r = np.hypot(y, x)
    start = np.exp(-((r / waist) ** 2)) + 0j
    for sign in (1, -1):
        exact = ref.gaussian_exact(r, sign * z, waist=waist, wavelength=LAM)
        assert err_db(exact, ref.rayleigh_sommerfeld(start, pitch, sign * z, LAM)) > 150


@pytest.mark.parametrize(
    ("z", "as_1", "as_2", "blas"),
    [(4, 33.83, 46.82, 46.82), (8, 28.87, 45.23, 55.91), (64, 17.99, 26.22, 50.76)],
)
def test_slit_reaches_the_printed_snr(z, as_1, as_2, blas):
    n, dx = SETUP_A
    width = n * dx / 2
    x = ref.axis(n, dx)
    slit = ref.rectangle_coverage((1, n), dx, (dx, width)) + 0j
    assert slit[0, [n // 4, 3 * n // 4]] == pytest.approx(0.5, abs=1e-12)
    exact = ref.slit_exact(x, z * n * dx, width=width, wavelength=LAM)[None, :]
    for pad, method, printed in ((1, "as", as_1), (2, "as", as_2), (2, "blas", blas)):
        got = ref.propagate(slit, dx, z * n * dx, LAM, method=method, pad=pad)
        assert snr_db(exact, got) == pytest.approx(printed, abs=0.05)


# Printed values of the closed forms ----------------------------------------------------------


def same(printed: list[complex], got: np.ndarray, digits: int = 10) -> None:
    """Real and imaginary parts agree to the last printed digit, some of which are cut off."""
    difference = np.array(printed) - got
    assert np.max(np.abs([difference.real, difference.imag])) < 10.0**-digits


def test_printed_gaussian():
    got = ref.gaussian_exact(np.array([0, 2e-6, 10e-6]), 20e-6, waist=2e-6, wavelength=LAM)
    same([0.5649880656 - 0.4948028618j, 0.4165597660 - 0.0952317391j], got[:2])
    same([4.297195e-7 - 2.902597e-7j], got[2:], digits=13)
    paraxial = ref.gaussian_paraxial(np.array([0.0]), 20e-6, waist=2e-6, wavelength=LAM)
    assert 1e-3 < abs(paraxial[0] - got[0]) < 1e-2


def test_paraxial_gaussian_is_the_limit_of_the_exact_one():
    r = np.linspace(0, 2e-4, 5)
    for dim in (1, 2):
        beam = {"waist": 1e-4, "wavelength": LAM, "dim": dim}
        exact = ref.gaussian_exact(r, 0.05, **beam)
        assert relative_max(exact, ref.gaussian_paraxial(r, 0.05, **beam)) < 3e-6


def test_printed_circle_on_axis():
    got = [ref.circle_on_axis(z, radius=20e-6, wavelength=LAM) for z in (1e-5, 1e-4, 1e-3)]
    same(
        [
            1.4412425519 - 0.0728355024j,
            1.7907288312 + 0.5799020409j,
            1.6545571798 - 0.7557480125j,
        ],
        np.array(got),
    )


def test_printed_slits():
    got = ref.fresnel_slit(np.array([0, 100e-6, 250e-6]), 0.1, width=500e-6, wavelength=LAM)
    same(
        [
            1.1328219648 + 0.2561565131j,
            1.0404790532 - 0.3154447745j,
            0.5580098109 - 0.0466346144j,
        ],
        got,
    )
    s = SETUP_A[0] * SETUP_A[1]
    x = np.array([0, 100e-6, 300e-6])
    near = [0.9844057669 - 0.0229074454j, 1.0293766143 + 0.0066370470j]
    near += [-0.1364424913 + 0.1459632169j]
    far = [0.8316661805 - 0.1448330023j, 1.0850891106 + 0.0402193628j]
    far += [0.4755011731 + 0.0294225908j]
    same(near, ref.slit_exact(x, s, width=s / 2, wavelength=LAM))
    same(far, ref.slit_exact(x, 64 * s, width=s / 2, wavelength=LAM))


def test_printed_lens_focus_and_the_image_of_a_point():
    lens = {"diameter": 3.6e-3, "wavelength": LAM}
    same([-154.2236393580j], ref.lens_focus(np.zeros(1), f=0.12, **lens))
    zero = 1.2196698912665 * LAM * 0.24 / 3.6e-3
    image = ref.point_image(np.array([0, zero]), z1=0.24, z2=0.24, **lens)
    area = np.pi * 3.6e-3**2 / 4
    assert image[0] == pytest.approx(area / (1j * LAM * 0.24) ** 2, rel=1e-14)
    assert abs(image[1] / image[0]) < 1e-12


def test_printed_talbot_ratio():
    period = 8 * LAM
    assert ref.talbot_distance(period, LAM) / (2 * period**2 / LAM) == pytest.approx(
        0.99608, abs=5e-6
    )


# Elements ------------------------------------------------------------------------------------


def test_lens_phase():
    got = ref.lens_phase((3, 4), (2e-5, 3e-5), 0.02, LAM, origin=(1e-5, -2e-5))
    r2 = ref.radius_squared((3, 4), (2e-5, 3e-5), (1e-5, -2e-5))
    assert r2[0, 1] == pytest.approx((-2e-5 + 1e-5) ** 2 + (-3e-5 - 2e-5) ** 2)
    assert relative_max(np.exp(-1j * np.pi * r2 / (LAM * 0.02)), got) < 1e-14


def test_circle_coverage_is_exact():
    shape, pitch = (23, 31), (1.3, 0.9)
    place = {"centre": (1.7, -2.2), "origin": (0.4, 0.1)}
    got = ref.circle_coverage(shape, pitch, 15.0, **place)
    assert got.sum() * 1.3 * 0.9 == pytest.approx(np.pi * 7.5**2, rel=1e-13)
    fine = supersampled(shape, pitch, 0.4 - 1.7, 0.1 + 2.2, lambda y, x: np.hypot(y, x) < 7.5)
    assert np.abs(got - fine).max() < 1 / 100
    assert np.abs(got - fine).mean() < 2e-4
    small = ref.circle_coverage((3, 3), 1.0, 0.5, centre=(1, 0))
    assert small[2, 1] == pytest.approx(np.pi / 16, rel=1e-14)
    assert np.count_nonzero(small) == 1


def supersampled(shape, pitch, oy, ox, inside, n: int = 100) -> np.ndarray:
    """Covered fraction by n x n points a cell: an edge along the points errs by up to 1/n."""
    sub = (np.arange(n) + 0.5) / n - 0.5
    y = (ref.axis(shape[0], pitch[0], oy)[:, None] + sub * pitch[0]).ravel()
    x = (ref.axis(shape[1], pitch[1], ox)[:, None] + sub * pitch[1]).ravel()
    points = inside(y[:, None], x[None, :]).reshape(shape[0], n, shape[1], n)
    return points.mean(axis=(1, 3))


def test_rectangle_coverage_is_exact():
    got = ref.rectangle_coverage((5, 6), (1.0, 2.0), (2.5, 3.0), centre=(0.25, 0.5), origin=(0, 1))
    assert np.allclose(got[:, 3], [0, 0.5, 1, 1, 0], atol=1e-15)
    assert np.allclose(got[2], [0, 0, 0.5, 1, 0, 0], atol=1e-15)
    assert got.sum() * 2 == pytest.approx(2.5 * 3.0)


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
@pytest.mark.parametrize("fill", ["circular", "full"])
@pytest.mark.parametrize(
    ("scale", "rotation"),
    [(1.0, 0.0), (0.83, 0.7), pytest.param(1.0, -0.3, marks=pytest.mark.nightly)],
)
def test_microlens_array_against_points(lattice, fill, scale, rotation):
    """Nearest centre and covered area by brute force over all lenslets and 10^4 points a cell."""
    shape, pitch, origin, offset = (45, 40), (7.1e-6, 8.3e-6), (1e-6, 2.3e-6), (7.3e-6, -11.1e-6)
    array = {"count": (2, 3), "lattice": lattice, "offset": offset, "rotation": rotation}
    got = ref.microlens_array(
        shape, pitch, pitch=70e-6, f=4e-3, wavelength=LAM, fill=fill,
        diameter=scale * 70e-6, origin=origin, **array,
    )  # fmt: skip
    centres = ref.lenslet_centres(70e-6, **array).reshape(-1, 2)
    half = scale * 35e-6

    def inside(y, x):
        covered = np.zeros(np.broadcast(y, x).shape, dtype=bool)
        for cx, cy in centres:
            along = (x - cx) * np.cos(rotation) + (y - cy) * np.sin(rotation)
            across = (y - cy) * np.cos(rotation) - (x - cx) * np.sin(rotation)
            if fill == "circular":
                covered |= np.hypot(along, across) < half
            elif lattice == "square":
                covered |= np.maximum(np.abs(along), np.abs(across)) < half
            else:
                slanted = np.abs(along) / 2 + np.abs(across) * np.sqrt(3) / 2
                covered |= np.maximum(np.abs(along), slanted) < half
        return covered

    fine = supersampled(shape, pitch, *origin, inside)
    assert np.abs(np.abs(got) - fine).max() < 2 / 100
    assert np.abs(np.abs(got) - fine).mean() < 1e-3
    y, x = ref.axis(shape[0], pitch[0], origin[0]), ref.axis(shape[1], pitch[1], origin[1])
    r2 = np.min([(y - cy)[:, None] ** 2 + (x - cx)[None, :] ** 2 for cx, cy in centres], axis=0)
    assert relative_max(np.abs(got) * np.exp(-1j * np.pi * r2 / (LAM * 4e-3)), got) < 1e-12
    form = {("square", "full"): 4, ("hexagonal", "full"): 2 * np.sqrt(3)}
    area = 6 * form.get((lattice, fill), np.pi) * half**2
    assert np.abs(got).sum() * pitch[0] * pitch[1] == pytest.approx(area, rel=1e-9)


def test_lenslet_centres():
    got = ref.lenslet_centres(2.0, count=(2, 3), offset=(0.5, 7.0))
    assert np.allclose(got[1, 0], (5.0, 1.5))
    assert np.allclose(got[0, 2], (9.0, -0.5))
    got = ref.lenslet_centres(2.0, count=(3, 2), lattice="hexagonal")
    assert np.allclose(got[0, 0], (-1.0, -np.sqrt(3)))
    assert np.allclose(got[1], [(0.0, 0.0), (2.0, 0.0)])
    turned = ref.lenslet_centres(2.0, count=(1, 2), rotation=np.pi / 2)
    assert np.allclose(turned[0, 1], (0.0, 1.0))
    with pytest.raises(ValueError, match="lattice"):
        ref.lenslet_centres(2.0, count=2, lattice="triangle")


def test_microlens_arrays_that_overlap_are_refused():
    kw = {"pitch": 1e-4, "f": 1e-2, "count": 2, "wavelength": LAM}
    with pytest.raises(ValueError, match="does not fit"):
        ref.microlens_array((9, 9), 1e-5, diameter=1.2e-4, **kw)
    with pytest.raises(ValueError, match="fill"):
        ref.microlens_array((9, 9), 1e-5, fill="round", **kw)
