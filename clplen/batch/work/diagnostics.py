"""Diagnostics of a frame and of the volume behind it, a sentence each."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.microscopy.frames.given_lattice import pitch_sentence
from clplen.microscopy.frames.prepare import Preparation
from clplen.microscopy.frames.prepared import Prepared
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pupil.pupil_check import PupilCheck
from clplen.microscopy.reconstruction.fit import MOST, displacement, unevenness, without_depth

Values = np.ndarray[Any, Any]

EXPLAINED = 0.75  # of what lenslets without depth leave: a volume that leaves more says little
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
    if found is not None and found.rms > MOST:
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
