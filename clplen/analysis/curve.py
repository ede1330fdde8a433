"""A transfer function along one direction, and the frequencies at which it is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.samples import Values, first_fall
from clplen.errors import ShapeError
from clplen.reprs import OneLine


@dataclass(frozen=True, eq=False, repr=False)
class Curve(OneLine):
    """Contrast against spatial frequency.

    Attributes
    ----------
    frequency : numpy.ndarray
        Cycles a metre, ascending from 0, float64, shape (n,).
    value : numpy.ndarray
        Contrast, 1 at frequency 0, float64, shape (n,).

    Raises
    ------
    ShapeError
        If the two have not the same length, at least 2.
    ValueError
        If a number is not finite or the frequencies do not ascend.
    """

    frequency: Values
    value: Values

    def __post_init__(self) -> None:
        f, v = (np.array(a, np.float64) for a in (self.frequency, self.value))
        if f.ndim != 1 or f.shape != v.shape or f.size < 2:
            raise ShapeError(
                f"A curve has as many frequencies as values, at least 2, not {f.shape} and "
                f"{v.shape}."
            )
        if not (np.isfinite(f).all() and np.isfinite(v).all() and (np.diff(f) > 0).all()):
            raise ValueError("The frequencies of a curve ascend, and all its numbers are finite.")
        object.__setattr__(self, "frequency", f)
        object.__setattr__(self, "value", v)

    def at(self, value: float) -> float:
        """The frequency of a contrast: where the curve first falls below it.

        Between samples by a straight line. MTF50 is ``at(0.5)``, MTF10 ``at(0.1)``.

        Parameters
        ----------
        value : float
            Between 0 and 1.

        Returns
        -------
        float
            Cycles a metre; NaN where the curve never falls so low.

        Raises
        ------
        ValueError
            For another contrast.
        """
        if not 0 < value < 1:
            raise ValueError(f"A contrast to look for lies between 0 and 1, not {value!r}.")
        return first_fall(self.frequency, self.value, value)

    def contrast(self, frequency: Any) -> Any:
        """The contrast at frequencies, between samples by a straight line.

        Parameters
        ----------
        frequency : array_like
            Cycles a metre.

        Returns
        -------
        numpy.ndarray or float
            NaN outside the curve.
        """
        found = np.interp(frequency, self.frequency, self.value, left=np.nan, right=np.nan)
        return float(found) if np.ndim(found) == 0 else found

    def floor(self, beyond: float) -> float:
        """rms of the curve beyond a frequency where no signal can be: its noise floor.

        Parameters
        ----------
        beyond : float
            Cycles a metre.

        Raises
        ------
        ValueError
            If the curve ends before it.
        """
        rest = self.value[self.frequency > beyond]
        if not rest.size:
            raise ValueError(
                f"The curve ends at {self.frequency[-1]:.6g} cycles/m, not beyond {beyond!r}."
            )
        return float(np.sqrt(np.mean(rest**2)))

    def cutoff(self, *, level: float = 0.01, noise: float = 0.0) -> float:
        """The first frequency from which on the curve stays at or below ``level + noise``.

        Zeros between lobes are passed over, unlike by `at`.

        Parameters
        ----------
        level : float
            Contrast that counts as nothing.
        noise : float
            Noise floor, such as `floor` gives.

        Returns
        -------
        float
            Cycles a metre, between samples by a straight line; NaN where the curve ends above.

        Raises
        ------
        ValueError
            If a number is negative, or their sum is 0 or not below 1.
        """
        least = level + noise
        if not (level >= 0 and noise >= 0 and 0 < least < 1):
            raise ValueError(
                f"level and noise are not negative and sum to between 0 and 1, not to {level!r} "
                f"+ {noise!r}."
            )
        above = np.flatnonzero(self.value > least)
        if not above.size:
            return float(self.frequency[0])
        k = int(above[-1])
        if k + 1 == self.value.size:
            return float("nan")
        (f0, f1), (v0, v1) = self.frequency[k : k + 2], self.value[k : k + 2]
        return float(f0 + (f1 - f0) * (v0 - least) / (v0 - v1))
