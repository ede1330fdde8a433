"""Adjoints of propagations and systems, and gradients through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import clplen
from clplen.errors import SamplingError, ShapeError
from clplen.wave import ConvergingLight, Element, Lens, Pupil, Space, Stop, intensity_gradient
from clplen.wave.field.adjoints import inner_product
from clplen.wave.propagation.transfer_function import Transfer

# Adjoints are those of a sum whether it is sampled well or not.
pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")

LAM = 500e-9
BOUND = {"single": 1e-5, "double": 1e-12}
METHODS = (
    "auto", "as", "blas", "cblas", "rs", "one-step", "fresnel-tf", "fresnel-ir", "fresnel-1fft",
    "fresnel-multistep",
)  # fmt: skip
FREE = ("auto", "cblas", "rs", "one-step", "fresnel-1fft")
SLOPED = ("auto", "as", "blas", "cblas", "rs", "one-step", "fresnel-tf")


@pytest.fixture
def wave(device, request):
    """The device in single or in double precision (indirect parameter)."""
    return request.getfixturevalue("precise") if request.param == "double" else device


def waves(seed, *shape):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def smooth(grid, seed):
    """Light whose band no window cuts: a random sum of Gaussian beams."""
    rng = np.random.default_rng(seed)
    (hy, hx), total = (e / 2 for e in grid.extent), 0
    for _ in range(4):
        cy, cx, ay, ax = rng.uniform(-0.3, 0.3, 4)
        r2 = ((grid.y[:, None] - cy * hy) / hy) ** 2 + ((grid.x - cx * hx) / hx) ** 2
        tilt = ay * grid.y[:, None] / grid.pitch[0] + ax * grid.x / grid.pitch[1]
        total = total + complex(*rng.normal(size=2)) * np.exp(-12 * r2 + 1j * tilt)
    return total


def mismatch(forward, adjoint, u, back_grid, seed=3):
    """Of <A u, v> and <u, A' v>, v next to A u so that neither is small."""
    image = forward(u)
    values = image.to_numpy().astype(complex)
    values = values + 0.3 * np.abs(values).mean() * waves(seed, *values.shape)
    v = clplen.Field.from_array(values, image.grid, wavelength=LAM, device=u.device)
    back = adjoint(v)
    assert back.grid == back_grid
    assert back.shape == u.shape
    left, right = (
        np.vdot(a.to_numpy().astype(complex), b.to_numpy().astype(complex))
        for a, b in ((image, v), (u, back))
    )
    return abs(left - right) / abs(left)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_adjoint_of_every_method(wave):
    z = -0.02
    for method in METHODS:
        for shape, out in (
            ((31, 48), None),
            ((31, 48), (23, 41)),
            ((1, 61), None),
            ((53, 1), None),
        ):
            if out and method not in FREE:
                continue
            grid = clplen.Grid(shape, (4e-6, 5e-6), origin=(1e-6, -3e-6))
            target = clplen.Grid(out, (6e-6, 3e-6), origin=(20e-6, 10e-6)) if out else None
            plan = clplen.Propagator(
                grid, z, wavelength=LAM, method=method, out_grid=target, device=wave
            )
            u = clplen.Field.from_array(waves(1, 2, *shape), grid, wavelength=LAM, device=wave)
            assert mismatch(plan, plan.adjoint, u, grid) <= BOUND[wave.precision], (shape, out)


def test_adjoint_of_the_identity_and_of_no_fields(device):
    grid = clplen.Grid((5, 7), 4e-6)
    plan = clplen.Propagator(grid, 0.0, wavelength=LAM, device=device)
    u = clplen.Field.from_array(waves(1, 5, 7), grid, wavelength=LAM, device=device)
    np.testing.assert_array_equal(plan.adjoint(u).to_numpy(), u.to_numpy())
    none = clplen.Field.from_array(np.zeros((0, 5, 7)), grid, wavelength=LAM, device=device)
    there = clplen.Propagator(grid, 1e-3, wavelength=LAM, device=device)
    assert there.adjoint(none).shape == (0, 5, 7)


def test_scipy_takes_a_plan(device):
    grid, out = clplen.Grid((9, 12), 4e-6), clplen.Grid((7, 5), 6e-6)
    plan = clplen.Propagator(
        grid, 2e-3, wavelength=LAM, method="cblas", out_grid=out, device=device
    )
    matrix = plan.as_linear_operator()
    whole = np.stack([matrix @ row for row in np.eye(108, dtype=device.complex)], axis=-1)
    back = np.stack([matrix.H @ row for row in np.eye(35, dtype=device.complex)], axis=-1)
    assert np.abs(whole.conj().T - back).max() <= 1e-5 * np.abs(whole).max()


def test_a_field_of_another_grid_is_refused():
    grid, out = clplen.Grid((9, 12), 4e-6), clplen.Grid((7, 5), 6e-6)
    plan = clplen.Propagator(grid, 2e-3, wavelength=LAM, method="cblas", out_grid=out)
    u = clplen.Field.from_array(waves(1, 9, 12), grid, wavelength=LAM)
    with pytest.raises(ShapeError, match="The output of the plan must be on"):
        plan.adjoint(u)


def check_slope_by_the_distance_against_differences(precise, method, z):
    for shape, out in (((31, 48), None), ((31, 48), (23, 41)), ((1, 61), None)):
        if out and method not in FREE:
            continue
        grid = clplen.Grid(shape, (4e-6, 5e-6))
        target = clplen.Grid(out, (5e-6, 3e-6), origin=(8e-6, 4e-6)) if out else None
        u = clplen.Field.from_array(smooth(grid, 2), grid, wavelength=LAM, device=precise)
        options = {"wavelength": LAM, "method": method, "out_grid": target, "device": precise}
        plan = clplen.Propagator(grid, z, **options)

        def at(distance, grid=grid, options=options, plan=plan, u=u):
            moved = clplen.Propagator(grid, distance, **options)
            factor = plan.description.factor
            if isinstance(factor, Transfer):  # whose frequencies and weights stay
                kept = replace(factor, z=distance)
                moved.description = replace(plan.description, factor=kept)
            return moved(u).to_numpy()

        def difference(h, at=at):
            return (at(z + h) - at(z - h)) / (2 * h)

        h = 2e-6
        expected = (4 * difference(h / 2) - difference(h)) / 3
        found = plan.distance_slope(u).to_numpy()
        assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max(), (shape, out)


def test_slope_by_the_distance_against_differences(precise):
    for method in SLOPED:
        z = 0.05 if method == "one-step" else 3e-3  # which is not exact so near
        check_slope_by_the_distance_against_differences(precise, method, z)


def test_methods_without_a_slope_say_so(device):
    grid = clplen.Grid((9, 12), 4e-6)
    u = clplen.Field.from_array(waves(1, 9, 12), grid, wavelength=LAM, device=device)
    plan = clplen.Propagator(grid, 0.1, wavelength=LAM, method="fresnel-1fft", device=device)
    with pytest.raises(SamplingError, match="derivative by z requires"):
        plan.distance_slope(u)


def system(grid):
    mla = clplen.MicrolensArray(40e-6, 1e-3, count=(3, 5), offset=(3e-6, 2e-6), rotation=0.02)
    spread = clplen.Grid((29, 40), (5e-6, 4e-6), origin=(4e-6, -2e-6))
    prism = Element(
        lambda field: clplen.wave.tilt(field, (0.01, -0.02)),
        "prism",
        adjoint_function=lambda field: clplen.wave.tilt(field, (-0.01, 0.02)),
    )
    return clplen.OpticalSystem(
        [
            Stop(100e-6), prism, Space(2e-3), Lens(0.02, diameter=120e-6), mla,
            Space(5e-3, method="cblas", out_grid=spread), Pupil(4e-3, 0.01),
        ]
    )  # fmt: skip


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_adjoint_of_a_system(wave):
    grid = clplen.Grid((31, 48), (4e-6, 5e-6))
    made = system(grid)
    u = clplen.Field.from_array(waves(5, 3, 31, 48), grid, wavelength=LAM, device=wave)

    def back(field):
        return made.adjoint(field, grid=grid)

    assert mismatch(made, back, u, grid) <= BOUND[wave.precision]
    operator = made.operator(grid, wavelength=LAM, device=wave)
    assert operator.as_linear_operator().shape == (29 * 40, 31 * 48)
    assert operator.dtype == wave.complex


def test_adjoint_of_an_element(precise):
    for part in [
        Lens(0.02),
        Lens(-0.03, diameter=130e-6),
        Lens(0.02, form="stigmatic"),
        Lens(np.inf),
        ConvergingLight(0.03),
        Stop(90e-6, centre=(8e-6, -5e-6)),
        clplen.wave.Pupil.of_cutoff(7e4, LAM, path=lambda v, u: 2e-7 * v**3),
        clplen.MicrolensArray(40e-6, 1e-3, count=(3, 5), rotation=0.1, lattice="hexagonal"),
    ]:
        grid = clplen.Grid((31, 48), (4e-6, 5e-6))
        u = clplen.Field.from_array(waves(5, 2, 31, 48), grid, wavelength=LAM, device=precise)
        assert mismatch(part.apply, part.adjoint, u, grid) <= 1e-12


def made_of(z, focal_length, offset, grid):
    mla = clplen.MicrolensArray(40e-6, 2e-3, count=(3, 5), fill="full", offset=offset)
    out = clplen.Grid((27, 33), (4e-6, 5e-6), origin=(8e-6, -15e-6))
    last = Space(z[1], method="rs", out_grid=out)
    return clplen.OpticalSystem([Space(z[0]), Lens(focal_length), mla, last])


def test_gradients_through_a_system_against_differences(precise):
    grid = clplen.Grid((31, 48), (4e-6, 5e-6))
    target = np.random.default_rng(1).random((27, 33))
    values = smooth(grid, 4)

    def loss(changed=None, by=0.0, u=values):
        p = {"z0": 4e-3, "z1": 2e-3, "f": 0.02, "oy": 3e-6, "ox": -2e-6}
        if changed:
            p[changed] += by
        made = made_of((p["z0"], p["z1"]), p["f"], (p["oy"], p["ox"]), grid)
        field = clplen.Field.from_array(u, grid, wavelength=LAM, device=precise)
        image, pullback = made.vjp(field, parameters=[0, 1, 2, -1])
        wrong = image.intensity().to_numpy() - target
        return (wrong**2).sum(), pullback, intensity_gradient(image, 2 * wrong)

    _, pullback, cotangent = loss()
    assert pullback.nbytes == 4 * 16 * 31 * 48
    gradient = pullback(cotangent)
    found = {
        "z0": gradient.parameters[0]["z"],
        "z1": gradient.parameters[3]["z"],
        "f": gradient.parameters[1]["focal_length"],
        "oy": gradient.parameters[2]["offset"][0],
        "ox": gradient.parameters[2]["offset"][1],
    }
    for name, h in (("z0", 4e-7), ("z1", 4e-7), ("f", 1e-6), ("oy", 1e-10), ("ox", 1e-10)):
        steps = [(loss(name, a * h)[0] - loss(name, -a * h)[0]) / (2 * a * h) for a in (1, 0.5)]
        assert found[name] == pytest.approx((4 * steps[1] - steps[0]) / 3, rel=1e-6), name
    direction = waves(7, 31, 48)
    above, below = (loss(u=values + h * direction)[0] for h in (1e-6, -1e-6))
    got = (np.conj(gradient.field.to_numpy()) * direction).sum().real
    assert got == pytest.approx((above - below) / 2e-6, rel=1e-6)


def test_parts_without_gradients_or_adjoints_are_named(device):
    grid = clplen.Grid((9, 12), 4e-6)
    u = clplen.Field.from_array(waves(1, 9, 12), grid, wavelength=LAM, device=device)
    plain = clplen.OpticalSystem([Element(lambda field: field, "mirror"), 1e-3])
    with pytest.raises(TypeError, match="'mirror' has no adjoint"):
        plain.adjoint(u)
    with pytest.raises(TypeError, match="Part 0, mirror, has no parameters with gradients"):
        plain.vjp(u, parameters=[0])
    with pytest.raises(IndexError, match="must be from 0 to 1, got 2"):
        plain.vjp(u, parameters=[2])
    with pytest.raises(ShapeError, match="must have the shape of the field"):
        intensity_gradient(u, np.ones((9, 11)))


def test_inner_product_keeps_what_float32_sums_lose(device):
    grid = clplen.Grid((3, 4099), 4e-6)
    a, b = waves(1, 2, 3, 4099), 1e-3 * waves(2, 2, 3, 4099)
    b[..., 7] = 1e3 * a[..., 7]
    fields = [clplen.Field.from_array(v, grid, wavelength=LAM, device=device) for v in (a, b)]
    expected = np.vdot(*(f.to_numpy().astype(complex) for f in fields))
    assert inner_product(*fields) == pytest.approx(expected, rel=3e-7)
