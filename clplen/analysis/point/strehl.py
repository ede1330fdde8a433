"""The Strehl ratio of a wavefront: exactly, and from its rms."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.errors import ShapeError


def wavefront_rms(phase: Any, *, weight: Any = None) -> float:
    """Standard deviation of a wavefront over the pupil (Born and Wolf 1999, section 9.1.2).

    Parameters
    ----------
    phase : array_like
        In radians.
    weight : array_like, optional
        Amplitude over the pupil, same shape, not negative: 0 outside; default 1.

    Returns
    -------
    float
        Radians.

    Raises
    ------
    ShapeError, ValueError
        If the shapes differ, a number is not finite, or the pupil is dark.
    """
    phi, w = _pupil(phase, weight)
    mean = np.sum(w * phi) / w.sum()
    return float(np.sqrt(np.sum(w * (phi - mean) ** 2) / w.sum()))


def wavefront_strehl(phase: Any, *, weight: Any = None) -> float:
    """Intensity on the reference point over that of the flat wavefront.

    abs(sum w exp(i phase))^2/(sum w)^2 (Born and Wolf 1999, section 9.1.2). The peak itself may lie
    beside that point: `PSF.strehl` finds it.

    Parameters
    ----------
    phase, weight
        As in `wavefront_rms`.
    """
    phi, w = _pupil(phase, weight)
    return float(np.abs(np.sum(w * np.exp(1j * phi)) / w.sum()) ** 2)


def strehl_of_rms(rms: Any) -> Any:
    """exp(-sigma^2): the Strehl ratio of a wavefront with a small rms (Mahajan 1983).

    Marechal's (1 - sigma^2/2)^2 (Born and Wolf 1999, section 9.3) has the same first terms.

    Parameters
    ----------
    rms : array_like
        sigma in radians; right within a few hundredths up to about 1.

    Returns
    -------
    numpy.ndarray or float

    Raises
    ------
    ValueError
        If a number is negative or not finite.
    """
    sigma = np.asarray(rms, np.float64)
    if not (np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise ValueError(f"The rms of a wavefront is finite and not negative, not {rms!r}.")
    found = np.exp(-(sigma**2))
    return float(found) if found.ndim == 0 else found


def _pupil(phase: Any, weight: Any) -> tuple[Any, Any]:
    phi = np.asarray(phase, np.float64)
    w = np.ones(phi.shape) if weight is None else np.asarray(weight, np.float64)
    if w.shape != phi.shape:
        raise ShapeError(f"The phase has shape {phi.shape}, its weights {w.shape}.")
    if not (np.isfinite(phi).all() and np.isfinite(w).all() and (w >= 0).all() and w.sum() > 0):
        raise ValueError(
            "Phase and weights of a wavefront are finite, and the weights not negative nor all 0."
        )
    return phi, w
