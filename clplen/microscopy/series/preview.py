"""Small refocused picture of a frame, shown while a series runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.microscopy.model.images import PointImages

Vector = np.ndarray[Any, Any]

MIN_SIDE_PIXELS = 256  # a size that is comfortable to look at on a screen
GAP_LENSLETS = 1  # between the pictures
WHITE_PERCENTILE = 99.9  # brightness that is drawn white


def preview(counts: Vector, images: PointImages, device: Device) -> Vector:
    """Refocus a rectified frame on the first, the middle and the last plane, side by side.

    A lenslet becomes a pixel. The disparity between adjacent views is d = -z M^2 dx/(n f_mu p)
    lenslets, with dx = p/N and N pixels per lenslet, in the paraxial limit (Levoy et al. 2006).
    """
    n = images.pixels
    rows, columns = counts.shape[0] // n, counts.shape[1] // n
    views = counts.reshape(rows, n, columns, n).transpose(1, 3, 0, 2)
    lf = LightField.from_array(np.ascontiguousarray(views, np.float32), device=device)
    planes = images.planes[[0, len(images.planes) // 2, -1]]
    pictures = [refocus(lf, disparity=d).to_numpy() for d in disparities(planes, images)]
    gap = np.zeros((rows, GAP_LENSLETS), np.float32)
    picture = np.hstack([pictures[0], gap, pictures[1], gap, pictures[2]])
    picture = np.maximum(picture, 0) / max(float(np.percentile(picture, WHITE_PERCENTILE)), 1e-30)
    size = -(-MIN_SIDE_PIXELS // rows)
    grey = (255 * np.sqrt(np.minimum(picture, 1)) + 0.5).astype(np.uint8)
    return np.repeat(np.repeat(grey, size, axis=0), size, axis=1)


def disparities(z: Vector, images: PointImages) -> Vector:
    """Return the disparities of planes at z metres, in lenslets per pixel of a lenslet."""
    parameters = images.parameters
    step = parameters["lenslet_pitch"] / images.pixels
    scale = parameters["magnification"] ** 2 * step / parameters["medium_index"]
    scale /= parameters["lenslet_focal_length"] * parameters["lenslet_pitch"]
    return np.asarray(-z * scale)
