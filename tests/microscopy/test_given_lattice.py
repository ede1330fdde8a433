"""Lattices that are told, and what a pitch other than the nominal one means."""

import math

import numpy as np
import pytest

from clplen import ShapeError
from clplen.lightfield import Lattice
from clplen.microscopy import preparation, rectify, square_lattice
from clplen.microscopy.frames.nominal_lattice import pitch_sentence


def test_a_lattice_by_its_pitch():
    found = square_lattice(33.04, (500, 600), offset=(20, 30), rotation=0.01)
    assert found.origin == (20, 30)
    assert found.pitch == pytest.approx((33.04, 33.04))
    assert found.rotation == pytest.approx(0.01)
    assert found.column[0] > 0  # +x turned towards +y
    corner = square_lattice(15, (31, 47))
    frame = np.random.default_rng(1).random((31, 47))
    assert np.array_equal(rectify(frame, corner), frame[:30, :45].astype(np.float32))


def test_frames_with_a_told_lattice(device):
    lattice = square_lattice(12.4, (150, 180), offset=(7, 8), rotation=0.02)
    frame = np.random.default_rng(2).random((150, 180)) + 1
    found = preparation(13, device=device, lattice=lattice)(frame)
    assert np.array_equal(found.counts, rectify(frame, lattice, device=device, pixels=13))
    assert found.white.shape == found.counts.shape
    assert (found.white == 1).all()
    with pytest.raises(ShapeError, match=r"frame has shape \(150, 181\) and the lattice"):
        preparation(13, device=device, lattice=lattice)(np.ones((150, 181)))
    with pytest.raises(ValueError, match="white frame defines the lattice"):
        preparation(13, device=device, lattice=lattice, white=frame)


def test_what_is_no_lattice():
    for words, error, message in [
        ({"pitch": 2.9}, ValueError, "must be at least 3 pixels"),
        ({"pitch": math.nan}, ValueError, "finite numbers"),
        ({"pitch": 15.0, "offset": (math.nan, 0.0)}, ValueError, "finite numbers"),
        ({"pitch": 15.0, "rotation": 2.0}, ValueError, "less than 90 degrees"),
        ({"pitch": 101.0}, ShapeError, "do not fit a frame of 100 x 130"),
    ]:
        with pytest.raises(error, match=message):
            square_lattice(shape=(100, 130), **words)


def test_lattices_of_no_frame(device):
    for lattice, message in [
        (Lattice("square", (7, 7), (15, 0), (0, 15)), "has no frame shape"),
        (Lattice("square", (7, 7), (1e-6, 0), (0, 1e-6), (90, 90)), "must be at least 3 pixels"),
        (Lattice("square", (7, 7), (15, 0), (14, 15), (90, 90)), "must form squares"),
        (Lattice("square", (7, 7), (15, 0), (0, 30), (90, 90)), "must form squares"),
        (Lattice("square", (7, 7), (1e8, 0), (0, 1e8), (90, 90)), "do not fit"),
    ]:
        with pytest.raises((ValueError, ShapeError), match=message):
            preparation(15, device=device, lattice=lattice)


def test_another_pitch_is_told():
    assert pitch_sentence(square_lattice(33.04 * 1.004, (500, 600)), 33.04) is None
    for ratio, said in [(1.019, "more"), (0.981, "less")]:
        found = pitch_sentence(square_lattice(33.04 * ratio, (500, 600)), 33.04)
        assert f"1.9 % {said}" in found
        assert f"magnifies {ratio:.4g} times" in found
        assert "the lenslet pitch is wrong" in found
