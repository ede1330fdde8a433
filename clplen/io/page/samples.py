"""Samples of a page: 8 bits as PNG or JPEG, others as gzip of 16 bits."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image as Pillow

Array = np.ndarray[Any, Any]
Blob = Callable[[], bytes]

MAX_LEVEL = 65534  # largest level of 16 bits; the next value means NaN
_DEFLATE_LEVEL = 6
_THREADS = 4


@dataclass
class Content:
    """Content of a page: a JSON description that refers to parts of the data by index."""

    # Keys "title" and "items"; for a comparison also "compare" and "scores".
    about: dict[str, Any] = field(default_factory=dict)
    blobs: list[Blob] = field(default_factory=list)  # each returns the bytes of a part

    def add(self, blob: Blob) -> int:
        """Add a part of the data, and return its index."""
        self.blobs.append(blob)
        return len(self.blobs) - 1

    def encoded(self) -> list[bytes]:
        """Return the bytes of all parts; zlib and Pillow run in parallel threads."""
        with ThreadPoolExecutor(_THREADS) as pool:
            return list(pool.map(lambda blob: blob(), self.blobs))


def png(picture: Array) -> bytes:
    """Encode a uint8 picture (y, x[, 3]) without loss."""
    stream = BytesIO()
    Pillow.fromarray(picture).save(stream, "png", compress_level=_DEFLATE_LEVEL)
    return stream.getvalue()


def jpeg(picture: Array, quality: int) -> bytes:
    """Encode a uint8 picture (y, x[, 3]) as JPEG with colours at full resolution."""
    stream = BytesIO()
    Pillow.fromarray(picture).save(stream, "jpeg", quality=quality, subsampling=0)
    return stream.getvalue()


@dataclass(frozen=True)
class Levels:
    """Quantised values low + q step; NaN is level 65535 of 16 bits."""

    low: float
    step: float

    @classmethod
    def of(cls, values: Array, largest: int = MAX_LEVEL) -> Levels:
        """Return the levels for all finite values."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return cls(0.0, 1.0)
        low, high = float(finite.min()), float(finite.max())
        if values.dtype.kind == "u" and high <= largest:
            return cls(0.0, 1.0)
        return cls(low, (high - low) / largest or 1.0)

    def sixteen(self, values: Array) -> Array:
        """Return levels of 16 bits."""
        levels = (np.asarray(values, np.float64) - self.low) / self.step
        is_valid = np.isfinite(levels)
        return np.where(is_valid, np.rint(np.where(is_valid, levels, 0)), MAX_LEVEL + 1).astype(
            np.uint16
        )

    def packed(self, values: Array) -> bytes:
        """Return values (y, x[, c]) as gzip: differences along rows, low bytes, then high bytes."""
        levels = self.sixteen(values).reshape(len(values), -1)
        difference = np.diff(levels, axis=1, prepend=np.uint16(0))
        halves = difference.astype("<u2", order="C").view(np.uint8).reshape(-1, 2)
        return gzip.compress(np.ascontiguousarray(halves.T).tobytes(), _DEFLATE_LEVEL, mtime=0)


def packed_floats(values: Array) -> bytes:
    """Return values as gzip of float32: all first bytes, then all second bytes and so on."""
    parts = np.ascontiguousarray(values, "<f4").view(np.uint8).reshape(-1, 4)
    return gzip.compress(np.ascontiguousarray(parts.T).tobytes(), _DEFLATE_LEVEL, mtime=0)


def downscaled(values: Array, n: int) -> Array:
    """Return means of n x n pixels of a picture (y, x[, c]) in its dtype; drop the remainder."""
    if n == 1:
        return values
    ny, nx = (size // n for size in values.shape[:2])
    blocks = values[: ny * n, : nx * n].reshape(ny, n, nx, n, *values.shape[2:])
    means = blocks.mean(axis=(1, 3), dtype=np.float64)
    return (np.rint(means) if values.dtype.kind == "u" else means).astype(values.dtype)
