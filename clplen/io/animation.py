"""Animated GIFs: to look at, never to measure."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np

from clplen.files import PathLike, replacing


def write_animation(
    path: PathLike, pictures: Iterable[np.ndarray[Any, Any]], *, seconds: float = 0.1
) -> None:
    """Write pictures as an animated GIF that repeats for ever.

    Parameters
    ----------
    path : path-like
        ``.gif``.
    pictures : iterable of numpy.ndarray
        uint8, all of one shape (y, x) or (y, x, 3), at least one. A GIF keeps 256 colours.
    seconds : float
        For each picture, at least 0.02.

    Raises
    ------
    ValueError
        If the suffix is another one, there is no picture, or they differ.
    OSError
        If the file cannot be written.
    """
    frames = list(pictures)
    if Path(path).suffix.lower() != ".gif":
        raise ValueError(f"An animation is written as .gif, not as {Path(path).name}.")
    if not frames or len({frame.shape for frame in frames}) != 1:
        raise ValueError("An animation has at least one picture, all of one shape.")
    if any(frame.dtype != np.uint8 or frame.ndim not in (2, 3) for frame in frames):
        raise ValueError("The pictures of an animation are uint8, (y, x) or (y, x, 3).")
    if not seconds >= 0.02:
        raise ValueError(f"A picture is shown for at least 0.02 seconds, not {seconds!r}.")
    with replacing(path) as temporary:
        imageio.imwrite(
            temporary,
            np.stack(frames),
            plugin="pillow",
            extension=".gif",
            duration=1000 * seconds,
            loop=0,
        )
