"""What a comparison of cameras found, as tidy tables: a row a value, SI units in the headers."""

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
    """Rows under a header; the first column is the camera's name.

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
        """As CSV, whole or not at all; NaN stays empty.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        with (
            replacing(path) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(self.header)
            writer.writerows([_written(cell) for cell in row] for row in self.rows)


def tables(comparison: Comparison) -> dict[str, Table]:
    """All tables of a comparison, by the names that their files get; "summary" is the first."""
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
    found = {"summary": Table(("camera", "quantity", "value", "unit"), tuple(_summary(comparison)))}
    for name, (rows, header) in makers.items():
        if name in comparison.analyses:
            every = [row for one in comparison.cameras for row in rows(one)]
            found[name] = Table(header, tuple(every))
    if "transfer" in comparison.analyses:
        header = ("camera", "dz_m", "mtf50_of_object_cycles_per_m", "nyquist_of_object", "note")
        every = [row for one in comparison.cameras for row in _best_focus(one)]
        found["transfer-mtf50"] = Table(header, tuple(every))
    return found


def summary_values(one: Measured, analyses: tuple[str, ...]) -> dict[str, tuple[float, str]]:
    """The numbers of one camera, (value, unit) by name, of what was asked for."""
    found: dict[str, tuple[float, str]] = {}
    if "psf" in analyses and one.psf is not None:
        for axis in (0, 1):
            found[f"FWHM {AXES[axis]}"] = (one.fwhm(axis), "m")
    if "mtf" in analyses:
        for axis in (0, 1):
            mtf = one.mtf(axis)
            for name, value in (
                ("MTF50", mtf.at(0.5)),
                ("MTF10", mtf.at(0.1)),
                ("MTF cut-off", one.mtf_cutoff(axis)),
            ):
                found[f"{name} {AXES[axis]}"] = (value, "cycles/m")
    if "two-points" in analyses:
        for axis in (0, 1):
            found[f"two-point limit {AXES[axis]}"] = (one.two_point_limit(axis), "m")
    if "strehl" in analyses:
        found["Strehl ratio"] = (one.strehl(), "")
    if "energy" in analyses and one.psf is not None:
        for share in (0.5, 0.8):
            found[f"radius of {share:.0%} of the energy"] = (one.radius(share), "m")
    if one.crosstalk is not None:
        found["crosstalk"] = (one.crosstalk, "")
    if one.transfer is not None:
        dz, frequency = one.transfer.best
        found["best focus at dz"] = (dz, "m")
        found["MTF50 there, of the object"] = (frequency, "cycles/m")
    if one.depth is not None:
        known = one.depth.errors[np.isfinite(one.depth.errors)]
        rms = float(np.sqrt(np.mean(known**2))) if known.size else math.nan
        found["rms error of depth, where measured"] = (rms, "m")
        measured = np.isfinite(one.depth.rms)
        found["depths measured"] = (float(measured.sum()), f"of {measured.size}")
    return found


def _summary(comparison: Comparison) -> Iterator[Row]:
    for one in comparison.cameras:
        for name, (value, unit) in summary_values(one, comparison.analyses).items():
            yield one.name, name, value, unit


def _sampling(one: Measured) -> Iterator[Row]:
    for field in fields(Sampling):
        value = float(getattr(one.sampling, field.name))  # the kind, "1.0", too
        yield one.name, field.name, value, _UNITS.get(field.name, "")


def _psf(one: Measured) -> Iterator[Row]:
    assert one.psf is not None
    centre = one.psf.centroid()
    for axis in (0, 1):
        places, line = one.psf.profile(axis)
        for place, value in zip(places - centre[axis], line / one.psf.peak, strict=True):
            yield one.name, AXES[axis], place, value


def _mtf(one: Measured) -> Iterator[Row]:
    for axis in (0, 1):
        curve = one.mtf(axis)
        for frequency, value in zip(curve.frequency, curve.value, strict=True):
            yield one.name, AXES[axis], frequency, value


def _two_points(one: Measured) -> Iterator[Row]:
    for axis in (0, 1):
        s = one.separations()
        for separation, value in zip(s, one.mid_over_peak(s, axis), strict=True):
            yield one.name, AXES[axis], separation, value


def _energy(one: Measured) -> Iterator[Row]:
    for radius, share in zip(*one.encircled(), strict=True):
        yield one.name, radius, share


def _transfer(one: Measured) -> Iterator[Row]:
    assert one.transfer is not None
    for dz, curve in zip(one.transfer.dz, one.transfer.curves, strict=True):
        if curve is not None:
            for frequency, value in zip(curve.frequency, curve.value, strict=True):
                yield one.name, dz, frequency, value


def _best_focus(one: Measured) -> Iterator[Row]:
    assert one.transfer is not None
    rows = zip(one.transfer.dz, one.transfer.mtf50, one.transfer.notes, strict=True)
    for dz, frequency, note in rows:
        yield one.name, dz, frequency, object_nyquist(one.camera, float(dz)), note


def _depth(one: Measured) -> Iterator[Row]:
    assert one.depth is not None
    for dz, errors, note in zip(one.depth.dz, one.depth.errors, one.depth.notes, strict=True):
        for place, error in enumerate(errors):
            yield one.name, dz, place, error, note


def _written(cell: Any) -> str:
    if isinstance(cell, str):
        return cell
    if not fits_float64(cell):
        return "" if cell != cell else str(cell)
    return f"{cell:.9g}"
