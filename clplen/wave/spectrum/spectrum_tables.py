"""Spectra by name, from a file, and the checks of their numbers."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import fits_float64, is_finite, is_integer, real_array
from clplen.errors import FormatError
from clplen.units import metres

SHORTEST, LONGEST = 1e-10, 1e-3  # metres
UNITS = {"m": 1.0, "um": 1e6, "nm": 1e9}  # in a metre
# Where the wavelengths of a file without a unit are taken for one: 100 nm to 20 um; in nm only up
# to 2600 nm, since more may be angstrom, or wavenumbers in /cm.
GUESSES = {"m": (1e-7, 2e-5), "um": (0.1, 20.0), "nm": (100.0, 2600.0)}
BINARY = re.compile(r"[\x00-\x08\x0e-\x1f]")
NUMBER = re.compile(r"[-+.\d]")

# Visible lines of Hg I in vacuum and their relative intensities in a low-pressure pencil lamp:
# NIST Atomic Spectra Database, after Sansonetti, Salit & Reader, Appl. Opt. 35, 74 (1996).
MERCURY = {
    404.77081e-9: 12000.0,
    407.89883e-9: 1000.0,
    435.95600e-9: 12000.0,
    546.22675e-9: 6000.0,
    577.12101e-9: 1000.0,
    579.22757e-9: 900.0,
}
# Peak (nm), FWHM (nm) and height of the blue die and of the yellow phosphor.
WHITE_LED = ((445.0, 25.0, 1.0), (560.0, 125.0, 0.5))
# Relative power of CIE standard illuminant D65 from 300 to 830 nm every 10 nm: CIE 15:2004, table
# T.1 (ISO 11664-2).
D65 = (
    0.0341, 3.2945, 20.236, 37.0535, 39.9488, 44.9117, 46.6383, 52.0891, 49.9755, 54.6482, 82.7549,
    91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811, 109.354,
    107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342, 95.788, 88.6856, 90.0062, 89.5991,
    87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091, 74.349, 61.604,
    69.8856, 75.087, 63.5927, 46.4182, 66.8054, 63.3828, 64.304, 59.4519, 51.959, 57.4406, 60.3125,
)  # fmt: skip

Vector = np.ndarray[Any, np.dtype[np.float64]]


def white_led() -> tuple[Vector, Vector]:
    """Wavelengths in metres and density of a white LED; see `Spectrum.white_led`."""
    nm = np.arange(380.0, 781.0, 5.0)
    parts = [h * np.exp(-4 * np.log(2) * ((nm - p) / w) ** 2) for p, w, h in WHITE_LED]
    return nm * 1e-9, np.sum(parts, axis=0)


def daylight() -> tuple[Vector, Vector]:
    """Wavelengths in metres and relative power of CIE standard illuminant D65."""
    return np.arange(300, 831, 10, dtype=np.float64) * 1e-9, np.array(D65, np.float64)


def check_wavelength(value: object) -> float:
    """Refuse what is no wavelength of light in metres."""
    fault = _no_wavelength(value)
    if fault:
        raise ValueError(fault)
    return float(value)  # type: ignore[arg-type]


def check_width(width: object, wavelength: float, what: str) -> float:
    """Refuse a width that is not positive, or comes within a factor of 2 of the wavelength."""
    if not (is_finite(width) and 0 < width < wavelength / 2):  # type: ignore[operator]
        raise ValueError(
            f"{what} is positive and below half the wavelength, in metres, that is below "
            f"{metres(wavelength / 2, 4)} here, not {width!r}{_meant(width)}"
        )
    return float(width)  # type: ignore[arg-type]


def check_table(wavelengths: Any, values: Any) -> tuple[Vector, Vector]:
    """A density over rising wavelengths, without the dark points at its ends."""
    lam, density = (np.array(real_array(a, "A spectrum", float)) for a in (wavelengths, values))
    if lam.ndim != 1 or lam.shape != density.shape:
        raise ValueError(
            "A spectrum has one value for each wavelength, two rows of the same length, not "
            f"shapes {lam.shape} and {density.shape}."
        )
    fault = fault_of(lam, density)
    if fault:
        point, sentence = fault
        raise ValueError(sentence if point is None else f"Point {point} of a spectrum: {sentence}")
    lit = np.flatnonzero(density)
    within = slice(max(0, lit[0] - 1), lit[-1] + 2)  # 0 outside anyway
    return lam[within], density[within]


def check_count(n: object) -> int:
    """Refuse what is no number of samples."""
    if not is_integer(n) or n < 1:  # type: ignore[operator]
        raise ValueError(f"A number of samples is a whole number, at least 1, not {n!r}.")
    return int(n)  # type: ignore[call-overload]


def check_path(path: object) -> float:
    """Refuse what is no path difference."""
    if not is_finite(path) or path < 0:  # type: ignore[operator]
        raise ValueError(f"A path difference is a length in metres, at least 0, not {path!r}.")
    return float(path)  # type: ignore[arg-type]


def check_powers(wavelengths: Any, powers: Any) -> tuple[list[float], list[float]]:
    """Wavelengths and powers, sum 1, of the lines that have any."""
    lam, power = (np.array(real_array(a, "A spectrum", float)) for a in (wavelengths, powers))
    if lam.ndim != 1 or lam.shape != power.shape or not lam.size:
        raise ValueError(
            "Lines have one power each, two rows of the same length, not shapes "
            f"{lam.shape} and {power.shape}."
        )
    for value in lam:
        check_wavelength(float(value))
    if not (np.isfinite(power).all() and (power >= 0).all() and power.any()):
        raise ValueError(
            f"The powers of lines are finite, none negative and not all 0: {power.tolist()}."
        )
    lit = power > 0
    return lam[lit].tolist(), (power[lit] / power.sum()).tolist()


def fault_of(wavelengths: Vector, values: Vector) -> tuple[int | None, str] | None:
    """What is wrong with a table: its point (None: the whole of it) and a sentence."""
    for i, (lam, value) in enumerate(zip(wavelengths.tolist(), values.tolist(), strict=True)):
        fault = _no_wavelength(lam)
        if fault:
            return i, fault
        if not fits_float64(value) or value < 0:
            why = "is no number" if not fits_float64(value) else "is negative"
            return i, f"the value {value:g} {why}: a density is at least 0, set noise below 0 to 0."
        if i and lam <= wavelengths[i - 1]:
            before = metres(float(wavelengths[i - 1]))
            return i, f"{metres(lam)} comes after {before}: wavelengths rise, sort them."
    if len(values) < 2:
        return None, f"A tabulated spectrum has at least two points, not {len(values)}."
    if not values.any():
        return None, "A spectrum is empty: every value is 0."
    return None


def _no_wavelength(value: object) -> str:
    """A sentence, where something is no wavelength of light in metres."""
    if not is_finite(value):
        return f"A wavelength is a finite number of metres, not {value!r}."
    if SHORTEST <= value <= LONGEST:  # type: ignore[operator]
        return ""
    return f"{value:g} m is no wavelength of light: wavelengths are in metres{_meant(value)}"


def _meant(value: object) -> str:
    """What a number of nanometres or micrometres was meant to be."""
    if not is_finite(value) or not LONGEST < value < 1e5:  # type: ignore[operator]
        return "."
    return f", did you mean {value:g}e-{9 if value >= 10 else 6}?"  # type: ignore[operator]


def read_table(path: str | os.PathLike[str], unit: str | None) -> tuple[Vector, Vector]:
    """Wavelengths in metres and density from a file; see `Spectrum.read`."""
    if unit is not None and unit not in UNITS:
        raise ValueError(f"The unit of the wavelengths is 'm', 'um', 'nm' or None, not {unit!r}.")
    path = Path(path)
    lines, rows = _rows(path, _text(path))
    table = np.array(rows, dtype=float).reshape(-1, 2)
    lam = table[:, 0] / UNITS[unit or _guess(path, table[:, 0])]
    fault = fault_of(lam, table[:, 1])
    if fault:
        point, sentence = fault
        where = str(path) if point is None else f"{path}, line {lines[point]}"
        raise FormatError(f"{where}: {sentence}")
    return lam, table[:, 1]


def _text(path: Path) -> str:
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_bytes().decode("latin-1")
    if BINARY.search(text):
        raise FormatError(f"{path} is no text file: a spectrum is two columns of numbers.")
    return text


def _rows(path: Path, text: str) -> tuple[list[int], list[list[float]]]:
    """The lines that hold numbers, counted from 1, and their numbers."""
    lines: list[int] = []
    rows: list[list[float]] = []
    for i, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words or (not rows and not NUMBER.match(words[0])):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != 2 or not np.isfinite(row).all():
            raise FormatError(
                f"{path}, line {i}: {line.strip()[:40]!r} is not a wavelength and a value: a "
                "spectrum has two columns, with a decimal point."
            )
        lines.append(i)
        rows.append(row)
    return lines, rows


def _guess(path: Path, wavelengths: Vector) -> str:
    """The unit in which all wavelengths of a file are those of visible or nearby light."""
    if not wavelengths.size:
        raise FormatError(f"{path} holds no numbers: a spectrum is two columns of numbers.")
    low, high = wavelengths.min(), wavelengths.max()
    for unit, (shortest, longest) in GUESSES.items():
        if shortest <= low and high <= longest:
            return unit
    raise FormatError(
        f"{path}: wavelengths from {low:g} to {high:g} leave their unit open: give unit='m', 'um' "
        "or 'nm'."
    )
