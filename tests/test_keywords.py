"""Keywords that a function passes on: an unknown one is named, with the nearest known one."""

import inspect

import numpy as np
import pytest

import clplen
from clplen import Coherence, Field, Grid, LightField, OpticalSystem, propagate
from clplen.io.lightfields.lightfield_files import files_of
from clplen.microscopy import fit_pupil_patches
from clplen.wave import RandomPhaseMask, Space, propagate_wavelengths
from clplen.wave.field.intensity import AVERAGING

GRID = Grid((5, 7), 10e-6)


@pytest.fixture
def field(device):
    return Field.from_array(np.ones(GRID.shape), GRID, wavelength=500e-9, device=device)


def test_propagate(field):
    light = Coherence(RandomPhaseMask(40e-6))
    for given, hint in (
        ("outgrid", r"did you mean out_grid=\?"),
        ("snapshot", r"did you mean snapshots=\?"),
        ("colour", "it has method, pad, out_grid, "),
    ):
        said = f"propagate has no keyword '{given}': {hint}"
        with pytest.raises(TypeError, match=said):
            propagate(field, 0.01, coherence=light, **{given: 1})
        with pytest.raises(TypeError, match=said):
            propagate_wavelengths(field, 0.01, [5e-7], **{given: 1})


def test_an_optical_system(field):
    system = OpticalSystem([0.01])
    with pytest.raises(TypeError, match=r"OpticalSystem .*'rtoll': did you mean rtol=\?"):
        system(field, rtoll=0.1)
    with pytest.raises(TypeError, match="no keyword 'outgrid': it has coherence, snapshots, "):
        system(field, outgrid=GRID)


def test_keywords_of_an_average_are_those_of_coherence():
    taken = inspect.signature(Coherence.average).parameters.values()
    assert tuple(one.name for one in taken if one.kind is one.KEYWORD_ONLY) == AVERAGING


def test_others():
    for call, name, nearest in (
        (lambda **k: Coherence.plan(Space(0.1), snr=9, **k), "wavelenght", "wavelength"),
        (lambda **k: files_of("none", **k), "max_byte", "max_bytes"),
        (lambda **k: fit_pupil_patches(None, None, (1, 1), **k), "term", "terms"),
    ):
        with pytest.raises(TypeError, match=f"no keyword '{name}': did you mean {nearest}="):
            call(**{name: 1})


def test_a_file_that_is_opened(tmp_path):
    np.save(tmp_path / "views.npy", np.ones((3, 3, 8, 9), np.uint8))
    with (
        pytest.raises(TypeError, match=r"open_lightfield .*'lattices': did you mean lattice=\?"),
        clplen.open_lightfield(tmp_path / "views.npy", lattices=1),
    ):
        pass


def test_results(device, tmp_path):
    lf = LightField.from_array(np.ones((3, 3, 8, 9), np.float32), device=device)
    with pytest.raises(TypeError, match=r"LightField.save has no keyword 'overwrite': it has none"):
        lf.save(tmp_path / "lf.h5", overwrite=True)
    assert not list(tmp_path.iterdir())
    with pytest.raises(TypeError, match=r"LightField.plot .*'regions': did you mean region=\?"):
        lf.plot(regions=2)
