"""Results that hold samples: as NumPy arrays, by DLPack, in another process, as copies.

`Image` is a picture on a device; `count_bad` finds samples that are NaN or infinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device, as_device
from clplen.compute.drivers.forked import is_forked, unreachable
from clplen.results import Plottable, Savable
from clplen.types import Array

Kind = TypeVar("Kind")

_HOST = (1, 0)  # DLPack's kDLCPU


class HostArray:
    """Base of what has ``to_numpy()``: NumPy and DLPack take the same values."""

    _samples: ClassVar[str] = ""  # the attribute that holds them
    _downloads: ClassVar[bool] = False  # whether to_numpy makes a new array each time

    def to_numpy(self) -> Array:
        """The values on the host: not a copy where they are there already."""
        return np.asarray(getattr(self, self._samples))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """What ``numpy.asarray`` takes: the values on the host."""
        values = self.to_numpy()
        same = dtype is None or np.dtype(dtype) == values.dtype
        if copy is False and (self._downloads or not same):
            raise ValueError(
                f"A {type(self).__name__} is an array of "
                f"{'its own type' if same else str(np.dtype(dtype))} only by a copy: leave out "
                "copy=False."
            )
        if not same:
            return values.astype(dtype)
        return values.copy() if copy and not self._downloads else values

    def __dlpack__(self, **options: Any) -> Any:
        """The values on the host, for ``from_dlpack`` of any library."""
        if options.get("copy") is False and self._downloads:
            raise BufferError(
                f"A {type(self).__name__} on a device is on the host only by a copy: leave out "
                "copy=False."
            )
        given = {name: value for name, value in options.items() if value is not None}
        return self.to_numpy().__dlpack__(**given)

    def __dlpack_device__(self) -> tuple[int, int]:
        """The host, (1, 0): values on a device are copied there."""
        return _HOST


class OnDevice(HostArray):
    """Base of the frozen dataclasses that have samples on a device.

    They are pickled, and copied deeply, by way of the host; a shallow copy shares the samples.
    """

    _downloads: ClassVar[bool] = True
    data: cla.Array
    device: Device

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device, optional=False))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the samples."""
        return tuple(int(n) for n in self.data.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the samples."""
        return np.dtype(self.data.dtype)

    def to_numpy(self) -> Array:
        """The samples on the host, same shape and dtype."""
        return self.device.download(self.data)

    def __copy__(self: Kind) -> Kind:
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        return twin

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"data": self.device.download(self.data)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        values, device = state["data"], state["device"]
        data = unreachable(values) if is_forked() else device.upload(values)
        self.__dict__.update(state | {"data": data})


@dataclass(frozen=True, eq=False, repr=False)
class Image(Savable, Plottable, OnDevice):
    """What an intensity, a view, a rendering or a refocus returns.

    Attributes
    ----------
    data : pyopencl.array.Array
        Real values, shape (y, x) or (y, x, c); an EPI has (u, x[, c]) or (v, y[, c]).
    device : Device
        The device that holds them.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((5, 5, 32, 48), np.float32))
    >>> picture = lf.render()
    >>> picture
    <Image (32, 48) float32, ...>
    >>> np.asarray(picture).shape, f"{picture.to_numpy().mean():.3f}"
    ((32, 48), '1.000')
    """

    _writer: ClassVar[str] = "write_image"
    _figure: ClassVar[str] = "picture"

    data: cla.Array
    device: Device

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.shape} {self.data.dtype}, {self.device.name}>"

_DEFINES = {np.dtype(np.float64): {"DOUBLE": True}, np.dtype(np.float16): {"HALF": True}}
LENGTH = 2**14  # reals that one work-item reads: enough to forget the cost of starting it
_GROUP = 64  # work-items of a GPU that read a quarter of that, as finite.cl has it


def count_bad(array: cla.Array, device: Device) -> int:
    """Number of NaN and infinite samples of a float16 to float64, complex64 or complex128 array.

    Integer arrays have none; a complex sample counts once for each bad part.
    """
    if array.dtype.kind not in "fc" or array.size == 0:
        return 0
    reals = array.view(np.empty(0, array.dtype).real.dtype)
    defines = _DEFINES.get(reals.dtype, {})
    length, group = (LENGTH, 1) if device.rows else (LENGTH // 4, _GROUP)
    stretches = -(-int(reals.size) // length)
    bad = device.empty((stretches,), np.int32)
    kernel = device.kernel("finite.cl", "count_bad", **defines)
    size = (stretches * group,)
    device.launch(kernel, size, bad, reals, np.int64(reals.size), length, group=(group,))
    return int(device.download(bad).sum(dtype=np.int64))
