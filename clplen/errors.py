"""The errors and the warning that clplen raises.

::

    Exception
      ClplenError            catch this one to catch all of them
        DeviceError          no such OpenCL device, two devices mixed, too little memory
        KernelBuildError     an OpenCL compiler refused a kernel (.source and .log say why)
        SamplingError        a field, phase or transfer function would be aliased
        ShapeError           arrays, grids or view counts that do not fit together
        FormatError          a file that is missing, truncated or not what it should be

    Warning
      UserWarning
        SamplingWarning      what SamplingError says, where the caller asked only to be warned

Wrong plain arguments (a negative pitch, both or neither of two options) are `ValueError` and
`TypeError`, as everywhere in Python.
"""

from __future__ import annotations


class ClplenError(Exception):
    """Base class of every error that clplen raises on purpose."""


class DeviceError(ClplenError):
    """No usable OpenCL device, two devices mixed, or too little device memory."""


class KernelBuildError(ClplenError):
    """An OpenCL compiler refused a kernel.

    Parameters
    ----------
    message : str
        One sentence: which kernel file, on which device.
    source : str, optional
        The complete source as the compiler saw it.
    log : str, optional
        The compiler's build log.

    Attributes
    ----------
    source : str
        The source, each line preceded by its number (from 1).
    log : str
        The build log.
    """

    def __init__(self, message: str, *, source: str = "", log: str = "") -> None:
        super().__init__(message)
        lines = source.splitlines()
        width = len(str(len(lines)))
        self.source = "\n".join(f"{i:{width}d}  {line}" for i, line in enumerate(lines, 1))
        self.log = log

    def __str__(self) -> str:
        return "\n".join(filter(None, (super().__str__(), self.source, self.log)))


class SamplingError(ClplenError):
    """A field, phase or transfer function would be sampled too coarsely."""


class ShapeError(ClplenError):
    """Arrays, grids or view counts do not fit together."""


class FormatError(ClplenError):
    """A file is missing, truncated or not in the format it should have."""


class SamplingWarning(UserWarning):
    """What `SamplingError` says, where the caller asked only to be warned."""
