"""One magnification of a picture about its middle."""

from __future__ import annotations

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device


def magnify(picture: cla.Array, alpha: float, *, device: Device) -> cla.Array:
    """A picture on the synthetic plane: alpha^2 R(alpha x') about the middle, linear, 0 outside.

    Parameters
    ----------
    picture : pyopencl.array.Array
        float32, shape (y, x[, c]).
    alpha : float
        F/F' > 0.
    device : Device

    Returns
    -------
    pyopencl.array.Array
        float32, the picture's shape.
    """
    ny, nx, *channels = (int(n) for n in picture.shape)
    count = channels[0] if channels else 1
    out = device.empty(picture.shape, np.float32)
    tables = []
    for n in (ny, nx):
        position = (n - 1) / 2 + alpha * (np.arange(n) - (n - 1) / 2)
        whole = np.floor(np.clip(position, -2, n))
        tables += [whole.astype(np.int32), (position - whole).astype(np.float32)]
    device.launch_rows(
        device.kernel("magnify.cl", "magnify"),
        (ny, nx * count),
        out,
        picture,
        *(device.upload(table) for table in tables),
        np.float32(alpha**2),
        *(np.int32(n) for n in (ny, nx, count)),
    )
    return out
