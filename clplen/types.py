"""Type aliases of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

# any dtype and number of axes
Array = np.ndarray[Any, Any]
# fixed dtype
Float32Array = np.ndarray[Any, np.dtype[np.float32]]
Float64Array = np.ndarray[Any, np.dtype[np.float64]]
Complex128Array = np.ndarray[Any, np.dtype[np.complex128]]
