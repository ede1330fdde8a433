"""Gradients of elements, against central differences of their own transmission in float64."""

import numpy as np
import pytest

from clplen import DeviceError, Field, Grid, MicrolensArray, ShapeError, thin_lens
from clplen.wave import (
    LensletErrors,
    LensletSurface,
    PhasePlate,
    ZernikePlate,
    gaussian_beam,
    gaussian_beam_gradient,
    polar_gradient,
    spherical_wave,
    spherical_wave_gradient,
    thin_lens_gradient,
    tilt,
    tilt_gradient,
)

LAM, DX = 532e-9, 5e-6
P = 9.37 * DX
GRID = Grid((47, 53), (0.9 * DX, DX), origin=(DX / 3, -0.2 * DX))
DOUBLE, SINGLE = 1e-6, 2e-4


def waves(seed, *shape):
    random = np.random.default_rng(seed)
    return random.normal(size=shape) + 1j * random.normal(size=shape) + (0.4 - 0.3j)


U, G = waves(1, 2, *GRID.shape), waves(2, 2, *GRID.shape)
MEAN = (G.conj() * U).sum(axis=0)  # a transmission t has the loss Re sum MEAN t


def field(values, device, grid=GRID):
    return Field.from_array(values, grid, wavelength=LAM, device=device)


def slope(loss, step):
    """dL/ds at 0, by central differences and Richardson's extrapolation."""
    wide, narrow = ((loss(h) - loss(-h)) / (2 * h) for h in (step, step / 2))
    return (4 * narrow - wide) / 3


def agree(expected, in_double, in_single, scale=None):
    """Within the tolerances, relative to the value or to the largest of its kind."""
    scale = abs(expected) if scale is None else scale
    assert scale > 0
    assert abs(in_double - expected) <= DOUBLE * scale
    assert abs(in_single - expected) <= SINGLE * scale


# Lenslets ---------------------------------------------------------------------------------------

ARRAYS = {
    "square": {"focal_length": (2.5e-3, 3.1e-3), "count": (4, 5), "diameter": 0.93 * P},
    "cells": {"focal_length": 2.5e-3, "count": (4, 3), "fill": "full", "diameter": 0.9 * P},
    "touching": {"focal_length": 2.5e-3, "count": (4, 3), "fill": "full"},
    "hexagonal": {
        "focal_length": (2.5e-3, 3.5e-3, -2.8e-3),
        "count": (3, 4),
        "lattice": "hexagonal",
        "rotation": -0.3,
    },
    "hexagons": {
        "focal_length": 2.5e-3,
        "count": (9, 9),  # more than the window holds
        "lattice": "hexagonal",
        "fill": "full",
        "diameter": 0.9 * P,
        "rotation": -0.3,
    },
}


def array(**values):
    usual = {"pitch": P, "offset": (2.1e-6, -6.3e-6), "rotation": 0.12}
    return usual | values


def array_slope(values, change, step, device):
    """Of the loss, where ``change(values, s)`` are the array's arguments."""

    def loss(s):
        mla = MicrolensArray(**change(values, s))
        return (MEAN * device.download(mla.transmission(GRID, LAM, device))).sum().real

    return slope(loss, step)


def changes(values):
    """name, index, what changes it, step."""
    yield "rotation", (), lambda v, s: v | {"rotation": v["rotation"] + s}, 1e-8
    for axis in (0, 1):
        yield (
            "offset",
            axis,
            lambda v, s, axis=axis: (
                v | {"offset": tuple(np.array(v["offset"]) + s * (np.arange(2) == axis))}
            ),
            1e-12,
        )
    lengths = np.atleast_1d(values["focal_length"])
    for k in range(len(lengths)):
        yield (
            "focal_lengths",
            k,
            lambda v, s, k=k: (
                v | {"focal_length": tuple(lengths + s * (np.arange(len(lengths)) == k))}
            ),
            1e-8,
        )
    yield "focal_length", (), lambda v, s: v | {"focal_length": tuple(lengths + s)}, 1e-8


@pytest.mark.parametrize("kind", ARRAYS)
def test_arrays_of_lenslets(device, precise, kind):
    values = array(**ARRAYS[kind])
    mla = MicrolensArray(**values)
    double, single = (mla.gradient(field(U, d), field(G, d)) for d in (precise, device))
    for name, index, change, step in changes(values):
        expected = array_slope(values, change, step, precise)
        agree(expected, *(np.asarray(found[name])[index] for found in (double, single)))
    if "diameter" in values:
        for name in ("pitch", "diameter"):
            expected = array_slope(
                values, lambda v, s, name=name: v | {name: v[name] + s}, 1e-12, precise
            )
            agree(expected, double[name], single[name])
    else:  # which follows the pitch
        expected = array_slope(values, lambda v, s: v | {"pitch": v["pitch"] + s}, 1e-12, precise)
        agree(expected, *(found["pitch"] + found["diameter"] for found in (double, single)))
    assert np.allclose(double["centres"].sum((0, 1)), double["offset"], rtol=1e-12)
    assert double["lenslet_focal_lengths"].shape == mla.count
    assert double["lenslet_focal_lengths"].sum() == pytest.approx(double["focal_length"])


def check_lattices_on_the_samples(device, precise, lattice, fill, count):
    grid = Grid((47, 53), DX)
    values = {"pitch": 10 * DX, "focal_length": 3e-3, "count": count, "fill": fill}
    values |= {"lattice": lattice, "offset": (0.0, 0.0), "rotation": 0.0}
    double, single = (
        MicrolensArray(**values).gradient(field(U, d, grid), field(G, d, grid))
        for d in (precise, device)
    )

    def loss(**changed):
        t = MicrolensArray(**values | changed).transmission(grid, LAM, precise)
        return (MEAN * precise.download(t)).sum().real

    for axis in (0, 1):
        expected = slope(lambda s, axis=axis: loss(offset=axis_of((0, 0), axis, s)), 1e-12)
        agree(expected, double["offset"][axis], single["offset"][axis])
    expected = slope(lambda s: loss(pitch=values["pitch"] + s), 1e-12)
    agree(expected, *(found["pitch"] + found["diameter"] for found in (double, single)))
    agree(slope(lambda s: loss(rotation=s), 1e-8), double["rotation"], single["rotation"])


def test_lattices_on_the_samples(device, precise):
    """Derivatives are means of those one way and the other.

    Samples between two lenslets have the phase of the one or of the other when an array moves, and
    cells on the diagonal of a disc strips along x or along y.
    """
    for lattice, fill, count in [
        ("square", "full", (2, 4)),
        ("hexagonal", "full", (2, 4)),
        ("square", "circular", (3, 3)),
    ]:
        check_lattices_on_the_samples(device, precise, lattice, fill, count)


def test_lenslets_that_are_not_thin_have_no_gradient(device):
    mla = MicrolensArray(P, surface=LensletSurface(2e-3, 1.5), count=3)
    with pytest.raises(ValueError, match="thin lenslets"):
        mla.gradient(field(U, device), field(G, device))


def check_errors_of_lenslets(device, precise, terms, lattice, f):
    mla = MicrolensArray(P, f, count=(4, 3), lattice=lattice, offset=(2e-6, -6e-6), rotation=0.3)
    y, x = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    away = np.min([np.hypot(y - a, x - b) for a, b in mla.centres().reshape(-1, 2)], axis=0)
    u = np.where(away < 0.8 * P, U, 0)  # beyond the array the polynomials grow
    random = np.random.default_rng(3)
    values = {
        "terms": terms,
        "circle": 1.2 * P,
        "focal_lengths": np.array(f)[mla.types()] * random.uniform(0.8, 1.2, mla.count),
        "tilt": random.uniform(-2e-3, 2e-3, (*mla.count, 2)),
        "position": random.uniform(-4e-6, 4e-6, (*mla.count, 2)),
    }

    def loss(name, value):
        phase = LensletErrors(**values | {name: value}).phase(mla, GRID, LAM, precise)
        return (G.conj() * u * precise.download(phase)).sum().real

    errors = LensletErrors(**values)
    double, single = (errors.gradient(mla, field(u, d), field(G, d)) for d in (precise, device))
    for orders in terms:
        expected = slope(
            lambda s, orders=orders: loss("terms", terms | {orders: terms[orders] + s}), 1e-10
        )
        agree(expected, double["terms"][orders], single["terms"][orders])
    for name, step in (("focal_lengths", 1e-7), ("tilt", 1e-6), ("position", 1e-9)):
        scale = np.abs(double[name]).max()
        for index in list(np.ndindex(values[name].shape))[::7]:
            unit = np.zeros(values[name].shape)
            unit[index] = 1

            def moved(s, name=name, unit=unit):
                return loss(name, values[name] + s * unit)

            agree(slope(moved, step), double[name][index], single[name][index], scale)


def test_errors_of_lenslets(device, precise):
    for terms in [{(2, -2): 0.3 * LAM, (5, 1): -0.2 * LAM}, {}]:
        for lattice, f in [("square", (2.5e-3, 3e-3)), ("hexagonal", (2.5e-3, 3.5e-3, 2.8e-3))]:
            check_errors_of_lenslets(device, precise, terms, lattice, f)


# Lenses, tilts and sources ----------------------------------------------------------------------


def check_thin_lenses(device, precise, diameter, form, f):
    shape = {"diameter": diameter, "form": form}

    def loss(s):
        behind = thin_lens(field(U, precise), f + s, **shape, aliasing="allow").to_numpy()
        return (G.conj() * behind).sum().real

    found = [
        thin_lens_gradient(field(U, d), field(G, d), f, **shape)["focal_length"]
        for d in (precise, device)
    ]
    agree(slope(loss, 1e-4 * f), *found)


def test_thin_lenses(device, precise):
    for diameter in [None, 0.17e-3]:
        for form, f in [("paraxial", 0.011), ("stigmatic", -0.0013)]:
            check_thin_lenses(device, precise, diameter, form, f)


def test_a_lens_of_infinite_focal_length(device):
    for form in ("paraxial", "stigmatic"):
        found = thin_lens_gradient(field(U, device), field(G, device), np.inf, form=form)
        assert found == {"focal_length": 0.0}


def axis_of(values, axis, s):
    return tuple(np.array(values) + s * (np.arange(2) == axis))


def test_tilts(device, precise):
    direction = (0.011, -0.023)
    found = [tilt_gradient(field(U, d), field(G, d), direction)["direction"]
             for d in (precise, device)]  # fmt: skip
    for axis in (0, 1):

        def loss(s, axis=axis):
            behind = tilt(field(U, precise), axis_of(direction, axis, s)).to_numpy()
            return (G.conj() * behind).sum().real

        agree(slope(loss, 1e-6), *(one[axis] for one in found))


def check_spherical_waves(device, precise, shape, z):
    grid = Grid(shape, GRID.pitch, origin=GRID.origin)
    g, source = waves(3, *shape), (2.3e-5, -3.1e-5)

    def loss(z, source):
        wave = spherical_wave(grid, z, wavelength=LAM, device=precise, source=source)
        return (g.conj() * wave.to_numpy()).sum().real

    double, single = (
        spherical_wave_gradient(field(g, d, grid), z, source=source) for d in (precise, device)
    )
    agree(slope(lambda s: loss(z + s, source), 1e-7), double["z"], single["z"])
    agree(loss(z, source), double["amplitude"], single["amplitude"])
    for axis in (0, 1):
        expected = slope(lambda s, axis=axis: loss(z, axis_of(source, axis, s)), 1e-8)
        if shape[axis] == 1:
            assert expected == double["source"][axis] == single["source"][axis] == 0
        else:
            agree(expected, double["source"][axis], single["source"][axis])


def test_spherical_waves(device, precise):
    for shape in [GRID.shape, (1, 53)]:
        for z in [0.013, -0.013]:
            check_spherical_waves(device, precise, shape, z)


def check_gaussian_beams(device, precise, shape):
    grid = Grid(shape, GRID.pitch, origin=GRID.origin)
    g = waves(4, *shape)
    values = {"waist": 4.1e-5, "z": 0.0043, "centre": (1.1e-5, -2e-5), "direction": (0.006, 0.004)}

    def loss(**changed):
        waist, *rest = (values | changed).items()
        beam = gaussian_beam(grid, waist[1], wavelength=LAM, device=precise, **dict(rest))
        return (g.conj() * beam.to_numpy()).sum().real

    waist, *rest = values.items()
    double, single = (
        gaussian_beam_gradient(field(g, d, grid), waist[1], **dict(rest)) for d in (precise, device)
    )
    agree(loss(), double["amplitude"], single["amplitude"])
    for name, step in (("waist", 1e-8), ("z", 1e-6)):
        expected = slope(lambda s, name=name: loss(**{name: values[name] + s}), step)
        agree(expected, double[name], single[name])
    for name, step in (("centre", 1e-8), ("direction", 1e-6)):
        for axis in (0, 1):
            if shape[axis] == 1:
                assert double[name][axis] == single[name][axis] == 0
                continue
            expected = slope(
                lambda s, name=name, axis=axis: loss(**{name: axis_of(values[name], axis, s)}), step
            )
            agree(expected, double[name][axis], single[name][axis])


def test_gaussian_beams(device, precise):
    for shape in [GRID.shape, (47, 1)]:
        check_gaussian_beams(device, precise, shape)


# Plates and fields ------------------------------------------------------------------------------


def check_plates_of_pixels(device, precise, pixels, place, amplitude):
    random = np.random.default_rng(5)
    phase = random.uniform(-3, 3, pixels)
    given = {
        "none": None,
        "real": random.uniform(0.2, 1, pixels),
        "complex": waves(6, *pixels),
    }[amplitude]
    plate = PhasePlate(phase, amplitude=given, **place)
    double, single = (plate.gradient(field(U, d), field(G, d)) for d in (precise, device))
    along = random.normal(size=pixels)

    def loss(phase, amplitude):
        behind = PhasePlate(phase, amplitude=amplitude, **place).apply(field(U, precise))
        return (G.conj() * behind.to_numpy()).sum().real

    def along_found(found, direction):
        return (np.conj(found) * direction).sum().real

    expected = slope(lambda s: loss(phase + s * along, given), 1e-3)
    agree(expected, *(along_found(one["phase"], along) for one in (double, single)))
    start = 1.0 if given is None else given
    for unit in (1, 1j) if amplitude == "complex" else (1,):
        expected = slope(lambda s, unit=unit: loss(phase, start + s * unit * along), 1e-3)
        agree(expected, *(along_found(one["amplitude"], unit * along) for one in (double, single)))
    assert double["phase"].shape == double["amplitude"].shape == pixels
    assert np.iscomplexobj(double["amplitude"]) == (amplitude == "complex")


def test_plates_of_pixels(device, precise):
    for pixels, place in [
        (GRID.shape, {}),
        (GRID.shape, {"edges": "pixels"}),
        ((11, 8), {"pitch": (2.3 * DX, 3.1 * DX), "centre": (1e-6, -7e-6)}),
        ((11, 8), {"pitch": 2.3 * DX, "edges": "pixels"}),
        ((11, 8), {"pitch": 2.3 * DX, "edges": "samples"}),
    ]:
        for amplitude in ["none", "real", "complex"]:
            check_plates_of_pixels(device, precise, pixels, place, amplitude)


def test_adjoints_of_plates(precise):
    for plate in [
        PhasePlate(waves(7, 11, 8).real, amplitude=waves(8, 11, 8), pitch=2.3 * DX),
        PhasePlate(amplitude=waves(8, *GRID.shape)),
        ZernikePlate({4: 5e-8, 7: -3e-8}, diameter=0.2e-3),
    ]:
        before, behind = (plate.apply(field(U, precise)), plate.adjoint(field(G, precise)))
        one, other = (G.conj() * before.to_numpy()).sum(), (behind.to_numpy().conj() * U).sum()
        assert abs(one - other) <= 1e-12 * abs(one)


def check_plates_of_zernike_polynomials(device, precise, indexing):
    terms = {4: 6e-8, 7: -4e-8, 12: 3e-8}
    shape = {"diameter": 0.19e-3, "indexing": indexing, "centre": (4e-6, -9e-6)}
    double, single = (
        ZernikePlate(terms, **shape).gradient(field(U, d), field(G, d))["coefficients"]
        for d in (precise, device)
    )
    for j in terms:

        def loss(s, j=j):
            plate = ZernikePlate(terms | {j: terms[j] + s}, **shape)
            return (G.conj() * plate.apply(field(U, precise)).to_numpy()).sum().real

        agree(slope(loss, 1e-9), double[j], single[j])


def test_plates_of_zernike_polynomials(device, precise):
    for indexing in ["noll", "osa"]:
        check_plates_of_zernike_polynomials(device, precise, indexing)


def test_what_plates_say():
    assert PhasePlate(np.zeros((3, 4))).describe() == "3 x 4 pixels"
    assert PhasePlate(np.zeros((3, 4)), pitch=1e-5).describe() == "3 x 4 pixels of 10 um x 10 um"
    assert ZernikePlate({4: 5e-8}, diameter=2e-3).describe() == "Z4 50 nm, D = 2 mm"
    with pytest.raises(ValueError, match="requires an amplitude, a phase or both"):
        PhasePlate()
    with pytest.raises(ShapeError, match="phase must have the shape of amplitude"):
        PhasePlate(np.zeros((3, 4)), amplitude=np.zeros((4, 3)))
    with pytest.raises(TypeError, match="coefficients must be"):
        ZernikePlate([1e-8], diameter=1e-3)


def test_amplitude_and_phase_of_a_field(device, precise):
    double, single = (polar_gradient(field(U, d), field(G, d)) for d in (precise, device))
    amplitude, phase = np.abs(U), np.angle(U)
    along = np.random.default_rng(9).normal(size=U.shape)

    def loss(a, p):
        return (G.conj() * a * np.exp(1j * p)).sum().real

    for name, changed in (
        ("amplitude", lambda s: loss(amplitude + s * along, phase)),
        ("phase", lambda s: loss(amplitude, phase + s * along)),
    ):
        found = ((one[name] * along).sum() for one in (double, single))
        agree(slope(changed, 1e-3), *found)


def test_where_a_field_is_dark_its_phase_is_zero(device):
    grid = Grid((1, 2), DX)
    found = polar_gradient(field([[0, 2j]], device, grid), field([[3 + 4j, 3 + 4j]], device, grid))
    assert found["amplitude"].tolist() == [[3, 4]]
    assert found["phase"].tolist() == [[0, -6]]


# What is refused --------------------------------------------------------------------------------


def test_cotangents_that_do_not_fit(device, precise):
    mla = MicrolensArray(P, 2.5e-3, count=3)
    with pytest.raises(ShapeError, match="cotangent"):
        mla.gradient(field(U, device), field(G[0], device))
    with pytest.raises(TypeError, match="cotangent must be a Field"):
        mla.gradient(field(U, device), G)
    with pytest.raises(DeviceError, match="two devices"):
        polar_gradient(field(U, device), field(G, precise))
    with pytest.raises(ShapeError, match="cotangent"):
        gaussian_beam_gradient(field(G, device), 1e-4)
