"""A small picture of a frame, refocused: what a series shows while it runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.microscopy.model.images import PointImages

Vector = np.ndarray[Any, Any]

LEAST = 256  # pixels along the shorter side, at least
GAP = 1  # pixels of lenslets between the pictures
TOP = 99.9  # per cent of the pixels are no brighter than white


def preview(counts: Vector, images: PointImages, device: Device) -> Vector:
    """A rectified frame refocused on the first, the middle and the last plane, side by side.

    A lenslet is a pixel. Sub-images move from view to view by d = -z M^2 dx/(n f_mu p) lenslets, dx
    = p/N with N pixels a lenslet, in the paraxial limit (Levoy et al. 2006).
    """
    n = images.pixels
    rows, columns = counts.shape[0] // n, counts.shape[1] // n
    views = counts.reshape(rows, n, columns, n).transpose(1, 3, 0, 2)
    lf = LightField.from_array(np.ascontiguousarray(views, np.float32), device=device)
    planes = images.planes[[0, len(images.planes) // 2, -1]]
    pictures = [refocus(lf, disparity=d).to_numpy() for d in disparities(planes, images)]
    gap = np.zeros((rows, GAP), np.float32)
    picture = np.hstack([pictures[0], gap, pictures[1], gap, pictures[2]])
    picture = np.maximum(picture, 0) / max(float(np.percentile(picture, TOP)), 1e-30)
    size = -(-LEAST // rows)
    grey = (255 * np.sqrt(np.minimum(picture, 1)) + 0.5).astype(np.uint8)
    return np.repeat(np.repeat(grey, size, axis=0), size, axis=1)


def disparities(z: Vector, images: PointImages) -> Vector:
    """d of planes at z metres: lenslets from one pixel of theirs to the next."""
    about = images.parameters
    step = about["lenslet_pitch"] / images.pixels
    scale = about["magnification"] ** 2 * step / about["medium_index"]
    scale /= about["lenslet_focal_length"] * about["lenslet_pitch"]
    return np.asarray(-z * scale)
