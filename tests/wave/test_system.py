"""Optical systems: the same as the calls by hand, positions, printing, images of points."""

from __future__ import annotations

import warnings
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from reference_closed import airy
from scipy.special import sici
from tolerance import err_db

from clplen import (
    Field,
    Grid,
    MicrolensArray,
    Propagator,
    SamplingError,
    SamplingWarning,
    aperture,
    propagate,
    thin_lens,
)
from clplen.wave.systems.components import ConvergingLight, Element, Lens, Stop
from clplen.wave.systems.optical_system import OpticalSystem, imaging_system
from clplen.wave.systems.space import Space

LAM = 550e-9
GRID = Grid((53, 46), (4e-6, 5e-6), origin=(2e-6, -3e-6))
ARRAY = MicrolensArray(60e-6, 4e-3, count=3, fill="full")


def noise(device, grid=GRID, batch=()):
    rng = np.random.default_rng(7)
    u = rng.normal(size=(*batch, *grid.shape)) + 1j * rng.normal(size=(*batch, *grid.shape))
    return Field.from_array(u, grid, wavelength=LAM, device=device)


def conjugate(field):
    return Field.from_array(
        field.to_numpy().conj(), field.grid, wavelength=field.wavelength, device=field.device
    )


def test_a_system_is_its_calls_by_hand(device):
    for batch in [(), (2, 3)]:
        field = noise(device, batch=batch)
        stop = {"shape": "square", "centre": (20e-6, -10e-6)}
        system = OpticalSystem([
            1e-3, Stop(90e-6, **stop), Lens(9e-3, diameter=150e-6, form="stigmatic"), conjugate,
            Space(2e-3, method="blas", pad=1), ARRAY, Lens(-0.02), -3e-3,
        ])  # fmt: skip
        by_hand = aperture(propagate(field, 1e-3), 90e-6, **stop)
        by_hand = conjugate(thin_lens(by_hand, 9e-3, diameter=150e-6, form="stigmatic"))
        by_hand = ARRAY.apply(propagate(by_hand, 2e-3, method="blas", pad=1))
        by_hand = propagate(thin_lens(by_hand, -0.02), -3e-3)
        out = system(field)
        assert out.grid == GRID
        np.testing.assert_array_equal(out.to_numpy(), by_hand.to_numpy())


def test_the_trace_passes_every_plane(device):
    lens = Lens(0.01)
    system = OpticalSystem([1e-3, lens, conjugate, 2e-3, Element(conjugate, "block", length=1e-3)])
    field = noise(device)
    z, parts, fields = zip(*system.trace(field), strict=True)
    assert z == pytest.approx((1e-3, 1e-3, 1e-3, 3e-3, 4e-3))
    assert parts == system.parts
    assert (system.length, system.positions) == (
        pytest.approx(4e-3), pytest.approx((0, 1e-3, 1e-3, 1e-3, 3e-3))
    )  # fmt: skip
    behind_lens = thin_lens(propagate(field, 1e-3), 0.01)
    np.testing.assert_array_equal(fields[1].to_numpy(), behind_lens.to_numpy())
    np.testing.assert_array_equal(fields[-1].to_numpy(), system(field).to_numpy())


def test_systems_are_sequences():
    lens, stop = Lens(0.1), Stop(1e-3)
    system = OpticalSystem([0.1, lens, 0.2])
    assert (len(system), system[1], list(system)) == (3, lens, [Space(0.1), lens, Space(0.2)])
    assert system[1:] == OpticalSystem([lens, 0.2])
    assert system[::-1].positions == pytest.approx((0, 0.2, 0.2))
    assert system + stop == OpticalSystem([0.1, lens, 0.2, stop])
    assert system + system == OpticalSystem([system, 0.1, lens, 0.2]) != system
    assert len({system, OpticalSystem([0.1, lens, np.float64(0.2)])}) == 1
    with pytest.raises(FrozenInstanceError):
        system.parts = ()


def test_what_is_printed():
    grid = Grid((30, 41), (2e-6, 3e-6))
    system = OpticalSystem([
        ConvergingLight(0.24),
        Space(0.24, method="blas", out_grid=grid),
        Lens(-0.12, diameter=3.6e-3),
        Stop(2e-3, shape="square", centre=(0, 1e-4)),
        Space(5e-5, pad=1),
        ARRAY,
        Element(conjugate, "mirror"),
        conjugate,
    ])  # fmt: skip
    assert str(system).splitlines() == [
        "optical system of 8 parts, 240.05 mm long",
        "   no  part                     z",
        "    1  converging light         0 m   focus 240 mm on",
        "    2  space                    0 m   240 mm, method blas, pad 2, to 30 x 41 samples of "
        "2 um x 3 um",
        "    3  lens                   240 mm  f = -120 mm, D = 3.6 mm, paraxial",
        "    4  stop                   240 mm  square, D = 2 mm, centre (y, x) = (0 m, 100 um)",
        "    5  space                  240 mm  50 um, method auto",
        "    6  lenslets            240.05 mm  3 x 3, pitch 60 um, f = 4 mm, square, full",
        "    7  mirror              240.05 mm",
        "    8  conjugate           240.05 mm",
    ]


def test_a_propagator_keeps_its_distance(device):
    plan = Propagator(GRID, 2e-3, wavelength=LAM, method="as", device=device)
    system = OpticalSystem([plan, Lens(0.1)])
    assert system.length == 2e-3
    assert system[0].label == "propagator (as)"
    expected = thin_lens(plan(noise(device)), 0.1)
    np.testing.assert_array_equal(system(noise(device)).to_numpy(), expected.to_numpy())


def test_a_part_of_another_kind_needs_apply_only(device):
    class Mask:
        def apply(self, field):
            return conjugate(field)

        def __repr__(self):
            return "a mask"

    system = OpticalSystem([Mask()])
    assert str(system).endswith("Mask         0 m   a mask")
    expected = noise(device).to_numpy().conj()
    np.testing.assert_array_equal(system(noise(device)).to_numpy(), expected)


def test_bad_systems():
    for make, error, message in [
        (lambda: OpticalSystem([]), ValueError, "at least one part"),
        (lambda: OpticalSystem([0.1])[1:], ValueError, "at least one part"),
        (lambda: OpticalSystem([0.1, float("nan")]), ValueError, "Part 2 .* finite distance"),
        (lambda: OpticalSystem([0.1, Lens(1), np.inf]), ValueError, "Part 3 .* finite distance"),
        (lambda: OpticalSystem([0.1, None]), TypeError, "Part 2 of the system .* got None"),
        (lambda: OpticalSystem([Lens]), TypeError, "Part 1 .* must be a distance"),
        (lambda: OpticalSystem([True]), TypeError, "Part 1 .* must be a distance"),
        (lambda: OpticalSystem([0.1]) + "lens", TypeError, "Part 2 of the system .* got 'lens'"),
        (lambda: OpticalSystem(Lens(0.1)), TypeError, "must be a sequence of parts"),
        (lambda: Space(np.nan), ValueError, "finite number"),
        (lambda: Space((0.1, 0.2)), ValueError, "finite number"),
        (lambda: Lens(0), ValueError, "focal_length must not be 0"),
        (lambda: Lens(0.1, diameter=-1), ValueError, "diameter of a lens must be positive"),
        (lambda: Lens(0.1, form="thick"), ValueError, "'paraxial' or 'stigmatic'"),
        (lambda: Stop(0), ValueError, "diameter of a stop must be positive"),
        (lambda: Stop(1e-3, shape="round"), ValueError, "'circular' or 'square'"),
        (lambda: Stop(1e-3, centre=0), ValueError, r"centre of a stop must be \(y, x\)"),
        (lambda: ConvergingLight(-1), ValueError, "distance of the focus must be positive"),
        (lambda: imaging_system(-0.1, diameter=1), ValueError, "focal length .* positive"),
        (
            lambda: imaging_system(0.1, diameter=0),
            ValueError,
            "diameter of its lens must be positive",
        ),
        (
            lambda: imaging_system(0.1, diameter=1, magnification=0),
            ValueError,
            "magnification must be positive",
        ),
    ]:
        with pytest.raises(error, match=message):
            make()


def test_bad_calls(device):
    with pytest.raises(TypeError, match="must be a Field, got ndarray"):
        OpticalSystem([0.1])(np.ones((3, 3)))
    with pytest.raises(TypeError, match="element 'shape' must return a Field, got tuple"):
        OpticalSystem([Element(lambda field: field.shape, "shape")])(noise(device))


def test_aliasing_is_passed_on(device):
    for aliasing in ["raise", "warn", "allow"]:
        system = OpticalSystem([Lens(1e-4, aliasing=aliasing)])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if aliasing == "allow":
                system(noise(device))
                continue
            with pytest.raises(SamplingError if aliasing == "raise" else SamplingWarning):
                system(noise(device))


def test_distances_of_an_imaging_system():
    system = imaging_system(
        0.03, diameter=2e-3, magnification=0.5, method="as", pad=1, koehler=True
    )
    near, far = Space(0.09, method="as", pad=1), Space(0.045, method="as", pad=1)
    assert system == OpticalSystem([ConvergingLight(0.09), near, Lens(0.03, diameter=2e-3), far])
    assert imaging_system(0.12, diameter=1).positions == pytest.approx((0, 0.24, 0.24))


def test_a_point_beside_the_axis_is_imaged_upside_down(device, precise):
    for magnification in [1.0, 0.5]:
        f, diameter, grid = 0.02, 0.5e-3, Grid((181, 144), (4e-6, 5e-6))
        u = np.zeros(grid.shape)
        u[90 + 17, 72 - 22] = 1 / (4e-6 * 5e-6)
        point = (17 * 4e-6, -22 * 5e-6)
        z1, z2 = f * (1 + 1 / magnification), f * (1 + magnification)
        y, x = grid.y[:, None], grid.x[None, :]
        r = np.hypot(y + magnification * point[0], x + magnification * point[1])
        chirp = np.exp(1j * np.pi / LAM * ((y**2 + x**2) / z2 + np.hypot(*point) ** 2 / z1))
        area = np.pi * diameter**2 / 4
        # Goodman (2005), section 5.3, for a circular pupil and a unit point beside the axis.
        image = (
            area / (1j * LAM * z1 * 1j * LAM * z2) * chirp * airy(np.pi * diameter * r / LAM / z2)
        )
        system = imaging_system(f, diameter=diameter, magnification=magnification)
        for dev in (device, precise):
            got = system(Field.from_array(u, grid, wavelength=LAM, device=dev)).to_numpy()
            # 58 and 55 dB: a paraxial lens aberrates; an
            # image that is one sample off has less than 25 dB.
            assert err_db(image, got) >= 50


def test_converging_light_shows_an_object_wider_than_the_lens(device):
    n, dx, f, diameter, half = 1010, 6.6e-6, 0.12, 3.6e-3, 2.4e-3
    grid = Grid((1, n), (1e-6, dx))
    edges = [sici(np.pi * diameter * (grid.x + s * half) / (LAM * 2 * f))[0] for s in (1, -1)]
    theory = np.abs(edges[0] - edges[1]) / np.pi
    slit = Field.from_array(np.abs(grid.x)[None] < half, grid, wavelength=LAM, device=device)
    seen = np.abs(grid.x) < 2.7e-3

    def deviation(koehler):
        system = imaging_system(f, diameter=diameter, koehler=koehler)
        return np.sqrt(np.mean((np.abs(system(slit).to_numpy()[0]) - theory)[seen] ** 2))

    assert deviation(True) <= 4e-3  # measured 2.8e-3
    assert deviation(False) >= 0.3  # dark beyond half the diameter


def quiet(grid, part, device):
    u = np.ones(grid.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        OpticalSystem([part])(Field.from_array(u, grid, wavelength=LAM, device=device))


def test_a_window_that_cuts_an_opening_warns(device):
    for grid, part, needed in [
        (Grid((40, 30), 1e-5), Lens(1, diameter=3.3e-4), "along x .* lens .* 33 samples of 10 um"),
        (Grid((30, 40), 1e-5), Lens(1, diameter=3.3e-4), "along y .* lens"),
        (Grid((1, 30), 1e-5), Lens(1, diameter=3.3e-4), "along x"),
        (Grid((40, 40), 1e-5, origin=(8e-5, 0)), Lens(1, diameter=3.3e-4), "along y .* 49 samples"),
        (Grid((40, 40), 1e-5, origin=(0, -8e-5)), Lens(1, diameter=3.3e-4), "along x"),
        (Grid((40, 40), 1e-5), Stop(1e-4, centre=(0, 1.8e-4)), "along x .* stop .* 46 samples"),
    ]:
        with pytest.warns(SamplingWarning, match=needed):
            OpticalSystem([part])(
                Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
            )


def test_a_window_as_wide_as_the_lens_is_enough(device):
    for n in [33, 34]:
        quiet(Grid((n, n), 1e-5), Lens(1, diameter=n * 1e-5), device)
        quiet(Grid((n, n), 1e-5, origin=(1, 1)), Lens(1, aliasing="allow"), device)
        quiet(Grid((n, n), 1e-5, origin=(1, 1)), Stop(1e-4, centre=(1, 1)), device)
