"""The blur that linear interpolation between pixels adds, made the same for every plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.model.alpha_law import view_shifts

if TYPE_CHECKING:
    from clplen.lightfield.refocus.focal_stack import FocalStack

Vector = np.ndarray[Any, np.dtype[np.float64]]

_VARIANCE, _FOURTH = 1 / 4, 1 / 16  # moments, in pixels, of the mean of two neighbours
NO_TAPS = np.array([1.0, 0.0, 0.0])


def stack_taps(stack: FocalStack, planes: slice) -> Vector:
    """`evening_taps` of pictures of a focal stack.

    Views moved by whole pixels keep all their detail and others lose some, so that the sharpness
    of a focal stack has false peaks at whole disparities. After these taps every plane has
    lost the same, whatever the spectrum of the picture and its noise.

    Parameters
    ----------
    stack : FocalStack
        Not blurred if it has no weights.
    planes : slice

    Returns
    -------
    numpy.ndarray
        float64, shape (n, 2, 3): along y and along x, at distance 0, 1 and 2.
    """
    disparities = stack.disparities[planes]
    if stack.weights is None:
        return np.broadcast_to(NO_TAPS, (disparities.size, 2, 3))
    moved = view_shifts(stack.spacing, stack.weights.shape, disparities, positions=stack.positions)
    shares = [stack.weights.sum(axis=1), stack.weights.sum(axis=0)]
    if stack.positions is not None:
        shares = [stack.weights, stack.weights]
    taps = [
        [evening_taps(shift, share) for shift, share in zip(both, shares, strict=True)]
        for both in zip(*moved, strict=True)
    ]
    return np.array(taps)


def evening_taps(shift: Vector, weights: np.ndarray[Any, Any]) -> Vector:
    """Taps that, after the views' interpolation along one axis, blur as half a pixel does.

    A fraction f of a pixel mixes the samples f and 1 - f away with weights 1 - f and f: variance
    a = f (1 - f), fourth moment a (1 - 3 a). The taps bring the second and fourth moments of the
    mean over the views to those of f = 1/2 (for independent steps m2 + n2 and
    m4 + 6 m2 n2 + n4), so that, for views that lie symmetrically, the transfer functions
    of all shifts agree up to the fifth power of the frequency.

    Parameters
    ----------
    shift : numpy.ndarray
        Of the views, in pixels.
    weights : numpy.ndarray
        Of the views, same shape, not negative, not all 0.

    Returns
    -------
    numpy.ndarray
        float64, shape (3,): at distance 0, 1 and 2; over both sides they sum to 1.
    """
    part = shift - np.floor(shift)
    spread = part * (1 - part)
    total = weights.sum(dtype=np.float64)
    variance = (spread * weights).sum() / total
    fourth = (spread * (1 - 3 * spread) * weights).sum() / total
    n2 = _VARIANCE - variance
    n4 = _FOURTH - fourth - 6 * variance * n2
    second = (n4 - n2) / 24
    first = n2 / 2 - 4 * second
    return np.array([1 - 2 * (first + second), first, second])
