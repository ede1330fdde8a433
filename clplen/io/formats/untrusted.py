"""Untrusted files: first bytes, limits on memory, and errors of damaged files.

A few bytes must not claim gigabytes. Exceptions of libraries become a `FormatError`.
"""

from __future__ import annotations

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clplen.compute.memory import free_memory
from clplen.errors import FormatError, argument

# First bytes and suffixes of files whose readers are imported on demand.
ZIP = b"PK\3\4"
MATLAB = b"MATLAB"
MATLAB_SUFFIXES = (".mat",)
LYTRO = b"\x89LFP\r\n\x1a\n"
LYTRO_SUFFIXES = (".json", ".raw")  # files that other tools extract from a container
RAYTRIX = b"<RayCalibData"
RAYTRIX_SUFFIXES = (".xml", ".ray")

DEFLATE = 1032.0  # largest ratio of zlib, gzip, zip and PNG (RFC 1951: 258 bytes from 2 bits)
SLACK = 1 << 20  # bytes that any file may allocate
UNREADABLE = (  # exceptions of libraries on damaged or other files
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SystemError,
    TypeError,
    ValueError,
    SyntaxError,
    lzma.LZMAError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
_MAX_LISTED = 10  # names in a message


@dataclass(frozen=True)
class Bound:
    """Upper bound on the decoded size of a file or a part of it."""

    path: Path
    stored: int  # stored bytes
    ratio: float = 1.0  # largest ratio of their compression
    max_bytes: int | None = None  # None: half of the free memory

    def wider(self, times: float) -> Bound:
        """Return the bound for samples that are ``times`` as wide in memory."""
        return replace(self, ratio=self.ratio * times)

    def require(self, nbytes: int, what: str) -> None:
        """Raise FormatError for a declared size beyond the bound or the free memory."""
        if nbytes < 0 or nbytes > self.stored * self.ratio + SLACK:
            raise FormatError(
                f"{self.path}: {what} declares {nbytes:,} bytes, more than {self.stored:,} stored "
                "bytes can hold: the file is damaged."
            )
        require_room(nbytes, path=self.path, what=what, max_bytes=self.max_bytes)


def require_room(nbytes: int, *, path: Path, what: str, max_bytes: int | None) -> None:
    """Raise FormatError for a step that would take more memory than allowed."""
    limit = free_memory() // 2 if max_bytes is None else max_bytes
    if nbytes > limit:
        rule = "half of the free memory" if max_bytes is None else "the given limit"
        raise FormatError(
            f"{path}: {what} needs {nbytes:,} bytes, more than {limit:,} ({rule}): raise "
            f"{argument('max_bytes')} to allow it."
        )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn the exceptions of libraries on unreadable files into a FormatError of the file."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # casts of untrusted numbers
            yield
    except UNREADABLE as error:
        reason = (str(error).splitlines() or [""])[0].strip(" .'\"") or type(error).__name__
        if isinstance(error, MemoryError):
            raise FormatError(
                f"{path} needs more memory than this process may use ({reason[:200]}): the file is "
                "damaged or too large."
            ) from error
        raise FormatError(
            f"{path} is truncated or damaged ({reason[:200]}): copy or write it again."
        ) from error


def listed(items: Sequence[str]) -> str:
    """Return a list for a message, shortened if long."""
    more = len(items) - _MAX_LISTED
    return ", ".join(items[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
