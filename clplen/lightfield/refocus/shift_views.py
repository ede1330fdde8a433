"""Views moved by distances of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.errors import ShapeError
from clplen.lightfield.refocus.phase_ramps import channels_of, keep_real, take_views, turned

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField


def move_views(lf: LightField, steps: Any) -> LightField:
    """A light field whose views are moved, each by its own distance.

    What lay at (y + steps[v, u, 0], x + steps[v, u, 1]) of view (v, u) comes to (y, x), by the
    phase of its spectrum: exact below the Nyquist frequency, edges periodic, sums kept. The views
    keep their places on the main lens.

    Parameters
    ----------
    lf : LightField
    steps : array_like
        Shape (V, U, 2), (y, x) in pixels, finite.

    Returns
    -------
    LightField
        float32, of the same shape; it has no raw image.

    Raises
    ------
    ShapeError
        If the steps are not two for each view.
    ValueError
        If one is not finite.
    DeviceError
        If both light fields do not fit the device.
    """
    moves = np.asarray(steps, np.float64)
    V, U, ny, nx = lf.shape[:4]
    if moves.shape != (V, U, 2):
        raise ShapeError(f"Views are moved by (y, x) each, shape {(V, U, 2)}, not {moves.shape}.")
    if not np.isfinite(moves).all():
        raise ValueError("The steps of views are finite numbers of pixels.")
    device, row_shape = lf.device, (U, ny, nx, *lf.shape[4:])
    device.require_memory(2 * 4 * int(np.prod(lf.shape)), "The light field of moved views")
    out = device.empty(lf.shape, np.float32)
    row = device.empty(row_shape, np.float32)
    for v in range(V):
        for channel in range(channels_of(lf)):
            views = take_views(lf, np.ones(U), np.arange(v * U, (v + 1) * U), channel)
            device.fft.forward(views, device)
            turned(lf, views, *moves[v].T)
            device.fft.inverse(views, device)
            keep_real(row, views, np.ones(U), channel, lf)
        device.copy_into(out, row, v * row.nbytes)
    return replace(lf, data=out, raw=None)
