"""What OpenCL refuses, as errors that name the device, its driver and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pyopencl as cl

from clplen.errors import ClplenError, DeviceError

ADVICE = (
    "run `clplen devices --check` to see what works there, update the driver, or choose another "
    "device"
)


@contextmanager
def device_errors(device: cl.Device, step: str) -> Iterator[None]:
    """Turn errors of OpenCL and want of host memory inside this block into a `DeviceError`."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, cl.Error) or is_want_of_memory(error)):
            raise
        raise device_error(device, step, error) from error


_NO_MEMORY = (
    "OUT_OF_HOST_MEMORY",  # OpenCL
    "FAILED_TO_ALLOCATE",  # VkFFT
    "failed to map segment",  # the loader of libraries, as an ImportError
    "cannot allocate memory",
)


def is_want_of_memory(error: BaseException | None) -> bool:
    """Whether memory is used up, of the device or of the host."""
    if isinstance(error, ClplenError):  # said already
        return False
    found = any(word in str(error) for word in _NO_MEMORY)
    return found or isinstance(error, MemoryError | cl.MemoryError)


def device_error(device: cl.Device, step: str, error: Exception) -> DeviceError:
    """The sentence on a step that OpenCL (or VkFFT) refused; arguments as in `device_errors`."""
    where = (
        f"{device.name.strip()} ({device.platform.name.strip()} {device.driver_version.strip()})"
    )
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    if is_want_of_memory(error):
        return DeviceError(
            f"{step} needs more memory than {where} has left ({reason}): use fewer planes or "
            "samples at a time, integer instead of float storage, or a device with more memory."
        )
    return DeviceError(f"{step} failed on {where} ({reason}): {ADVICE}.")
