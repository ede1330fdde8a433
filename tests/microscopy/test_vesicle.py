"""A real frame of a giant vesicle, from the white frame's lattice to a hollow shell."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from clplen.microscopy.model.psf import point_images
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

EXAMPLES = Path(__file__).parents[2] / "examples"
Z = np.arange(-16.5, 17, 3) * 1e-6


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The vesicle of examples/, with the frame's reader and measure."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module("vesicle")


@pytest.mark.thorough
def test_a_real_vesicle_is_a_hollow_sphere(device, data_folder, example):
    if not (data_folder / "lfm_guv").is_dir():
        pytest.skip(f"no lfm_guv in {data_folder}")
    shell = importlib.import_module("shell")
    seen = example.seen(*example.read(), 15, device)
    # an independent fit of the white frame: 15.387 along x, 15.410 along y, -0.12 degrees
    assert seen.lattice.pitch == pytest.approx((15.387, 15.410), abs=5e-3)
    assert np.degrees(seen.lattice.rotation) == pytest.approx(-0.12, abs=0.02)
    images = point_images(example.camera(device, 15), Z, voxels_per_lenslet=2, cut=1e-2)
    projector = Projector(images, (28, 28), device=device)
    found = deconvolve(
        seen.counts, projector, iterations=15, white=seen.white, background=seen.haze
    )
    assert (np.diff(found.residuals) < 0).all()
    # .0400; pupils counted in the white frame too .055, a pixel off .049
    assert found.residuals[-1] < 0.044
    voxels = shell.Voxels(Z, 100e-6 / 60 / 2, projector.volume_shape)
    sphere = shell.find_shell(found.volume, voxels, centre=(0, 0, 0), radius=12e-6, within=45)
    # 50 planes 1 um apart: centre -1.25, .64, -.53 um and radii 13.52, 13.36, 13.40 um
    assert sphere.centre * 1e6 == pytest.approx([-1.25, 0.64, -0.53], abs=0.3)
    assert sphere.radii[1:] * 1e6 == pytest.approx([13.4, 13.4], abs=0.3)
    assert sphere.radii[0] == pytest.approx(sphere.radii[1:].mean(), rel=0.2)
    inside, outside = shell.contrast(found.volume, voxels, sphere)
    assert inside < 0.04  # .021; haze left in .056
    assert outside < 0.1  # .059; haze left in .168
