"""NumPy files (.npy), written atomically and read without pickles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.untrusted import Bound
from clplen.outputs import NPY_HEADER

MAGIC = b"\x93NUMPY"
SUFFIXES = (".npy",)
_VERSION = b"\x01\0"  # header length of two bytes


def write_npy(path: PathLike, values: ArrayLike, *, durable: bool = False) -> None:
    """Write an array for `numpy.load`, with the header of `clplen.outputs`.

    Parameters
    ----------
    path : path-like
        Output file; no suffix is added.
    values : array_like
        Real numbers; written in C order.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, OSError
        If the values are not real numbers; if the file cannot be written.

    Examples
    --------
    >>> clplen.io.write_npy("disparity.npy", np.linspace(-1, 1, 5))
    >>> np.load("disparity.npy").tolist()
    [-1.0, -0.5, 0.0, 0.5, 1.0]
    """
    array = np.ascontiguousarray(host_array(values, "An array of a file"))
    if array.dtype.kind not in "buif":
        raise ValueError(
            f"The values of a .npy file must be real numbers, got {array.dtype}: write .real and "
            ".imag, or abs(values)."
        )
    about = np.lib.format.header_data_from_array_1_0(array)
    length = NPY_HEADER - len(MAGIC + _VERSION) - 2
    header = repr(about).encode("ascii").ljust(length - 1) + b"\n"
    with replacing(path, durable) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + _VERSION + length.to_bytes(2, "little") + header)
        array.tofile(file)


def read_npy(path: PathLike, *, max_bytes: int | None = None) -> np.ndarray[Any, Any]:
    """Read an array of real numbers without unpickling.

    Parameters
    ----------
    path : path-like
        ``.npy`` file.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Array in memory, with the shape and dtype of the file.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or has other contents.

    Examples
    --------
    >>> np.save("disparity.npy", np.zeros((32, 48), np.float32))
    >>> values = clplen.io.read_npy("disparity.npy")
    >>> values.shape, values.dtype.name
    ((32, 48), 'float32')
    """
    values = map_npy(path)
    if values.dtype.kind not in "buif":
        raise FormatError(f"{path} must hold real numbers, got {values.dtype}.")
    Bound(Path(path), Path(path).stat().st_size, 1, max_bytes).require(values.nbytes, "its array")
    return np.array(values)


def map_npy(path: PathLike, *, what: str = "an array") -> np.ndarray[Any, Any]:
    """Map an array from its file, without unpickling; it cannot be larger than the file."""
    noun = what.partition(" ")[2]
    if not Path(path).is_file():
        raise FormatError(f"There is no {noun} {path}.")
    try:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except Exception as error:  # NumPy raises any exception on damaged headers
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise FormatError(f"Cannot read {path} ({reason[:200]}).") from error
