"""Whether a rectified frame fits its white frame: places of sub-images, and a volume without depth.

Where light comes from many places, the mean sub-image of some tens of lenslets is the image of the
pupil, in a frame as in the white frame. Parts of the frame whose sub-images are not where those of
the white frame are tell that the array of lenslets was moved or turned, or another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Vector = np.ndarray[Any, Any]

PARTS = 4  # of a frame along an axis
ALIKE = 0.85  # correlation with the white frame from which on a part tells something
SCATTER = 0.5  # pixels, rms of single parts about what all of them say
MOST = 1.0  # pixels, the step from one direction to the next
_STEPS = 10  # of a pixel, to which a displacement is found
_FINEST = 1e-12  # of the light: a part without contrast


@dataclass(frozen=True)
class Displacement:
    """Of the sub-images of a frame from those of its white frame, in rectified pixels.

    Attributes
    ----------
    y, x : float
        In the middle of the frame.
    rms : float
        Over the frame, with what turning and another pitch add.
    """

    y: float
    x: float
    rms: float


def displacement(counts: Vector, level: Vector, n: int) -> Displacement | None:
    """How far the sub-images of a frame lie from those of the white frame.

    The frame is cut into 4 x 4 parts. The mean sub-image of each is correlated with that of the
    white frame, cyclically because sub-images adjoin; a plane through the 16 places of the maxima
    is the displacement. Beads and edges light parts of the pupil only: where a part does not look
    like the white frame, or parts disagree, nothing is said.
    """
    cells, white = (one.reshape(-1, n, one.shape[1] // n, n) for one in (counts, level))
    rows, columns = cells.shape[0], cells.shape[2]
    if min(rows, columns) < 2 * PARTS:
        return None
    known = white.mean(axis=(0, 2), dtype=np.float64)
    whole, _ = _shift(cells.mean(axis=(0, 2), dtype=np.float64), known)
    found, places = [], []
    for i in np.array_split(np.arange(rows), PARTS):
        for k in np.array_split(np.arange(columns), PARTS):
            part = cells[i[0] : i[-1] + 1, :, k[0] : k[-1] + 1].mean(axis=(0, 2), dtype=np.float64)
            shift, alike = _shift(part, known)
            if alike < ALIKE:
                return None
            found.append(whole + (shift - whole + n / 2) % n - n / 2)
            places.append((1, (i.mean() + 0.5) / rows - 0.5, (k.mean() + 0.5) / columns - 0.5))
    plane, *_ = np.linalg.lstsq(np.array(places), np.array(found), rcond=None)
    left = np.array(found) - np.array(places) @ plane
    if np.sqrt(np.square(left).sum() / (len(left) - len(plane))) > SCATTER:
        return None
    # the mean square of places in (-1/2, 1/2) is 1/12
    rms = np.sqrt(np.square(plane[0]).sum() + np.square(plane[1:]).sum() / 12)
    return Displacement(float(plane[0, 0]), float(plane[0, 1]), float(rms))


def _shift(part: Vector, known: Vector) -> tuple[Vector, float]:
    """(y, x) by which one cyclic picture lies from another, and their correlation there."""
    n, m = len(part), _STEPS * len(part)
    first, second = (np.fft.fft2(one - one.mean()) for one in (part, known))
    power = np.sqrt(np.square(abs(first)).sum() * np.square(abs(second)).sum())
    if power <= _FINEST * part.sum() * known.sum():
        return np.zeros(2), 0.0
    wide = np.zeros((m, m), complex)
    places = np.fft.fftfreq(n, 1 / n).astype(int)
    wide[np.ix_(places, places)] = first * second.conj()
    seen = np.fft.ifft2(wide).real * m**2 / power
    at = np.array(np.unravel_index(seen.argmax(), seen.shape))
    return ((at + m // 2) % m - m // 2) / _STEPS, float(seen.max())


def without_depth(
    counts: Vector, white: Vector, background: Vector, level: Vector, n: int
) -> float:
    """The residual that lenslets leave which are lit evenly, each as brightly as fits best."""
    seen, even, of = (
        np.where(white > 0, one, 0).reshape(-1, n, counts.shape[1] // n, n).astype(np.float64)
        for one in (counts - background, level, counts)
    )
    light = np.square(even).sum(axis=(1, 3), keepdims=True)
    a = (seen * even).sum(axis=(1, 3), keepdims=True) / np.where(light > 0, light, 1)
    return float(np.square(seen - a * even).sum() / np.square(of).sum())


def unevenness(frame: Vector, n: int) -> float:
    """Standard deviation of the light of lenslets over its mean."""
    light = frame.reshape(-1, n, frame.shape[1] // n, n).sum(axis=(1, 3), dtype=np.float64)
    return float(light.std() / max(light.mean(), np.finfo(float).tiny))
