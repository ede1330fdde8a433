"""How well the views of a light field agree with its centre on a plane, past what hides it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.samples import C_TYPE
from clplen.lightfield.shifts import unit_steps

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.lightfield import LightField

Table = np.ndarray[Any, Any]
Vector = np.ndarray[Any, np.dtype[np.float64]]

GROUPS = 9  # all views, and eight half apertures
RATIO, MARGIN = 1.2, 0.17  # how much better a half must agree; the margin in levels a channel
TRUNCATION = 10.0  # levels a channel: worse agreement than this is none
_SMOOTH = 0.1065  # taps beside the middle: a Gaussian of half a pixel
_BLOCK = 256  # pixels of a row that an item of a CPU takes
_ALMOST = 1e-6  # of a view step: on the line between two halves


@dataclass(frozen=True)
class Views:
    """The views that are compared, sorted by the half apertures that they belong to.

    Attributes
    ----------
    view : numpy.ndarray
        int32, shape (K,): number v U + u of each.
    step : numpy.ndarray
        float64, shape (K, 2): (y, x) in pixels from a point's place in the centre view to its
        sample, for disparity 1.
    first : numpy.ndarray
        int32, shape (patterns + 1,): where the views of each pattern begin.
    pattern : numpy.ndarray
        float32, shape (patterns, 9): share of those views in every group.
    reference : numpy.ndarray
        int32: which of them make the centre, and with what ``share`` (float32, sum 1).
    """

    view: Table
    step: Vector
    first: Table
    pattern: Table
    reference: Table
    share: Table

    def on(self, device: Device) -> list[Any]:
        """The tables of groups and references, as both kernels take them."""
        return [
            device.upload(self.first),
            device.upload(self.pattern),
            np.int32(len(self.pattern)),
            device.upload(self.reference),
            device.upload(self.share),
            np.int32(len(self.reference)),
        ]


def sorted_views(lf: LightField) -> Views:
    """The views with a weight and their groups.

    The eight half apertures are bounded by lines through the middle, 45 degrees apart; a view on
    such a line belongs to both sides by one half, the middle view only to the whole.

    Raises
    ------
    ValueError
        If fewer than two views have a weight.
    """
    lit = np.flatnonzero(lf.weights.ravel() > 0).astype(np.int32)
    if lit.size < 2:
        raise ValueError(f"Depth needs at least two views with a weight, not {lit.size}.")
    steps = unit_steps(lf).reshape(-1, 2)
    offsets = -steps[lit] / np.maximum(np.abs(steps).max(axis=0), _ALMOST)
    angles = np.arange(8) * np.pi / 4
    sides = offsets @ np.stack((np.sin(angles), np.cos(angles)))
    halves = np.where(np.abs(sides) < _ALMOST, 0.5, sides > 0)
    halves[np.abs(offsets).max(axis=1) < _ALMOST] = 0
    pattern, which = np.unique(
        np.column_stack((np.ones(len(lit)), halves)), axis=0, return_inverse=True
    )
    order = np.argsort(which.ravel(), kind="stable")
    counts = np.bincount(which.ravel(), minlength=len(pattern))
    reference, share = _references(steps[lit][order])
    return Views(
        lit[order],
        steps[lit][order],
        np.concatenate(([0], np.cumsum(counts))).astype(np.int32),
        pattern.astype(np.float32),
        reference,
        share,
    )


def _references(steps: Vector) -> tuple[Table, Table]:
    """The views next to the middle, bilinear; the nearest where none lies within a step of it."""
    share = np.prod(np.maximum(1 - np.abs(steps), 0), axis=1)
    if not share.any():
        share[np.argmin((steps**2).sum(axis=1))] = 1
    chosen = np.flatnonzero(share)
    return chosen.astype(np.int32), (share[chosen] / share.sum()).astype(np.float32)


def smoothed(lf: LightField, gain: float) -> cla.Array:
    """The samples times a gain, blurred by half a pixel so that interpolation changes little.

    Returns
    -------
    pyopencl.array.Array
        float32, the light field's shape.
    """
    V, U, ny, nx, channels = (*lf.shape, 1)[:5]
    out = lf.device.empty(lf.shape, np.float32)
    lf.device.launch_rows(
        lf.device.kernel("matching.cl", "smooth", SAMPLE=C_TYPE[lf.dtype]),
        (V * U, ny, nx * channels),
        out,
        lf.data,
        np.float32(gain),
        np.float32(_SMOOTH),
        *(np.int32(n) for n in (ny, nx, channels)),
    )
    return out


def match_costs(samples: cla.Array, views: Views, planes: Vector, *, device: Device) -> cla.Array:
    """Cost of every plane at every pixel of the centre view.

    The mean over the views of the absolute difference to the centre, added over the channels and
    truncated; over the half aperture that agrees best where that is clearly better than the whole:
    what hides a place from one side of the aperture leaves it visible from the other.

    Parameters
    ----------
    samples : pyopencl.array.Array
        From `smoothed`, in levels.
    views : Views
    planes : numpy.ndarray
        Disparities, shape (P,).
    device : Device

    Returns
    -------
    pyopencl.array.Array
        float32, shape (P, y, x).
    """
    _, _, ny, nx, channels = (*(int(n) for n in samples.shape), 1)[:5]
    shift = np.clip(planes[:, None, None] * views.step, -(2**20), 2**20)
    whole = np.floor(shift)
    part = shift - whole
    out = device.empty((planes.size, ny, nx), np.float32)
    block = _BLOCK if device.rows else 1
    device.launch(
        device.kernel("matching.cl", "match", CHANNELS=channels, BLOCK=block),
        (-(-nx // block), ny, planes.size),
        out,
        samples,
        device.upload(views.view),
        device.upload(whole.astype(np.int32)),
        device.upload(_cubic(part).astype(np.float32)),
        device.upload((part > 0).astype(np.int32)),
        *views.on(device),
        *(np.int32(n) for n in (len(views.view), ny, nx)),
        *(np.float32(t) for t in thresholds(channels)),
        group=(1, 1, 1),
    )
    return out


def thresholds(channels: int) -> tuple[float, float, float]:
    """tau, ratio and margin of the kernels."""
    return (TRUNCATION * channels, RATIO, MARGIN * channels)


def _cubic(part: Vector) -> Vector:
    """Taps at -1, 0, 1 and 2 for a fraction (Keys 1981, a = -1/2); a new last axis."""
    rest = 1 - part
    outer, far = -part * rest**2 / 2, -rest * part**2 / 2
    inner = 1 + part**2 * (1.5 * part - 2.5)
    return np.stack((outer, inner, 1 - outer - inner - far, far), axis=-1)
