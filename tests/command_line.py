"""The command ``clplen`` in this process, and what it says."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from click.testing import CliRunner, Result

from clplen.cli import main
from clplen.compute.device import Device


def invoke(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def invoke_on(device: Device, *words: object) -> Result:
    return invoke(*words, "--device", device.place)


def done(result: Result) -> str:
    """Return the standard output of a command that succeeded."""
    assert result.exit_code == 0, result.output
    return result.stdout


def said(result: Result, code: int = 1) -> str:
    """Return the standard error of a command that failed without a traceback."""
    assert result.exit_code == code, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output
    return result.stderr


def refused(result: Result, code: int = 2) -> str:
    """Return the standard error as one line."""
    return " ".join(said(result, code).split())


def write_views(folder: Path, size: tuple[int, int], d: float = 1.0) -> Path:
    """Write 3 x 5 colour views of a textured plane at disparity d, named a_{v}_{u}.png."""
    folder.mkdir()
    random = np.random.default_rng(3)
    waves = [(random.uniform(-1.2, 1.2, 2), random.uniform(0, 6)) for _ in range(40)]
    y, x = np.indices(size)
    for v, u in np.ndindex(3, 5):
        parts = [
            np.cos(ky * (y + d * (v - 1)) + kx * (x + d * (u - 2)) + at) for (ky, kx), at in waves
        ]
        grey = np.clip(120 + 12 * sum(parts), 0, 255).astype(np.uint8)
        imageio.imwrite(folder / f"a_{v}_{u}.png", np.stack([grey, grey // 2, 255 - grey], -1))
    return folder
