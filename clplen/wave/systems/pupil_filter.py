"""Shift-invariant imaging: a pupil as a filter of spatial frequencies, and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.checks import check_finite, fits_float64, real_array
from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, run
from clplen.compute.fft.lines import Separable, cropped_inverse, padded_spectrum
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.elements.hard_apertures import disc_coverage, interval_coverage
from clplen.wave.field.field import Field, Grid, derived_grid
from clplen.wave.field.transmission import offsets, phasor
from clplen.wave.propagation.description import request
from clplen.wave.propagation.free_space import FreeSpace
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.transfer_function import Transfer
from clplen.wave.systems.components import require_positive
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.space import Space

Values = np.ndarray[Any, Any]
Rim = Literal["circular", "square", "slit"]
Path = Callable[[Values, Values], Any]
SHAPES = ("circular", "square", "slit")


@dataclass(frozen=True, repr=False)
class Pupil(OneLine):
    """Shift-invariant imaging system: an exit pupil, with an upright image of equal size.

    The spectrum of the field is multiplied by the coherent transfer function
    H(fy, fx) = P(lam z2 fy, lam z2 fx) with the exit pupil P (Goodman 2005, section 6.2.1). The
    window is periodic: light that leaves it on one side enters on the other.

    Parameters
    ----------
    diameter : float
        Width D of the exit pupil in metres: diameter of the circle, side of the square, or width of
        the slit.
    distance : float
        Distance z2 from the exit pupil to the image in metres, positive.
    shape : {"circular", "square", "slit"}
        Shape of the pupil. A slit limits the frequencies along x only. On a grid of one row a
        circle is a slit; on a grid of one column a slit limits y. No shape limits an axis of
        length 1.
    path : callable, optional
        Aberration: a function W(v, u) that returns the additional path length in metres at pupil
        coordinates v = fy/fc and u = fx/fc, arrays of shape (n,), 1 at the rim (up to a sample
        beyond). The pupil is multiplied by exp(2 pi i W/lam).

    Raises
    ------
    ValueError
        If the diameter or distance is not positive, or the shape unknown.

    Examples
    --------
    >>> pupil = clplen.wave.Pupil(4e-3, 0.1)
    >>> f"{pupil.cutoff(500e-9) / 1e3:.0f} cycles/mm"
    '40 cycles/mm'
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> point = np.zeros((32, 32))
    >>> point[16, 16] = 1.0
    >>> image = pupil.apply(clplen.Field.from_array(point, grid, wavelength=500e-9))
    >>> f"{image.power() / 1e-10:.2f} of the light passes"
    '0.49 of the light passes'
    """

    diameter: float
    distance: float
    _: KW_ONLY
    shape: Rim = "circular"
    path: Path | None = None
    label = "pupil"

    def __post_init__(self) -> None:
        require_positive("The diameter of a pupil", self.diameter)
        units.DIAMETER.check(self.diameter, "The diameter of a pupil")
        require_positive("The distance from a pupil to the image", self.distance)
        require_shape(self.shape, SHAPES)

    @classmethod
    def of_cutoff(
        cls, fc: float, wavelength: float, *, shape: Rim = "circular", path: Path | None = None
    ) -> Pupil:
        """Return the pupil, 1 m from the image, that has a given coherent cut-off frequency.

        Parameters
        ----------
        fc : float
            Cut-off frequency in cycles per metre, positive.
        wavelength : float
            Wavelength in metres.
        shape, path
            Arguments of `Pupil`.
        """
        if not (fits_float64(fc) and fc > 0):
            raise ValueError(f"fc must be positive, in cycles per metre, got {fc!r}.")
        require_positive("The wavelength", wavelength)
        units.WAVELENGTH.check(wavelength, "The wavelength")
        return cls(2 * wavelength * fc, 1.0, shape=shape, path=path)

    def cutoff(self, wavelength: float) -> float:
        """Return fc = D/(2 lam z2) in cycles per metre (Goodman 2005, section 6.2.2)."""
        require_positive("The wavelength", wavelength)
        return self.diameter / (2 * wavelength * self.distance)

    def transfer(self, grid: Grid, wavelength: float) -> Values:
        """Return H on the frequencies of a grid; on the rim, the covered fraction of each cell.

        Parameters
        ----------
        grid : Grid
            Grid of the field.
        wavelength : float
            Wavelength in metres.

        Returns
        -------
        numpy.ndarray
            Transfer function, complex128, shape (ny, nx), FFT order.

        Raises
        ------
        ValueError
            If the aberration is not finite in the pupil.
        """
        fc = self.cutoff(wavelength)
        (ny, nx), (dy, dx) = grid.shape, grid.pitch
        lattice = derived_grid(grid.shape, (1 / (ny * dy), 1 / (nx * dx)))
        P = self._covered(lattice, fc).astype(np.complex128)
        if self.path is not None:
            row, column = np.nonzero(P)
            fy, fx = offsets(lattice)
            W = np.asarray(self.path(fy[row] / fc, fx[column] / fc), np.float64)
            if not np.isfinite(W).all():
                raise ValueError("path must return finite values everywhere in the pupil.")
            P[row, column] *= phasor(W / wavelength)
        return np.fft.ifftshift(P)

    def apply(self, field: Field) -> Field:
        """Return the image of a field (or of each of a batch)."""
        return field.with_data(_filtered(field, self._spectrum(field), field.device))

    def adjoint(self, field: Field) -> Field:
        """Return the adjoint of `apply`: the field filtered by the conjugate transfer function."""
        return field.with_data(_filtered(field, self._spectrum(field).conjugate(), field.device))

    def _spectrum(self, field: Field) -> Spectrum:
        device, key = field.device, ("pupil", self, field.grid, field.wavelength)
        cached: Spectrum | None = device.plans.get(key)
        if cached is not None:
            return cached
        spectrum = Spectrum.of(self.transfer(field.grid, field.wavelength), device)
        return device.plans.keep(key, spectrum, int(spectrum.values.nbytes))

    def describe(self) -> str:
        """Return shape, diameter and distance."""
        text = f"{self.shape}, D = {metres(self.diameter)} at {metres(self.distance)}"
        return text if self.path is None else f"{text}, aberrated"

    def _covered(self, lattice: Grid, fc: float) -> Values:
        """Return the covered fraction of each frequency's cell, zero frequency at sample N//2."""
        if self.shape == "circular" and 1 not in lattice.shape:
            return disc_coverage(lattice, fc, (0.0, 0.0))
        ny, nx = lattice.shape
        bounded = (ny > 1 and not (self.shape == "slit" and nx > 1), nx > 1)
        ty, tx = (
            interval_coverage(f, pitch, fc) if hard else np.ones(f.size)
            for f, pitch, hard in zip(offsets(lattice), lattice.pitch, bounded, strict=True)
        )
        return np.multiply.outer(ty, tx)


def transfer_of(system: Any, grid: Grid, wavelength: float) -> Values | None:
    """Return the transfer function of a system of periodic filters, None for other systems.

    Periodic filters are `Pupil`, and `Space` with method "as" or "blas", pad 1 and an unchanged
    grid.
    """
    H = np.ones(grid.shape, np.complex128)
    if isinstance(system, FreeSpace) and system.is_plain:
        system = Space(system.z, method=system.method, pad=system.pad, out_grid=system.out_grid)
    for part in system.parts if isinstance(system, OpticalSystem) else (system,):
        if isinstance(part, Pupil):
            H *= part.transfer(grid, wavelength)
        elif isinstance(part, Space) and _is_filter(part, grid):
            H *= _free_space(part, grid, wavelength)
        else:
            return None
    return H


def otf(s: Any, *, shape: Rim = "circular") -> Values:
    """Return the optical transfer function of an aberration-free pupil.

    It is (2/pi) (acos s - s sqrt(1 - s^2)) for a circle, 1 - s for a slit or along the side of a
    square, and 0 beyond s = 1 (Goodman 2005, section 6.3.3).

    Parameters
    ----------
    s : array_like
        Frequency abs(f)/(2 fc) as a fraction of the incoherent cut-off.
    shape : {"circular", "square", "slit"}
        Shape of the pupil, as in `Pupil`.

    Returns
    -------
    numpy.ndarray
        Contrast from 0 to 1, float64, with the shape of ``s``.

    Raises
    ------
    ValueError
        If the shape is unknown.

    Examples
    --------
    >>> np.round(clplen.wave.otf([0.0, 0.5, 1.0]), 3).tolist()
    [1.0, 0.391, 0.0]
    """
    require_shape(shape, SHAPES)
    s = np.minimum(np.abs(real_array(s, "s", np.float64)), 1)
    if shape != "circular":
        return np.asarray(1 - s)
    return np.asarray(2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s)))


def coherent_edge(x_fc: Any) -> Values:
    """Return the intensity of the image of a straight edge in coherent light.

    It is (1/2 + Si(2 pi fc x)/pi)^2, the step of amplitude behind an ideal low pass of fc (Goodman
    2005, section 6.5.3), with 1/4 at the edge. Only the width of the pupil across the edge matters.

    Parameters
    ----------
    x_fc : array_like
        Distance from the edge times fc, positive on the bright side.

    Returns
    -------
    numpy.ndarray
        Intensity, float64, with the shape of ``x_fc``, 1 far inside.

    Examples
    --------
    >>> np.round(clplen.wave.coherent_edge([-1.0, 0.0, 1.0]), 3).tolist()
    [0.002, 0.25, 0.905]
    """
    from scipy.special import sici

    return np.asarray(
        (0.5 + sici(2 * np.pi * real_array(x_fc, "x_fc", np.float64))[0] / np.pi) ** 2
    )


def incoherent_edge(x_fc: Any, *, shape: Rim = "circular") -> Values:
    """Return the intensity of the image of a straight edge in incoherent light.

    It is 1/2 + (1/pi) int_0^1 OTF(s) sin(a s)/s ds with a = 4 pi fc x, the step of intensity behind
    the OTF (Goodman 2005, section 6.5.3). A slit has 1/2 + (Si(a) - (1 - cos a)/a)/pi; a circle is
    integrated by Gauss-Legendre quadrature in t with s = sin t, to 1e-12.

    Parameters
    ----------
    x_fc : array_like
        Distance from the edge times fc, positive on the bright side.
    shape : {"circular", "square", "slit"}
        Shape of the pupil, as in `Pupil`.

    Returns
    -------
    numpy.ndarray
        Intensity, float64, with the shape of ``x_fc``, 1 far inside.

    Raises
    ------
    ValueError
        If the shape is unknown.

    Examples
    --------
    >>> np.round(clplen.wave.incoherent_edge([-1.0, 0.0, 1.0]), 3).tolist()
    [0.032, 0.5, 0.968]
    """
    require_shape(shape, SHAPES)
    check_finite(x_fc=x_fc)
    a = 4 * np.pi * real_array(x_fc, "x_fc", np.float64)
    if shape != "circular":
        from scipy.special import sici

        half = a / 2
        versine = np.sin(half) * np.sinc(half / np.pi)  # (1 - cos a)/a
        return np.asarray(0.5 + (sici(a)[0] - versine) / np.pi)
    nodes, weights = np.polynomial.legendre.leggauss(64 + math.ceil(np.abs(a).max(initial=0.0)))
    t = np.pi / 4 * (nodes + 1)
    s = np.sin(t)
    density = weights * np.pi / 4 * otf(s) * np.cos(t) / s
    return np.asarray(0.5 + np.sin(np.multiply.outer(a, s)) @ density / np.pi)


def require_shape(shape: str, shapes: tuple[str, ...]) -> None:
    """Raise unless a shape of a pupil is supported."""
    if shape not in shapes:
        raise ValueError(f"shape must be one of {', '.join(shapes)}, got {shape!r}.")


def _filtered(field: Field, spectrum: Spectrum, device: Device) -> Any:
    """Return the field's data behind a periodic filter."""
    into, back = (
        Separable(*((line(n, n),) for n in field.grid.shape))
        for line in (padded_spectrum, cropped_inverse)
    )
    return run(field.data, into, [spectrum], [back], device)[0]


def _is_filter(space: Space, grid: Grid) -> bool:
    """Return True if free space acts on a grid as a filter of its frequencies."""
    periodic = space.method in ("as", "blas") and space.pad == 1
    return space.out_grid in (None, grid) and (periodic or space.z == 0)


def _free_space(space: Space, grid: Grid, wavelength: float) -> Values:
    """Return H of free space in float64 (Goodman 2005, eq. 3-66), without the carrier exp(ikz)."""
    factor = describe(request(grid, space.z, wavelength, space.method, space.pad)).factor
    if not isinstance(factor, Transfer):  # z = 0
        return np.ones(grid.shape, np.complex128)
    wy, wx = (_mirrored(table, n) for table, n in zip(factor.weights, grid.shape, strict=True))
    s = wavelength**2 * np.add.outer(grid.fy**2, grid.fx**2)
    c = np.sqrt(np.maximum(1 - s, 0))
    H = phasor(-space.z / wavelength * s / (1 + c))
    decay = np.exp(-2 * np.pi * np.abs(space.z) / wavelength * np.sqrt(np.maximum(s - 1, 0)))
    waves = decay * phasor(-space.z / wavelength) if space.z > 0 else 0.0
    return np.multiply.outer(wy, wx) * np.where(s <= 1, H, waves)


def _mirrored(half: Values, n: int) -> Values:
    """Expand a table up to the middle to an even table of n frequencies, FFT order."""
    index = np.arange(n)
    return half[np.minimum(index, n - index)]
