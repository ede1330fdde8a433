"""True depth of synthetic scenes, written and read."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from clplen.cameras.scenes.ground_truth import Truth, truth_of
from clplen.io import write_truth

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
