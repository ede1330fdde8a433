"""What is written by hand computes what clplen computes, where all views reach."""

from __future__ import annotations

from typing import Any

import byhand
import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

SHAPES = [(3, 4, 31, 37, 3), (4, 3, 29, 33)]
DISPARITY = 1.37


def views(shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    return np.random.default_rng(4).random(shape, dtype=np.float32)


@pytest.mark.parametrize("shape", SHAPES)
def test_numpy_is_what_clplen_refocuses(device: Device, shape: tuple[int, ...]) -> None:
    field = views(shape)
    margin, rows, columns = byhand.margins(shape, DISPARITY)
    picture = refocus(LightField.from_array(field, device=device), disparity=DISPARITY).to_numpy()
    inner = picture[margin : margin + rows, margin : margin + columns]
    np.testing.assert_allclose(byhand.numpy_slices(field, DISPARITY), inner, atol=2e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_form_that_is_installed_agrees_with_numpy(shape: tuple[int, ...]) -> None:
    field = views(shape)
    want = byhand.numpy_slices(field, DISPARITY)
    for one in byhand.by_hand(field, DISPARITY, (1, 2)):
        # OpenCV rounds the fraction of a shift to 1/32 of a pixel
        limit = 0.04 if "OpenCV" in one.name else 2e-6
        np.testing.assert_allclose(np.asarray(one.run()), want, atol=limit, err_msg=one.name)


def test_planes_by_numba() -> None:
    pytest.importorskip("numba", reason="numba is not installed")
    field, planes = views(SHAPES[0]), np.linspace(-1.5, 1.5, 11)
    found = byhand.numba_planes(field, planes, threads=2)()
    margin = byhand.margins(field.shape, 1.5)[0]
    for picture, d in zip(found, planes, strict=True):
        inner = margin - byhand.margins(field.shape, d)[0]
        want = byhand.numpy_slices(field, d)[inner:, inner:]
        rows, columns = picture.shape[:2]
        np.testing.assert_allclose(picture, want[:rows, :columns], atol=2e-6)
