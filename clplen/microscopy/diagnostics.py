"""Diagnostics of a frame and of the volume behind it, a sentence each.

Where light comes from many places, the mean sub-image of some tens of lenslets is the image of the
pupil, in a frame as in the white frame. Parts of the frame whose sub-images lie elsewhere than
those of the white frame show that the array of lenslets was moved or turned, or is another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.microscopy.frames.given_lattice import pitch_sentence
from clplen.microscopy.frames.prepare import Preparation, Prepared
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pupil.pupil_check import PupilCheck

Values = np.ndarray[Any, Any]

EXPLAINED = 0.75  # of what lenslets without depth leave: a volume that leaves more says little
PARTS = 4  # of a frame along an axis
ALIKE = 0.85  # correlation with the white frame from which on a part tells something
SCATTER = 0.5  # pixels, rms of single parts about what all of them say
FARTHEST = 1.0  # pixels, the step from one direction to the next
_STEPS = 10  # of a pixel, to which a displacement is found
_FINEST = 1e-12  # of the light: a part without contrast
UNEVEN = 2  # times the unevenness of the frame: a white frame that is more so is none


def diagnose_series(
    images: PointImages, prepare: Preparation, pupil: PupilCheck | None, is_corrected: bool
) -> list[str]:
    """How the white frame, or the lattice, fits the point images."""
    said = []
    nominal = images.notes.get("sensor_pixels")
    if prepare.lattice is not None and nominal:
        sentence = pitch_sentence(prepare.lattice, nominal)
        said += [] if sentence is None else [sentence]
    if pupil is None:
        return said
    text = pupil.sentence()
    if is_corrected:
        text += "; the sensitivity of pixels holds it (radiometric)"
    elif not pupil.fits:
        text += (
            f", and a volume may leave {pupil.share:.2g} of residual for it: mend na and "
            "apodisation, or correct the sensitivity (--radiometric)"
        )
    return [*said, text + "."]


def diagnose_frame(prepare: Preparation, frame: Prepared, background: float) -> list[str]:
    """What a frame looks like beside the white and the dark frame."""
    said = _pixels(frame, prepare.noise)
    lit = frame.counts[frame.white > 0]
    mean = float(lit.mean(dtype=np.float64)) / prepare.area if lit.size else 0.0
    if background > mean:
        said.append(
            f"the background of {background:g} counts is above the mean of the frame, {mean:.4g}: "
            "hardly anything is left for the volume."
        )
    if prepare.level is None:
        return said
    n = prepare.pixels
    if unevenness(prepare.level, n) > UNEVEN * unevenness(frame.counts, n):
        said.append("the frame is lit more evenly than the white frame: are they exchanged?")
    found = displacement(frame.counts, prepare.level, n)
    if found is not None and found.rms > FARTHEST:
        said.append(
            f"its sub-images lie {found.rms:.1f} pixels rms from those of the white frame, in the "
            f"middle (y, x) = ({found.y:+.1f}, {found.x:+.1f}): was the array of lenslets moved, "
            "or the frame turned? Take a new white frame."
        )
    return said


def _pixels(frame: Prepared, noise: float) -> list[str]:
    """Those that do not count."""
    said = []
    size = max(frame.size, 1)
    if frame.left_out:
        said.append(
            f"{frame.left_out:,} saturated or not finite pixels are left out "
            f"({100 * frame.left_out / size:.2g} %)."
        )
    if frame.masked:
        said.append(f"{frame.masked:,} pixels are left out by the mask.")
    if frame.hot:
        said.append(
            f"{frame.hot:,} hot pixels, which stand out of those around them as no light does, are "
            "left out."
        )
    if frame.doubtful:
        said.append(
            f"{frame.doubtful:,} pixels ({100 * frame.doubtful / size:.2g} %) stand out more than "
            "light of these point images does, too many to be hot: they are kept. Look at the "
            "parameters of the point images."
        )
    if frame.negative:
        text = f"{frame.negative:,} pixels below 0 are taken as 0 "
        text += f"({100 * frame.negative / size:.2g} %)"
        if noise and frame.deep:
            text += (
                f", {frame.deep:,} of them by more than the noise of the dark frame ({noise:.2g} "
                "counts): is that of the same exposure, or the mean of many?"
            )
        elif noise:
            text += ", all of them within the noise of the dark frame."
        said.append(text if noise else text + ".")
    return said


def diagnose_volume(
    residuals: Values,
    frame: Prepared,
    background: Values,
    level: Values | None,
    pixels: int,
    variance: float,
    *,
    pupil: float = 0.0,
    placed: bool = True,
) -> list[str]:
    """How well a volume explains its frame."""
    last, counts, n = float(residuals[-1]), frame.counts, pixels
    if last > 1:
        return [
            f"the residual is {last:.3g}, and an empty volume without background leaves 1: is the "
            "background too high?"
        ]
    if level is None:
        cells = counts.reshape(-1, n, counts.shape[1] // n, n).mean(axis=(0, 2))
        level = np.tile(cells, (counts.shape[0] // n, counts.shape[1] // n))
    flat = without_depth(counts, frame.white, background, level, n)
    lit = counts[frame.white > 0].astype(np.float64)
    noise = variance * lit.sum() / np.square(lit).sum()
    missing = "" if placed else " no white frame and no lattice told where lenslets are: give one,"
    if last > max(flat, noise) + pupil:
        return [
            f"the residual of {last:.3g} is worse than no depth at all, {flat:.3g} by lenslets lit "
            f"evenly:{missing or ' more iterations may be needed,'} else look at the white frame "
            "and at the parameters of the point images."
        ]
    if flat <= noise or last - noise - pupil <= EXPLAINED * (flat - noise):
        return []
    return [
        f"the residual of {last:.3g} is high, lenslets lit evenly would leave {flat:.3g}:{missing} "
        "more iterations may be needed, else look at the white frame and at the parameters of the "
        "point images."
    ]


@dataclass(frozen=True)
class Displacement:
    """Displacement of sub-images of a frame from those of its white frame, in rectified pixels."""

    y: float  # in the middle of the frame
    x: float
    rms: float  # over the frame, with what turning and another pitch add


def displacement(counts: Values, level: Values, n: int) -> Displacement | None:
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


def _shift(part: Values, known: Values) -> tuple[Values, float]:
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
    counts: Values, white: Values, background: Values, level: Values, n: int
) -> float:
    """The residual that lenslets leave which are lit evenly, each as brightly as fits best."""
    seen, even, of = (
        np.where(white > 0, one, 0).reshape(-1, n, counts.shape[1] // n, n).astype(np.float64)
        for one in (counts - background, level, counts)
    )
    light = np.square(even).sum(axis=(1, 3), keepdims=True)
    a = (seen * even).sum(axis=(1, 3), keepdims=True) / np.where(light > 0, light, 1)
    return float(np.square(seen - a * even).sum() / np.square(of).sum())


def unevenness(frame: Values, n: int) -> float:
    """Standard deviation of the light of lenslets over its mean."""
    light = frame.reshape(-1, n, frame.shape[1] // n, n).sum(axis=(1, 3), dtype=np.float64)
    return float(light.std() / max(light.mean(), np.finfo(float).tiny))
