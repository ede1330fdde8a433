"""Errors of OpenCL, as messages that name the device, its driver and a remedy."""

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
    """Turn OpenCL errors and out-of-memory errors in this block into a `DeviceError`."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, cl.Error) or is_out_of_memory(error)):
            raise
        raise device_error(device, step, error) from error


_NO_MEMORY = (
    "OUT_OF_HOST_MEMORY",  # OpenCL
    "FAILED_TO_ALLOCATE",  # VkFFT
    "failed to map segment",  # dynamic loader, in an ImportError
    "cannot allocate memory",
)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return True if an error means that the device or the host is out of memory."""
    if isinstance(error, ClplenError):  # has a message of its own
        return False
    matches = any(phrase in str(error) for phrase in _NO_MEMORY)
    return matches or isinstance(error, MemoryError | cl.MemoryError)


def device_error(device: cl.Device, step: str, error: Exception) -> DeviceError:
    """Return the error of a step that OpenCL or VkFFT refused; see `device_errors`."""
    where = (
        f"{device.name.strip()} ({device.platform.name.strip()} {device.driver_version.strip()})"
    )
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    if is_out_of_memory(error):
        return DeviceError(
            f"{step} needs more memory than {where} has left ({reason}): use fewer planes or "
            "samples at a time, integer instead of float storage, or a device with more memory."
        )
    return DeviceError(f"{step} failed on {where} ({reason}): {ADVICE}.")
