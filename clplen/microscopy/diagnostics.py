"""Diagnostic messages about a frame and its volume, one sentence each.

In an extended scene the mean sub-image of some tens of lenslets is the image of the pupil, as in
the white frame. If the sub-images of a frame are displaced from those of the white frame, the
lenslet array was moved, rotated or replaced.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.microscopy.frames.nominal_lattice import pitch_sentence
from clplen.microscopy.frames.prepare import Preparation, Prepared
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pupil.pupil_check import PupilCheck

Values = np.ndarray[Any, Any]

# Maximum residual of a volume, relative to the residual of evenly lit lenslets (both above noise).
MAX_RELATIVE_RESIDUAL = 0.75
TILES_PER_AXIS = 4  # tiles of a frame in which the displacement is estimated
MIN_CORRELATION = 0.85  # of a tile with the white frame; tiles below it are not extended scenes
MAX_SCATTER_PIXELS = 0.5  # rms deviation of the tiles from the fitted plane
MAX_DISPLACEMENT_PIXELS = 1.0  # a rectified pixel is one direction of view
_STEPS_PER_PIXEL = 10  # resolution of the estimated displacement
_MIN_CONTRAST = 1e-12  # of the light; rounding errors of a tile without contrast lie below
MAX_UNEVENNESS_RATIO = 2  # unevenness of a white frame over that of the frame


def diagnose_series(
    images: PointImages, prepare: Preparation, pupil: PupilCheck | None, is_corrected: bool
) -> list[str]:
    """Compare the white frame, or the lattice, with the point images."""
    messages = []
    nominal = images.notes.get("sensor_pixels")
    if prepare.lattice is not None and nominal:
        sentence = pitch_sentence(prepare.lattice, nominal)
        messages += [] if sentence is None else [sentence]
    if pupil is None:
        return messages
    text = pupil.sentence()
    if is_corrected:
        text += "; the pixel sensitivity corrects it (radiometric)"
    elif not pupil.fits:
        text += (
            f", which can add {pupil.share:.2g} to the residual: adjust na and apodisation, or "
            "correct the sensitivity (--radiometric)"
        )
    return [*messages, text + "."]


def diagnose_frame(prepare: Preparation, frame: Prepared, background: float) -> list[str]:
    """Compare a frame with the white and the dark frame."""
    messages = _pixels(frame, prepare.noise)
    lit = frame.counts[frame.white > 0]
    mean = float(lit.mean(dtype=np.float64)) / prepare.area if lit.size else 0.0
    if background > mean:
        messages.append(
            f"the background of {background:g} counts exceeds the mean of the frame, {mean:.4g}: "
            "almost no light remains for the volume."
        )
    if prepare.level is None:
        return messages
    n = prepare.pixels
    if unevenness(prepare.level, n) > MAX_UNEVENNESS_RATIO * unevenness(frame.counts, n):
        messages.append("the frame is lit more evenly than the white frame: are they exchanged?")
    shift = displacement(frame.counts, prepare.level, n)
    if shift is not None and shift.rms > MAX_DISPLACEMENT_PIXELS:
        messages.append(
            f"its sub-images are displaced by {shift.rms:.1f} pixels rms from those of the white "
            f"frame, in the middle (y, x) = ({shift.y:+.1f}, {shift.x:+.1f}): was the lenslet "
            "array moved, or the frame rotated? Take a new white frame."
        )
    return messages


def _pixels(frame: Prepared, noise: float) -> list[str]:
    """Report the excluded pixels."""
    messages = []
    size = max(frame.size, 1)
    if frame.left_out:
        messages.append(
            f"{frame.left_out:,} saturated or non-finite pixels are excluded "
            f"({100 * frame.left_out / size:.2g} %)."
        )
    if frame.masked:
        messages.append(f"{frame.masked:,} pixels are excluded by the mask.")
    if frame.hot:
        messages.append(
            f"{frame.hot:,} hot pixels, brighter than light could make them beside their "
            "neighbours, are excluded."
        )
    if frame.doubtful:
        messages.append(
            f"{frame.doubtful:,} pixels ({100 * frame.doubtful / size:.2g} %) are brighter beside "
            "their neighbours than these point images allow, too many to be hot pixels: they are "
            "kept. Check the parameters of the point images."
        )
    if frame.negative:
        text = f"{frame.negative:,} pixels below 0 are set to 0 "
        text += f"({100 * frame.negative / size:.2g} %)"
        if noise and frame.deep:
            text += (
                f", {frame.deep:,} of them by more than the noise of the dark frame ({noise:.2g} "
                "counts): has the dark frame the same exposure, or is it the mean of many?"
            )
        elif noise:
            text += ", all of them within the noise of the dark frame."
        messages.append(text if noise else text + ".")
    return messages


def diagnose_volume(
    residuals: Values,
    frame: Prepared,
    background: Values,
    level: Values | None,
    pixels: int,
    variance: float,
    *,
    pupil: float = 0.0,
    is_located: bool = True,
) -> list[str]:
    """Judge a volume by its residual beside those of noise and of evenly lit lenslets."""
    last, counts, n = float(residuals[-1]), frame.counts, pixels
    if last > 1:
        return [
            f"the residual of {last:.3g} exceeds 1, that of an empty volume without background: is "
            "the background too high?"
        ]
    if level is None:
        cells = counts.reshape(-1, n, counts.shape[1] // n, n).mean(axis=(0, 2))
        level = np.tile(cells, (counts.shape[0] // n, counts.shape[1] // n))
    flat = without_depth(counts, frame.white, background, level, n)
    lit = counts[frame.white > 0].astype(np.float64)
    noise = variance * lit.sum() / np.square(lit).sum()
    missing = "" if is_located else " no white frame or lattice locates the lenslets: give one,"
    if last > max(flat, noise) + pupil:
        return [
            f"the residual of {last:.3g} exceeds {flat:.3g}, that of evenly lit lenslets without "
            f"depth:{missing or ' more iterations may be needed,'} else check the white frame and "
            "the parameters of the point images."
        ]
    if flat <= noise or last - noise - pupil <= MAX_RELATIVE_RESIDUAL * (flat - noise):
        return []
    return [
        f"the residual of {last:.3g} is high beside {flat:.3g}, that of evenly lit lenslets:"
        f"{missing} more iterations may be needed, else check the white frame and the parameters "
        "of the point images."
    ]


@dataclass(frozen=True)
class Displacement:
    """Displacement of sub-images of a frame from those of its white frame, in rectified pixels."""

    y: float  # in the middle of the frame
    x: float
    rms: float  # over the frame, rotation and a change of pitch included


def displacement(counts: Values, level: Values, n: int) -> Displacement | None:
    """Estimate the displacement of the sub-images of a frame from those of the white frame.

    The mean sub-image of each of 4 x 4 tiles is correlated with that of the white frame,
    cyclically because sub-images adjoin. The displacement is a plane fitted to the 16 maxima.
    Beads and edges light parts of the pupil only: return None where a tile does not resemble the
    white frame, or the tiles disagree.
    """
    cells, white = (f.reshape(-1, n, f.shape[1] // n, n) for f in (counts, level))
    rows, columns = cells.shape[0], cells.shape[2]
    if min(rows, columns) < 2 * TILES_PER_AXIS:
        return None
    reference = white.mean(axis=(0, 2), dtype=np.float64)
    common, _ = _shift(cells.mean(axis=(0, 2), dtype=np.float64), reference)
    shifts, design = [], []
    for i in np.array_split(np.arange(rows), TILES_PER_AXIS):
        for k in np.array_split(np.arange(columns), TILES_PER_AXIS):
            part = cells[i[0] : i[-1] + 1, :, k[0] : k[-1] + 1].mean(axis=(0, 2), dtype=np.float64)
            shift, correlation = _shift(part, reference)
            if correlation < MIN_CORRELATION:
                return None
            shifts.append(common + (shift - common + n / 2) % n - n / 2)
            design.append((1, (i.mean() + 0.5) / rows - 0.5, (k.mean() + 0.5) / columns - 0.5))
    plane, *_ = np.linalg.lstsq(np.array(design), np.array(shifts), rcond=None)
    residuals = np.array(shifts) - np.array(design) @ plane
    if np.sqrt(np.square(residuals).sum() / (len(residuals) - len(plane))) > MAX_SCATTER_PIXELS:
        return None
    # the mean square of a coordinate in (-1/2, 1/2) is 1/12
    rms = np.sqrt(np.square(plane[0]).sum() + np.square(plane[1:]).sum() / 12)
    return Displacement(float(plane[0, 0]), float(plane[0, 1]), float(rms))


def _shift(tile: Values, reference: Values) -> tuple[Values, float]:
    """Return the cyclic shift (y, x) of a tile against a reference, and their correlation."""
    n, m = len(tile), _STEPS_PER_PIXEL * len(tile)
    first, second = (np.fft.fft2(picture - picture.mean()) for picture in (tile, reference))
    power = np.sqrt(np.square(abs(first)).sum() * np.square(abs(second)).sum())
    if power <= _MIN_CONTRAST * tile.sum() * reference.sum():
        return np.zeros(2), 0.0
    padded = np.zeros((m, m), complex)
    orders = np.fft.fftfreq(n, 1 / n).astype(int)
    padded[np.ix_(orders, orders)] = first * second.conj()
    correlation = np.fft.ifft2(padded).real * m**2 / power
    peak = np.array(np.unravel_index(correlation.argmax(), correlation.shape))
    return ((peak + m // 2) % m - m // 2) / _STEPS_PER_PIXEL, float(correlation.max())


def without_depth(
    counts: Values, white: Values, background: Values, level: Values, n: int
) -> float:
    """Return the residual of evenly lit lenslets, each scaled to fit its own sub-image."""
    signal, even, total = (
        np.where(white > 0, f, 0).reshape(-1, n, counts.shape[1] // n, n).astype(np.float64)
        for f in (counts - background, level, counts)
    )
    light = np.square(even).sum(axis=(1, 3), keepdims=True)
    a = (signal * even).sum(axis=(1, 3), keepdims=True) / np.where(light > 0, light, 1)
    return float(np.square(signal - a * even).sum() / np.square(total).sum())


def unevenness(frame: Values, n: int) -> float:
    """Return the standard deviation of the light of the lenslets over its mean."""
    light = frame.reshape(-1, n, frame.shape[1] // n, n).sum(axis=(1, 3), dtype=np.float64)
    return float(light.std() / max(light.mean(), np.finfo(float).tiny))
