"""Names of array types that several rooms share."""

from __future__ import annotations

from typing import Any

import numpy as np

# of any type of samples, and of any number of axes
Array = np.ndarray[Any, Any]
# of one type of samples
Float32Array = np.ndarray[Any, np.dtype[np.float32]]
Float64Array = np.ndarray[Any, np.dtype[np.float64]]
Complex128Array = np.ndarray[Any, np.dtype[np.complex128]]
