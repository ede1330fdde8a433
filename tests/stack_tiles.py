"""A focal stack in host memory that comes in parts, as those of `clplen.lightfield.stack_tiles`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Block = tuple[slice, slice, slice, np.ndarray]


@dataclass
class Tiles:
    """Parts of at most (planes, rows, columns) of an array (n, y, x[, c]), the last one first."""

    values: np.ndarray
    parts: tuple[int, int, int]
    spacing: Any = None
    camera: Any = None
    fails_at: int = -1
    closed: list[bool] = field(default_factory=list)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape

    @property
    def disparities(self) -> np.ndarray:
        return np.linspace(-1, 2, len(self.values))

    @property
    def alphas(self) -> np.ndarray:
        return np.where(self.disparities > 1.5, np.nan, 1 - self.disparities / 4)

    def __iter__(self) -> Iterator[Block]:
        starts = [range(0, n, step) for n, step in zip(self.shape, self.parts, strict=False)]
        count = 0
        try:
            for k in starts[0]:
                for i in reversed(starts[1]):
                    for j in starts[2]:
                        if count == self.fails_at:
                            raise KeyboardInterrupt
                        count += 1
                        at = [slice(s, s + n) for s, n in zip((k, i, j), self.parts, strict=True)]
                        yield at[0], at[1], at[2], self.values[tuple(at)]
        finally:
            self.closed.append(True)


def random_values(*shape: int) -> np.ndarray:
    return np.random.default_rng(4).normal(size=shape).astype(np.float32)


@contextmanager
def full_disk(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A disk of 256 KiB that says it has room; skipped where no such disk can be mounted."""
    import shutil
    import subprocess
    from types import SimpleNamespace

    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs the right to mount a small disk")
    try:
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1 << 40))
            yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
