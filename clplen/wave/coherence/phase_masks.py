"""Random phase masks: cells of random phase that turn into speckle over a short distance."""

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
MIN_SAMPLES = 2  # minimum number of samples of a cell
MIN_CELLS = {"square": 2, "gaussian": 3}  # minimum number of cells of a window
GAUSSIAN_TAPS = 5  # number of cells that contribute to a sample; the sixth is below 3e-8
FWHM = 2 * math.sqrt(2 * math.log(2))  # full width of a Gaussian in standard deviations
CELL_TOLERANCE = 1e-6  # relative deviation of a window from an integer number of cells
SPECKLE_DISTANCE = 4  # distance in cell^2/wavelength at which cells have become speckle
_JITTER = 1  # stream of random numbers


@dataclass(frozen=True)
class RandomPhaseMask(SpatialModel):
    """Partially coherent light from a lattice of cells with random phases.

    A snapshot is a lattice of points of random phase, convolved with a kernel and propagated by a
    distance that turns cells into speckle; the window is periodic. The mean over snapshots has the
    degree of coherence returned by `degree`, at any distance.

    Parameters
    ----------
    cell : float or tuple of float
        Side p of a cell in metres, or (py, px): the coherence length. An integer number of cells,
        at least 2, must fill the window, and a cell needs at least 2 samples.
    kernel : {"square", "gaussian"}
        Amplitude of a cell: a square of side p, or a Gaussian of full width p at half maximum.
    distance : float, optional
        Distance d_c in metres, not negative; by default 4 p^2/lam, the shortest distance with
        developed speckle.
    kind : {"field", "phase"}
        Light of the field, with mean intensity 1, or of its phase alone, with intensity 1
        everywhere.
    jitter : bool
        True to move the lattice in each snapshot; without it the mean keeps a trace of the lattice.

    Raises
    ------
    ValueError
        If the cell or distance is out of range, or the kernel or kind unknown.

    Notes
    -----
    The phases are uniform at every wavelength, as behind a diffuser many wavelengths deep; the size
    of the cells does not depend on the wavelength.

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
                f"cell must be a positive length in metres or a pair (y, x), got {self.cell!r}."
            )
        object.__setattr__(self, "cell", tuple(sides.tolist()) if sides.ndim else float(sides))
        units.PITCH.check(sides, "The cell of a mask")
        if self.kernel not in ("square", "gaussian"):
            raise ValueError(f"kernel must be 'square' or 'gaussian', got {self.kernel!r}.")
        if self.kind not in KINDS:
            raise ValueError(f"kind must be 'field' or 'phase', got {self.kind!r}.")
        if self.distance is not None and not (is_finite(self.distance) and self.distance >= 0):
            raise ValueError(f"distance must not be negative, in metres, got {self.distance!r}.")

    @property
    def degree_is_exact(self) -> bool:
        """True if `degree` is exact: for fields of a moving lattice."""
        return self.kind == "field" and self.jitter

    @property
    def cells(self) -> tuple[float, float]:
        """Sides (py, px) of a cell in metres."""
        py, px = (float(side) for side in np.broadcast_to(self.cell, 2))
        return py, px

    def count(self, grid: Grid) -> tuple[int, int]:
        """Return the numbers of cells (ny, nx) that fill a window, 1 along an axis of length 1.

        Parameters
        ----------
        grid : Grid
            Samples of the window.

        Returns
        -------
        tuple of int

        Raises
        ------
        SamplingError
            If a cell has fewer than 2 samples, or the window fewer than 2 (Gaussian: 3) cells or
            not an integer number of cells. The message names the nearest cell that fits.
        """
        ny, nx = (
            cells_along(grid, axis, side, minimum=MIN_CELLS[self.kernel], exactly=True)
            for axis, side in enumerate(self.cells)
        )
        return ny, nx

    def min_distance(self, grid: Grid, wavelength: float) -> float:
        """Return 4 p^2/lam in metres, p the longer side of a cell along the axes that vary."""
        check_positive(wavelength=wavelength)
        sides = [p for p, n in zip(self.cells, grid.shape, strict=True) if n > 1]
        return SPECKLE_DISTANCE * max(sides, default=0.0) ** 2 / wavelength

    def distance_on(self, grid: Grid, wavelength: float) -> float:
        """Return the propagated distance in metres."""
        return self.min_distance(grid, wavelength) if self.distance is None else self.distance

    def check(self, grid: Grid, *, wavelength: float) -> None:
        """Raise if the cells do not fit the grid; see `count`.

        Warns
        -----
        SamplingWarning
            If the distance is below 4 p^2/lam, at which the cells show in the intensity.
        """
        self.count(grid)
        minimum, distance = self.min_distance(grid, wavelength), self.distance_on(grid, wavelength)
        if distance < minimum * (1 - 1e-9):
            warn_caller(
                f"Cells of {metres(max(self.cells))} become speckle at a distance of at least "
                f"4 p^2/lam = {metres(minimum)}; after {metres(distance)} their edges show in "
                "every snapshot.",
                SamplingWarning,
            )

    def half_angle(self, wavelength: float) -> float:
        """Return the half angle to which the light of a cell spreads, lam/p, in rad."""
        return math.asin(min(1.0, wavelength / min(self.cells)))

    def degree(self, dy: ArrayLike, dx: ArrayLike, *, wavelength: float = 0.0) -> Array:
        """Return the degree of coherence of two points (dy, dx) apart.

        It is the autocorrelation mu of the kernel: (1 - abs(dy)/py)(1 - abs(dx)/px) for squares,
        exp(-D^2/(4 s^2)) with s = p/2.355 for Gaussians (Goodman 2015, section 5.2). The phase
        alone has (pi/4) mu 2F1(1/2, 1/2; 2; mu^2) (Reed 1962, for hard-limited Gaussian fields),
        accurate to 0.01 from d_c = 2 p^2/lam and a dozen cells across. Without propagation squares
        are pure phase and keep mu.
        """
        shifts = float64_array(dy), float64_array(dx)
        along = [np.abs(s) / p for s, p in zip(shifts, self.cells, strict=True)]
        if self.kernel == "square":
            mu = np.maximum(1 - along[0], 0) * np.maximum(1 - along[1], 0)
        else:
            mu = np.exp(-(FWHM**2) / 4 * (along[0] ** 2 + along[1] ** 2))
        is_pure_phase = self.kernel == "square" and self.distance == 0
        return hard_limited(mu) if self.kind == "phase" and not is_pure_phase else mu

    def power_spectrum(self, grid: Grid, *, wavelength: float = 0.0) -> Array:
        """Return the share of light at each frequency; it is undefined without jitter."""
        self.count(grid)
        if not self.jitter:
            raise ValueError(
                "Light of a lattice that does not move varies with position and has no power "
                "spectrum; use jitter=True, or method='monte-carlo'."
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
        """Return a snapshot; see `SpatialModel.field`."""
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
        """Return the cells that contribute to each sample, and their weights; shapes (n, taps)."""
        at = np.arange(n) * cells / n + (shift if n > 1 else 0.0)  # in cells
        if self.kernel == "square" or n == 1:
            only = (np.floor(at).astype(np.int32) % cells)[:, None]
            if self.kernel == "square":
                return only, np.ones((n, 1))
            return np.repeat(only, GAUSSIAN_TAPS, 1), np.eye(1, GAUSSIAN_TAPS)
        centres = np.rint(at).astype(np.int32)[:, None] + np.arange(GAUSSIAN_TAPS) - 2
        sigma = 1 / FWHM  # in cells
        unit = math.sqrt(1 / (sigma * math.sqrt(math.pi)))  # mean over the jitter of the sum of w^2
        return (centres % cells).astype(np.int32), unit * np.exp(
            -(((at[:, None] - centres) / sigma) ** 2) / 2
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
        """Return the lattice of cells on the samples before propagation."""
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
        """Normalise a field to unit modulus in place."""
        device, (ny, nx) = field.device, field.grid.shape
        kernel = device.kernel("masks.cl", "unit_phase", **device.wave_defines())
        device.launch_rows(kernel, field.shape, field.data, ny, nx)
        return field


def cells_along(grid: Grid, axis: int, side: float, *, minimum: int, exactly: bool) -> int:
    """Return the number of cells along an axis whose side is nearest to ``side``."""
    n, pitch, name = grid.shape[axis], grid.pitch[axis], "yx"[axis]
    if n == 1:
        return 1
    window, maximum = n * pitch, n // MIN_SAMPLES
    if maximum < minimum:
        raise SamplingError(
            f"A mask requires a window of at least {minimum * MIN_SAMPLES} samples along {name}, "
            f"or 1 for no variation, got {n}."
        )
    nearest = min(max(round(window / side), minimum), maximum)
    if not exactly:
        return nearest
    remedy = f"use {metres(window / nearest)}, {nearest} cells along {name}"
    if side < MIN_SAMPLES * pitch * (1 - CELL_TOLERANCE):
        raise SamplingError(
            f"A cell of {metres(side)} has fewer than {MIN_SAMPLES} samples of {metres(pitch)}; "
            f"{remedy}."
        )
    if abs(window / side - nearest) > CELL_TOLERANCE * nearest:
        raise SamplingError(
            f"The window of {metres(window)} must hold an integer number of at least {minimum} "
            f"cells, got cells of {metres(side)}; {remedy}."
        )
    return nearest


def hard_limited(mu: ArrayLike) -> Array:
    """Return the degree of coherence of the phase of a circular Gaussian field with degree mu.

    (pi/4) mu 2F1(1/2, 1/2; 2; mu^2) (Reed 1962).
    """
    from scipy import special  # a local import, a third of the package's import time

    value = np.asarray(mu, np.float64)
    return np.pi / 4 * value * special.hyp2f1(0.5, 0.5, 2.0, np.minimum(value**2, 1.0))
