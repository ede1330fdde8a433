"""Named spectra, spectra from files, and checks of their numbers."""

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
# Ranges of wavelengths that imply a unit, 100 nm to 20 um; in nm only up to 2600, since larger
# numbers may be angstrom or wavenumbers in /cm.
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
    """Return wavelengths in metres and density of a white LED; see `Spectrum.white_led`."""
    nm = np.arange(380.0, 781.0, 5.0)
    parts = [h * np.exp(-4 * np.log(2) * ((nm - p) / w) ** 2) for p, w, h in WHITE_LED]
    return nm * 1e-9, np.sum(parts, axis=0)


def daylight() -> tuple[Vector, Vector]:
    """Return wavelengths in metres and relative power of CIE standard illuminant D65."""
    return np.arange(300, 831, 10, dtype=np.float64) * 1e-9, np.array(D65, np.float64)


def check_wavelength(value: object) -> float:
    """Return a wavelength of light in metres, or raise a ValueError."""
    fault = _no_wavelength(value)
    if fault:
        raise ValueError(fault)
    return float(value)  # type: ignore[arg-type]


def check_width(width: object, wavelength: float, what: str) -> float:
    """Return a width below half the wavelength, or raise a ValueError."""
    if not (is_finite(width) and 0 < width < wavelength / 2):  # type: ignore[operator]
        raise ValueError(
            f"{what} must be positive and below half the wavelength, {metres(wavelength / 2, 4)}, "
            f"got {width!r} m{_hint(width)}"
        )
    return float(width)  # type: ignore[arg-type]


def check_table(wavelengths: Any, values: Any) -> tuple[Vector, Vector]:
    """Return a density over rising wavelengths, without the dark points at its ends."""
    lam, density = (np.array(real_array(a, "A spectrum", float)) for a in (wavelengths, values))
    if lam.ndim != 1 or lam.shape != density.shape:
        raise ValueError(
            "wavelengths and values must be rows of equal length, got shapes "
            f"{lam.shape} and {density.shape}."
        )
    fault = fault_of(lam, density)
    if fault:
        point, sentence = fault
        raise ValueError(sentence if point is None else f"Point {point} of a spectrum: {sentence}")
    lit = np.flatnonzero(density)
    within = slice(max(0, lit[0] - 1), lit[-1] + 2)  # 0 outside anyway
    return lam[within], density[within]


def check_count(n: object) -> int:
    """Return a number of samples, or raise a ValueError."""
    if not is_integer(n) or n < 1:  # type: ignore[operator]
        raise ValueError(f"n must be an integer of at least 1, got {n!r}.")
    return int(n)  # type: ignore[call-overload]


def check_path(path: object) -> float:
    """Return a path difference, or raise a ValueError."""
    if not is_finite(path) or path < 0:  # type: ignore[operator]
        raise ValueError(f"path must be at least 0, in metres, got {path!r}.")
    return float(path)  # type: ignore[arg-type]


def check_powers(wavelengths: Any, powers: Any) -> tuple[list[float], list[float]]:
    """Return wavelengths and powers, of sum 1, of the lines with power."""
    lam, power = (np.array(real_array(a, "A spectrum", float)) for a in (wavelengths, powers))
    if lam.ndim != 1 or lam.shape != power.shape or not lam.size:
        raise ValueError(
            "wavelengths and powers must be rows of equal length, got shapes "
            f"{lam.shape} and {power.shape}."
        )
    for value in lam:
        check_wavelength(float(value))
    if not (np.isfinite(power).all() and (power >= 0).all() and power.any()):
        raise ValueError(
            f"powers must be finite, not negative and not all 0, got {power.tolist()}."
        )
    lit = power > 0
    return lam[lit].tolist(), (power[lit] / power.sum()).tolist()


def fault_of(wavelengths: Vector, values: Vector) -> tuple[int | None, str] | None:
    """Return the fault of a table, its point (None: all points) and a message, or None."""
    for i, (lam, value) in enumerate(zip(wavelengths.tolist(), values.tolist(), strict=True)):
        fault = _no_wavelength(lam)
        if fault:
            return i, fault
        if not fits_float64(value) or value < 0:
            why = "is not a number" if not fits_float64(value) else "is negative"
            return i, f"the value {value:g} {why}; set negative noise to 0."
        if i and lam <= wavelengths[i - 1]:
            before = metres(float(wavelengths[i - 1]))
            return i, f"wavelengths must rise, got {metres(lam)} after {before}; sort them."
    if len(values) < 2:
        return None, f"A tabulated spectrum must have at least two points, got {len(values)}."
    if not values.any():
        return None, "A spectrum is empty: every value is 0."
    return None


def _no_wavelength(value: object) -> str:
    """Return a message unless a value is a wavelength of light in metres."""
    if not is_finite(value):
        return f"A wavelength must be a finite number of metres, got {value!r}."
    if SHORTEST <= value <= LONGEST:  # type: ignore[operator]
        return ""
    return f"{value:g} m is not a wavelength of light: wavelengths are in metres{_hint(value)}"


def _hint(value: object) -> str:
    """Return the end of a message, with a guess for numbers in nanometres or micrometres."""
    if not is_finite(value) or not LONGEST < value < 1e5:  # type: ignore[operator]
        return "."
    return f", did you mean {value:g}e-{9 if value >= 10 else 6}?"  # type: ignore[operator]


def read_table(path: str | os.PathLike[str], unit: str | None) -> tuple[Vector, Vector]:
    """Return wavelengths in metres and density from a file; see `Spectrum.read`."""
    if unit is not None and unit not in UNITS:
        raise ValueError(f"unit must be 'm', 'um', 'nm' or None, got {unit!r}.")
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
        raise FormatError(f"{path} is not a text file; provide two columns of numbers.")
    return text


def _rows(path: Path, text: str) -> tuple[list[int], list[list[float]]]:
    """Return the numbers of the lines with numbers, from 1, and their values."""
    lines: list[int] = []
    rows: list[list[float]] = []
    for i, line in enumerate(text.splitlines(), 1):
        cells = line.split("#")[0].replace(",", " ").split()
        if not cells or (not rows and not NUMBER.match(cells[0])):
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != 2 or not np.isfinite(row).all():
            raise FormatError(
                f"{path}, line {i}: {line.strip()[:40]!r} is not a wavelength and a value; provide "
                "two columns with decimal points."
            )
        lines.append(i)
        rows.append(row)
    return lines, rows


def _guess(path: Path, wavelengths: Vector) -> str:
    """Return the unit in which all wavelengths of a file are visible or nearby light."""
    if not wavelengths.size:
        raise FormatError(f"{path} contains no numbers; provide two columns of numbers.")
    low, high = wavelengths.min(), wavelengths.max()
    for unit, (shortest, longest) in GUESSES.items():
        if shortest <= low and high <= longest:
            return unit
    raise FormatError(
        f"{path}: the unit of wavelengths from {low:g} to {high:g} is ambiguous; set unit='m', "
        "'um' or 'nm'."
    )
