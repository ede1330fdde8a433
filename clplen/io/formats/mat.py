"""MATLAB files of versions 5 to 7.2: read headers of variables, and their samples with SciPy.

A file has a header of 128 bytes and elements of an 8-byte tag (type, length) and data. A variable
is an element ``miMATRIX`` of flags, dimensions, name and samples (first dimension fastest), or a
zlib stream of such an element (MATLAB MAT-File Format, MathWorks, chapter 1).

SciPy does not limit the inflated size of headers and samples. Therefore this module reads the
headers, and passes a single numeric variable to SciPy, inflated to its declared size.
"""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clplen.errors import FormatError

Array = np.ndarray[Any, Any]

_HEADER_BYTES = 128  # of the file
_MAX_VARIABLE_HEADER = 4096  # bytes with flags, dimensions and name of a variable
_MATRIX, _COMPRESSED = 14, 15
_COMPLEX, _LOGICAL = 0x800, 0x200
_MAX_CLASS = 15  # largest class number with dimensions and a name
_CLASSES = dict(enumerate(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"], 6))
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_SCIPY_KEYS = ("__header__", "__version__", "__globals__")  # added by SciPy
_STORED |= {12: "i8", 13: "u8"}


@dataclass(frozen=True)
class Variable:
    """Variable of a MATLAB file."""

    name: str
    shape: tuple[int, ...]  # in MATLAB's order
    dtype: np.dtype[Any] | None  # None unless an array of real numbers
    packed: np.dtype[Any] | None  # type of the stored samples, possibly narrower
    offset: int  # of the element's data in the file, in bytes
    length: int  # of the element's data in the file, in bytes
    start: int  # offset of the samples in the inflated data
    compressed: bool


def variables(file: BinaryIO, path: Path) -> list[Variable]:
    """Return the variables of a file, read from their headers alone."""
    size = path.stat().st_size
    file.seek(0)
    order = {b"IM": "<", b"MI": ">"}.get(file.read(_HEADER_BYTES)[126:])
    if order is None:
        raise FormatError(f"{path} is not a MATLAB file: it has no byte order at byte 126.")
    listing = []
    offset = _HEADER_BYTES
    while offset + 8 <= size:
        file.seek(offset)
        kind, length = struct.unpack(f"{order}2I", file.read(8))
        if kind not in (_MATRIX, _COMPRESSED):
            break
        head = file.read(min(length, _MAX_VARIABLE_HEADER))
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(head, _MAX_VARIABLE_HEADER)
        if head:
            available = min(length, size - offset - 8)
            parsed = _variable(head, order, kind == _COMPRESSED, offset + 8, available)
            listing += [parsed] if parsed else []
        offset += 8 + length
    return listing


def _variable(
    head: bytes, order: str, compressed: bool, offset: int, length: int
) -> Variable | None:
    """Parse a variable from the first bytes of its element; None without dimensions."""
    position = 8 if compressed else 0
    flags, position = _element(head, position, order)
    bits = struct.unpack_from(f"{order}I", flags)[0]
    if bits & 0xFF > _MAX_CLASS:
        return None
    sizes, position = _element(head, position, order)
    shape = tuple(int(n) for n in np.frombuffer(sizes, f"{order}i4"))
    name, position = _element(head, position, order)
    text = name.decode("latin-1")
    if bits & 0xFF not in _CLASSES or bits & _COMPLEX or min(shape, default=0) < 1:
        return Variable(text, shape, None, None, offset, length, 0, compressed)
    kind, nbytes, start = _tag(head, position, order)
    dtype = np.dtype(bool if bits & _LOGICAL else _CLASSES[bits & 0xFF])
    packed = np.dtype(order + _STORED[kind])
    if nbytes != math.prod(shape) * packed.itemsize:
        raise ValueError(f"{nbytes:,} bytes for {text} of size {shape}")
    return Variable(text, shape, dtype, packed, offset, length, start, compressed)


def _tag(head: bytes, position: int, order: str) -> tuple[int, int, int]:
    """Return type, length and offset of the data of an element; the tag holds up to 4 bytes."""
    first, second = struct.unpack_from(f"{order}2I", head, position)
    if first >> 16:
        return first & 0xFFFF, first >> 16, position + 4
    return first, second, position + 8


def _element(head: bytes, position: int, order: str) -> tuple[bytes, int]:
    """Return the data of an element and the offset of the next element."""
    _, nbytes, start = _tag(head, position, order)
    data = head[start : start + nbytes]
    if len(data) < nbytes:
        raise ValueError(f"a header of {nbytes:,} bytes")
    return data, position + 8 if start == position + 4 else start + -(-nbytes // 8) * 8


def read_variable(file: BinaryIO, variable: Variable) -> Array:
    """Return the samples of a variable of real numbers."""
    from scipy.io import loadmat  # imported late: it takes a sixth of a second
    from scipy.io.matlab import MatReadError

    assert variable.packed is not None
    nbytes = variable.start + math.prod(variable.shape) * variable.packed.itemsize
    file.seek(0)
    header = file.read(_HEADER_BYTES)
    file.seek(variable.offset)
    if variable.compressed:
        matrix = zlib.decompressobj().decompress(file.read(variable.length), nbytes)
    else:
        file.seek(variable.offset - 8)
        matrix, nbytes = file.read(8 + nbytes), 8 + nbytes
    if len(matrix) < nbytes:
        raise EOFError(f"{variable.name} ends after {len(matrix):,} bytes")
    content = header + matrix
    del matrix  # before SciPy makes another copy
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            contents = loadmat(BytesIO(content), squeeze_me=False)
        except MatReadError as error:
            raise ValueError(str(error)) from error
    (values,) = (np.asarray(value) for name, value in contents.items() if name not in _SCIPY_KEYS)
    if values.shape != variable.shape or values.dtype.kind not in "buif":
        raise ValueError(f"{variable.name} is {values.dtype} of shape {values.shape}")
    return values
