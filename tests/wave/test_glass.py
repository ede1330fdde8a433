"""Glasses: indices of catalogues, wavelengths out of range, glasses of one's own."""

import numpy as np
import pytest

from clplen.wave import Glass

# n_d and V_d as makers print them: Schott 2017, Ohara 2017, Malitson 1965.
CATALOGUE = {
    "N-BK7": (1.51680, 64.17),
    "N-SF11": (1.78472, 25.68),
    "SF11": (1.78472, 25.76),
    "F2": (1.62004, 36.37),
    "S-LAH79": (2.00330, 28.27),
    "fused silica": (1.45846, 67.82),
}
# Other lines, nm: Schott's data sheet of N-BK7; the computed column of Malitson's table I.
LINES = {
    "N-BK7": {
        365.0: 1.53627,
        435.8: 1.52668,
        486.1: 1.52238,
        632.8: 1.51509,
        656.3: 1.51432,
        1014.0: 1.50731,
        1529.6: 1.50091,
        2325.4: 1.48921,
    },
    "fused silica": {
        404.656: 1.46962,
        486.133: 1.46313,
        656.272: 1.45637,
        1013.98: 1.45024,
        1529.52: 1.44427,
        2325.42: 1.43293,
        3706.7: 1.39939,
    },
}
# Measured to 1e-3 (Sultanova, Kasarova and Nikolov 2009, table): nm, PMMA, polycarbonate.
PLASTICS = [
    (436.8, 1.502, 1.612),
    (486.1, 1.497, 1.599),
    (587.6, 1.491, 1.585),
    (632.8, 1.489, 1.580),
    (703.0, 1.486, 1.575),
    (833.0, 1.484, 1.569),
    (879.0, 1.483, 1.568),
    (1052.0, 1.481, 1.565),
]


def test_indices_of_catalogues():
    for name in CATALOGUE:
        glass = Glass.named(name)
        n_d, v_d = CATALOGUE[name]
        assert glass.n_d == pytest.approx(n_d, abs=1e-5)
        assert glass.abbe_number == pytest.approx(v_d, abs=0.05)
        assert glass.source


def test_indices_at_other_lines():
    for name in LINES:
        lam, n = np.array(list(LINES[name].items())).T
        np.testing.assert_allclose(Glass.named(name).index(lam * 1e-9), n, atol=1.2e-5)


def test_plastics_to_what_was_measured():
    lam, pmma, polycarbonate = np.array(PLASTICS).T
    for name, n in (("PMMA", pmma), ("polycarbonate", polycarbonate)):
        # a thousandth of the measurement, half of one of the table's last digit
        np.testing.assert_allclose(Glass.named(name).index(lam * 1e-9), n, atol=1.5e-3)
    assert Glass.named("PMMA").abbe_number == pytest.approx(59.2, rel=0.11)
    assert Glass.named("polycarbonate").abbe_number == pytest.approx(29.1, rel=0.11)


def test_dispersion_is_the_derivative():
    for name in Glass.names():
        glass = Glass.named(name)
        lam = np.linspace(*glass.range, 203)[1:-1].reshape(3, 67)
        step = 1e-11
        slope = (glass.index(lam + step) - glass.index(lam - step)) / (2 * step)
        got = glass.dispersion(lam)
        assert got.shape == lam.shape
        np.testing.assert_allclose(got, slope, rtol=1e-4)
        assert (got < 0).all()
        assert glass.dispersion(float(lam[1, 3])) == pytest.approx(got[1, 3], rel=1e-14)


def test_scalars_and_arrays():
    glass = Glass.named("N-BK7")
    lam = np.array([[0.3, 0.55, 2.5], [1.0, 0.4861, 0.6]]) * 1e-6
    many = glass.index(lam)
    assert many.shape == lam.shape
    assert many.dtype == np.float64
    for where in np.ndindex(lam.shape):
        one = glass.index(float(lam[where]))
        assert isinstance(one, float)
        assert one == many[where]
    assert glass.index(np.float32(5.5e-7)) == pytest.approx(glass.index(5.5e-7), abs=1e-8)
    assert glass.index([]).shape == (0,)


def test_names_as_people_write_them():
    for name, same in [("n bk7", "N-BK7"), (" N_BK7 ", "N-BK7"), ("SiO2", "Fused Silica"),
                       ("acrylic", "pmma"), ("PC", "polycarbonate")]:  # fmt: skip
        assert Glass.named(name) == Glass.named(same)
    assert set(Glass.names()) == {*CATALOGUE, "PMMA", "polycarbonate"}


def test_unknown_names():
    for name, message in [
        ("BK7", "no glass 'BK7'; there are N-BK7, .*Did you mean N-BK7"),
        ("S-LAH97", "Did you mean S-LAH79"),
        ("polycarbonat", "Did you mean polycarbonate"),
        ("water", r"no glass 'water'.*by Glass\(name, B, C, range\)"),
        ("", "no glass ''"),
        (None, "no glass None"),
        (1.5, "no glass 1.5"),
    ]:
        with pytest.raises(ValueError, match=message):
            Glass.named(name)


def test_wavelengths_out_of_range():
    for name, wavelength, message in [
        (
            "N-BK7",
            550.0,
            "within 300 nm to 2.5 um for N-BK7, got 550 m; did you mean 5.5e-07",
        ),
        ("SF11", 0.55, "within 390 nm to 2.5 um for SF11, got 0.55 m; did you mean 5.5e-07"),
        ("SF11", 380e-9, r"within 390 nm to 2.5 um for SF11, got 3.8e-07 m\.$"),
        ("fused silica", 4e-6, r"within 210 nm to 3.71 um for fused silica, got 4e-06 m\.$"),
        ("PMMA", [5e-7, 1.06e-6, 2e-6], "got 1.06e-06 m"),
        ("F2", np.nan, "got nan m"),
        ("F2", -5e-7, "got -5e-07 m"),
        ("F2", 0, "got 0 m"),
        ("F2", np.inf, "got inf m"),
    ]:
        for ask in (Glass.named(name).index, Glass.named(name).dispersion):
            with pytest.raises(ValueError, match=message):
                ask(wavelength)


def test_what_is_no_wavelength():
    for wavelength in ["550 nm", None, 5e-7 + 1j, [[5e-7], [5e-7, 6e-7]]]:
        with pytest.raises(TypeError):
            Glass.named("F2").index(wavelength)


def test_a_glass_of_one_s_own():
    """A constant (C = 0) and one resonance, against the formula by hand."""
    glass = Glass("gel", (0.7, 0.31), (0, 0.0132), (0.4e-6, 1.1e-6), "measured by us")
    assert glass.index(0.6e-6) == pytest.approx((1 + 0.7 + 0.31 * 0.36 / (0.36 - 0.0132)) ** 0.5)
    assert glass.range == (0.4e-6, 1.1e-6)
    assert Glass("one", [1.2], [0.01], (4e-7, 7e-7)).index(5e-7) == pytest.approx(2.25**0.5)
    infrared = Glass("infrared", (1.0,), (0.01,), (0.7e-6, 2e-6))
    with pytest.raises(ValueError, match=r"within 700 nm to 2 um for infrared, got 4.86"):
        _ = infrared.abbe_number


def test_bad_glasses():
    for arguments, message in [
        (("", (1,), (0.01,), (4e-7, 7e-7)), "name must be a string"),
        ((7, (1,), (0.01,), (4e-7, 7e-7)), "name must be a string"),
        (("g", (1, 2), (0.01,), (4e-7, 7e-7)), "got 2 and 1"),
        (("g", (np.nan,), (0.01,), (4e-7, 7e-7)), "B of g must be finite"),
        (("g", (), (), (4e-7, 7e-7)), "B of g must be finite"),
        (("g", (1,), (1e-14,), (4e-7, 7e-7)), "in um.2, .* got 1e-14; did you mean 0.01"),
        (("g", (1,), (0.25,), (4e-7, 7e-7)), r"resonance at 0.5 um \(C = 0.25 um.2\), within"),
        (("g", (1,), (0.01,), (400, 700)), "range of g must be in metres, .*; did you mean 7e-07"),
        (("g", (1,), (0.01,), (0.4, 0.7)), "range of g must be in metres, .*; did you mean 7e-07"),
        (("g", (1,), (0.01,), (7e-7, 4e-7)), "shortest and longest wavelength in metres"),
        (("g", (1,), (0.01,), (0, 4e-7)), "shortest and longest"),
        (("g", (1,), (0.01,), 4e-7), "shortest and longest"),
        (("g", (1,), (1e4,), (4e-7, 7e-7)), "index below 1 within its range"),
    ]:
        with pytest.raises(ValueError, match=message):
            Glass(*arguments)
