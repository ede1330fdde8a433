"""NumPy files, whole or not at all."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.files import PathLike, replacing
from clplen.outputs import NPY_HEADER

MAGIC = b"\x93NUMPY"
SUFFIXES = (".npy",)
_VERSION = b"\x01\0"  # the length of the header follows in two bytes


def write_npy(path: PathLike, values: np.ndarray[Any, Any], *, durable: bool = False) -> None:
    """Write an array for `numpy.load`, with the header of `clplen.outputs`.

    Parameters
    ----------
    path : path-like
    values : numpy.ndarray
        Of real numbers; written in C order.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    array = np.ascontiguousarray(values)
    about = np.lib.format.header_data_from_array_1_0(array)
    length = NPY_HEADER - len(MAGIC + _VERSION) - 2
    header = repr(about).encode("ascii").ljust(length - 1) + b"\n"
    with replacing(path, durable) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + _VERSION + length.to_bytes(2, "little") + header)
        array.tofile(file)
