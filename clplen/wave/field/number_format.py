"""Numbers as people read them: lengths, frequencies, angles and amounts with their prefixes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence


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
    """The half angle asin(lam f) and the numerical aperture lam f of a spatial frequency.

    Parameters
    ----------
    frequency : float
        In cycles a metre, at least 0.
    wavelength : float
        In metres.
    """
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
