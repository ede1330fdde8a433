"""A selector is taken wherever a Device is, and anything else is refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import clplen

GRID = clplen.Grid((8, 8), 1e-6)
LAM = 5e-7
L = np.arange(3 * 3 * 16 * 16, dtype=np.float32).reshape(3, 3, 16, 16)
MLA = clplen.MicrolensArray(150e-6, 10e-3, count=5, fill="full")
CAMERA = {"mla": MLA, "wavelength": LAM, "pixels_per_lenslet": 30}
STORED = clplen.StoredLightField.from_array(L)
SOURCE = {"wavelength": LAM, "seed": 1, "index": 0}

# Every public call with a parameter `device`, given it; its result has a device or has none.
CALLS: dict[str, Callable[..., Any]] = {}
