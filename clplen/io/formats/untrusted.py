"""Files of unknown origin: their first bytes, the memory they may ask for, and errors of damage.

A few bytes must not claim gigabytes, and what a library raises becomes one `FormatError`.
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

# First bytes and suffixes of files whose readers are imported only when they are needed.
ZIP = b"PK\3\4"
MATLAB = b"MATLAB"
MATLAB_SUFFIXES = (".mat",)
LYTRO = b"\x89LFP\r\n\x1a\n"
LYTRO_DESCRIBED = (".json", ".raw")  # what other tools take out of a container
RAYTRIX = b"<RayCalibData"
RAYTRIX_SUFFIXES = (".xml", ".ray")

DEFLATE = 1032.0  # largest ratio of zlib, gzip, zip and PNG (RFC 1951: 258 bytes from 2 bits)
SLACK = 1 << 20  # bytes that any file may ask for
UNREADABLE = (  # what libraries raise on files that are damaged or something else
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
_LISTED = 10  # how many names a message lists


@dataclass(frozen=True)
class Bound:
    """What the bytes of a file, or of a part of it, can hold."""

    path: Path
    stored: int  # bytes that are there
    ratio: float = 1.0  # largest ratio of their compression
    max_bytes: int | None = None  # None: half of the free memory

    def wider(self, times: float) -> Bound:
        """The bound of samples that take so many times their bytes in memory."""
        return replace(self, ratio=self.ratio * times)

    def require(self, wanted: int, what: str) -> None:
        """Refuse a size that a file declares but cannot hold, or that would fill the memory."""
        if wanted < 0 or wanted > self.stored * self.ratio + SLACK:
            raise FormatError(
                f"{self.path}: {what} declares {wanted:,} bytes, more than {self.stored:,} stored "
                "bytes can hold: the file is damaged."
            )
        require_room(wanted, path=self.path, what=what, max_bytes=self.max_bytes)


def require_room(wanted: int, *, path: Path, what: str, max_bytes: int | None) -> None:
    """Refuse a step, such as reading or decoding, that would take more memory than allowed."""
    limit = free_memory() // 2 if max_bytes is None else max_bytes
    if wanted > limit:
        rule = "half of the free memory" if max_bytes is None else "the given limit"
        raise FormatError(
            f"{path}: {what} needs {wanted:,} bytes, more than {limit:,} ({rule}): raise "
            f"{argument('max_bytes')} if that is meant."
        )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Make a FormatError, naming the file, of what a library says of one that it cannot read."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # casts of hostile numbers
            yield
    except UNREADABLE as error:
        reason = (str(error).splitlines() or [""])[0].strip(" .'\"") or type(error).__name__
        if isinstance(error, MemoryError):
            raise FormatError(
                f"{path} asks for more memory than this process may take ({reason[:200]}): it is "
                "damaged, or too large."
            ) from error
        raise FormatError(
            f"{path} is truncated or damaged ({reason[:200]}): copy or write it again."
        ) from error


def listed(items: Sequence[str]) -> str:
    """A list for a message, cut where it gets long."""
    more = len(items) - _LISTED
    return ", ".join(items[:_LISTED]) + (f" and {more} more" if more > 0 else "")
