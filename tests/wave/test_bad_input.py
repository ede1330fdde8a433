"""Wrong input of a propagation gets one clear sentence, before anything is allocated."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from fields import LAM, field_of

from clplen import (
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


NAMES = ", ".join(METHODS)
COARSE = Grid((8, 9), 4e-6)
FINITE = "z must be a finite number of metres, got "
REFUSED = [  # distance, options of propagate, words
    (math.nan, {}, f"{FINITE}nan"),
    ([1e-3, -math.inf], {}, f"{FINITE}-inf"),
    ("far", {}, f"{FINITE}'far'"),
    (1e-3j, {}, f"{FINITE}0.001j"),
    (-1e300, {}, r"z must be at most 1e\+12 m, got "),
    ([[1e-3, 2e-3]], {}, "z must be a distance or a list of distances"),
    ([], {}, "z must be a distance or a list of distances"),
    (1e-3, {"method": "asm"}, f"method must be one of {NAMES}, got 'asm'"),
    (1e-3, {"pad": 0.5}, "pad must be at least 1 and finite, got 0.5"),
    (1e-3, {"pad": math.nan}, "pad must be at least 1 and finite, got nan"),
    (1e-3, {"guard": -1}, "number of Fresnel widths, at least 0, got -1"),
    (1e-3, {"method": "fresnel-multistep", "border": 1}, "fraction of half the window, .* got 1"),
    (1e-3, {"support": (1e-5, 0)}, r"support must be positive widths \(y, x\) in metres, got"),
    (1e-3, {"support": [[1e-5, 1e-5]]}, r"support must be one width or \(y, x\), in metres, got"),
    (1e-3, {"method": "as", "lens": 0.1}, "'fresnel-1fft', got 'as'; apply thin_lens before"),
    (1e-3, {"method": "fresnel-1fft", "lens": 0}, "lens must not be 0 or NaN, got 0"),
    (0, {"method": "one-step", "out_grid": COARSE}, "one-step requires a distance z other than 0"),
    (0, {"method": "fresnel-1fft"}, "is 0 at z = 0; use another method"),
    ([1e-3, 2e-3], {"method": "fresnel-1fft"}, r"a different pitch at each .* or set out_grid="),
    (
        1e-3,
        {"out_grid": np.ones((4, 4))},
        r"out_grid must be a Grid, such as Grid\(\(ny, nx\), pitch\)",
    ),
]


def test_wrong_input_gets_a_sentence(device):
    for z, options, words in REFUSED:
        with pytest.raises((ValueError, TypeError, SamplingError), match=words):
            propagate(ones(device), z, **options)


def test_wrong_plans_get_a_sentence(device, precise, monkeypatch):
    other = re.escape(f"{FINITE}[0.001, 0.002]")
    for z, options, words in (
        ([1e-3, 2e-3], {}, other),
        (1e-3, {"phase": "fast"}, "phase must be one of tables, fp64, twofloat, got 'fast'"),
        (1e-3, {"wavelength": -550e-9}, "wavelength must be positive, in metres, got -5.5e-07"),
    ):
        with pytest.raises(ValueError, match=words):
            Propagator(GRID, z, **{"wavelength": LAM, "device": device, **options})
    for phase in ("fp64", "twofloat"):
        with pytest.raises(
            ValueError, match=f"phase must be 'tables' in double precision, got '{phase}'"
        ):
            Propagator(GRID, 1e-3, wavelength=LAM, device=precise, phase=phase)
    monkeypatch.setattr(device, "has_fp64", False)
    with pytest.raises(ValueError, match="has no double precision: use phase='twofloat'"):
        Propagator(GRID, 1e-3, wavelength=LAM, device=device, phase="fp64")
    with pytest.raises(ValueError, match="wavelengths must have at least one wavelength"):
        propagate_wavelengths(ones(device), 1e-3, [])
    for wrong in ("5um", (1e-6, 2e-6, 3e-6)):
        with pytest.raises(ValueError, match=r"^pitch must be positive and finite, in metres"):
            Grid((8, 8), wrong)
        with pytest.raises(ValueError, match=r"^origin must be finite, in metres, got"):
            Grid((8, 8), 3e-6, origin=wrong)


# Output grids -----------------------------------------------------------------------------------


def test_most_methods_keep_the_grid(device):
    outs = (COARSE, Grid((9, 8), 3e-6), Grid((8, 9), 3e-6, origin=(0, 1e-6)))
    for method in KEEPS_THE_GRID:
        assert Request(GRID, 1e-3, LAM, method, out_grid=Grid((8, 9), 3e-6)).target == GRID
        text = (
            f"method='{method}' requires the grid of the field, .* method='cblas' supports any grid"
        )
        for out in (*outs, Grid((8, 9), (3e-6, 3.0001e-6))):
            with pytest.raises(SamplingError, match=text):
                propagate(ones(device), 1e-3, method=method, out_grid=out)


def test_nothing_varies_along_an_axis_of_one_sample(device):
    for grid, out, axis in (
        (Grid((1, 9), 3e-6), Grid((2, 9), 3e-6), "y"),
        (Grid((9, 1), 3e-6), Grid((9, 5), 1e-6), "x"),
    ):
        text = rf"a single sample along {axis}, .* got {max(out.shape[axis == 'x'], 2)}"
        with pytest.raises(SamplingError, match=text):
            propagate(ones(device, grid), 1e-3, out_grid=out)


def test_an_output_that_no_light_reaches(device):
    for axis in [0, 1]:
        for z in [1e-3, -1e-3]:
            origin = [0.0, 0.0]
            origin[axis] = -1e-3
            # Rays to 1 mm +- 13 um or so; 3 um samples carry 1.667e5 cycles/m, to 92 um.
            text = (
                f"No light .* along {'yx'[axis]}: its rays have .*e[+]06 to .*e[+]06 "
                r"cycles/m, above .* of 1.667e[+]05;"
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
                ShapeError, match=r"The input of the plan must be on .* got .* 5.5e-07 m"
            ):
                call(ones(device))


def test_a_field_is_a_field():
    for wrong in [np.ones((8, 9), complex), None, GRID]:
        for z in (1e-3, 0, [1e-3]):
            with pytest.raises(TypeError, match=r"field must be a Field, as Field\.from_array"):
                propagate(wrong, z)


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_what_does_not_fit_the_memory(device, monkeypatch):
    needed = r"This propagation needs ([\d,]+) bytes .*, but .* has 400,000 bytes"
    for method in ("auto", "as", "cblas", "rs", "fresnel-tf"):
        made = Propagator(Grid((200, 300), 3e-6), 4e-3, wavelength=LAM, method=method, pad=3,
                          device=device)  # fmt: skip
        field = ones(device, made.grid)
        with monkeypatch.context() as patch:
            patch.setattr(device, "memory_bytes", 400_000)
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
