"""Whether an array on a device holds NaN or infinity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

if TYPE_CHECKING:
    from clplen.compute.device import Device


def count_bad(array: cla.Array, device: Device) -> int:
    """Number of NaN and infinite samples of a float32, float64, complex64 or complex128 array.

    Integer arrays have none; a complex sample counts once for each bad part.
    """
    if array.dtype.kind not in "fc" or array.size == 0:
        return 0
    nx = array.shape[-1] * (2 if array.dtype.kind == "c" else 1)
    rows = int(np.prod(array.shape[:-1], dtype=np.int64))
    defines = {"DOUBLE": True} if array.dtype.itemsize // (1 + (array.dtype.kind == "c")) == 8 else {}
    bad = device.empty((rows,), np.int32)
    kernel = device.kernel("finite.cl", "count_bad", **defines)
    device.launch(kernel, (rows,), bad, array, np.int32(rows), np.int32(nx))
    return int(device.download(bad).sum(dtype=np.int64))
