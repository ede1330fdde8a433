"""MATLAB files of versions 5 to 7.2: variables by their headers, samples by SciPy.

A header of 128 bytes, then elements of an 8-byte tag (type, length) and data. A variable is an
element ``miMATRIX`` of flags, dimensions, name and samples (the first dimension fastest), or a
zlib stream of one (MATLAB MAT-File Format, MathWorks, chapter 1).

SciPy reads the header of a variable and the samples without a limit on what is inflated. So the
headers are read here, and SciPy gets one variable of numbers, inflated as far as its header says.
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

_HEADER = 128
_HEAD = 4096  # bytes in which flags, dimensions and name of a variable lie
_MATRIX, _COMPRESSED = 14, 15
_COMPLEX, _LOGICAL = 0x800, 0x200
_LARGEST = 15  # the largest class that has dimensions and a name
_CLASSES = dict(enumerate(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"], 6))
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_ABOUT = ("__header__", "__version__", "__globals__")  # what SciPy adds
_STORED |= {12: "i8", 13: "u8"}


@dataclass(frozen=True)
class Variable:
    """A variable of a MATLAB file."""

    name: str
    shape: tuple[int, ...]  # as MATLAB shows it
    dtype: np.dtype[Any] | None  # of its class; None for what is no array of real numbers
    packed: np.dtype[Any] | None  # as its samples are stored, which may be narrower
    place: int  # of the element's data in the file, in bytes
    length: int  # of the element's data in the file, in bytes
    start: int  # of the samples in that data, after it is inflated
    compressed: bool


def variables(file: BinaryIO, path: Path) -> list[Variable]:
    """The variables of a file, from their headers alone."""
    size = path.stat().st_size
    file.seek(0)
    order = {b"IM": "<", b"MI": ">"}.get(file.read(_HEADER)[126:])
    if order is None:
        raise FormatError(f"{path} has no byte order at its byte 126: it is no MATLAB file.")
    found = []
    place = _HEADER
    while place + 8 <= size:
        file.seek(place)
        kind, length = struct.unpack(f"{order}2I", file.read(8))
        if kind not in (_MATRIX, _COMPRESSED):
            break
        head = file.read(min(length, _HEAD))
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(head, _HEAD)
        if head:
            within = min(length, size - place - 8)
            parsed = _variable(head, order, kind == _COMPRESSED, place + 8, within)
            found += [parsed] if parsed else []
        place += 8 + length
    return found


def _variable(
    head: bytes, order: str, compressed: bool, place: int, length: int
) -> Variable | None:
    """A variable from the first bytes of its element; None for one without dimensions."""
    at = 8 if compressed else 0
    flags, at = _element(head, at, order)
    bits = struct.unpack_from(f"{order}I", flags)[0]
    if bits & 0xFF > _LARGEST:
        return None
    sizes, at = _element(head, at, order)
    shape = tuple(int(n) for n in np.frombuffer(sizes, f"{order}i4"))
    name, at = _element(head, at, order)
    text = name.decode("latin-1")
    if bits & 0xFF not in _CLASSES or bits & _COMPLEX or min(shape, default=0) < 1:
        return Variable(text, shape, None, None, place, length, 0, compressed)
    kind, nbytes, start = _tag(head, at, order)
    dtype = np.dtype(bool if bits & _LOGICAL else _CLASSES[bits & 0xFF])
    packed = np.dtype(order + _STORED[kind])
    if nbytes != math.prod(shape) * packed.itemsize:
        raise ValueError(f"{nbytes:,} bytes for {text} of size {shape}")
    return Variable(text, shape, dtype, packed, place, length, start, compressed)


def _tag(head: bytes, at: int, order: str) -> tuple[int, int, int]:
    """Type, length and place of the data of an element; up to 4 bytes lie in the tag itself."""
    first, second = struct.unpack_from(f"{order}2I", head, at)
    if first >> 16:
        return first & 0xFFFF, first >> 16, at + 4
    return first, second, at + 8


def _element(head: bytes, at: int, order: str) -> tuple[bytes, int]:
    """The data of an element, and where the next one begins, on a multiple of 8 bytes."""
    _, nbytes, start = _tag(head, at, order)
    data = head[start : start + nbytes]
    if len(data) < nbytes:
        raise ValueError(f"a header of {nbytes:,} bytes")
    return data, at + 8 if start == at + 4 else start + -(-nbytes // 8) * 8


def read_variable(file: BinaryIO, variable: Variable) -> Array:
    """The samples of a variable of real numbers."""
    from scipy.io import loadmat  # imported where it is needed: it takes a sixth of a second
    from scipy.io.matlab import MatReadError

    assert variable.packed is not None
    nbytes = variable.start + math.prod(variable.shape) * variable.packed.itemsize
    file.seek(0)
    header = file.read(_HEADER)
    file.seek(variable.place)
    if variable.compressed:
        matrix = zlib.decompressobj().decompress(file.read(variable.length), nbytes)
    else:
        file.seek(variable.place - 8)
        matrix, nbytes = file.read(8 + nbytes), 8 + nbytes
    if len(matrix) < nbytes:
        raise EOFError(f"{variable.name} ends after {len(matrix):,} bytes")
    content = header + matrix
    del matrix  # before SciPy makes the next copy
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            held = loadmat(BytesIO(content), squeeze_me=False)
        except MatReadError as error:
            raise ValueError(str(error)) from error
    (values,) = (np.asarray(value) for name, value in held.items() if name not in _ABOUT)
    if values.shape != variable.shape or values.dtype.kind not in "buif":
        raise ValueError(f"{variable.name} is {values.dtype} of shape {values.shape}")
    return values
