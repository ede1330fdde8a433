"""Exceptions and warnings of clplen.

::

    Exception
      ClplenError            base class of all of them
        DeviceError          no such OpenCL device, two devices mixed, too little memory
        KernelBuildError     an OpenCL compiler rejected a kernel (see .source and .log)
        SamplingError        a field, phase or transfer function would be aliased
        ShapeError           arrays, grids or view counts do not match
        FormatError          a file is missing, truncated or of another format

    Warning
      UserWarning
        SamplingWarning      aliasing that the caller chose to be warned about

Invalid plain arguments (a negative pitch, both or neither of two options) raise `ValueError` and
`TypeError`, as usual in Python.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal

Surface = Literal["python", "command", "file"]
_surface: ContextVar[Surface] = ContextVar("surface", default="python")
_OPTIONS = {"ms": "m"}  # arguments with an option of another name

_PACKAGE = __name__.partition(".")[0]


class ClplenError(Exception):
    """Base class of all errors that clplen raises.

    Examples
    --------
    >>> try:
    ...     clplen.read_lightfield("missing.h5")
    ... except clplen.ClplenError as error:
    ...     print(f"{type(error).__name__}: {error}")
    FormatError: There is no file or folder missing.h5.
    """


class DeviceError(ClplenError):
    """No usable OpenCL device, two devices mixed, or too little device memory.

    Examples
    --------
    >>> clplen.Device.open("no such device")
    Traceback (most recent call last):
        ...
    clplen.errors.DeviceError: No OpenCL device matches 'no such device'. Available devices: ...
    """


class KernelBuildError(ClplenError):
    """An OpenCL compiler rejected a kernel.

    Parameters
    ----------
    message : str
        Sentence that names the kernel file and the device.
    source : str, optional
        Complete source as passed to the compiler.
    log : str, optional
        The compiler's build log.

    Attributes
    ----------
    source : str
        The source, each line preceded by its number (from 1).
    log : str
        The build log.

    Examples
    --------
    >>> clplen.Device.open().kernel("missing.cl", "missing")
    Traceback (most recent call last):
        ...
    clplen.errors.KernelBuildError: No kernel file 'missing.cl' in ...
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
    """A field, phase or transfer function would be aliased.

    Examples
    --------
    >>> field = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> try:
    ...     clplen.thin_lens(field, 1e-3)
    ... except clplen.SamplingError as error:
    ...     print(error)
    The phase of a lens of f = 0.001 m is aliased on samples of 1e-05 m: ...
    """


class ShapeError(ClplenError):
    """Arrays, grids or view counts do not match.

    Examples
    --------
    >>> clplen.LightField.from_array(np.zeros((32, 32)))
    Traceback (most recent call last):
        ...
    clplen.errors.ShapeError: A light field must have shape (v, u, y, x) or ...
    """


class FormatError(ClplenError):
    """A file is missing, truncated or of another format.

    Examples
    --------
    >>> with open("notes.h5", "w") as file:
    ...     written = file.write("hello")
    >>> clplen.read_lightfield("notes.h5")
    Traceback (most recent call last):
        ...
    clplen.errors.FormatError: notes.h5 is not a supported light field ...
    """


class SamplingWarning(UserWarning):
    """A field, phase or transfer function is aliased, by the caller's choice of ``"warn"``.

    Examples
    --------
    >>> import warnings
    >>> field = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     lit = clplen.thin_lens(field, 1e-3, aliasing="warn")
    >>> caught[0].category.__name__
    'SamplingWarning'
    """


def warn_caller(message: str, category: type[Warning]) -> None:
    """Issue a warning at the calling line outside the package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_inside(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def _is_inside(module: str) -> bool:
    """Return True for a frame of the package or of a standard-library wrapper."""
    return module.partition(".")[0] in (_PACKAGE, "contextlib", "functools")


def reason_of(error: BaseException) -> str:
    """Return an error's message without a compiler's log, with the file name as given."""
    if isinstance(error, OSError) and error.errno is not None:
        name = error.filename
        prefix = f"{os.fsdecode(name)}: " if isinstance(name, str | bytes | os.PathLike) else ""
        return f"{prefix}{error.strerror or os.strerror(error.errno)}"
    is_unicode_error = isinstance(error, UnicodeError)
    return str(error.args[0] if error.args and not is_unicode_error else error)


@contextmanager
def arguments_as(surface: Surface) -> Iterator[None]:
    """Format arguments in messages for Python, the command line or a TOML file."""
    token = _surface.set(surface)
    try:
        yield
    finally:
        _surface.reset(token)


def argument(name: str, value: object = None) -> str:
    """Format an argument for the current surface: ``white=``, ``--white`` or ``white =``.

    A value is appended: ``views=(3, 4)``, ``--views 3 4``, ``views = [3, 4]``. An option without a
    value is a flag.
    """
    parts = [str(part) for part in value] if isinstance(value, tuple) else None
    if _surface.get() == "command":
        text = value if isinstance(value, str) else " ".join(parts or ())
        flag = f"--{_OPTIONS.get(name, name).replace('_', '-')}"
        return f"{flag} {text}" if text else flag
    if _surface.get() == "file":
        if value is None:
            return f"{name} ="
        return f"{name} = " + (f"[{', '.join(parts)}]" if parts else json.dumps(value))
    if value is None:
        return f"{name}="
    return f"{name}=" + (f"({', '.join(parts)})" if parts else repr(value))


def worded(*, python: str, command: str, file: str) -> str:
    """Return the text of the current surface, for texts that differ in more than an argument."""
    return {"python": python, "command": command, "file": file}[_surface.get()]
