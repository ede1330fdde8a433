"""Tidy tables of a comparison of cameras: one value per row, SI units in the headers."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import object_nyquist
from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.sampling import Sampling
from clplen.checks import fits_float64
from clplen.files import PathLike, replacing
from clplen.reprs import OneLine

AXES = ("y", "x")
_UNITS = {
    "spatial_pitch": "m",
    "angular_step": "rad",
    "angular_range": "rad",
    "nyquist": "cycles_per_m",
    "diffraction_cutoff": "cycles_per_m",
}
Row = tuple[Any, ...]


@dataclass(frozen=True, repr=False)
class Table(OneLine):
    """Table whose first column is the camera's name.

    Attributes
    ----------
    header : tuple of str
        Names of the columns, with their units.
    rows : tuple of tuple
        Cells of each row, str or float, as many as the header has.

    Examples
    --------
    >>> rows = (("macro", 19.0), ("wide", float("nan")))
    >>> clplen.analysis.Table(("camera", "views"), rows).write("views.csv")
    >>> with open("views.csv") as file:
    ...     file.read().split()
    ['camera,views', 'macro,19', 'wide,']
    """

    header: tuple[str, ...]
    rows: tuple[Row, ...]

    def write(self, path: PathLike) -> None:
        """Write CSV atomically; NaN becomes an empty cell.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        with (
            replacing(path) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(self.header)
            writer.writerows([_csv_cell(cell) for cell in row] for row in self.rows)


def tables(comparison: Comparison) -> dict[str, Table]:
    """Return all tables of a comparison by their file names; "summary" is the first."""
    makers = {
        "sampling": (_sampling, ("camera", "quantity", "value", "unit")),
        "psf": (_psf, ("camera", "axis", "position_m", "intensity_over_peak")),
        "mtf": (_mtf, ("camera", "axis", "frequency_cycles_per_m", "contrast")),
        "two-points": (_two_points, ("camera", "axis", "separation_m", "mid_over_peak")),
        "energy": (_energy, ("camera", "radius_m", "share")),
        "transfer": (
            _transfer,
            ("camera", "dz_m", "frequency_of_object_cycles_per_m", "contrast"),
        ),
        "depth": (_depth, ("camera", "dz_m", "place", "error_m", "note")),
    }
    results = {
        "summary": Table(("camera", "quantity", "value", "unit"), tuple(_summary(comparison)))
    }
    for name, (rows, header) in makers.items():
        if name in comparison.analyses:
            table_rows = [row for measured in comparison.cameras for row in rows(measured)]
            results[name] = Table(header, tuple(table_rows))
    if "transfer" in comparison.analyses:
        header = ("camera", "dz_m", "mtf50_of_object_cycles_per_m", "nyquist_of_object", "note")
        table_rows = [row for measured in comparison.cameras for row in _best_focus(measured)]
        results["transfer-mtf50"] = Table(header, tuple(table_rows))
    return results


def summary_values(measured: Measured, analyses: tuple[str, ...]) -> dict[str, tuple[float, str]]:
    """Return the numbers of a camera's analyses as (value, unit) by name."""
    values: dict[str, tuple[float, str]] = {}
    if "psf" in analyses and measured.psf is not None:
        for axis in (0, 1):
            values[f"FWHM {AXES[axis]}"] = (measured.fwhm(axis), "m")
    if "mtf" in analyses:
        for axis in (0, 1):
            mtf = measured.mtf(axis)
            for name, value in (
                ("MTF50", mtf.at(0.5)),
                ("MTF10", mtf.at(0.1)),
                ("MTF cut-off", measured.mtf_cutoff(axis)),
            ):
                values[f"{name} {AXES[axis]}"] = (value, "cycles/m")
    if "two-points" in analyses:
        for axis in (0, 1):
            values[f"two-point limit {AXES[axis]}"] = (measured.two_point_limit(axis), "m")
    if "strehl" in analyses:
        values["Strehl ratio"] = (measured.strehl(), "")
    if "energy" in analyses and measured.psf is not None:
        for share in (0.5, 0.8):
            values[f"radius of {share:.0%} of the energy"] = (measured.radius(share), "m")
    if measured.crosstalk is not None:
        values["crosstalk"] = (measured.crosstalk, "")
    if measured.transfer is not None:
        dz, frequency = measured.transfer.best
        values["best focus at dz"] = (dz, "m")
        values["MTF50 there, of the object"] = (frequency, "cycles/m")
    if measured.depth is not None:
        errors = measured.depth.errors[np.isfinite(measured.depth.errors)]
        rms = float(np.sqrt(np.mean(errors**2))) if errors.size else math.nan
        values["rms error of depth, where measured"] = (rms, "m")
        is_measured = np.isfinite(measured.depth.rms)
        values["depths measured"] = (float(is_measured.sum()), f"of {is_measured.size}")
    return values


def _summary(comparison: Comparison) -> Iterator[Row]:
    for measured in comparison.cameras:
        for name, (value, unit) in summary_values(measured, comparison.analyses).items():
            yield measured.name, name, value, unit


def _sampling(measured: Measured) -> Iterator[Row]:
    for field in fields(Sampling):
        value = float(getattr(measured.sampling, field.name))  # the kind, "1.0", too
        yield measured.name, field.name, value, _UNITS.get(field.name, "")


def _psf(measured: Measured) -> Iterator[Row]:
    assert measured.psf is not None
    centre = measured.psf.centroid()
    for axis in (0, 1):
        positions, line = measured.psf.profile(axis)
        for position, value in zip(positions - centre[axis], line / measured.psf.peak, strict=True):
            yield measured.name, AXES[axis], position, value


def _mtf(measured: Measured) -> Iterator[Row]:
    for axis in (0, 1):
        curve = measured.mtf(axis)
        for frequency, value in zip(curve.frequency, curve.value, strict=True):
            yield measured.name, AXES[axis], frequency, value


def _two_points(measured: Measured) -> Iterator[Row]:
    for axis in (0, 1):
        s = measured.separations()
        for separation, value in zip(s, measured.mid_over_peak(s, axis), strict=True):
            yield measured.name, AXES[axis], separation, value


def _energy(measured: Measured) -> Iterator[Row]:
    for radius, share in zip(*measured.encircled(), strict=True):
        yield measured.name, radius, share


def _transfer(measured: Measured) -> Iterator[Row]:
    assert measured.transfer is not None
    for dz, curve in zip(measured.transfer.dz, measured.transfer.curves, strict=True):
        if curve is not None:
            for frequency, value in zip(curve.frequency, curve.value, strict=True):
                yield measured.name, dz, frequency, value


def _best_focus(measured: Measured) -> Iterator[Row]:
    assert measured.transfer is not None
    rows = zip(measured.transfer.dz, measured.transfer.mtf50, measured.transfer.notes, strict=True)
    for dz, frequency, note in rows:
        yield measured.name, dz, frequency, object_nyquist(measured.camera, float(dz)), note


def _depth(measured: Measured) -> Iterator[Row]:
    assert measured.depth is not None
    for dz, errors, note in zip(
        measured.depth.dz, measured.depth.errors, measured.depth.notes, strict=True
    ):
        for position, error in enumerate(errors):
            yield measured.name, dz, position, error, note


def _csv_cell(cell: Any) -> str:
    if isinstance(cell, str):
        return cell
    if not fits_float64(cell):
        return "" if cell != cell else str(cell)
    return f"{cell:.9g}"
