"""Rims of apertures on samples: a step without frequencies beyond the band of the samples."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

Values = np.ndarray[Any, np.dtype[np.float64]]

RIM = 12  # half width of the filter in samples, as in rim_weights.cl
RIM_STEPS = 64  # table steps per sample
STOP_DB = 90.0  # maximum attenuation of the stop band


@lru_cache(maxsize=64)
def rim_weights(passband: float, stopband: float) -> Values:
    """Return the weights across a rim, from `RIM` samples outside to `RIM` samples inside.

    They are a step convolved with Kaiser's low-pass filter (Kaiser 1974): frequencies across the
    rim pass up to ``passband`` and are blocked from ``stopband`` on, in cycles per sample.
    """
    stop_db = 14.36 * 2 * RIM * max(stopband - passband, 0.0) + 7.95
    beta = 0.1102 * max(min(stop_db, STOP_DB) - 8.7, 0.0)
    t = (np.arange(2 * RIM * RIM_STEPS) + 0.5) / RIM_STEPS - RIM
    taper = np.i0(beta * np.sqrt(1 - (t / RIM) ** 2)) / np.i0(beta)
    total = np.concatenate([[0.0], np.cumsum(np.sinc((passband + stopband) * t) * taper)])
    weights = np.asarray(total / total[-1])
    weights.flags.writeable = False
    return weights
