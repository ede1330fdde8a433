"""Pupils found from frames of beads and of anything, and what is refused."""

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera, PointSources, ShapeError
from clplen.microscopy import fit_pupil, fit_pupil_patches
from clplen.microscopy.pupil.bead_pupil import find_beads
from clplen.microscopy.pupil.volume_pupil import (
    Observed,
    Sampling,
    images_and_tangents,
    state_of,
    with_coefficients,
)
from clplen.microscopy.reconstruction.projector import Projector

OPTICS = {"magnification": 10, "na": 0.2, "wavelength": 525e-9, "pixels_per_lenslet": 11}
TRUE = {6: 35e-9, 8: -30e-9, 11: 25e-9}
BEADS = np.array([(7e-6, -5e-6, 55e-6), (-9e-6, 3e-6, -48e-6), (2e-6, 11e-6, 20e-6)])


def microscope(device, pupil=None, count=9):
    mla = MicrolensArray(60e-6, 1.5e-3, count=count, fill="full")
    return PlenopticCamera.microscope(mla=mla, device=device, pupil=pupil, **OPTICS)


@pytest.fixture(scope="module")
def of_beads(device):
    points = PointSources(BEADS, power=[6e4, 4e4, 5e4])
    mean = microscope(device, TRUE).expose(points).to_numpy() + 0.25
    return np.random.default_rng(4).poisson(mean)


def test_beads(device, of_beads):
    where = BEADS + np.array([[0.8, -0.6, 1.5], [-0.5, 0.4, -2], [0.3, 0.7, 1]]) * 1e-6
    found = fit_pupil(of_beads, microscope(device), beads=where, terms=tuple(TRUE))
    off = found.coefficients - np.array(list(TRUE.values()))
    assert (np.abs(off) < 4 * found.errors + 1e-9).all()  # 1 nm: the narrower window
    assert (found.errors < 2e-9).all()
    assert np.abs(found.positions - BEADS).max() < 0.3e-6
    assert found.residuals[-1] < 0.2 * found.residuals[0]
    assert 0.8 < found.chi2 < 1.2
    assert found.energies == pytest.approx([6e4, 4e4, 5e4], rel=0.03)


def test_beads_are_found(device, of_beads):
    z = np.arange(-75, 76, 15) * 1e-6
    even = np.ones(of_beads.shape)
    seen = Observed(of_beads, even, 0.25 * even, 1.0)
    found = find_beads(microscope(device), seen, z, voxels=3, binning=1, cut=5e-3)
    for bead in BEADS:
        near = np.abs(found - bead).max(axis=1)
        assert near.min() < 8e-6
        assert np.abs(found[near.argmin(), :2] - bead[:2]).max() < 2e-6


def scene(device, terms=TRUE, shape=(8, 7), seed=1):
    """A frame of lines in two planes, without noise, and how it is sampled."""
    how = Sampling(np.array([-60e-6, 45e-6]), 3, 1, 0.01, 15)
    images, _ = images_and_tangents(
        microscope(device, terms), how.planes, (), voxels=3, binning=1, cut=0.01
    )
    projector = Projector(images, shape, device=device)
    volume = np.zeros(projector.volume_shape)
    rng = np.random.default_rng(seed)
    for plane in volume:
        for t in np.linspace(0, 1, 60):
            y, x = ((1 - t) * rng.uniform(0.1, 0.4), t)[::1]
            plane[int(y * len(plane)), int(x * (plane.shape[1] - 1))] += 50
        plane[:, rng.integers(plane.shape[1])] += 30
    return projector.forward(volume).astype(np.float64) + 0.01, how


@pytest.mark.thorough
def test_anything(device):
    frame, how = scene(device)
    found = fit_pupil(
        frame, microscope(device), planes=how.planes, terms=tuple(TRUE), iterations=15, steps=2,
        cut=0.01, background=0.01,
    )  # fmt: skip
    off = found.coefficients - np.array(list(TRUE.values()))
    assert np.linalg.norm(off) < 6e-9  # 52 nm were put in
    assert found.residuals[-1] < 0.6 * found.residuals[0]
    assert found.volume.shape == (2, 24, 21)


def test_slopes_are_those_of_what_is_left(device):
    """-E against two states, the weights of the middle one."""
    frame, how = scene(device)
    seen = Observed(frame, np.ones(frame.shape), np.full(frame.shape, 0.01), 1.0)
    camera, step = microscope(device, TRUE), 6e-9
    middle = state_of(camera, seen, (9,), how)
    left = []
    for sign in (1, -1):
        there = state_of(with_coefficients(camera, (9,), np.array([sign * step])), seen, (9,), how)
        left.append(there.residuals)
    slope = (left[0] - left[1]) / (2 * step)
    along = -(middle.slopes[0] @ slope) / np.linalg.norm(slope) / np.linalg.norm(middle.slopes[0])
    assert along > 0.9
    assert np.linalg.norm(middle.slopes[0]) == pytest.approx(np.linalg.norm(slope), rel=0.2)


@pytest.mark.thorough
def test_patches(device):
    frame, how = scene(device, shape=(5, 10))
    parts = fit_pupil_patches(
        frame, microscope(device), (1, 2), planes=how.planes, terms=(6,), iterations=5, steps=1,
        cut=0.01,
    )  # fmt: skip
    assert [len(row) for row in parts] == [2]
    alone = fit_pupil(
        frame[:, 55:], microscope(device), planes=how.planes, terms=(6,), iterations=5, steps=1,
        cut=0.01,
    )  # fmt: skip
    assert parts[0][1].coefficients == pytest.approx(alone.coefficients, rel=1e-4)
    with pytest.raises(ShapeError, match="got 2 patches of 5"):
        fit_pupil_patches(frame, microscope(device), (2, 1), planes=how.planes)


def other_array(device, f=1.5e-3, **array):
    mla = MicrolensArray(60e-6, f, count=9, fill="full", **array)
    return PlenopticCamera.microscope(mla=mla, device=device, **OPTICS)


def test_what_is_not_fitted(device):
    for change, error, words in [
        ({"terms": (4, 5)}, ValueError, "must be from 5 on, got 4"),
        ({"terms": (5, 5)}, ValueError, "each once"),
        ({"planes": None}, ValueError, "Give either beads="),
        ({"beads": "all"}, ValueError, "an array of positions or 'find'"),
        ({"planes": None, "beads": BEADS[:, :2]}, ShapeError, r"shape \(n, 3\)"),
        ({"planes": None, "beads": BEADS * 1e6}, ValueError, "did you mean"),
        ({"planes": None, "beads": BEADS * 20}, ValueError, "must be within x"),
        ({"planes": None, "beads": BEADS * np.nan}, ValueError, "finite positions"),
        ({"gain": 0}, ValueError, "gain must be positive"),
        ({"steps": 0}, ValueError, "steps"),
        ({"background": -1.0}, ValueError, "background has values that are negative"),
        ({"white": np.ones((3, 3))}, ShapeError, "white must have the shape"),
        ({"frame": np.full((55, 55), np.nan)}, ValueError, "not finite"),
        ({"frame": np.zeros((55, 55))}, ValueError, "must have counts"),
        ({"frame": np.ones((44, 55))}, ShapeError, "at least 5 along an axis"),
        ({"camera": None}, TypeError, "PlenopticCamera.microscope"),
        ({"camera": other_array(device, lattice="hexagonal")}, ValueError, "hexagonal array"),
        ({"camera": other_array(device, f=(1.5e-3, 1.7e-3))}, ValueError, "a square array with 2"),
        ({"beads": "find", "planes": [0.0, 1e-5]}, ShapeError, "at least 3 planes"),
        ({"beads": "find", "planes": [-1e-5, 0.0, 1e-5]}, ValueError, "No bead"),
    ]:
        given = {
            "frame": np.ones((55, 55)),
            "camera": microscope(device),
            "planes": [1e-5],
        } | change
        with pytest.raises(error, match=words):
            fit_pupil(given.pop("frame"), given.pop("camera"), **given)
