"""Glasses and plastics: refractive index by Sellmeier's formula from published coefficients."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen import units
from clplen.checks import real_array
from clplen.reprs import OneLine

LINE_F, LINE_D, LINE_C = 486.1327e-9, 587.5618e-9, 656.2725e-9  # lines of H, He, H in metres
_ROUNDING = 1e-9  # relative tolerance of the ends of a range
_SMALLEST_C = 1e-5  # um^2, a resonance at 3 nm; smaller values are in m^2


@dataclass(frozen=True, init=False, repr=False)
class Glass(OneLine):
    """Transparent material with a refractive index by Sellmeier's formula (Sellmeier 1871).

    n^2 - 1 = sum over i of B_i lam^2/(lam^2 - C_i), the form of glass catalogues.

    Parameters
    ----------
    name : str
        Name, not blank.
    B : sequence of float
        Strengths of the resonances, dimensionless.
    C : sequence of float
        Squared wavelengths of the resonances in um^2, as in catalogues, one for each B; 0 adds a
        constant.
    range : tuple of float
        Shortest and longest wavelength of the formula in metres.
    source : str
        Source of the coefficients.

    Raises
    ------
    ValueError
        If coefficients are not finite or differ in number, a resonance lies within the range, or
        the range is invalid.

    See Also
    --------
    Glass.named : Materials with published coefficients.

    Notes
    -----
    Catalogues list indices relative to air at about 20 C, and wavelengths in air.

    Examples
    --------
    >>> f"{clplen.wave.Glass.named('N-BK7').index(587.5618e-9):.5f}"
    '1.51680'
    >>> glass = clplen.wave.Glass("sample", (1.0, 0.2), (0.007, 0.02), (0.4e-6, 1.1e-6))
    >>> f"{glass.index(550e-9):.4f}"
    '1.4959'
    """

    name: str
    B: tuple[float, ...]
    C: tuple[float, ...]
    range: tuple[float, float]
    source: str = ""

    def __init__(
        self,
        name: str,
        B: Sequence[float],
        C: Sequence[float],
        range: tuple[float, float],
        source: str = "",
    ) -> None:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"name must be a string that is not blank, got {name!r}.")
        strengths, resonances = _coefficients(name, B, "B"), _coefficients(name, C, "C")
        if len(strengths) != len(resonances):
            raise ValueError(
                f"B and C of {name} must have equal length, got {len(strengths)} and "
                f"{len(resonances)}."
            )
        ends = _ends(name, range)
        _check_resonances(name, resonances, ends)
        values = {"name": name, "B": strengths, "C": resonances, "range": ends, "source": source}
        for key, value in values.items():
            object.__setattr__(self, key, value)
        lam = np.linspace(*ends, 1001)
        if not (self._square(lam) >= 1).all():
            raise ValueError(
                f"With these coefficients {name} has an index below 1 within its range of "
                f"{_between(ends)}; give C in um^2."
            )

    @classmethod
    def named(cls, name: str) -> Glass:
        """Return a material with published coefficients; `names` lists them.

        Glasses of Schott and Ohara and fused silica (Malitson 1965) agree with the indices of their
        catalogues to 1e-5. PMMA and polycarbonate are fits to measurements with an error of 1e-3,
        so their Abbe numbers are uncertain by a tenth.

        Parameters
        ----------
        name : str
            Name used by the manufacturer; case, blanks and hyphens are ignored.

        Raises
        ------
        ValueError
            If the name is unknown; the message suggests similar names.
        """
        key = _plain(name) if isinstance(name, str) else ""
        names = {_plain(title): title for title in _PUBLISHED} | _ALSO
        if key in names:
            title = names[key]
            return cls(title, *_PUBLISHED[title])
        near = difflib.get_close_matches(key, names, n=3, cutoff=0.5)
        hint = (
            f" Did you mean {' or '.join(dict.fromkeys(names[n] for n in near))}?" if near else ""
        )
        raise ValueError(
            f"There is no glass {name!r}; there are {', '.join(_PUBLISHED)}.{hint} Define other "
            "materials by Glass(name, B, C, range)."
        )

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the materials of `named`."""
        return tuple(_PUBLISHED)

    def index(self, wavelength: Any) -> Any:
        """Return the refractive index.

        Parameters
        ----------
        wavelength : float or array_like
            Wavelength in metres, within `range`.

        Returns
        -------
        float or numpy.ndarray
            Refractive index, float64, with the shape of ``wavelength``.

        Raises
        ------
        ValueError
            If a wavelength is outside of the range.
        """
        lam = self._within(wavelength)
        n = np.sqrt(self._square(lam))
        return float(n) if n.ndim == 0 else n

    def dispersion(self, wavelength: Any) -> Any:
        """Return dn/dlam in 1/m, with the shape of ``wavelength``; negative in clear glass.

        n dn/dlam = -sum over i of B_i C_i lam/(lam^2 - C_i)^2.
        """
        lam = self._within(wavelength)
        c = np.multiply(self.C, 1e-12)
        square = lam[..., None] ** 2
        terms = np.multiply(self.B, c) * lam[..., None] / (square - c) ** 2
        slope = -np.sum(terms, axis=-1) / np.sqrt(self._square(lam))
        return float(slope) if slope.ndim == 0 else slope

    @property
    def n_d(self) -> float:
        """Refractive index at the yellow line of helium, 587.5618 nm."""
        return float(self.index(LINE_D))

    @property
    def abbe_number(self) -> float:
        """Abbe number V_d = (n_d - 1)/(n_F - n_C), lines F and C at 486.1327 and 656.2725 nm.

        Raises
        ------
        ValueError
            If the lines are outside of the range.
        """
        n_f, n_d, n_c = self.index(np.array([LINE_F, LINE_D, LINE_C]))
        return float((n_d - 1) / (n_f - n_c))

    def _square(self, lam: Any) -> Any:
        """Return n^2, with 0 instead of infinity on a resonance."""
        square = np.asarray(lam)[..., None] ** 2
        return 1 + np.sum(np.multiply(self.B, square) / (square - np.multiply(self.C, 1e-12)), -1)

    def _within(self, wavelength: Any) -> Any:
        lam = real_array(wavelength, "wavelength", np.float64)
        low, high = self.range
        inside = (lam >= low * (1 - _ROUNDING)) & (lam <= high * (1 + _ROUNDING))
        if not inside.all():
            wrong = float(lam[~inside].ravel()[0])
            raise ValueError(
                f"wavelength must be within {_between(self.range)} for {self.name}, got {wrong:g} m"
                f"{units.WAVELENGTH.suggestion(wrong)}"
            )
        return lam


def index_of(glass: Glass | float, wavelength: float) -> float:
    """Return the index of a glass at a wavelength; a number is the index at all wavelengths."""
    return float(glass.index(wavelength)) if isinstance(glass, Glass) else float(glass)


def _coefficients(name: str, values: Any, what: str) -> tuple[float, ...]:
    numbers = np.atleast_1d(real_array(values, f"The coefficients {what} of {name}", np.float64))
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise ValueError(f"{what} of {name} must be finite numbers, got {values!r}.")
    return tuple(float(number) for number in numbers)


def _ends(name: str, limits: Any) -> tuple[float, float]:
    units.WAVELENGTH.check(limits, f"The range of {name}")
    ends = np.asarray(limits)
    if ends.shape != (2,) or not np.isfinite(ends).all() or not 0 < ends[0] < ends[1]:
        raise ValueError(
            f"range of {name} must be its shortest and longest wavelength in metres, got "
            f"{limits!r}."
        )
    return float(ends[0]), float(ends[1])


def _check_resonances(name: str, C: tuple[float, ...], ends: tuple[float, float]) -> None:
    tiny = [c for c in C if 0 < abs(c) < _SMALLEST_C]
    if tiny:
        raise ValueError(
            f"C of {name} must be in um^2, as in catalogues, got {tiny[0]:g}"
            f"{f'; did you mean {tiny[0] * 1e12:.6g}?' if tiny[0] > 0 else '.'}"
        )
    low, high = (end * 1e6 for end in ends)
    inside = [c for c in C if low**2 <= c <= high**2]
    if inside:
        raise ValueError(
            f"{name} has a resonance at {math.sqrt(inside[0]):g} um (C = {inside[0]:g} um^2), "
            f"within its range of {_between(ends)}."
        )


def _between(ends: tuple[float, float]) -> str:
    return f"{units.metres(ends[0])} to {units.metres(ends[1])}"


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


_SCHOTT = "Schott, optical glass catalogue, 20 January 2017"
_POLYMER = "fit by Polyanskiy (refractiveindex.info) to Sultanova, Kasarova and Nikolov (2009)"
# Name: B, C in um^2, range in metres, source.
_PUBLISHED: dict[str, tuple[Any, ...]] = {
    "N-BK7": (
        (1.03961212, 0.231792344, 1.01046945),
        (0.00600069867, 0.0200179144, 103.560653),
        (0.3e-6, 2.5e-6),
        _SCHOTT,
    ),
    "N-SF11": (
        (1.73759695, 0.313747346, 1.89878101),
        (0.013188707, 0.0623068142, 155.23629),
        (0.37e-6, 2.5e-6),
        _SCHOTT,
    ),
    "SF11": (
        (1.73848403, 0.311168974, 1.17490871),
        (0.0136068604, 0.0615960463, 121.922711),
        (0.39e-6, 2.5e-6),
        _SCHOTT,
    ),
    "F2": (
        (1.34533359, 0.209073176, 0.937357162),
        (0.00997743871, 0.0470450767, 111.886764),
        (0.32e-6, 2.5e-6),
        _SCHOTT,
    ),
    "S-LAH79": (
        (2.32557148, 0.507967133, 2.43087198),
        (0.0132895208, 0.0528335449, 161.122408),
        (0.37e-6, 2.4e-6),
        "Ohara, optical glass catalogue, 30 November 2017",
    ),
    "fused silica": (
        (0.6961663, 0.4079426, 0.8974794),
        (0.0684043**2, 0.1162414**2, 9.896161**2),
        (0.21e-6, 3.71e-6),
        "Malitson (1965), table I and eq. 1",
    ),
    "PMMA": ((1.1819,), (0.011313,), (0.4368e-6, 1.052e-6), _POLYMER),
    "polycarbonate": ((1.4182,), (0.021304,), (0.4368e-6, 1.052e-6), _POLYMER),
}
_ALSO = {
    "silica": "fused silica",
    "sio2": "fused silica",
    "acrylic": "PMMA",
    "pc": "polycarbonate",
}
