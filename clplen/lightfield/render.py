"""Pictures from the views as they are: one view, a synthetic aperture, an epipolar slice."""

from __future__ import annotations

from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.image import Image
from clplen.lightfield.aperture import Weights, aperture_weights
from clplen.lightfield.shear import shear_sum

if TYPE_CHECKING:
    from clplen.lightfield.lightfield import LightField


def view(lf: LightField, v: float, u: float) -> Image:
    """See `LightField.view`."""
    nearest = aperture_weights(lf, None, (v, u))
    weights = nearest * lf.weights
    return _mean(lf, weights if weights.any() else nearest)


def render(lf: LightField, *, aperture: Any, viewpoint: Any, total: bool) -> Image:
    """See `LightField.render`."""
    if aperture is None and viewpoint is not None and not total:
        return view(lf, *viewpoint)
    weights = view_weights(lf, aperture, viewpoint)
    return _sum(lf, weights) if total else _mean(lf, weights)


def view_weights(lf: LightField, aperture: Any, viewpoint: Any) -> Weights:
    """Weights of an aperture times the light field's own.

    Parameters
    ----------
    lf : LightField
    aperture, viewpoint
        See `LightField.render`.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), not all 0.

    Raises
    ------
    ValueError
        If no view is left, or from `aperture_weights`.
    """
    weights = aperture_weights(lf, aperture, viewpoint) * lf.weights
    if not weights.any():
        raise ValueError(
            f"The aperture {aperture!r} (viewpoint {viewpoint!r}) leaves only views of weight 0: "
            "give a wider one or another viewpoint."
        )
    return weights


def epi(
    lf: LightField, *, y: int | None, x: int | None, v: int | None, u: int | None
) -> Image:
    """See `LightField.epi`."""
    given = {name: n for name, n in zip("yxvu", (y, x, v, u), strict=True) if n is not None}
    if set(given) not in ({"y", "v"}, {"x", "u"}):
        raise ValueError(
            f"An epipolar-plane image takes y and v, or x and u, not {', '.join(given) or 'none'}."
        )
    sizes = dict(zip("vuyx", lf.shape, strict=False))
    for name, n in given.items():
        if not isinstance(n, Integral) or not 0 <= n < sizes[name]:
            raise ValueError(f"{name} is a whole number from 0 to {sizes[name] - 1}, not {n!r}.")
    steps = dict(zip("vuyx", _steps(lf.shape), strict=True))
    rows, columns = "ux" if "y" in given else "vy"
    channels = lf.shape[4:]
    out = lf.device.empty((sizes[rows], sizes[columns], *channels), np.float32)
    count = channels[0] if channels else 1
    lf.device.launch_rows(
        lf.device.kernel("views.cl", "slice", SAMPLE=SAMPLE[lf.dtype]),
        (sizes[rows], sizes[columns] * count),
        out,
        lf.data,
        np.int64(sum(int(n) * steps[name] for name, n in given.items())),
        np.int64(steps[rows]),
        np.int64(steps[columns]),
        np.int32(sizes[columns]),
        np.int32(count),
    )
    return Image(out, lf.device)
