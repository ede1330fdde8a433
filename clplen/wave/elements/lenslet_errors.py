"""Errors of the lenslets of an array: tilts, positions, focal lengths and Zernike terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import DeviceLike, as_device
from clplen.reprs import OneLine
from clplen.types import Float64Array
from clplen.wave.elements.lenslet_gradients import lenslet_moments
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.elements.zernike import zernike_gradient, zernike_monomials
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.field_gradients import transmission_gradient
from clplen.wave.field.transmission import multiply

Orders = tuple[int, int]
HIGHEST_ORDER = 8  # of Zernike terms; float32 polynomials are accurate to 4e-4 rad per wave


@dataclass(frozen=True, eq=False, repr=False)
class LensletErrors(OneLine):
    """Deviations of the lenslets of an array along its columns (x) and rows (y).

    Attributes
    ----------
    terms : dict of (int, int) to float
        Zernike polynomials (n, m) common to all lenslets, in metres rms over a circle about their
        centres.
    circle : float
        Diameter of the circle in metres.
    focal_lengths : numpy.ndarray
        Focal lengths in metres, shape (ny, nx).
    tilt : numpy.ndarray
        Slopes (y, x) that the lenslets add to rays, in radians, shape (ny, nx, 2).
    position : numpy.ndarray
        Offsets (y, x) of the vertices from the centres of the apertures in metres, shape (ny, nx,
        2).

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 2e-3, count=4)
    >>> scatter = clplen.cameras.LensletScatter(tilt=1e-3, seed=1)
    >>> aberrations = clplen.cameras.Aberrations(lenslets={11: 20e-9}, scatter=scatter)
    >>> errors = aberrations.lenslet_errors(mla)
    >>> errors.terms, errors.tilt.shape
    ({(4, 0): 2e-08}, (4, 4, 2))
    """

    terms: dict[Orders, float]
    circle: float
    focal_lengths: Float64Array
    tilt: Float64Array
    position: Float64Array

    def phase(
        self, mla: MicrolensArray, grid: Grid, wavelength: float, device: DeviceLike | None = None
    ) -> cla.Array:
        """Return exp(i phase), the factor of an array's transmission, with the shape of the grid.

        The vertex of a lenslet may deviate from the centre s of its aperture, which does not move.
        The transmission has the term of -pi abs(r - s)^2/(lam f) with r^2 and the design focal
        length.
        """
        device = as_device(device)
        real = device.real
        order = max((n for n, _ in self.terms), default=0)
        defines = device.wave_defines() | {"ORDER": order}
        defines |= {"HEXAGONAL": True} if mla.lattice == "hexagonal" else {}
        out = device.empty(grid.shape, device.complex)
        device.launch_rows(
            device.kernel("lenslet_errors.cl", "lenslet_errors", **defines),
            grid.shape,
            out,
            *(device.upload(table) for table in mla.lattice_tables(grid, device)),
            device.upload(self._polynomial(order, mla.pitch, wavelength).astype(real)),
            device.upload(self._lenslet_terms(mla, wavelength).astype(real)),
            *mla.count,
            *grid.shape,
        )
        return out

    def gradient(self, mla: MicrolensArray, field: Field, cotangent: Field) -> dict[str, Any]:
        """Return the gradient of a loss with respect to the errors.

        Parameters
        ----------
        mla : MicrolensArray
            Array with the errors.
        field : Field
            Field in front of the errors, to be multiplied by `phase`.
        cotangent : Field
            Gradient dL/dRe + i dL/dIm with respect to the field behind, with the shape of
            ``field``.

        Returns
        -------
        dict
            Gradients in float64: "terms", {(n, m): float}; "focal_lengths", shape (ny, nx); "tilt"
            and "position", shape (ny, nx, 2).

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        """
        require_field(field)
        grid, device, lam = field.grid, field.device, field.wavelength
        behind = multiply(field, self.phase(mla, grid, lam, device))
        of_log = transmission_gradient(behind, cotangent)
        order = max((n for n, _ in self.terms), default=0)
        moments = 2 * np.pi * lenslet_moments(mla, of_log, grid, device, max(order, 2))
        powers = (2 * mla.pitch / self.circle) ** np.add.outer(*[np.arange(order + 1)] * 2)
        common = moments.sum(axis=(0, 1))[: order + 1, : order + 1] * powers / lam
        terms = {
            (n, m): float((common[: n + 1, : n + 1] * zernike_monomials(n, m)).sum())
            for n, m in self.terms
        }
        zeroth, slope = moments[..., 0, 0, None], mla.pitch * moments[..., (1, 0), (0, 1)]
        square = mla.pitch**2 * (moments[..., 0, 2] + moments[..., 2, 0])
        bent = 1 / (2 * lam * self.focal_lengths)[..., None]
        towards = 2 * slope - self.position * zeroth
        by_bent = (self.position * towards).sum(axis=-1) - square
        return {
            "terms": terms,
            "focal_lengths": -by_bent * bent[..., 0] / self.focal_lengths,
            "tilt": slope / lam,
            "position": 2 * bent * (slope - self.position * zeroth),
        }

    def _polynomial(self, order: int, pitch: float, wavelength: float) -> Float64Array:
        """Return turns c[i, k] of b^i a^k, with b and a in pitches."""
        coefficients = np.zeros((order + 1, order + 1))
        powers = (2 * pitch / self.circle) ** np.arange(order + 1)
        for (n, m), metres in self.terms.items():
            coefficients[: n + 1, : n + 1] += metres / wavelength * zernike_monomials(n, m)
        return coefficients * np.outer(powers, powers)

    def _lenslet_terms(self, mla: MicrolensArray, wavelength: float) -> Float64Array:
        """Return turns (constant, along a, along b, quadratic) of each lenslet, in pitches."""
        designed = np.asarray(mla.focal_lengths)[mla.types()]
        bent = 1 / (2 * wavelength * self.focal_lengths)
        slope = self.tilt / wavelength + 2 * bent[..., None] * self.position
        columns = (
            -bent * (self.position**2).sum(axis=-1),
            slope[..., 1] * mla.pitch,
            slope[..., 0] * mla.pitch,
            (1 / (2 * wavelength * designed) - bent) * mla.pitch**2,
        )
        return np.stack(columns, axis=-1)

    def bend(self, lenslet: Any, y: Any, x: Any) -> tuple[Any, Any]:
        """Return the slopes (y, x) that lenslets add to rays, in place of -(y, x)/f.

        Parameters
        ----------
        lenslet : numpy.ndarray
            Index of the lenslet: row times number of columns plus column.
        y, x : numpy.ndarray
            Position relative to the centre of the aperture, along the array's rows and columns, in
            metres.
        """
        f = self.focal_lengths.ravel()[lenslet]
        tilt, position = (values.reshape(-1, 2)[lenslet] for values in (self.tilt, self.position))
        down = tilt[..., 0] - (y - position[..., 0]) / f
        right = tilt[..., 1] - (x - position[..., 1]) / f
        radius = self.circle / 2
        for (n, m), metres in self.terms.items():
            steps = zernike_gradient(n, m, y / radius, x / radius)
            down, right = down + metres / radius * steps[0], right + metres / radius * steps[1]
        return down, right
