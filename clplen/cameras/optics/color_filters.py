"""Colour filters over the pixels of a sensor, and the response of each pixel to light."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np

from clplen.checks import real_array
from clplen.reprs import OneLine
from clplen.wave.spectrum.spectral_distribution import SpectralDistribution, as_spectrum
from clplen.wave.spectrum.spectral_quadrature import Signal
from clplen.wave.spectrum.spectrum import Spectrum

Values = np.ndarray[Any, np.dtype[np.float64]]
Per = Literal["photon", "energy"]
Tile = tuple[tuple[str, ...], ...]

ORDERS = ("RGGB", "GRBG", "GBRG", "BGGR")
MAX_TILE_FILTERS = 4096  # maximum number of filters of a tile
# Sums of Gaussians of the wavelength: centre (nm), full width at half maximum (nm), height. Fitted
# by least squares to the relative sensitivities of a Nikon D5100 from 400 to 700 nm (Darrodi,
# Finlayson, Goodman and Mackiewicz, J. Opt. Soc. Am. A 32, 381 (2015)), each colour's largest 1;
# rms deviations 0.014, 0.009 and 0.025.
D5100 = {
    "R": ((588, 21, 0.556), (607, 39, 0.78), (643, 40, 0.348), (453, 78, 0.06), (528, 38, 0.108)),
    "G": ((517, 40, 0.234), (542, 82, 0.876), (474, 32, 0.273), (438, 31, 0.155)),
    "B": ((428, 15, 0.377), (447, 34, 0.461), (477, 65, 0.849)),
}
BAND_NM = (400.0, 700.0)  # nm; the camera's own filter blocks light beyond


@dataclass(frozen=True, init=False, repr=False)
class ColorFilterArray(OneLine):
    """Colour filters over the pixels: a tile that repeats, and the sensitivity behind each filter.

    Parameters
    ----------
    tile : sequence of str, or of sequences of str
        Names of the filters, row by row from the pixel (0, 0): ``["RG", "GB"]``, or
        ``[["red", "clear"], ["clear", "blue"]]``.
    sensitivities : mapping of str to SpectralDistribution
        Sensitivity behind each filter. With ``per="photon"`` it is the quantum efficiency of the
        pixel times the transmittance of its filter, electrons a photon.
    per : {"photon", "energy"}
        Unit of the sensitivities: signal of a photon, or of a unit of energy as in most published
        curves. A unit of energy at lam has lam/lam_0 times the photons of a unit at lam_0, the
        camera's ``wavelength``, where both agree.

    Attributes
    ----------
    tile : tuple of tuple of str
        Names of the filters, row by row.
    names : tuple of str
        Distinct names in the order of the tile.
    sensitivities : tuple of SpectralDistribution
        Sensitivities in the order of ``names``.
    per : str
        Unit of the sensitivities.

    Raises
    ------
    ValueError
        If the tile is empty, its rows are of unequal lengths, or it names a filter without
        sensitivity.
    TypeError
        If a name is not a string, or a sensitivity has another type.

    Examples
    --------
    >>> bayer = clplen.cameras.ColorFilterArray.bayer("RGGB")  # the filters of a Nikon D5100
    >>> bayer.tile
    (('R', 'G'), ('G', 'B'))
    >>> daylight = clplen.wave.SpectralDistribution.illuminant("D65")
    >>> {name: f"{gain:.2f}" for name, gain in bayer.white_balance(daylight).items()}
    {'R': '1.69', 'G': '1.00', 'B': '1.19'}
    """

    tile: Tile
    names: tuple[str, ...]
    sensitivities: tuple[SpectralDistribution, ...]
    per: Per

    def __init__(
        self,
        tile: Sequence[Sequence[str]],
        sensitivities: Mapping[str, SpectralDistribution],
        *,
        per: Per = "photon",
    ) -> None:
        if per not in ("photon", "energy"):
            raise ValueError(f"per must be 'photon' or 'energy', got {per!r}.")
        rows = _tile(tile)
        names = tuple(dict.fromkeys(name for row in rows for name in row))
        if not isinstance(sensitivities, Mapping):
            raise TypeError(
                "sensitivities must map names of filters to curves, such as {'R': "
                f"SpectralDistribution(...)}}, got {type(sensitivities).__name__}."
            )
        missing = [name for name in names if name not in sensitivities]
        if missing:
            available = ", ".join(map(repr, sensitivities)) or "none"
            raise ValueError(
                f"sensitivities must contain every filter of the tile, but {missing[0]!r} is "
                f"missing; got {available}."
            )
        for name in names:
            if not isinstance(sensitivities[name], SpectralDistribution):
                raise TypeError(
                    f"The sensitivity of {name!r} must be a SpectralDistribution(wavelengths, "
                    f"values), got {type(sensitivities[name]).__name__}."
                )
        object.__setattr__(self, "tile", rows)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "sensitivities", tuple(sensitivities[name] for name in names))
        object.__setattr__(self, "per", per)

    @classmethod
    def bayer(
        cls,
        order: str = "RGGB",
        sensitivities: Mapping[str, SpectralDistribution] | None = None,
        *,
        per: Per = "photon",
    ) -> ColorFilterArray:
        """Return a Bayer mosaic.

        Parameters
        ----------
        order : {"RGGB", "GRBG", "GBRG", "BGGR"}
            Filters of the pixels (0, 0), (0, 1), (1, 0), (1, 1).
        sensitivities : mapping of str to SpectralDistribution, optional
            Sensitivities of "R", "G" and "B". None: those of a Nikon D5100 as sums of Gaussians
            from 400 to 700 nm (fitted to Darrodi et al. 2015, doi:10.1364/JOSAA.32.000381; rms
            deviations 0.014, 0.009, 0.025), each colour's largest about 1 and ``per="energy"``.
        per : {"photon", "energy"}
            Unit of the given sensitivities.

        Raises
        ------
        ValueError
            If ``order`` has another value.
        """
        return _mosaic(cls, _bayer(order, 1), sensitivities, per)

    @classmethod
    def quad_bayer(
        cls,
        order: str = "RGGB",
        sensitivities: Mapping[str, SpectralDistribution] | None = None,
        *,
        per: Per = "photon",
    ) -> ColorFilterArray:
        """Return a Bayer mosaic of two by two pixels of each colour; parameters as for `bayer`."""
        return _mosaic(cls, _bayer(order, 2), sensitivities, per)

    @classmethod
    def monochrome(
        cls, sensitivity: SpectralDistribution | None = None, *, per: Per = "photon"
    ) -> ColorFilterArray:
        """Return an array without colours: every pixel has the same sensitivity.

        Parameters
        ----------
        sensitivity : SpectralDistribution, optional
            Sensitivity of the pixels. None: an ideal sensor, an electron a photon from 300 to
            1100 nm.
        per : {"photon", "energy"}
            Unit of the given sensitivity.
        """
        ideal = SpectralDistribution([300e-9, 1100e-9], [1.0, 1.0])
        return cls(["L"], {"L": ideal if sensitivity is None else sensitivity}, per=per)

    @property
    def shape(self) -> tuple[int, int]:
        """Pixels (ny, nx) of the tile."""
        return len(self.tile), len(self.tile[0])

    @property
    def mosaic(self) -> Tile | None:
        """Tile, or None if all filters are equal."""
        return None if len(self.names) == 1 else self.tile

    @cached_property
    def index(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Index in ``names`` of each pixel of the tile, shape (ny, nx)."""
        return np.array([[self.names.index(name) for name in row] for row in self.tile])

    def response(self, wavelengths: Any, reference: float) -> Values:
        """Compute the signal of a unit of energy.

        Parameters
        ----------
        wavelengths : array_like
            Wavelengths in metres, shape (n,).
        reference : float
            Wavelength in metres at which a unit of energy has as many photons as units.

        Returns
        -------
        numpy.ndarray
            Signals in the order of ``names``, shape (n, filters).
        """
        lam = real_array(wavelengths, "wavelengths", np.float64)
        curves = np.stack([curve(lam) for curve in self.sensitivities], axis=-1)
        return curves * (lam / reference)[..., None] if self.per == "photon" else curves

    def white_balance(self, light: Spectrum | SpectralDistribution) -> dict[str, float]:
        """Return factors that make the signals of white in some light equal behind all filters.

        Parameters
        ----------
        light : Spectrum or SpectralDistribution
            Spectrum of the light.

        Returns
        -------
        dict of str to float
            Factor for each name; the filter with the largest signal has 1.

        Raises
        ------
        ValueError
            If a filter does not transmit the light.
        """
        signals = signal_of(self, [as_spectrum(light, "The light")], 550e-9).totals[0]
        if not signals.min() > 0:
            blind = self.names[int(signals.argmin())]
            raise ValueError(
                f"The filter {blind!r} transmits nothing of this light: use a broader spectrum."
            )
        return {n: float(signals.max() / s) for n, s in zip(self.names, signals, strict=True)}

    def to_json(self) -> str:
        """Return the array as JSON, for `from_json`."""
        curves = {
            name: [list(curve.wavelengths), list(curve.values)]
            for name, curve in zip(self.names, self.sensitivities, strict=True)
        }
        return json.dumps({"tile": self.tile, "sensitivities": curves, "per": self.per})

    @classmethod
    def from_json(cls, text: str) -> ColorFilterArray:
        """Read an array that `to_json` wrote.

        Raises
        ------
        ValueError, TypeError, KeyError
            If the text is not valid.
        """
        values = json.loads(text)
        curves = {
            name: SpectralDistribution(*pair) for name, pair in values["sensitivities"].items()
        }
        return cls(values["tile"], curves, per=values["per"])


def signal_of(filters: ColorFilterArray, spectra: Sequence[Spectrum], reference: float) -> Signal:
    """Return the signal of spectra of unit energy behind each filter."""
    knots = np.unique([lam for curve in filters.sensitivities for lam in curve.wavelengths])
    return Signal.of(spectra, lambda lam: filters.response(lam, reference), knots.tolist())


def _tile(tile: Any) -> Tile:
    if isinstance(tile, str) or not isinstance(tile, Sequence):
        raise TypeError(
            f"tile must be rows of names of filters, such as ['RG', 'GB'], got {tile!r}."
        )
    rows = tuple(tuple(row) for row in tile)
    if not rows or not all(rows):
        raise ValueError(
            "tile must not be empty: use rows of names, such as ['RG', 'GB'], or "
            "ColorFilterArray.bayer('RGGB')."
        )
    if any(len(row) != len(rows[0]) for row in rows) or len(rows) * len(rows[0]) > MAX_TILE_FILTERS:
        raise ValueError(
            f"tile must have rows of equal length and at most {MAX_TILE_FILTERS} filters, got rows "
            f"of {[len(row) for row in rows][:9]} filters."
        )
    for name in (name for row in rows for name in row):
        if not isinstance(name, str) or not name:
            raise TypeError(f"The name of a filter must be a string, such as 'R', got {name!r}.")
    return rows


def _bayer(order: str, size: int) -> list[list[str]]:
    """Return the tile of a Bayer mosaic of ``size`` by ``size`` pixels of each colour."""
    if not isinstance(order, str) or order.upper() not in ORDERS:
        raise ValueError(f"order must be one of {', '.join(ORDERS)}, got {order!r}.")
    name = order.upper()
    return [[name[2 * (y // size) + x // size] for x in range(2 * size)] for y in range(2 * size)]


def _mosaic(
    kind: type[ColorFilterArray],
    tile: list[list[str]],
    sensitivities: Mapping[str, SpectralDistribution] | None,
    per: Per,
) -> ColorFilterArray:
    if sensitivities is None:
        return kind(tile, _d5100(), per="energy")
    return kind(tile, sensitivities, per=per)


@lru_cache(maxsize=1)
def _d5100() -> dict[str, SpectralDistribution]:
    nm = np.arange(BAND_NM[0], BAND_NM[1] + 1, 5.0)
    return {
        name: SpectralDistribution(
            nm * 1e-9,
            sum(h * np.exp(-4 * np.log(2) * ((nm - c) / w) ** 2) for c, w, h in parts),
        )
        for name, parts in D5100.items()
    }
