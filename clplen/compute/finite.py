"""Whether an array on a device holds NaN or infinity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

if TYPE_CHECKING:
    from clplen.compute.device import Device

_DEFINES = {np.dtype(np.float64): {"DOUBLE": True}, np.dtype(np.float16): {"HALF": True}}
LENGTH = 2**14  # reals that one work-item reads: enough to forget the cost of starting it


def count_bad(array: cla.Array, device: Device) -> int:
    """Number of NaN and infinite samples of a float16 to float64, complex64 or complex128 array.

    Integer arrays have none; a complex sample counts once for each bad part.
    """
    if array.dtype.kind not in "fc" or array.size == 0:
        return 0
    reals = array.view(np.empty(0, array.dtype).real.dtype)
    defines = _DEFINES.get(reals.dtype, {})
    stretches = -(-int(reals.size) // LENGTH)
    bad = device.empty((stretches,), np.int32)
    kernel = device.kernel("finite.cl", "count_bad", **defines)
    device.launch(kernel, (stretches,), bad, reals, np.int64(reals.size), np.int32(LENGTH))
    return int(device.download(bad).sum(dtype=np.int64))
