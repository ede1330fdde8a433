"""Pupils as filters: closed forms, edges, gratings, cut-offs, transfer functions of systems."""

import numpy as np
import pytest
from scipy.integrate import quad
from tolerance import fft_tolerance, relative_max

from clplen import Field, Grid
from clplen.wave.coherence.abbe import incoherent_image
from clplen.wave.systems.components import Lens
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.pupil_filter import Pupil, coherent_edge, incoherent_edge, otf, transfer_of
from clplen.wave.systems.space import Space

LAM = 550e-9
SHAPES = [(15, 22), (1, 17), (19, 1)]


def noise(shape, seed=5):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape) + 0.5


def on(device, u, grid):
    return Field.from_array(u, grid, wavelength=LAM, device=device)


# Closed forms: values of Goodman's formulae to the digits given


def test_edges_have_their_known_values():
    x = np.array([0, 0.25, 0.5, 0.10614])
    np.testing.assert_allclose(coherent_edge(x), [0.25, 0.87671, 1.18699, 0.5], atol=6e-6)
    circle = incoherent_edge([0, 0.25, 0.5, 1])
    np.testing.assert_allclose(circle, [0.5, 0.845445, 0.939089, 0.968396], atol=6e-7)
    assert incoherent_edge(0.25).shape == ()


def check_incoherent_edge_is_the_integral_of_its_otf(shape, slope):
    for x in (-0.9, -1e-5, 0.07, 2.3):
        a = 4 * np.pi * x
        whole, _ = quad(
            lambda s, a=a: otf(s, shape=shape) * a * np.sinc(a * s / np.pi), 0, 1, epsabs=1e-12
        )
        assert incoherent_edge(x, shape=shape) == pytest.approx(0.5 + whole / np.pi, abs=1e-10)
    step = 1e-4
    rise = np.diff(incoherent_edge([-step, step], shape=shape))[0] / (2 * step)
    assert rise == pytest.approx(slope, abs=1e-5)


def test_incoherent_edge_is_the_integral_of_its_otf():
    for shape, slope in [("circular", 1.69765), ("slit", 2.0)]:
        check_incoherent_edge_is_the_integral_of_its_otf(shape, slope)


def test_otf_of_circle_slit_and_square():
    s = np.array([0, 0.2, 0.7, 1, 1.4])
    np.testing.assert_allclose(otf(-s, shape="slit"), [1, 0.8, 0.3, 0, 0], atol=1e-15)
    np.testing.assert_array_equal(otf(s, shape="square"), otf(s, shape="slit"))
    overlap = [4 / np.pi * quad(lambda t: np.sqrt(1 - t * t), v, 1)[0] for v in s[:4]]
    np.testing.assert_allclose(otf(s), [*overlap, 0], atol=1e-8)  # quad's own at the rim


# The filter


def check_apply_is_the_periodic_filter(device, precise, shape, rim):
    grid = Grid(shape, (3e-6, 4e-6), origin=(1e-6, -7e-6))
    pupil = Pupil.of_cutoff(7e4, LAM, shape=rim, path=lambda v, u: 2e-7 * (v**3 - 0.5 * u + 0.2))
    u = noise((2, *shape))
    expected = np.fft.ifft2(np.fft.fft2(u) * pupil.transfer(grid, LAM))
    for one in (device, precise):
        got = pupil.apply(on(one, u, grid)).to_numpy()
        assert relative_max(expected, got) <= 2 * fft_tolerance(shape, one.complex)


def test_apply_is_the_periodic_filter(device, precise):
    for shape in SHAPES:
        for rim in ["circular", "square", "slit"]:
            check_apply_is_the_periodic_filter(device, precise, shape, rim)


def test_the_cut_off_follows_the_wavelength(device):
    grid, pupil = Grid((1, 64), 4e-6), Pupil(1e-3, 1e-2)
    delta = np.zeros((1, 64))
    delta[0, 20] = 1
    for wavelength in (500e-9, 700e-9):  # one after the other: plans are kept
        field = Field.from_array(delta, grid, wavelength=wavelength, device=device)
        peak = pupil.apply(field).to_numpy()[0, 20].real
        assert peak == pytest.approx(2 * 4e-6 * pupil.cutoff(wavelength), rel=1e-5)


def test_transfer_covers_the_area_of_its_shape():
    grid = Grid((45, 64), (4e-6, 2.5e-6))
    cell = 1 / (grid.extent[0] * grid.extent[1])
    fc = 6e4
    for rim, area in (("circular", np.pi * fc**2), ("square", 4 * fc**2)):
        P = Pupil.of_cutoff(fc, LAM, shape=rim).transfer(grid, LAM)
        assert P.sum().real * cell == pytest.approx(area, rel=1e-12)
        np.testing.assert_allclose(P, np.roll(P[::-1], 1, axis=0), atol=1e-12)
        f2 = np.add.outer(grid.fy**2, grid.fx**2)
        if rim == "circular":
            assert (P[f2 < (fc - 7e3) ** 2] == 1).all()
            assert (P[f2 > (fc + 7e3) ** 2] == 0).all()


def test_a_slit_bounds_one_axis():
    pupil = Pupil(1e-3, 0.02, shape="slit")
    fc = pupil.cutoff(LAM)
    assert fc == pytest.approx(1e-3 / (2 * LAM * 0.02))
    P = pupil.transfer(Grid((21, 128), (2e-6, 4e-6)), LAM)
    np.testing.assert_array_equal(P, np.broadcast_to(P[0], P.shape))
    assert P[0].sum().real == pytest.approx(2 * fc * 128 * 4e-6)
    for shape in ((1, 128), (128, 1)):
        for rim in ("slit", "circular", "square"):
            line = Pupil(1e-3, 0.02, shape=rim).transfer(Grid(shape, 4e-6), LAM)
            np.testing.assert_allclose(line.ravel(), P[0], atol=1e-12)


def test_a_tilted_path_moves_the_image(precise):
    grid, fc, u = Grid((24, 30), (3e-6, 2e-6)), 1e7, noise((24, 30))  # fc beyond all frequencies

    # exp(2 pi i f s) moves by -s: 2 samples along y, -5 along x; s = path slope/(lam fc)
    def path(v, u):
        return LAM * fc * (2 * 3e-6 * v - 5 * 2e-6 * u)

    # An even lattice has no frequency +N/2 to go with -N/2: without it the shift is exact.
    spectrum = np.fft.fft2(u)
    spectrum[12], spectrum[:, 15] = 0, 0
    u = np.fft.ifft2(spectrum)
    got = Pupil.of_cutoff(fc, LAM, path=path).apply(on(precise, u, grid)).to_numpy()
    assert relative_max(np.roll(u, (-2, 5), (0, 1)), got) <= 1e-12


# Systems


def test_transfer_of_a_system_is_what_it_does(device, precise):
    grid = Grid((15, 22), (3e-6, 4e-6), origin=(1e-6, 0))
    u = noise(grid.shape)
    pupil = Pupil(4e-4, 1e-2)
    for system in (
        OpticalSystem([pupil, Space(1e-3, method="as", pad=1)]),
        OpticalSystem([Space(2e-3, method="blas", pad=1)]),
        OpticalSystem([Space(-1e-4, method="as", pad=1), Space(0.0), pupil]),
    ):
        H = transfer_of(system, grid, LAM)
        expected = np.fft.ifft2(np.fft.fft2(u) * H)
        for one in (device, precise):
            tolerance = 5 * fft_tolerance(grid.shape, one.complex)  # three systems of FFT and H
            assert relative_max(expected, system(on(one, u, grid)).to_numpy()) <= tolerance
    single = transfer_of(pupil, grid, LAM)
    np.testing.assert_array_equal(single, pupil.transfer(grid, LAM))


def test_other_parts_are_no_filter():
    for part in [
        Lens(0.1),
        Space(1e-3),
        Space(1e-3, method="as"),
        Space(1e-3, method="cblas", pad=1),
    ]:
        grid = Grid((16, 16), 1e-5)
        assert transfer_of(OpticalSystem([Pupil(1e-3, 0.1), part]), grid, LAM) is None


# Edges and gratings by the filter


def test_images_of_an_edge(device):
    for shape, rim in [((1, 512), "slit"), ((512, 512), "circular")]:
        pitch, fc = 2e-6, 1 / 32e-6  # 16 samples per 1/fc
        grid = Grid(shape, pitch)
        strip = np.where(np.abs(grid.x) < 127.5 * pitch, 1.0, 0.0)
        strip[np.abs(np.abs(grid.x) - 128 * pitch) < pitch / 2] = 0.5  # on the edge
        pupil = Pupil.of_cutoff(fc, LAM)
        x_fc = (grid.x + 128 * pitch) * fc
        near = np.abs(x_fc) < 6
        coherent = pupil.apply(on(device, np.broadcast_to(strip, shape), grid)).intensity()
        seen = coherent.to_numpy()[shape[0] // 2]
        assert seen[x_fc == 0] == pytest.approx(0.25, abs=0.005)
        assert seen[near].max() == pytest.approx(1.187, abs=0.02)
        assert np.abs(seen - coherent_edge(x_fc))[near].max() <= 0.006  # .0034 and the other edge's
        H = pupil.transfer(grid, LAM)
        lamp = incoherent_image(on(device, np.broadcast_to(np.sqrt(strip), shape), grid), H)
        seen = lamp.to_numpy()[shape[0] // 2] / np.mean(np.abs(H) ** 2)
        assert seen[x_fc == 0] == pytest.approx(0.5, abs=0.005)
        assert np.abs(seen - incoherent_edge(x_fc, shape=rim))[near].max() <= 0.006


# Words and refusals


def test_bad_pupils():
    for make, words in [
        (lambda: Pupil(0, 1), "diameter of a pupil must be positive"),
        (lambda: Pupil(1e-3, -1), "distance from a pupil"),
        (lambda: Pupil(1e-3, 1, shape="round"), "circular, square, slit, got 'round'"),
        (lambda: Pupil.of_cutoff(np.nan, LAM), "fc must be positive"),
        (lambda: Pupil.of_cutoff(1e4, 0), "wavelength must be positive"),
        (lambda: otf(0.1, shape="ring"), "shape must be one of"),
        (lambda: incoherent_edge(0.1, shape="ring"), "shape must be one of"),
    ]:
        with pytest.raises(ValueError, match=words):
            make()
    holed = Pupil.of_cutoff(5e4, LAM, path=lambda v, u: np.where(v > 0.5, np.nan, 0))
    with pytest.raises(ValueError, match="finite values everywhere in the pupil"):
        holed.transfer(Grid((16, 16), 3e-6), LAM)


def test_transfer_of_evanescent_waves(precise):
    for z in [3e-7, -3e-7]:
        grid = Grid((12, 15), (LAM / 5, LAM / 4))
        space = Space(z, method="as", pad=1)
        u = noise(grid.shape)
        expected = np.fft.ifft2(np.fft.fft2(u) * transfer_of(space, grid, LAM))
        assert relative_max(expected, space.apply(on(precise, u, grid)).to_numpy()) <= 1e-12
