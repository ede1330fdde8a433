"""Rims of apertures on samples: a step without the frequencies that the samples cannot carry."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

Values = np.ndarray[Any, np.dtype[np.float64]]

RIM = 12  # samples on either side of a rim that its weights reach, as in rim_weights.cl
RIM_STEPS = 64  # of their table, a sample
STOP_DB = 90.0  # at most, of what would alias


@lru_cache(maxsize=64)
def rim_weights(kept: float, stopped: float) -> Values:
    """Weights across a rim, from `RIM` samples outside it to as many inside.

    A step, convolved with Kaiser's low-pass filter (Kaiser 1974): frequencies across the rim up to
    ``kept`` stay as they are, those from ``stopped`` on are gone.
    """
    stop_db = 14.36 * 2 * RIM * max(stopped - kept, 0.0) + 7.95
    beta = 0.1102 * max(min(stop_db, STOP_DB) - 8.7, 0.0)
    t = (np.arange(2 * RIM * RIM_STEPS) + 0.5) / RIM_STEPS - RIM
    taper = np.i0(beta * np.sqrt(1 - (t / RIM) ** 2)) / np.i0(beta)
    total = np.concatenate([[0.0], np.cumsum(np.sinc((kept + stopped) * t) * taper)])
    weights = np.asarray(total / total[-1])
    weights.flags.writeable = False
    return weights
