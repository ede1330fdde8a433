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
    """Base class of every error that clplen raises on purpose.

    Examples
    --------
    >>> try:
    ...     clplen.read_lightfield("nothing.h5")
    ... except (clplen.ClplenError, OSError) as error:
    ...     print(type(error).__name__)
    FormatError
    >>> issubclass(clplen.ShapeError, clplen.ClplenError)
    True
    """


class DeviceError(ClplenError):
    """No usable OpenCL device, two devices mixed, or too little device memory.

    Examples
    --------
    >>> try:
    ...     clplen.Device.open("abacus")
    ... except clplen.DeviceError as error:
    ...     print("no device is called abacus" if "abacus" in str(error) else error)
    no device is called abacus
    """


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

    Examples
    --------
    >>> issubclass(clplen.KernelBuildError, clplen.ClplenError)
    True
    >>> error = clplen.KernelBuildError("It does not compile.", source="kernel", log="line 1")
    >>> error.log
    'line 1'
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
    """A field, phase or transfer function would be sampled too coarsely.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 1e-4)
    >>> try:
    ...     clplen.thin_lens(clplen.wave.plane_wave(grid, wavelength=550e-9), 0.01)
    ... except clplen.SamplingError:
    ...     print("aliased")
    aliased
    """


class ShapeError(ClplenError):
    """Arrays, grids or view counts do not fit together.

    Examples
    --------
    >>> try:
    ...     clplen.LightField.from_array(np.ones((8, 8), np.float32))
    ... except clplen.ShapeError:
    ...     print("four or five axes")
    four or five axes
    """


class FormatError(ClplenError):
    r"""A file is missing, truncated or not in the format it should have.

    Examples
    --------
    >>> with open("broken.h5", "wb") as file:
    ...     _ = file.write(b"\x89HDF\r\n\x1a\n and no more")
    >>> try:
    ...     clplen.read_lightfield("broken.h5")
    ... except clplen.FormatError:
    ...     print("damaged")
    damaged
    """


class SamplingWarning(UserWarning):
    """What `SamplingError` says, where the caller asked only to be warned.

    Examples
    --------
    >>> import warnings
    >>> grid = clplen.Grid((64, 64), 1e-4)
    >>> field = clplen.wave.plane_wave(grid, wavelength=550e-9)
    >>> with warnings.catch_warnings(record=True) as said:
    ...     warnings.simplefilter("always")
    ...     _ = clplen.thin_lens(field, 0.01, aliasing="warn")
    >>> said[0].category.__name__
    'SamplingWarning'
    """
