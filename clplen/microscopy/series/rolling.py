"""Background that changes in time: the minimum of each pixel over a window of frames.

What is always there, haze and a slowly changing autofluorescence, stays in the minimum; what is
brighter at times stands above it. The minimum of N counts with the noise s lies below their mean by
about s sqrt(2 ln N), so that rather too little is taken for background than too much.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import numpy as np

from clplen.checks import host_array, positive_integer

Vector = np.ndarray[Any, Any]


def rolling_minimum(frames: Iterable[Any], window: int) -> Iterator[tuple[Vector, Vector]]:
    """Each frame of a series with the minimum of its pixels over ``window`` frames about it."""
    window = positive_integer(window, "window")
    ahead = (window - 1) // 2
    series, held, before = iter(frames), deque[Vector](), 0  # frames held before the next one
    while True:
        missing = before + 1 + ahead - len(held)
        held.extend(host_array(frame, "A frame") for frame in islice(series, missing))
        if before == len(held):
            return
        yield held[before], np.minimum.reduce(held)
        before += 1
        if before > window // 2:
            held.popleft()
            before -= 1
