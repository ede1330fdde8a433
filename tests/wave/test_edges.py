"""Edges of masks: what a sample on the rim lets through, and what that is worth behind it."""

import numpy as np
import pytest
from reference_closed import circle_on_axis, fresnel_slit, gauss_legendre
from tolerance import err_db

from clplen import Grid, aperture, propagate
from clplen.wave import (
    Stop,
    annular_aperture,
    plane_wave,
    polygonal_aperture,
    rectangular_aperture,
    transparency,
)

LAM, DX = 550e-9, 6.6e-6
GRID = Grid((37, 52), (3e-6, 2e-6), origin=(1e-6, -0.7e-6))
ARROW = np.array([(-40, -31), (12.5, -43.3), (-3.3, 2.2), (39, 41), (-21, 17.1)]) * 1e-6
CUTS = {
    "circle": (aperture, (61e-6,), {"centre": (4e-6, -7e-6)}),
    "square": (aperture, (61e-6,), {"shape": "square", "centre": (4e-6, -7e-6)}),
    "rectangle": (rectangular_aperture, ((31e-6, 55e-6),), {"centre": (4e-6, 3e-6)}),
    "turned": (rectangular_aperture, ((31e-6, 55e-6),), {"rotation": -1.2}),
    "ring": (annular_aperture, (83e-6,), {"inner": 40.3e-6, "centre": (4e-6, -7e-6)}),
    "polygon": (polygonal_aperture, (ARROW,), {}),
}


def mask(device, cut, *args, grid=GRID, **more):
    """The real transmission of an aperture."""
    return cut(plane_wave(grid, wavelength=LAM, device=device), *args, **more).to_numpy().real


def winding(grid, vertices):
    """Whether the middles of samples are inside: the angle under which they see the outline."""
    seen = np.asarray(vertices)[:, None, None] - np.stack(
        np.broadcast_arrays(grid.y[:, None], grid.x), axis=-1
    )
    angle = np.arctan2(seen[..., 0], seen[..., 1])
    steps = np.diff(angle, axis=0, append=angle[:1])
    return np.abs((steps - 2 * np.pi * np.rint(steps / (2 * np.pi))).sum(axis=0)) > np.pi


def carried(values, places, samples, width=1.0):
    """Values of pixels about ``places`` at ``samples``, their spectra cut at 1/2 a sample.

    By quadrature over frequency, all lengths in samples: shape (n samples, ...).
    """
    f, weight = gauss_legendre(-0.5, 0.5, panels=4 + 2 * int(np.ptp(np.append(places, samples))))
    spectrum = np.exp(-2j * np.pi * np.outer(f, places)) @ values
    spectrum = spectrum * (weight * width * np.sinc(f * width))[:, None]
    return np.exp(2j * np.pi * np.outer(samples, f)) @ spectrum


# The middle of a sample decides


def test_a_sample_s_middle_decides(precise):
    y, x = GRID.y[:, None], GRID.x
    r = np.hypot(y - 4e-6, x + 7e-6)
    cosine, sine = np.cos(-1.2), np.sin(-1.2)
    corners = np.array([(-15.5, -27.5), (-15.5, 27.5), (15.5, 27.5), (15.5, -27.5)]) * 1e-6
    turned = corners @ [[cosine, -sine], [sine, cosine]]
    expected = {
        "circle": r < 30.5e-6,
        "square": (np.abs(y - 4e-6) < 30.5e-6) & (np.abs(x + 7e-6) < 30.5e-6),
        "rectangle": (np.abs(y - 4e-6) < 15.5e-6) & (np.abs(x - 3e-6) < 27.5e-6),
        "turned": winding(GRID, turned),
        "ring": (r < 41.5e-6) & (r > 20.15e-6),
        "polygon": winding(GRID, ARROW),
    }
    for name, (cut, args, more) in CUTS.items():
        got = mask(precise, cut, *args, edges="samples", **more)
        assert 0 < got.mean() < 1
        np.testing.assert_array_equal(got, expected[name], err_msg=name)


def test_a_middle_on_the_rim_is_inside(precise):
    grid = Grid((11, 13), (2e-6, 1e-6))
    j, i = np.arange(11)[:, None] - 5, np.arange(13) - 6
    square = (np.abs(2 * j) <= 4) & (np.abs(i) <= 4)
    corners = np.array([(-4, -4), (-4, 4), (4, 4), (4, -4)]) * 1e-6
    disc = np.hypot(2 * j, i) <= 5  # through (4, 3)
    ring = disc & (np.hypot(2 * j, i) >= 2)
    diamond = np.abs(2 * j) + np.abs(i) <= 4
    tips = np.array([(-4, 0), (0, 4), (4, 0), (0, -4)]) * 1e-6
    for expected, cut, args, more in (
        (square, aperture, (8e-6,), {"shape": "square"}),
        (square, rectangular_aperture, (8e-6,), {"rotation": np.pi / 2}),
        (square, polygonal_aperture, (corners,), {}),
        (square, polygonal_aperture, (corners[::-1],), {}),
        (disc, aperture, (10e-6,), {}),
        (disc, annular_aperture, (10e-6,), {"inner": 0}),
        (ring, annular_aperture, (10e-6,), {"inner": 4e-6}),
        (diamond, polygonal_aperture, (tips,), {}),
    ):
        got = mask(precise, cut, *args, grid=grid, edges="samples", **more)
        np.testing.assert_array_equal(got, expected)


def test_larger_than_the_window_and_beside_it(precise):
    everything = np.array([(-1, -2), (3, -1), (2, 2), (-2, 1)]) * 1e-3
    for edges in ("samples", "area", "pixels"):
        got = mask(precise, polygonal_aperture, everything, edges=edges)
        assert np.abs(got - 1).max() <= 1e-14
        assert np.abs(mask(precise, aperture, 1.0, edges=edges) - 1).max() <= 1e-14
        for away in ((1e-3, 0), (-1e-3, 0), (0, 1e-3), (0, -1e-3)):
            got = mask(precise, polygonal_aperture, ARROW + away, edges=edges)
            assert np.abs(got).max() <= 1e-14


# Square pixels


def test_pixels_have_the_spectrum_of_samples_times_sinc(device, precise):
    """Against quadrature of that spectrum; the border is clear of light."""
    small = {"circle": (aperture, (41e-6,), {}), "polygon": (polygonal_aperture, (ARROW / 2,), {})}
    for cut, args, more in [*small.values(), CUTS["rectangle"]]:
        hard = mask(precise, cut, *args, edges="samples", **more)
        assert hard.sum() == hard[1:-1, 1:-1].sum()
        rows, columns = np.arange(37), np.arange(52)
        along_y = carried(hard, rows, rows)
        expected = carried(along_y.T, columns, columns).T
        assert np.abs(expected.imag).max() <= 1e-13
        for where, tolerance in ((precise, 1e-13), (device, 4e-7)):
            got = mask(where, cut, *args, edges="pixels", **more)
            assert np.abs(got - expected.real).max() <= tolerance


def test_beyond_the_window_pixels_go_on_as_at_its_border(precise):
    random = np.random.default_rng(8)
    t = random.uniform(size=(9, 14)) + 1j * random.normal(size=(9, 14))
    light = plane_wave(Grid((9, 14), (3e-6, 2e-6)), wavelength=LAM, device=precise)
    got = transparency(light, t, edges="pixels").to_numpy()
    more = 300  # the tail beyond is 1/(pi^3 m^2) = 4e-7 of the border
    for axis, n in ((0, 9), (1, 14)):
        wide = np.pad(t, [(more, more) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        k = np.arange(-n - more, n + more + 1)
        f, weight = gauss_legendre(0, 0.5, panels=400)
        w = 2 * np.cos(2 * np.pi * np.outer(k, f)) @ (weight * np.sinc(f))
        steps = np.arange(n)[:, None] - (np.arange(n + 2 * more) - more) + n + more
        t = np.moveaxis(np.tensordot(w[steps], wide, (1, axis)), 0, axis)
    assert np.abs(got - t).max() <= 2e-6


def fields(mask_of, z, grid, device):
    light = plane_wave(grid, wavelength=LAM, device=device)
    far = propagate(mask_of(light), z, method="fresnel-ir", pad=4)
    return far.to_numpy().astype(complex)


# Pictures with a pitch


def test_pictures_of_other_pitch(device, precise):
    for shape, pitch, origin in [
        ((11, 8), (2e-6, 3e-6), (0, 0)),
        ((31, 40), (1e-6, 1.1e-6), (-1e-6, 0.5e-6)),
    ]:
        random = np.random.default_rng(6)
        t = random.uniform(size=(7, 5)) * np.exp(1j * random.uniform(-3, 3, (7, 5)))
        grid, spacing, centre = Grid(shape, pitch, origin=origin), (3e-6, 4.4e-6), (1.1e-6, -2.3e-6)
        middles = [
            (np.arange(m) - m // 2) * s + c
            for m, s, c in zip(t.shape, spacing, centre, strict=True)
        ]
        near = np.zeros(shape, complex)
        for i, j in np.ndindex(*shape):
            row = np.flatnonzero(np.abs(grid.y[i] - middles[0]) < spacing[0] / 2)
            column = np.flatnonzero(np.abs(grid.x[j] - middles[1]) < spacing[1] / 2)
            if row.size and column.size:
                near[i, j] = t[row[0], column[0]]
        in_samples = [
            (m / d, x / d, s / d)
            for m, x, s, d in zip(middles, (grid.y, grid.x), spacing, pitch, strict=True)
        ]
        band = carried(carried(t, *in_samples[0]).T, *in_samples[1]).T
        for where, tolerance in ((precise, 1e-12), (device, 1e-6)):
            light = plane_wave(grid, wavelength=LAM, device=where)
            for edges, expected in (("samples", near), ("pixels", band)):
                got = transparency(light, t, pitch=spacing, centre=centre, edges=edges).to_numpy()
                assert np.abs(got - expected).max() <= tolerance


def test_a_middle_on_the_border_of_two_pixels_takes_the_later(precise):
    light = plane_wave(Grid((1, 8), 1e-6), wavelength=LAM, device=precise)
    row = np.arange(1.0, 5.0)[None]  # pixels of 2e-6 about -4, -2, 0 and 2e-6
    got = transparency(light, row, pitch=(1, 2e-6), edges="samples").to_numpy().real
    np.testing.assert_array_equal(got[0], [1, 2, 2, 3, 3, 4, 4, 0])


# Words


def test_other_edges_are_refused(device):
    for edges in ["area-weighted", "pixel", None, 4, ""]:
        for cut, args, more in CUTS.values():
            with pytest.raises(ValueError, match="edges must be 'samples', 'area' or"):
                mask(device, cut, *args, edges=edges, **more)
        with pytest.raises(ValueError, match="edges must be 'samples', 'area' or"):
            Stop(1e-3, edges=edges)
        if edges is not None:
            with pytest.raises(ValueError, match="edges must be 'samples', 'area' or"):
                mask(device, transparency, np.ones(GRID.shape), edges=edges)


def test_a_stop_has_edges(precise):
    light = plane_wave(GRID, wavelength=LAM, device=precise)
    for edges in ("samples", "area", "pixels"):
        got = Stop(51e-6, edges=edges).apply(light).to_numpy()
        np.testing.assert_array_equal(got, aperture(light, 51e-6, edges=edges).to_numpy())
    assert Stop(51e-6).describe() == "circular, D = 51 um"
    assert Stop(51e-6, edges="pixels").describe() == "circular, D = 51 um, edges by pixels"


def test_an_axis_of_length_one_has_no_edge(precise):
    tall, wide = Grid((45, 1), (2e-6, 1e-3), origin=(0, 1.0)), Grid((1, 45), (1e-3, 2e-6))
    x = wide.x
    for grid in (tall, wide):
        for cut, args, more, expected in (
            (aperture, (31e-6,), {}, np.abs(x) < 15.5e-6),
            (rectangular_aperture, (31e-6,), {}, np.abs(x) < 15.5e-6),
            (annular_aperture, (31e-6,), {"inner": 11e-6}, np.abs(np.abs(x) - 10.5e-6) < 5e-6),
            (annular_aperture, (31e-6,), {"inner": 0}, np.abs(x) < 15.5e-6),
        ):
            got = mask(precise, cut, *args, grid=grid, edges="samples", **more)
            np.testing.assert_array_equal(got.ravel(), expected)
            got = mask(precise, cut, *args, grid=grid, edges="pixels", **more)
            t = carried(expected[:, None].astype(float), np.arange(45), np.arange(45))[:, 0]
            assert np.abs(got.ravel() - t.real).max() <= 1e-13
    point = Grid((1, 1), 1e-6)
    for edges in ("samples", "pixels"):
        assert mask(precise, annular_aperture, 3e-5, inner=1e-5, grid=point, edges=edges) == 1


@pytest.mark.parametrize(
    ("width", "centre", "expected"),
    [
        # in dB: samples, area, pixels, finer pixels
        (255, 0, (61.9, 61.9, 138.9, 76.6)),
        (187.37, 11.3, (35.7, 58.2, 35.7, 78.8)),
    ],
)
def test_slits_against_fresnel_integrals(device, width, centre, expected):
    grid = Grid((1, 512), DX)
    z = 5 * 512 * DX**2 / LAM
    exact = fresnel_slit(grid.x - centre * DX, z, width=width * DX, wavelength=LAM)[None]
    size, middle = width * DX, (0, centre * DX)
    finer = plane_wave(Grid((1, 2048), DX / 4), wavelength=LAM, device=device)
    drawn = rectangular_aperture(finer, size, centre=middle).to_numpy().real
    ways = [
        lambda light, edges=edges: rectangular_aperture(light, size, centre=middle, edges=edges)
        for edges in ("samples", "area", "pixels")
    ]
    ways.append(lambda light: transparency(light, drawn, pitch=DX / 4, edges="pixels"))
    for way, decibel in zip(ways, expected, strict=True):
        got = err_db(exact.astype(complex), fields(way, z, grid, device))
        assert got > 130 if decibel > 130 else abs(got - decibel) < 0.5


def test_a_circle_on_its_axis(device):
    """Drawn four times finer and taken as pixels, 70 dB at 5 z_c where area-weighting has 51."""
    grid, z, diameter = Grid((512, 512), DX), 5 * 512 * DX**2 / LAM, 200.4 * DX
    exact = circle_on_axis(z, radius=diameter / 2, wavelength=LAM)
    light = plane_wave(grid, wavelength=LAM, device=device)
    finer = plane_wave(Grid((1024, 1024), DX / 4), wavelength=LAM, device=device)
    drawn = aperture(finer, diameter).to_numpy().real
    for cut, limit in (
        (aperture(light, diameter), 50),
        (transparency(light, drawn, pitch=DX / 4, edges="pixels"), 69),
    ):
        error = abs(propagate(cut, z).to_numpy()[256, 256] - exact)
        assert limit < -20 * np.log10(error) < limit + 3


def check_a_mask_of_pixels_against_the_fresnel_integrals_of_all(device, n, pitch, wavelengths):
    grid = Grid(n, pitch)
    t = np.zeros(n)
    t[n[0] // 4 : n[0] // 2 + 7, n[1] // 3 : n[1] // 2 + 9] = 1
    t *= np.random.default_rng(9).random(n)
    z = wavelengths * max(m * d**2 for m, d in zip(n, pitch, strict=True)) / LAM * 1.7
    one = [
        fresnel_slit(x[:, None] - x, z, width=d, wavelength=LAM)
        for x, d in zip((grid.y, grid.x), pitch, strict=True)
    ]
    exact = one[0] @ t @ one[1].T
    points = err_db(exact, fields(lambda light: transparency(light, t), z, grid, device))
    squares = fields(lambda light: transparency(light, t, edges="pixels"), z, grid, device)
    assert points < 60
    assert err_db(exact, squares) > 100


def test_a_mask_of_pixels_against_the_fresnel_integrals_of_all(device):
    """Far behind random pixels, odd, prime and rectangular: below 60 dB become more than 100.

    What is left are the rings that the window cuts off, 1/(pi^3 m^2), m samples from the mask.
    """
    for n, pitch, wavelengths in [((96, 90), (5e-6, 7e-6), 4), ((61, 97), (3e-6, 2e-6), 6)]:
        check_a_mask_of_pixels_against_the_fresnel_integrals_of_all(device, n, pitch, wavelengths)
