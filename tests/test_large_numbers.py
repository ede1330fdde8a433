"""Whole numbers that float64 does not hold: refused like infinite ones, by calls and by readers."""

import re
from contextlib import suppress

import fuzzing
import numpy as np
import pytest

import clplen
from clplen import (
    ClplenError,
    Coherence,
    Field,
    Grid,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    analysis,
    cameras,
    io,
    microscopy,
    wave,
)
from clplen.checks import float64_array, is_integer
from clplen.microscopy.frames.outliers import hot_pixels
from clplen.microscopy.pupil.even_light import NEEDED, EvenLight
from clplen.wave import Space

HUGE = 10**400
GRID = Grid((8, 9), 1e-5)
MASK = wave.RandomPhaseMask(4e-5)
LENSLETS = {"pitch": 1.5e-4, "focal_length": 1e-2, "count": 9}


def lit(device):
    return wave.plane_wave(GRID, wavelength=5e-7, device=device)


def views(device):
    return LightField.from_array(np.ones((3, 3, 16, 18), np.float32), device=device)


CALLS = {
    "distance": lambda d: clplen.propagate(lit(d), [0.1, HUGE]),
    "support": lambda d: clplen.propagate(lit(d), 0.1, support=HUGE),
    "wavelengths": lambda d: wave.propagate_wavelengths(lit(d), 0.1, [HUGE]),
    "field": lambda d: Field.from_array([[HUGE, 1]], Grid((1, 2), 1e-5), wavelength=0.1, device=d),
    "lens": lambda d: clplen.thin_lens(lit(d), HUGE),
    "period": lambda d: wave.grating(lit(d), HUGE),
    "waist": lambda d: wave.gaussian_beam(GRID, HUGE, wavelength=5e-7, device=d),
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
    "mixed": lambda d: Field.from_array([[HUGE, 2j]], Grid((1, 2), 1e-5), wavelength=0.1, device=d),
    "snapshots": lambda d: Coherence(MASK).average(Space(0.01), lit(d), snapshots=HUGE),
    "degree": lambda d: wave.ExtendedSource(1e-3, 0.1).degree(0, 0, wavelength=HUGE),
    "transfer": lambda d: wave.Pupil(4e-3, 0.1).transfer(GRID, HUGE),
    "edge": lambda d: wave.incoherent_edge([HUGE]),
    "groups": lambda d: wave.usaf1951(GRID, groups=[HUGE]),
    "terms": lambda d: wave.wavefront(GRID, {(2, 0): HUGE}, diameter=4e-5),
    "order": lambda d: wave.zernike(*wave.noll(10**20), 0.5, 0),
    "lattice": lambda d: microscopy.square_lattice(33.67, (HUGE, 600)),
    "match": lambda d: microscopy.match_points(np.ones(3), np.ones(3), tolerance=(HUGE, 1, 1)),
    "even": lambda d: EvenLight(dict.fromkeys(NEEDED, HUGE)),
    "hot": lambda d: hot_pixels(np.ones((20, 30)), (0.3, 0.4, HUGE), 10),
    "cover": lambda d: cameras.CoverGlass(15e-5).path(np.array([0.5]), HUGE),
    "sines": lambda d: cameras.CoverGlass(15e-5).path(np.array([HUGE]), 1.0),
    "objective": lambda d: cameras.Objective(20, 0.5, 1.0, HUGE),
    "contrast": lambda d: cameras.noise(1, 64, contrast=HUGE),
    "bars": lambda d: cameras.Bars((0, 0), 16, count=HUGE, period=8, width=4),
    "disc": lambda d: clplen.lightfield.disc((HUGE, 5), 1.0),
    "aperture-centre": lambda d: clplen.lightfield.disc((5, 7), 1.0, centre=(HUGE, 2)),
    "best-focus": lambda d: clplen.lightfield.focus_ratio(None, HUGE),
    "intrinsics": lambda d: clplen.lightfield.Intrinsics(np.eye(5), np.zeros(5), (HUGE, 3, 8, 9)),
    "raytrix": lambda d: io.RaytrixCalibration((HUGE, 0.0), 23.0, (1.0, 0.0), (0.0, 1.0)),
    "origin": lambda d: io.RaytrixCalibration((0, 0), 23.0, (1, 0), (0, 1)).origin((HUGE, 9)),
    "type": lambda d: io.FocusType((HUGE, 0.0), (3.8, 100.0)),
    "voxel": lambda d: io.write_volume("x.tif", np.ones((1, 2, 3)), planes=[0], voxel=(HUGE, 1)),
    "picture": lambda d: io.write_image("x.tif", np.ones((2, 3)), spacing=(1, 1, HUGE, 1)),
    "map": lambda d: io.HciParameters(HUGE, 35, None, 512, 512, None, None, 45, 8).depth(0.1),
    "border": lambda d: analysis.score(np.ones((3, 4)), np.ones((3, 4)), border=np.inf),
    "sides": lambda d: clplen.lightfield.regular_polygon((5, 7), np.inf, 2.0),
    "seed": lambda d: cameras.LensletScatter(0.01, seed=np.inf),
    "count": lambda d: MicrolensArray(**LENSLETS | {"count": 1e308}),
}


def test_a_call(device, tmp_path, monkeypatch):
    for call in CALLS.values():
        monkeypatch.chdir(tmp_path)
        with pytest.raises((ValueError, TypeError, ClplenError)):
            call(device)


def test_arrays_and_whole_numbers():
    np.testing.assert_array_equal(
        float64_array([[1, HUGE], [-HUGE, 2]]), [[1, np.inf], [-np.inf, 2]]
    )
    assert not is_integer(HUGE)
    assert not is_integer(1e308)  # whole, but no number of samples
    assert not is_integer(np.inf)
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


def test_hostile_numbers_do_not_warn():
    """Matrices whose products leave float64 are refused, and places beyond it are unknown."""
    H = np.diag([1e-3, 1e-3, 1e-3, 1e308, 1.0])
    with pytest.raises(ValueError, match="H has 12 free numbers"), np.errstate(all="raise"):
        clplen.lightfield.Intrinsics(H, np.zeros(5), (3, 5, 8, 9))
    maps = cameras.OPDMaps(np.zeros((1, 1, 9, 9)), fields=[(0, 0)])
    with pytest.raises(ValueError, match="finite"):
        maps.path(0, 0, 5e-7, v=HUGE, u=[0, 1])
