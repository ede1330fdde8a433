"""Formatting of lengths in metres, detection of forgotten units, and sizes of memory in bytes.

The bounds separate metres from other units. They include whatever is built or observed, with a
margin: gamma rays and radio waves, dishes of 500 m, telescopes of long focal length. Distances of
propagation, of sources and of objects are bounded by 1e12 m only.
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
    """Bounds of lengths of one kind, in metres.

    Attributes
    ----------
    max_length : float
        Largest accepted length.
    usual : tuple of float
        Usual range (low, high) in which a number in another unit is searched.
    units : tuple of str
        Units of the kind, the most usual first.
    """

    max_length: float
    usual: tuple[float, float]
    units: tuple[str, ...]

    def check(self, values: Any, label: str) -> None:
        """Raise ValueError for numbers too large to be metres; other values pass."""
        if isinstance(values, float) and abs(values) <= self.max_length:
            return
        try:
            numbers = np.abs(np.asarray(values, np.float64))
        except (TypeError, ValueError):  # the caller raises its own error
            return
        except OverflowError:
            raise ValueError(
                f"{label} must be in metres, at most {self.max_length:g}, got more than 1e308."
            ) from None
        beyond = numbers[np.isfinite(numbers) & (numbers > self.max_length)]
        if beyond.size:
            largest = float(beyond.max())
            raise ValueError(
                f"{label} must be in metres, at most {self.max_length:g}, got "
                f"{largest:g}{self.suggestion(largest)}"
            )

    def suggestion(self, value: float) -> str:
        """Return the end of a message that suggests the length in metres of another unit."""
        low, high = self.usual
        for unit in self.units:
            metres = value * _UNITS[unit]
            if low <= metres <= high and math.isfinite(metres):
                return f"; did you mean {metres:.6g}?"
        return "."


# Gamma rays to radio waves of 1 GHz; suggestions from X-rays to terahertz.
WAVELENGTH = Length(0.3, (1e-7, 3e-3), ("nm", "um", "mm"))
# Grids, pixels and periods of gratings: 1 m samples a dish of 500 m. Output grids of fresnel-1fft
# over long distances are not bounded.
PITCH = Length(1.0, (1e-8, 5e-3), ("um", "nm", "mm"))
# Distances and positions of output grids: no unit is suggested, but squares stay finite.
DISTANCE = Length(1e12, (0.0, 0.0), ())
# Lenslets, up to the lenses of an array of cameras.
LENSLET_PITCH = Length(0.1, (2e-6, 2e-2), ("um", "mm"))
PIXEL_PITCH = Length(1e-3, (2e-7, 1e-4), ("um", "nm", "mm"))
# Offsets of arrays and sensors from the axis.
OFFSET = Length(0.5, (1e-7, 5e-2), ("um", "mm"))
LENSLET_FOCAL_LENGTH = Length(5.0, (5e-6, 1.0), ("mm", "um"))
# Lenses of imaging systems: telescopes have 50 m and more.
FOCAL_LENGTH = Length(100.0, (1e-4, 20.0), ("mm", "um"))
# Main lenses of cameras, and the distances behind them: primary mirrors have up to 20 m, and the
# usual lenses 25 mm and more.
CAMERA_FOCAL_LENGTH = Length(20.0, (1e-4, 2.0), ("mm", "um"))
# Single lenses may be as weak as a plate that is slightly curved.
WEAK_LENS = Length(1e5, (1e-4, 100.0), ("um", "mm"))
# Apertures, from the pupils of eyes to dishes of 500 m; those of cameras to mirrors of 40 m.
DIAMETER = Length(1000.0, (1e-6, 10.0), ("um", "mm"))
CAMERA_DIAMETER = Length(50.0, (1e-5, 2.0), ("mm", "um"))
TUBE_LENS = Length(5.0, (1e-2, 2.0), ("mm", "um"))
# Positions on the image plane of a camera, up to plates of half a metre.
IMAGE_PLACE = Length(5.0, (1e-5, 0.3), ("mm", "um"))
# Wavefront errors: 0.1 mm is at least a hundred wavelengths.
WAVEFRONT = Length(1e-2, (5e-10, 1e-4), ("nm", "um"))
# Point sources of finite size: beads, pinholes, lamps.
POINT = Length(1.0, (1e-9, 5e-3), ("um", "nm", "mm"))


def metres(value: float, digits: int = 6) -> str:
    """Format a length as m, mm, um or nm."""
    for factor, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")):
        if value == 0 or abs(value) >= factor * (1 - 1e-12):
            return f"{value / factor:.{digits}g} {unit}"
    return f"{value * 1e9:.{digits}g} nm"


def amount(value: float, unit: str) -> str:
    """Format bytes, operations or samples with a decimal prefix, to three digits."""
    for factor, prefix in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def angle(frequency: float, wavelength: float) -> str:
    """Format the half angle asin(lam f) and numerical aperture lam f of a spatial frequency."""
    sine = wavelength * frequency
    if sine > 1:
        return "half angle 90 deg and evanescent waves"
    return f"half angle {math.degrees(math.asin(sine)):.4g} deg, NA {sine:.3g}"


def interval(low: float, high: float) -> str:
    """Format an interval of distances in metres, open at 0 and infinity."""
    if low > 0 and math.isfinite(high):
        return f"{metres(low, 4)} to {metres(high, 4)}"
    if low > 0:
        return f"from {metres(low, 4)} on"
    return f"up to {metres(high, 4)}" if math.isfinite(high) else "any"


def both(values: Sequence[float], show: Callable[[float], str]) -> str:
    """Format values along y and x, or a single value if both texts are equal."""
    texts = [show(value) for value in values]
    return texts[0] if len(set(texts)) == 1 else " x ".join(texts) + " (y x)"


_BYTES = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
_BYTES |= {f"{unit}B": size for unit, size in _BYTES.items()}
_BYTES |= {"KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30, "TIB": 1 << 40}
_SIZE = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*([KMGT]?I?B?)\s*", re.IGNORECASE)
_MAX_DIGITS = 30  # digits of a size, far below the limit of a float


def bytes_of(value: Any) -> int:
    """Convert a size of memory, such as 2000000, "512MiB" or "4 GB", to bytes."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError('must be a whole number of bytes or a size such as "4 GiB"')
    match = _SIZE.fullmatch(str(value))
    unit = match[2].upper() if match else ""
    if match is None or unit not in _BYTES or len(match[1]) > _MAX_DIGITS:
        raise ValueError('must be a whole number of bytes or a size such as "512MiB" or "4 GB"')
    return int(float(match[1]) * _BYTES[unit])
