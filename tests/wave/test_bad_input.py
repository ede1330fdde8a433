"""Wrong input of a propagation gets one clear sentence, before anything is allocated."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from fields import LAM, field_of

from clplen import (
    Device,
    DeviceError,
    Field,
    Grid,
    Propagator,
    SamplingError,
    SamplingWarning,
    propagate,
)
from clplen.compute.fft.routes import FFTRoute
from clplen.errors import ShapeError
from clplen.wave import gaussian_beam, plane_wave, spherical_wave
from clplen.wave.propagation.description import FREE_GRID, METHODS, Request
from clplen.wave.propagation.free_space import propagate_wavelengths

GRID = Grid((8, 9), 3e-6)
KEEPS_THE_GRID = [m for m in METHODS if m not in FREE_GRID]


def ones(device, grid: Grid = GRID) -> Field:
    return field_of(np.ones(grid.shape), grid, device)


@pytest.fixture(autouse=True)
def nothing_runs(monkeypatch) -> None:
    """What is refused is refused before its first transform."""
    for name in ("lines", "transform"):
        monkeypatch.setattr(FFTRoute, name, lambda *_, **__: pytest.fail("a refused input ran"))


@pytest.mark.parametrize("z", [math.nan, math.inf, -math.inf])
def test_a_distance_is_finite(device, z):
    for asked in (z, [1e-3, z]):
        with pytest.raises(ValueError, match=f"distance z is one finite number of metres, not {z}"):
            propagate(ones(device), asked)
    with pytest.raises(ValueError, match="finite number of metres"):
        Propagator(GRID, z, wavelength=LAM, device=device)


@pytest.mark.parametrize("z", ["far", None, 1j, 1e-3j])
def test_a_distance_is_a_number(device, z):
    text = re.escape(f"one finite number of metres, not {z!r}.")
    with pytest.raises(ValueError, match=text):
        propagate(ones(device), z)
    with pytest.raises(ValueError, match=text):
        Propagator(GRID, z, wavelength=LAM, device=device)


@pytest.mark.parametrize("z", [1e300, -1e300, 1.01e12])
def test_a_distance_is_not_beyond_everything(device, z):
    for asked in (z, [1e-3, z]):
        with pytest.raises(ValueError, match=r"distance z is at most 1e\+12 m, not "):
            propagate(ones(device), asked)


def test_distances_are_one_list(device):
    for asked in ([[1e-3, 2e-3]], np.full((2, 2), 1e-3)):
        with pytest.raises(ValueError, match="z is one distance or a list of them, in metres, not"):
            propagate(ones(device), asked)


def test_a_plan_has_one_distance(device):
    with pytest.raises(ValueError, match="one finite number of metres, not "):
        Propagator(GRID, [1e-3, 2e-3], wavelength=LAM, device=device)


def test_some_distance_is_needed(device):
    with pytest.raises(ValueError, match="one distance or a list of them, in metres"):
        propagate(ones(device), [])


def test_an_unknown_method_lists_the_known_ones(device):
    names = ", ".join(METHODS)
    with pytest.raises(ValueError, match=f"no method 'asm'; use one of {names}"):
        propagate(ones(device), 1e-3, method="asm")


@pytest.mark.parametrize("pad", [0.5, 0, -2, math.nan, math.inf])
def test_pad_is_at_least_one(device, pad):
    with pytest.raises(ValueError, match=f"pad is at least 1 and finite, not {pad}"):
        propagate(ones(device), 1e-3, pad=pad)


@pytest.mark.parametrize("wavelength", [0.0, -550e-9, math.nan, math.inf])
def test_a_wavelength_is_positive(device, wavelength):
    text = f"wavelength is positive, in metres, not {re.escape(repr(wavelength))}"
    with pytest.raises(ValueError, match=text):
        Propagator(GRID, 1e-3, wavelength=wavelength, device=device)
    with pytest.raises(ValueError, match=text):
        field_of(np.ones(GRID.shape), GRID, device, wavelength)


def test_some_wavelength_is_needed(device):
    for none in ([], np.array([])):
        with pytest.raises(ValueError, match="wavelengths is one wavelength or several, in metres"):
            propagate_wavelengths(ones(device), 1e-3, none)


@pytest.mark.parametrize("guard", [-1, math.nan, math.inf])
def test_a_guard_is_not_negative(device, guard):
    with pytest.raises(ValueError, match=f"number of Fresnel widths, at least 0, not {guard}"):
        propagate(ones(device), 1e-3, guard=guard)


@pytest.mark.parametrize("border", [1, 1.5, -0.1, math.nan])
def test_a_border_is_a_fraction(device, border):
    with pytest.raises(ValueError, match=f"fraction of half the window, .* not {border}"):
        propagate(ones(device), 1e-3, method="fresnel-multistep", border=border)


@pytest.mark.parametrize("support", [0, -1e-5, (1e-5, 0), (math.nan, 1e-5), math.inf])
def test_a_support_is_positive(device, support):
    with pytest.raises(ValueError, match=r"support is positive widths \(y, x\) in metres, not"):
        propagate(ones(device), 1e-3, support=support)


@pytest.mark.parametrize("support", [(1, 2, 3), [], [[1e-5, 1e-5]]])
def test_a_support_is_a_width_or_two(device, support):
    with pytest.raises(ValueError, match=r"support is one width or \(y, x\), in metres, not"):
        propagate(ones(device), 1e-3, support=support)


def test_a_phase_route_is_known(device):
    with pytest.raises(ValueError, match="no phase route 'fast'; use one of tables, fp64, twofl"):
        Propagator(GRID, 1e-3, wavelength=LAM, device=device, phase="fast")


def test_double_precision_has_tables_alone(precise):
    for phase in ("fp64", "twofloat"):
        with pytest.raises(ValueError, match=f"double precision .* by 'tables', not '{phase}'"):
            Propagator(GRID, 1e-3, wavelength=LAM, device=precise, phase=phase)


def test_a_phase_in_double_needs_double(device, monkeypatch):
    monkeypatch.setattr(device, "has_fp64", False)
    with pytest.raises(ValueError, match="has no double precision: use phase='twofloat'"):
        Propagator(GRID, 1e-3, wavelength=LAM, device=device, phase="fp64")


@pytest.mark.parametrize("method", [m for m in METHODS if m != "fresnel-1fft"])
def test_a_lens_belongs_to_one_transform(device, method):
    with pytest.raises(ValueError, match=f"'fresnel-1fft', not '{method}': put a thin_lens before"):
        propagate(ones(device), 1e-3, method=method, lens=0.1)


@pytest.mark.parametrize("lens", [0, math.nan])
def test_a_focal_length_is_not_zero(device, lens):
    with pytest.raises(ValueError, match=f"focal length lens= is not 0, in metres; got {lens}"):
        propagate(ones(device), 1e-3, method="fresnel-1fft", lens=lens)


@pytest.mark.parametrize("wrong", ["5um", (1e-6, 2e-6, 3e-6), {}], ids=repr)
def test_pitch_and_origin_are_one_number_or_two(wrong):
    with pytest.raises(ValueError, match=r"^A grid's pitch is positive and finite, in metres, not"):
        Grid((8, 8), wrong)
    with pytest.raises(ValueError, match=r"^A grid's origin is finite, in metres, not"):
        Grid((8, 8), 3e-6, origin=wrong)


# Output grids -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", KEEPS_THE_GRID)
@pytest.mark.parametrize(
    "out",
    [
        Grid((8, 9), 4e-6),
        Grid((9, 8), 3e-6),
        Grid((8, 9), 3e-6, origin=(0, 1e-6)),
        Grid((8, 9), (3e-6, 3.0001e-6)),
    ],
    ids=["pitch", "shape", "origin", "pitch of x"],
)
def test_most_methods_keep_the_grid(device, method, out):
    text = f"method='{method}' keeps the grid of the field, .* method='cblas' gives any grid"
    with pytest.raises(SamplingError, match=text):
        propagate(ones(device), 1e-3, method=method, out_grid=out)


@pytest.mark.parametrize("method", METHODS)
def test_the_fields_own_grid_may_always_be_named(method):
    assert Request(GRID, 1e-3, LAM, method, out_grid=Grid((8, 9), 3e-6)).target == GRID


@pytest.mark.parametrize("out", [(64, 64), 3e-6, np.ones((4, 4))], ids=["shape", "pitch", "array"])
def test_an_output_grid_is_a_grid(device, out):
    for method in METHODS:
        with pytest.raises(
            TypeError, match=r"out_grid is a Grid, as Grid\(\(ny, nx\), pitch\) makes"
        ):
            propagate(ones(device), 1e-3, method=method, out_grid=out)


def test_one_step_is_for_a_distance(device):
    with pytest.raises(SamplingError, match="one-step is for a distance z other than 0"):
        propagate(ones(device), 0, method="one-step", out_grid=Grid((8, 9), 4e-6))


def test_one_transform_has_no_pitch_at_z_zero(device):
    with pytest.raises(SamplingError, match="would be 0 at z = 0: use another method"):
        propagate(ones(device), 0, method="fresnel-1fft")


def test_one_transform_goes_to_one_distance_at_a_time(device):
    with pytest.raises(SamplingError, match=r"another pitch at each .* or give an out_grid"):
        propagate(ones(device), [1e-3, 2e-3], method="fresnel-1fft")


@pytest.mark.parametrize(
    ("grid", "out", "axis"),
    [(Grid((1, 9), 3e-6), Grid((2, 9), 3e-6), "y"), (Grid((9, 1), 3e-6), Grid((9, 5), 1e-6), "x")],
)
def test_nothing_varies_along_an_axis_of_one_sample(device, grid, out, axis):
    for method in ("auto", "cblas"):
        text = rf"Nothing varies along {axis} .* {max(out.shape[axis == 'x'], 2)} samples .* one s"
        with pytest.raises(SamplingError, match=text):
            propagate(ones(device, grid), 1e-3, method=method, out_grid=out)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("z", [1e-3, -1e-3])
def test_an_output_that_no_light_reaches(device, axis, z):
    origin = [0.0, 0.0]
    origin[axis] = -1e-3
    # Rays to 1 mm +- 13 um or so; 3 um samples carry 1.667e5 cycles/m, to 92 um.
    text = (
        f"No light .* along {'yx'[axis]}: its rays have spatial frequencies .*e[+]06 to .*e[+]06 "
        r"cycles/m, the grid carries up to 1.667e[+]05;"
    )
    for method in ("auto", "cblas"):
        with pytest.warns(SamplingWarning, match=text):
            Propagator(
                GRID, z, wavelength=LAM, method=method, device=device,
                out_grid=Grid((8, 9), 3e-6, origin=(origin[0], origin[1])),
            )  # fmt: skip


# Other fields, devices, sizes -------------------------------------------------------------------


def test_a_plan_of_another_grid_or_wavelength(device):
    for grid, wavelength in ((Grid((9, 8), 3e-6), LAM), (Grid((8, 9), 2e-6), LAM), (GRID, 5e-7)):
        made = Propagator(grid, 1e-3, wavelength=wavelength, device=device)
        for call in (made, made.energy):
            with pytest.raises(
                ShapeError, match=r"The input of the plan is on .* the field is on .* 5.5e-07 m"
            ):
                call(ones(device))


@pytest.mark.parametrize("wrong", [np.ones((8, 9), complex), None, GRID], ids=["array", "", "grid"])
def test_a_field_is_a_field(wrong):
    for z in (1e-3, 0, [1e-3]):
        with pytest.raises(TypeError, match=r"propagate takes a Field, as Field\.from_array"):
            propagate(wrong, z)


def test_a_plan_of_another_device(device, precise):
    made = Propagator(GRID, 1e-3, wavelength=LAM, device=precise)
    with pytest.raises(DeviceError, match="two devices"):
        made(ones(device))


def test_no_device_is_the_default_one():
    assert Propagator(GRID, 1e-3, wavelength=LAM, device=None).device is Device.open()


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
@pytest.mark.parametrize("method", ["auto", "as", "cblas", "rs", "fresnel-tf"])
def test_what_does_not_fit_the_memory(device, monkeypatch, method):
    made = Propagator(Grid((200, 300), 3e-6), 4e-3, wavelength=LAM, method=method, pad=3,
                      device=device)  # fmt: skip
    field = ones(device, made.grid)
    monkeypatch.setattr(device, "memory_bytes", 400_000)
    needed = r"This propagation needs ([\d,]+) bytes .*, but .* has 400,000 bytes"
    with pytest.raises(DeviceError, match=needed) as error:
        made(field)
    found = re.search(needed, str(error.value))
    assert found is not None
    # At least what comes out, at most some windows of three times the grid.
    assert 480_000 <= int(found[1].replace(",", "")) <= 20 * 9 * 480_000


def test_a_wave_that_does_not_fit_the_memory(device, monkeypatch):
    """Refused with what both its samples and what they are made of need, before any is made."""
    monkeypatch.setattr(device, "empty", lambda *_: pytest.fail("made something"))
    grid = Grid((400_000, 400_000), 1e-6)
    for wave in (plane_wave, spherical_wave, gaussian_beam):
        more = {plane_wave: {}, spherical_wave: {"z": 1.0}, gaussian_beam: {"waist": 1e-3}}[wave]
        with pytest.raises(DeviceError, match=r"This wave needs 2,560,000,000,000 bytes"):
            wave(grid, wavelength=LAM, device=device, **more)
