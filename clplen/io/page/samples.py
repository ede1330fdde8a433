"""Samples as a page keeps them: 8 bits as PNG or JPEG, all others as gzip of 16 bits."""

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

MOST = 65534  # the largest level of 16 bits; the next one stands for NaN
_LEVEL = 6  # of deflate
_THREADS = 4


@dataclass
class Content:
    """What a page shows: a description of JSON that names parts of the data by their numbers."""

    # title, items; for several results side by side compare and scores.
    about: dict[str, Any] = field(default_factory=dict)
    blobs: list[Blob] = field(default_factory=list)  # each gives the bytes of a part

    def add(self, blob: Blob) -> int:
        """Keep a part; its number."""
        self.blobs.append(blob)
        return len(self.blobs) - 1

    def encoded(self) -> list[bytes]:
        """All parts, made by a few threads: zlib and Pillow compute without Python's lock."""
        with ThreadPoolExecutor(_THREADS) as pool:
            return list(pool.map(lambda blob: blob(), self.blobs))


def png(picture: Array) -> bytes:
    """A uint8 picture (y, x[, 3]) without loss."""
    stream = BytesIO()
    Pillow.fromarray(picture).save(stream, "png", compress_level=_LEVEL)
    return stream.getvalue()


def jpeg(picture: Array, quality: int) -> bytes:
    """A uint8 picture (y, x[, 3]) as JPEG, its colours at full resolution."""
    stream = BytesIO()
    Pillow.fromarray(picture).save(stream, "jpeg", quality=quality, subsampling=0)
    return stream.getvalue()


@dataclass(frozen=True)
class Levels:
    """Values by their levels q, low + q step; NaN is level 65535 of 16 bits."""

    low: float
    step: float

    @classmethod
    def of(cls, values: Array, most: int = MOST) -> Levels:
        """The levels that hold all finite values."""
        known = values[np.isfinite(values)]
        if known.size == 0:
            return cls(0.0, 1.0)
        low, high = float(known.min()), float(known.max())
        if values.dtype.kind == "u" and high <= most:
            return cls(0.0, 1.0)
        return cls(low, (high - low) / most or 1.0)

    def sixteen(self, values: Array) -> Array:
        """Levels of 16 bits."""
        shares = (np.asarray(values, np.float64) - self.low) / self.step
        known = np.isfinite(shares)
        return np.where(known, np.rint(np.where(known, shares, 0)), MOST + 1).astype(np.uint16)

    def packed(self, values: Array) -> bytes:
        """Values (y, x[, c]) as gzip: differences along rows, all low bytes, then all high ones."""
        levels = self.sixteen(values).reshape(len(values), -1)
        difference = np.diff(levels, axis=1, prepend=np.uint16(0))
        halves = difference.astype("<u2", order="C").view(np.uint8).reshape(-1, 2)
        return gzip.compress(np.ascontiguousarray(halves.T).tobytes(), _LEVEL, mtime=0)


def packed_floats(values: Array) -> bytes:
    """Values as gzip of float32, all first bytes, then all second ones and so on."""
    parts = np.ascontiguousarray(values, "<f4").view(np.uint8).reshape(-1, 4)
    return gzip.compress(np.ascontiguousarray(parts.T).tobytes(), _LEVEL, mtime=0)


def downscaled(values: Array, n: int) -> Array:
    """Means of n x n pixels of a picture (y, x[, c]), of its type; the rest is left out."""
    if n == 1:
        return values
    ny, nx = (size // n for size in values.shape[:2])
    blocks = values[: ny * n, : nx * n].reshape(ny, n, nx, n, *values.shape[2:])
    means = blocks.mean(axis=(1, 3), dtype=np.float64)
    return (np.rint(means) if values.dtype.kind == "u" else means).astype(values.dtype)
