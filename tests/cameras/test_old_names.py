"""Arguments and attributes of scenes still go by their old names, with a warning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clplen import PicturePlane
from clplen.cameras import Plane, Sphere
from clplen.cameras.scenes.surfaces import Spot
from clplen.microscopy.objects.points import match_points

OLD: dict[str, tuple[Callable[..., Any], str, str]] = {
    "picture": (lambda **z: PicturePlane([[1.0]], 1e-3, **z), "dz", "z"),
    "plane": (Plane, "d", "disparity"),
    "sphere": (lambda **d: Sphere((0, 0), 1.0, height=0.5, **d), "d", "disparity"),
    "spot": (lambda **d: Spot((0, 0), 1.0, **d), "d", "disparity"),
}


@pytest.mark.parametrize("name", OLD)
def test_old_names_of_lengths_and_disparities(name: str) -> None:
    make, old, new = OLD[name]
    with pytest.warns(DeprecationWarning, match=f"takes {new}=; its old name {old}= is"):
        source = make(**{old: 0.25})
    assert getattr(source, new) == 0.25
    with pytest.warns(DeprecationWarning, match=f"read .{new}"):
        assert getattr(source, old) == 0.25
    with pytest.raises(TypeError, match="twice"):
        make(**{old: 0.25, new: 0.5})


def test_old_name_of_the_tolerance_of_points() -> None:
    points = np.zeros((1, 3))
    with pytest.warns(DeprecationWarning, match="takes tolerance="):
        assert match_points(points, points, within=(1, 1, 1)).tolist() == [[0, 0]]
