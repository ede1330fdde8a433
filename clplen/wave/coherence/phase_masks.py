"""Random phase masks: cells of random phase that a short distance turns into speckle."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from clplen import units
from clplen.checks import check_positive, float64_array, is_finite
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError, SamplingWarning, warn_caller
from clplen.units import metres
from clplen.wave.coherence.spatial_models import SpatialModel, key_of, uniform
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.free_space import plan

Array = np.ndarray[Any, Any]

KINDS = ("field", "phase")
LEAST_SAMPLES = 2  # of a cell
LEAST_CELLS = {"square": 2, "gaussian": 3}  # of a window
GAUSSIAN_TAPS = 5  # cells across that reach a sample: the sixth is below 3e-8
FWHM = 2 * math.sqrt(2 * math.log(2))  # of a Gaussian, in standard deviations
FITS = 1e-6  # of a cell, by which a window may miss a whole number of them
ENOUGH = 4  # distance in cell^2/wavelength from which blocks have become speckle
_JITTER = 1  # stream of random numbers


@dataclass(frozen=True)
class RandomPhaseMask(SpatialModel):
    """Partially coherent light from a lattice of cells, each of one random phase.

    A snapshot is a lattice of points of random phase, spread over cells by a kernel and propagated
    by a distance that turns blocks into speckle; the window is periodic. The mean over snapshots is
    light of the degree of coherence that `degree` gives, whatever the distance.

    Parameters
    ----------
    cell : float or tuple of float
        Side p of a cell in metres, or (py, px): the coherence length. A whole number of cells, at
        least 2, fills the window, and a cell holds at least 2 samples.
    kernel : {"square", "gaussian"}
        Amplitude of one cell: a square of side p, or a Gaussian of full width p at half maximum.
    distance : float, optional
        Distance d_c in metres, not negative; by default 4 p^2/lam, from where the intensity is that
        of developed speckle.
    kind : {"field", "phase"}
        The field itself, whose mean intensity is 1, or its phase alone, of intensity 1 everywhere.
    jitter : bool
        Whether each snapshot moves the lattice: without it the mean keeps a trace of the lattice.

    Raises
    ------
    ValueError
        For a cell or distance out of range, or another kernel or kind.

    Notes
    -----
    The phases are uniform at every wavelength, as behind a diffuser many wavelengths deep, and the
    cells keep their size.

    Examples
    --------
    >>> mask = clplen.wave.RandomPhaseMask(40e-6)
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> mask.count(grid)
    (8, 8)
    >>> np.round(mask.degree(0.0, [0.0, 20e-6, 40e-6], wavelength=500e-9), 2).tolist()
    [1.0, 0.5, 0.0]
    """

    cell: float | tuple[float, float]
    _: KW_ONLY
    kernel: Literal["square", "gaussian"] = "square"
    distance: float | None = None
    kind: Literal["field", "phase"] = "field"
    jitter: bool = True

    def __post_init__(self) -> None:
        sides = np.asarray(self.cell)
        if (
            sides.dtype.kind not in "iuf"
            or sides.shape not in ((), (2,))
            or not (np.isfinite(sides).all() and (sides > 0).all())
        ):
            raise ValueError(
                f"The cell of a mask is a positive length in metres, or (y, x), not {self.cell!r}."
            )
        object.__setattr__(self, "cell", tuple(sides.tolist()) if sides.ndim else float(sides))
        units.PITCH.check(sides, "The cell of a mask")
        if self.kernel not in ("square", "gaussian"):
            raise ValueError(f"The kernel is 'square' or 'gaussian', not {self.kernel!r}.")
        if self.kind not in KINDS:
            raise ValueError(f"A mask is a 'field' or a 'phase', not {self.kind!r}.")
        if self.distance is not None and not (is_finite(self.distance) and self.distance >= 0):
            raise ValueError(
                f"The distance of a mask is not negative, in metres, not {self.distance!r}."
            )

    @property
    def degree_is_exact(self) -> bool:
        """Whether `degree` holds exactly: for fields of a lattice that moves."""
        return self.kind == "field" and self.jitter

    @property
    def cells(self) -> tuple[float, float]:
        """(py, px) in metres."""
        py, px = (float(side) for side in np.broadcast_to(self.cell, 2))
        return py, px

    def count(self, grid: Grid) -> tuple[int, int]:
        """Cells (ny, nx) that fill a window, 1 along an axis of length 1.

        Parameters
        ----------
        grid : Grid

        Returns
        -------
        tuple of int

        Raises
        ------
        SamplingError
            If a cell has fewer than 2 samples, the window fewer than 2 cells (3 Gaussian ones), or
            no whole number of them; with the nearest cell that fits.
        """
        ny, nx = (
            cells_along(grid, axis, side, least=LEAST_CELLS[self.kernel], exactly=True)
            for axis, side in enumerate(self.cells)
        )
        return ny, nx

    def least_distance(self, grid: Grid, wavelength: float) -> float:
        """4 p^2/lam in metres, p the longer side of a cell along the axes that vary."""
        check_positive(wavelength=wavelength)
        sides = [p for p, n in zip(self.cells, grid.shape, strict=True) if n > 1]
        return ENOUGH * max(sides, default=0.0) ** 2 / wavelength

    def distance_on(self, grid: Grid, wavelength: float) -> float:
        """The distance propagated in metres."""
        return self.least_distance(grid, wavelength) if self.distance is None else self.distance

    def check(self, grid: Grid, *, wavelength: float) -> None:
        """Refuse a mask that the grid does not carry: see `count`.

        Warns
        -----
        SamplingWarning
            If the distance is shorter than 4 p^2/lam: the cells then show in the intensity.
        """
        self.count(grid)
        least, distance = self.least_distance(grid, wavelength), self.distance_on(grid, wavelength)
        if distance < least * (1 - 1e-9):
            warn_caller(
                f"A mask of cells of {metres(max(self.cells))} needs a distance of at least "
                f"4 p^2/lam = {metres(least)} to become speckle; {metres(distance)} leaves blocks, "
                "whose edges show in every snapshot.",
                SamplingWarning,
            )

    def half_angle(self, wavelength: float) -> float:
        """Half angle to which the light of a cell spreads, lam/p, in rad."""
        return math.asin(min(1.0, wavelength / min(self.cells)))

    def degree(self, dy: ArrayLike, dx: ArrayLike, *, wavelength: float = 0.0) -> Array:
        """Degree of coherence of two points (dy, dx) apart.

        The autocorrelation of the kernel: (1 - abs(dy)/py)(1 - abs(dx)/px) for squares,
        exp(-D^2/(4 s^2)), s = p/2.355, for Gaussians (Goodman 2015, section 5.2). Of the phase
        alone (pi/4) mu 2F1(1/2, 1/2; 2; mu^2) (Reed 1962, as for any hard-limited Gaussian field):
        right to .01 once the field is one, from d_c = 2 p^2/lam and a dozen cells across on; cells
        that do not propagate are phase alone already and keep mu.
        """
        shifts = float64_array(dy), float64_array(dx)
        along = [np.abs(s) / p for s, p in zip(shifts, self.cells, strict=True)]
        if self.kernel == "square":
            mu = np.maximum(1 - along[0], 0) * np.maximum(1 - along[1], 0)
        else:
            mu = np.exp(-(FWHM**2) / 4 * (along[0] ** 2 + along[1] ** 2))
        still = self.kernel == "square" and self.distance == 0
        return hard_limited(mu) if self.kind == "phase" and not still else mu

    def power_spectrum(self, grid: Grid, *, wavelength: float = 0.0) -> Array:
        """The share of light at each frequency; without jitter the light has no spectrum."""
        self.count(grid)
        if not self.jitter:
            raise ValueError(
                "Light of a lattice that does not move has no power spectrum, being different from "
                "place to place: use jitter=True, or method='monte-carlo'."
            )
        return super().power_spectrum(grid, wavelength=wavelength)

    def field(
        self,
        grid: Grid,
        *,
        wavelength: float,
        device: DeviceLike | None = None,
        seed: int,
        index: int,
    ) -> Field:
        """One snapshot; see `SpatialModel.field`."""
        device = as_device(device)
        cells = self.count(grid)
        shift = uniform(seed, index, _JITTER, 1)[0, :2] if self.jitter else np.zeros(2)
        tables = [
            self._taps(n, count, float(part))
            for n, count, part in zip(grid.shape, cells, shift, strict=True)
        ]
        blocks = self._blocks(grid, cells, tables, device, key_of(seed), index)
        field = Field(blocks, grid, float(wavelength), device)
        z = self.distance_on(grid, wavelength)
        if z > 0:
            along = plan(grid, z, wavelength=wavelength, method="as", pad=1, device=device)
            field = along(field)
        return self._phase_of(field) if self.kind == "phase" else field

    def _taps(self, n: int, cells: int, shift: float) -> tuple[Array, Array]:
        """Cells that reach each sample, and the kernel there; shapes (n, taps)."""
        at = np.arange(n) * cells / n + (shift if n > 1 else 0.0)  # in cells
        if self.kernel == "square" or n == 1:
            only = (np.floor(at).astype(np.int32) % cells)[:, None]
            if self.kernel == "square":
                return only, np.ones((n, 1))
            return np.repeat(only, GAUSSIAN_TAPS, 1), np.eye(1, GAUSSIAN_TAPS)
        which = np.rint(at).astype(np.int32)[:, None] + np.arange(GAUSSIAN_TAPS) - 2
        sigma = 1 / FWHM  # in cells
        unit = math.sqrt(1 / (sigma * math.sqrt(math.pi)))  # mean over the jitter of the sum of w^2
        return (which % cells).astype(np.int32), unit * np.exp(
            -(((at[:, None] - which) / sigma) ** 2) / 2
        )

    def _blocks(
        self,
        grid: Grid,
        cells: tuple[int, int],
        tables: list[tuple[Array, Array]],
        device: Device,
        key: Array,
        index: int,
    ) -> Any:
        """The lattice of cells on the samples, before it propagates."""
        (ny, nx), (my, mx) = grid.shape, cells
        defines = device.wave_defines() | {"TAPS": tables[0][0].shape[1]}
        phasors = device.empty(cells, device.complex)
        device.launch_rows(
            device.kernel("masks.cl", "cell_phasors", **defines),
            cells, phasors, np.uint32(index), key, my, mx,
        )  # fmt: skip
        (rows_at, rows_w), (columns_at, columns_w) = (
            (device.upload(at), device.upload(w.astype(device.real))) for at, w in tables
        )
        rows = device.empty((ny, mx), device.complex)
        device.launch_rows(
            device.kernel("masks.cl", "spread_rows", **defines),
            rows.shape, rows, phasors, rows_at, rows_w, ny, mx,
        )  # fmt: skip
        out = device.empty(grid.shape, device.complex)
        device.launch_rows(
            device.kernel("masks.cl", "spread", **defines),
            out.shape, out, rows, columns_at, columns_w, mx, ny, nx,
        )  # fmt: skip
        return out

    def _phase_of(self, field: Field) -> Field:
        """The field's phase alone, in place."""
        device, (ny, nx) = field.device, field.grid.shape
        kernel = device.kernel("masks.cl", "unit_phase", **device.wave_defines())
        device.launch_rows(kernel, field.shape, field.data, ny, nx)
        return field


def cells_along(grid: Grid, axis: int, side: float, *, least: int, exactly: bool) -> int:
    """Cells along an axis of a window, as near as may be to a wanted side; 1 if nothing varies."""
    n, pitch, name = grid.shape[axis], grid.pitch[axis], "yx"[axis]
    if n == 1:
        return 1
    window, most = n * pitch, n // LEAST_SAMPLES
    if most < least:
        raise SamplingError(
            f"The window has {n} samples along {name}: a mask needs at least "
            f"{least * LEAST_SAMPLES}, or 1 for nothing to vary."
        )
    near = min(max(round(window / side), least), most)
    if not exactly:
        return near
    fits = f"{metres(window / near)}, {near} cells along {name}, is the nearest that does"
    if side < LEAST_SAMPLES * pitch * (1 - FITS):
        raise SamplingError(
            f"A cell of {metres(side)} has fewer than {LEAST_SAMPLES} samples of {metres(pitch)}: "
            f"{fits}."
        )
    if abs(window / side - near) > FITS * near:
        raise SamplingError(
            f"Cells of {metres(side)} do not fit the window of {metres(window)}, which holds a "
            f"whole number of them, {least} or more: {fits}."
        )
    return near


def hard_limited(mu: ArrayLike) -> Array:
    """Degree of coherence of the phase alone of a circular Gaussian field of degree mu.

    (pi/4) mu 2F1(1/2, 1/2; 2; mu^2) (Reed 1962).
    """
    from scipy import special  # here, because it takes a third of the package's import time

    value = np.asarray(mu, np.float64)
    return np.pi / 4 * value * special.hyp2f1(0.5, 0.5, 2.0, np.minimum(value**2, 1.0))
