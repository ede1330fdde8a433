"""Whole numbers that float64 does not hold: refused like infinite ones, by calls and by readers."""

import re
from contextlib import suppress

import fuzzing
import numpy as np
import pytest

import clplen
from clplen import ClplenError, Field, Grid, LightField, MicrolensArray, PlenopticCamera, wave
from clplen.checks import float64_array, is_integer

HUGE = 10**400
GRID = Grid((8, 9), 1e-5)
LENSLETS = {"pitch": 1.5e-4, "focal_length": 1e-2, "count": 9}


def lit(device):
    return wave.plane_wave(GRID, wavelength=5e-7, device=device)


def views(device):
    return LightField.from_array(np.ones((3, 3, 16, 18), np.float32), device=device)


CALLS = {
    "distance": lambda d: clplen.propagate(lit(d), [0.1, HUGE]),
    "support": lambda d: clplen.propagate(lit(d), 0.1, support=HUGE),
    "wavelengths": lambda d: wave.propagate_wavelengths(lit(d), 0.1, [HUGE]),
    "field": lambda d: Field.from_array([[HUGE, 1]], Grid((1, 2), 1e-5), wavelength=1, device=d),
    "lens": lambda d: clplen.thin_lens(lit(d), HUGE),
    "period": lambda d: wave.grating(lit(d), HUGE),
    "waist": lambda d: wave.gaussian_beam(GRID, HUGE, wavelength=5e-7, device=d),
    "sampling": lambda d: wave.lens_sampling(GRID, 0.1, wavelength=5e-7, diameter=HUGE),
    "system": lambda d: wave.imaging_system(0.1, diameter=1e-3, magnification=HUGE),
    "pupil": lambda d: wave.Pupil(HUGE, 1.0),
    "source": lambda d: wave.ExtendedSource(1e-3, HUGE),
    "lenslets": lambda d: MicrolensArray(**LENSLETS | {"count": HUGE}),
    "camera": lambda d: PlenopticCamera.type1(focal_length=HUGE, mla=MicrolensArray(**LENSLETS)),
    "points": lambda d: clplen.PointSources((HUGE, 0, 0)),
    "spacing": lambda d: LightField.from_array(np.ones((3, 3, 8, 9)), spacing=(HUGE, 1, 1, 1)),
    "refocus": lambda d: clplen.refocus(views(d), disparity=HUGE),
    "stack": lambda d: clplen.focal_stack(views(d), disparities=[0, HUGE]),
    "depth": lambda d: clplen.depth_map(views(d), disparities=[0, 1, HUGE]),
    "ellipse": lambda d: clplen.cameras.Ellipse((0, 0), HUGE),
    "m": lambda d: PlenopticCamera.type2(
        focal_length=0.12, mla=MicrolensArray(**LENSLETS), m=HUGE, object_distance=0.5
    ),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_a_call(device, call):
    with pytest.raises((ValueError, TypeError, ClplenError)):
        call(device)


def test_arrays_and_whole_numbers():
    np.testing.assert_array_equal(
        float64_array([[1, HUGE], [-HUGE, 2]]), [[1, np.inf], [-np.inf, 2]]
    )
    assert not is_integer(HUGE)
    with pytest.raises(TypeError):
        float64_array([1, None, object()])


@pytest.mark.parametrize("name", ["intrinsics", "zarr-stack"])
def test_readers(device, tmp_path, name):
    parser = fuzzing.PARSERS[name]
    whole = parser.make(tmp_path, device)
    count = 0
    for file in [whole] if whole.is_file() else sorted(whole.rglob(".zattrs")):
        text = file.read_text("utf-8")
        for number in list(re.finditer(r"(?<![\w.])-?\d+\.\d+", text))[:6]:
            file.write_text(text[: number.start()] + str(HUGE) + text[number.end() :], "utf-8")
            count += 1
            with suppress(*fuzzing.ALLOWED):
                parser.read(whole, device)
        file.write_text(text, "utf-8")
    assert count
