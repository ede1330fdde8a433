"""True depth of synthetic scenes, written and read."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from clplen.cameras.scenes.ground_truth import Truth, truth_of
from clplen.errors import FormatError
from clplen.io import read_masks, write_truth

SHAPE = (11, 17)
NAMES = ["edges", "near", "far", "planes", "smooth"]


def truth(**words: object) -> Truth:
    """A step of depth off the middle, a curved part, and a hole."""
    random = np.random.default_rng(5)
    surface = np.zeros(SHAPE, np.int32)
    surface[:, 6:], surface[8:, 12:] = 1, -1
    disparity = np.where(surface > 0, 1.2, -0.7) + 0.01 * random.normal(size=SHAPE)
    disparity[surface < 0] = np.nan
    return truth_of(disparity, surface, [False, True], **words)


def test_what_the_file_says_of_its_maps(tmp_path: Path):
    z = np.random.default_rng(6).normal(size=SHAPE).astype(np.float32)
    known = truth(z=z)
    write_truth(tmp_path / "with.h5", known)
    write_truth(tmp_path / "without.h5", truth())
    with h5py.File(tmp_path / "with.h5") as file:
        np.testing.assert_array_equal(file["z"], z)
        np.testing.assert_array_equal(file["surface"], known.surface)
        assert file["surface"].dtype == np.int32
        assert file["z"].attrs["units"] == "m"
        assert "farther" in file["z"].attrs["meaning"]
        assert file["disparity"].attrs["units"] == "pixels a view step"
        assert all(file["masks"][name].attrs["meaning"] for name in NAMES)
    with h5py.File(tmp_path / "without.h5") as file:
        assert "z" not in file


def test_what_is_said_where_there_are_no_masks(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["disparity"] = np.zeros((3, 5))
    with pytest.raises(FormatError, match=r"a\.h5 has no masks: .* it holds disparity \(3, 5\)"):
        read_masks(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["masks/near"] = np.zeros((2, 3, 5))
    with pytest.raises(FormatError, match=r"'/masks/near' of shape \(2, 3, 5\) .* no map"):
        read_masks(tmp_path / "a.h5")
