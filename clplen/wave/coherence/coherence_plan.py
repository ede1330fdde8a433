"""Number of snapshots and wavelengths for an image, and a check that light reaches the system."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np

from clplen.checks import is_finite
from clplen.errors import SamplingError
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.coherence.phase_masks import KINDS, MIN_CELLS, RandomPhaseMask, cells_along
from clplen.wave.coherence.spatial_models import SpatialModel
from clplen.wave.field.field import Field, Grid
from clplen.wave.spectrum.spectrum import Spectrum
from clplen.wave.spectrum.spectrum_tables import check_wavelength
from clplen.wave.systems.components import ConvergingLight, Lens, Part, Stop
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.pupil_filter import Pupil
from clplen.wave.systems.space import Space

AIRY = 0.61  # radius of the Airy disc times the coherent cut-off frequency

# Speckle contrast of the image of a clear field in a snapshot, over iota: resolution cell by
# coherence length. Simulated with square cells, d_c = 4 p^2/lam and a circular pupil (2-D) or a
# slit (1-D); accurate to 1 or 2 percent.
_IOTA = (0.03, 0.05, 0.07, 0.1, 0.14, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2, 5.0, 10.0)
_CONTRAST = {
    ("phase", 2): (0.126, 0.161, 0.195, 0.230, 0.273, 0.320, 0.389, 0.477, 0.603, 0.737, 0.834,
                   0.922, 0.974, 0.994, 1.0),
    ("field", 2): (0.992, 0.990, 0.990, 0.985, 0.984, 0.984, 0.982, 0.979, 0.978, 0.970, 0.934,
                   0.952, 0.979, 0.993, 0.995),
    ("phase", 1): (0.092, 0.111, 0.137, 0.156, 0.195, 0.227, 0.277, 0.344, 0.426, 0.533, 0.636,
                   0.759, 0.880, 0.955, 0.996),
    ("field", 1): (0.914, 0.915, 0.907, 0.911, 0.910, 0.908, 0.906, 0.897, 0.892, 0.872, 0.822,
                   0.822, 0.868, 0.915, 0.960),
}  # fmt: skip


class SpectralLines(Protocol):
    """Light of mutually incoherent wavelengths."""

    def lines(self, wavelength: float) -> list[tuple[float, float]]:
        """Return wavelengths in metres and their shares of the power."""


@runtime_checkable
class MainLens(Protocol):
    """Camera with a known object distance and main-lens aperture."""

    object_distance: Any
    aperture_diameter: Any


Light = TypeVar("Light", bound=SpectralLines)


@dataclass(frozen=True, repr=False)
class CoherencePlan(OneLine, Generic[Light]):
    """Result of `plan_coherence`: mask, snapshots and wavelengths.

    Attributes
    ----------
    coherence : Coherence
        Light, ready for use.
    snapshots : int
        Number of snapshots that reach the required signal-to-noise ratio.
    snr : float
        Predicted mean over standard deviation of the image of a clear field.
    iota : float
        Airy radius over cell, 0.61/(fc p): 0 is coherent, 2 nearly incoherent.
    cells : tuple of int
        Number n of cells across the window, (ny, nx).
    cell : float
        Longer side p of a cell in metres: the coherence length.
    distance : float
        Distance d_c in metres at the shortest wavelength.
    wavelengths : int
        Number of wavelengths that sample the spectrum.
    contrast : float
        Speckle contrast of a snapshot's image of a clear field.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> pupil = clplen.wave.Pupil(5e-3, 0.1)
    >>> plan = clplen.Coherence.plan(pupil, grid=grid, wavelength=500e-9, snr=10)
    >>> plan.cells, f"{plan.cell * 1e6:.0f} um", plan.snapshots, f"SNR {plan.snr:.1f}"
    ((32, 32), '20 um', 32, 'SNR 10.1')
    """

    coherence: Light
    snapshots: int
    snr: float
    iota: float
    cells: tuple[int, int]
    cell: float
    distance: float
    wavelengths: int
    contrast: float

    @property
    def n(self) -> int:
        """Number of cells across the longer axis, n of the thesis."""
        return max(self.cells)

    @property
    def d_c(self) -> float:
        """Distance d_c in metres."""
        return self.distance

    def __str__(self) -> str:
        rows = (
            ("cells", f"{self.cells[0]} x {self.cells[1]}, p = {metres(self.cell)}"),
            ("iota = 0.61/(fc p)", f"{self.iota:.3g}"),
            ("distance d_c", metres(self.distance)),
            ("contrast of a snapshot", f"{self.contrast:.3g}"),
            ("snapshots", f"{self.snapshots}"),
            ("wavelengths", f"{self.wavelengths}"),
            ("predicted SNR", f"{self.snr:.3g} in a clear field"),
        )
        return "\n".join(f"{name:<24}{value}" for name, value in rows)


def plan_coherence(
    light: Callable[..., Light],
    system: Any,
    *,
    snr: float,
    grid: Grid | None = None,
    wavelength: float | None = None,
    iota: float = 2.0,
    kind: Literal["field", "phase"] = "phase",
    spectrum: Spectrum | None = None,
    wavelengths: int | None = None,
    seed: int = 0,
) -> CoherencePlan[Light]:
    """Return the mask, snapshots and wavelengths for a required signal-to-noise ratio.

    The cell is p = 0.61/(iota fc) with the coherent cut-off frequency fc on the object, rounded to
    fit the window; d_c = 4 p^2/lam. The image of a clear field has a speckle contrast c1(iota) in a
    snapshot, c1/sqrt(M) after M snapshots. Mutually incoherent wavelengths of shares w_l reduce it
    by sqrt(sum w_l^2). Hence M = (c1/e)^2 sum w_l^2 with e = 1/snr.
    """
    _check_request(snr, iota, kind)
    window = getattr(system, "grid", None) if grid is None else grid
    if not isinstance(window, Grid):
        raise ValueError("Planning for a system without a grid requires grid=.")
    if wavelength is None:
        default = getattr(system, "wavelength", None) if spectrum is None else spectrum.centre
        if default is None:
            raise ValueError("Planning requires wavelength= or spectrum=.")
        wavelength = default
    wavelength = check_wavelength(wavelength)
    fc = object_cutoff(system, wavelength)
    target, minimum = AIRY / (iota * fc), MIN_CELLS["square"]
    ny, nx = (cells_along(window, axis, target, minimum=minimum, exactly=False) for axis in (0, 1))
    sides = (window.extent[0] / ny, window.extent[1] / nx)
    p = max((side for side, n in zip(sides, window.shape, strict=True) if n > 1), default=target)
    mask = RandomPhaseMask(sides, kind=kind)
    coherence = light(mask, spectrum, wavelengths=wavelengths, seed=seed)
    lines = coherence.lines(wavelength)
    actual_iota = AIRY / (fc * p)
    table = _CONTRAST[kind, 1 if 1 in window.shape else 2]
    contrast = math.exp(np.interp(math.log(actual_iota), np.log(_IOTA), np.log(table)))
    noise = contrast * math.sqrt(sum(share**2 for _, share in lines))
    snapshots = max(1, math.ceil((noise * snr) ** 2 * (1 - 1e-12)))
    return CoherencePlan(
        coherence=coherence,
        snapshots=snapshots,
        snr=math.sqrt(snapshots) / noise,
        iota=actual_iota,
        cells=(ny, nx),
        cell=p,
        distance=mask.distance_on(window, min(lam for lam, _ in lines)),
        wavelengths=len(lines),
        contrast=contrast,
    )


def _check_request(snr: float, iota: float, kind: str) -> None:
    """Raise if a plan is not possible for the arguments."""
    if not (is_finite(snr) and snr > 0):
        raise ValueError(f"snr must be positive, got {snr!r}.")
    if not (is_finite(iota) and _IOTA[0] <= iota <= _IOTA[-1]):
        raise ValueError(
            f"iota, resolution cell over coherence length, must be from {_IOTA[0]} to {_IOTA[-1]}, "
            f"got {iota!r}; for coherent light omit the spatial model."
        )
    if kind not in KINDS:
        raise ValueError(f"kind must be 'field' or 'phase', got {kind!r}.")


def object_cutoff(system: Any, wavelength: float) -> float:
    """Return the coherent cut-off frequency on the object, D/(2 lam z1), in cycles per metre."""
    if isinstance(system, MainLens):
        return float(system.aperture_diameter / (2 * wavelength * system.object_distance))
    z = 0.0
    for part in system.parts if isinstance(system, OpticalSystem) else (system,):
        if isinstance(part, Pupil):
            return part.cutoff(wavelength)
        if isinstance(part, Space):
            z += part.z
        elif isinstance(part, (Lens, Stop)) and part.diameter is not None and z > 0:
            return part.diameter / (2 * wavelength * z)
        elif not isinstance(part, ConvergingLight):
            break
    raise ValueError(
        "system must be a camera, a Pupil, or a system that begins with free space and a lens with "
        "a diameter, which define its cut-off frequency."
    )


def check_reach(system: Any, field: Field, light: SpatialModel) -> None:
    """Raise if no light from the edge of the object reaches the first opening.

    Light leaves the object parallel to the axis, or towards the focus of `ConvergingLight`, and
    spreads by the half angle of the source. The check covers systems that begin with free space.
    """
    opening = _first_opening(system.parts) if isinstance(system, OpticalSystem) else None
    if opening is not None:
        check_opening(field, light, opening)


@dataclass(frozen=True)
class Opening:
    """First lens or stop behind an object."""

    z: float  # distance from the object in metres
    diameter: float  # in metres
    # distance from the object to the focus of the light in metres; infinite: parallel light
    focus: float = math.inf
    centre: tuple[float, float] = (0.0, 0.0)  # (y, x) in metres


def check_opening(field: Field, light: SpatialModel, opening: Opening) -> None:
    """Raise if no light from the edge of the object reaches an opening; see `check_reach`."""
    angle = light.half_angle(field.wavelength)
    spread = opening.z * math.tan(min(angle, math.pi / 2 * (1 - 1e-9)))
    for axis, name in enumerate("yx"):
        for edge in _edges(field, axis):
            position = edge * (1 - opening.z / opening.focus)
            gap = abs(position - opening.centre[axis]) - opening.diameter / 2
            if gap > spread:
                raise SamplingError(
                    f"Light from the edge of the object, {name} = {metres(edge)}, arrives at "
                    f"{metres(position)} in the first opening of D = {metres(opening.diameter)} "
                    f"and spreads by {metres(spread)} only: it misses the pupil. Use koehler=True "
                    "(ConvergingLight), a smaller object, or a source with a half angle of at "
                    f"least {math.atan(gap / opening.z):.3g} rad instead of {angle:.3g}."
                )


def _first_opening(parts: Sequence[Part]) -> Opening | None:
    """Return the first lens or stop behind free space."""
    z, focus = 0.0, math.inf
    for part in parts:
        if isinstance(part, ConvergingLight) and z == 0:
            focus = part.z
        elif isinstance(part, Space):
            z += part.z
        elif isinstance(part, Lens) and part.diameter is not None and z > 0:
            return Opening(z, part.diameter, focus)
        elif isinstance(part, Stop) and z > 0:
            return Opening(z, part.diameter, focus, part.centre)
        else:
            return None
    return None


def _edges(field: Field, axis: int) -> list[float]:
    """Return the first and last coordinates along an axis at which the object transmits light."""
    if field.grid.shape[axis] == 1:
        return []
    clear = np.flatnonzero((np.abs(field.to_numpy()) > 0).any(axis=1 - axis))
    coordinates = (field.grid.y, field.grid.x)[axis]
    return [float(coordinates[i]) for i in (clear[0], clear[-1])] if clear.size else []
