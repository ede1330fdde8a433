"""Lengths in metres: how they are printed, and which unit was meant where one cannot be metres.

Sizes of memory in bytes are read here, too.

The bounds only tell metres from forgotten units. They hold whatever is built or observed, with
room: gamma rays and radio waves, dishes of 500 m, telescopes of long focal length. Distances of
propagation, of sources and of objects have none but 1e12 m.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_UNITS = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3}


@dataclass(frozen=True)
class Length:
    """Lengths of one kind, in metres.

    Attributes
    ----------
    most : float
        Larger numbers are refused.
    usual : tuple of float
        (low, high): where a number in another unit is looked for.
    units : tuple of str
        The units in which the kind is usually given, the most usual first.
    """

    most: float
    usual: tuple[float, float]
    units: tuple[str, ...]

    def check(self, values: Any, what: str) -> None:
        """Refuse numbers that are too large to be metres; anything but finite numbers passes."""
        if isinstance(values, float) and abs(values) <= self.most:
            return
        try:
            numbers = np.abs(np.asarray(values, np.float64))
        except (TypeError, ValueError):  # which the caller refuses in its own words
            return
        except OverflowError:
            raise ValueError(
                f"{what} is in metres, at most {self.most:g}, not a number above 1e308."
            ) from None
        beyond = numbers[np.isfinite(numbers) & (numbers > self.most)]
        if beyond.size:
            largest = float(beyond.max())
            raise ValueError(
                f"{what} is in metres, at most {self.most:g}, not {largest:g}{self.meant(largest)}"
            )

    def meant(self, value: float) -> str:
        """The end of a sentence: what a number in another unit is in metres."""
        low, high = self.usual
        for unit in self.units:
            metres = value * _UNITS[unit]
            if low <= metres <= high and math.isfinite(metres):
                return f"; did you mean {metres:.6g}?"
        return "."


# From gamma rays to radio waves of 1 GHz; light, from X-rays to terahertz, is what is meant.
WAVELENGTH = Length(0.3, (1e-7, 3e-3), ("nm", "um", "mm"))
# Grids, pixels and periods of gratings: 1 m samples a dish of 500 m. Where fresnel-1fft samples
# light that has gone far there is no bound.
PITCH = Length(1.0, (1e-8, 5e-3), ("um", "nm", "mm"))
# Distances and places of output grids: no unit is told from another, but squares stay finite.
DISTANCE = Length(1e12, (0.0, 0.0), ())
# Lenslets, up to the lenses of an array of cameras.
LENSLET_PITCH = Length(0.1, (2e-6, 2e-2), ("um", "mm"))
PIXEL_PITCH = Length(1e-3, (2e-7, 1e-4), ("um", "nm", "mm"))
# By how much arrays and sensors lie beside the axis.
OFFSET = Length(0.5, (1e-7, 5e-2), ("um", "mm"))
LENSLET_FOCAL_LENGTH = Length(5.0, (5e-6, 1.0), ("mm", "um"))
# Lenses of imaging systems: telescopes have 50 m and more.
FOCAL_LENGTH = Length(100.0, (1e-4, 20.0), ("mm", "um"))
# Main lenses of cameras, and the distances behind them: primary mirrors have up to 20 m, and the
# usual lenses 25 mm and more.
CAMERA_FOCAL_LENGTH = Length(20.0, (1e-4, 2.0), ("mm", "um"))
# Lenses by themselves may be as weak as a plate that is not quite flat.
WEAK_LENS = Length(1e5, (1e-4, 100.0), ("um", "mm"))
# Apertures, from the pupils of eyes to dishes of 500 m; those of cameras to mirrors of 40 m.
DIAMETER = Length(1000.0, (1e-6, 10.0), ("um", "mm"))
CAMERA_DIAMETER = Length(50.0, (1e-5, 2.0), ("mm", "um"))
TUBE_LENS = Length(5.0, (1e-2, 2.0), ("mm", "um"))
# Places on the image plane of a camera, up to plates of half a metre.
IMAGE_PLACE = Length(5.0, (1e-5, 0.3), ("mm", "um"))
# Wavefront errors: a tenth of a millimetre is a hundred wavelengths and more.
WAVEFRONT = Length(1e-2, (5e-10, 1e-4), ("nm", "um"))
# Single points of light that have a size: beads, pinholes, lamps.
POINT = Length(1.0, (1e-9, 5e-3), ("um", "nm", "mm"))


def metres(value: float, digits: int = 6) -> str:
    """A length as m, mm, um or nm."""
    for factor, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")):
        if value == 0 or abs(value) >= factor * (1 - 1e-12):
            return f"{value / factor:.{digits}g} {unit}"
    return f"{value * 1e9:.{digits}g} nm"


def amount(value: float, unit: str) -> str:
    """Bytes, operations or samples with a decimal prefix, to three digits."""
    for factor, prefix in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def angle(frequency: float, wavelength: float) -> str:
    """The half angle asin(lam f) and the numerical aperture lam f of a spatial frequency."""
    sine = wavelength * frequency
    if sine > 1:
        return "half angle 90 deg and evanescent waves"
    return f"half angle {math.degrees(math.asin(sine)):.4g} deg, NA {sine:.3g}"


def interval(low: float, high: float) -> str:
    """An interval of distances in metres; 0 and infinity are no ends."""
    if low > 0 and math.isfinite(high):
        return f"{metres(low, 4)} to {metres(high, 4)}"
    if low > 0:
        return f"from {metres(low, 4)} on"
    return f"up to {metres(high, 4)}" if math.isfinite(high) else "any"


def both(values: Sequence[float], show: Callable[[float], str]) -> str:
    """What belongs to y and x; once where both read the same."""
    texts = [show(value) for value in values]
    return texts[0] if len(set(texts)) == 1 else " x ".join(texts) + " (y x)"


_BYTES = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
_BYTES |= {f"{unit}B": size for unit, size in _BYTES.items()}
_BYTES |= {"KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30, "TIB": 1 << 40}
_SIZE = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*([KMGT]?I?B?)\s*", re.IGNORECASE)
_MAX_DIGITS = 30  # of a size; a float holds ten times as many


def bytes_of(value: Any) -> int:
    """Return a size of memory, as 2000000, "512MiB" or "4 GB", in bytes."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError('must be a whole number of bytes or a size such as "4 GiB"')
    found = _SIZE.fullmatch(str(value))
    unit = found[2].upper() if found else ""
    if found is None or unit not in _BYTES or len(found[1]) > _MAX_DIGITS:
        raise ValueError('must be a whole number of bytes or a size such as "512MiB" or "4 GB"')
    return int(float(found[1]) * _BYTES[unit])
