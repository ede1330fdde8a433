"""Image of uniform fluorescence behind a lenslet of a microscope: the image of the pupil.

Uniform incoherent light is equal on every plane: defocus is a phase of the pupil and cancels in the
mutual intensity. The light is a sum of plane waves on the array, weighted by cos^(2e) of the pupil.
Behind a periodic array each wave is periodic up to a phase (Bloch), so that propagating a single
cell is enough:

    E(u) = int |P(f)|^2 |t A_f|^2(u) df,   A_f = exp(2 pi i f_mu sqrt(1/lam^2 - (g + f)^2))

with the transmission t of a lenslet, frequencies g of the cell and the angular spectrum A_f over
the focal length f_mu. The point images of a uniform volume converge to this image for fine planes
and voxels.
"""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from clplen.checks import check_finite
from clplen.compute.fft.lines import smooth_length
from clplen.lightfield.raw.lenslet_lattice import Lattice

Vector = np.ndarray[Any, Any]

NEEDED = (
    "magnification", "na", "medium_index", "wavelength", "apodisation", "lenslet_pitch",
    "lenslet_focal_length", "lenslet_diameter", "lenslet_fill", "binning",
)  # fmt: skip
MAX_NA_RATIO = 1.15  # largest supported NA over the nominal NA
MAX_DENSITY = 5  # plane waves between orders of the array: errors of 7e-4 (4e-3 with 3)
MAX_SAMPLES = 2e7  # of all cells together, for memory and time
SUBSAMPLES = 8  # per frequency step along an axis, at the rim of the pupil


class EvenLight:
    """Cells of uniform light behind an array, for any NA and apodisation.

    Parameters
    ----------
    parameters : dict
        Parameters of the microscope, `PointImages.parameters`, in metres.

    Attributes
    ----------
    samples : int
        Number of samples of a cell along an axis, which resolve its finest detail.
    largest : float
        Largest supported NA.

    Raises
    ------
    ValueError
        If a parameter is missing.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        missing = [name for name in NEEDED if name not in parameters]
        if missing:
            raise ValueError(f"The parameters of the images must contain {missing[0]}.")
        check_finite(
            **{name: value for name, value in parameters.items() if isinstance(value, Real)}
        )
        self._parameters = parameters
        self.largest = min(MAX_NA_RATIO * parameters["na"], 0.999 * parameters["medium_index"])
        pitch, lam = parameters["lenslet_pitch"], parameters["wavelength"]
        slope = self.largest / parameters["magnification"]
        slope += parameters["lenslet_diameter"] / (2 * parameters["lenslet_focal_length"])
        self.samples = smooth_length(math.ceil(4 * slope * pitch / lam))
        cutoff = self.largest / (parameters["magnification"] * lam)
        density = self._density(cutoff * pitch)
        self._step = 1 / (density * pitch)
        k = np.arange(math.ceil(cutoff / self._step) + 1) * self._step
        fy, fx = (f.ravel() for f in np.meshgrid(k, k, indexing="ij"))
        is_inside = np.hypot(fy, fx) <= cutoff + self._step
        self._fy, self._fx = fy[is_inside], fx[is_inside]
        self._cells = np.stack(
            [self._cell_intensity(*f) for f in zip(self._fy, self._fx, strict=True)]
        )

    def __repr__(self) -> str:
        parameters = self._parameters
        return (
            f"<EvenLight {parameters['magnification']:g}x, up to NA {self.largest:.3g}, "
            f"{self.samples} x {self.samples} samples a cell>"
        )

    def _density(self, orders: float) -> int:
        """Return the number of plane waves between two orders of the array, odd."""
        for density in range(MAX_DENSITY, 1, -2):
            if np.pi / 4 * (orders * density) ** 2 * self.samples**2 <= MAX_SAMPLES:
                return density
        return 1

    def _cell_intensity(self, fy: float, fx: float) -> Vector:
        """Return the intensity of a plane wave on a cell of the sensor, float32."""
        parameters, n = self._parameters, self.samples
        lam, focal = parameters["wavelength"], parameters["lenslet_focal_length"]
        step = parameters["lenslet_pitch"] / n
        x = (np.arange(n) - (n - 1) / 2) * step
        r2 = x[:, None] ** 2 + x**2
        lens = np.exp(-1j * np.pi * r2 / (lam * focal))
        half = parameters["lenslet_diameter"] / 2
        if parameters["lenslet_fill"] == "circular":
            lens = lens * (r2 <= half**2)
        elif half < parameters["lenslet_pitch"] / 2:
            lens = lens * (abs(x[:, None]) <= half) * (abs(x) <= half)
        g = fft.fftfreq(n, step)
        square = np.maximum(1 / lam**2 - ((g + fy) ** 2)[:, None] - (g + fx) ** 2, 0)
        field = fft.ifft2(fft.fft2(lens) * np.exp(2j * np.pi * focal * np.sqrt(square)))
        return (abs(field) ** 2).astype(np.float32)

    def cell(self, na: float, apodisation: float) -> Vector:
        """Return uniform light behind a lenslet, float64, shape (samples, samples), mean 1.

        ``na`` is the NA of the pupil, up to ``largest``; raise ValueError for a larger NA.
        ``apodisation`` is e of the amplitude cos(theta)^e.
        """
        if not 0 < na <= self.largest:
            raise ValueError(f"na must be between 0 and {self.largest:.4g}, got {na!r}.")
        check_finite(apodisation=apodisation)
        parameters = self._parameters
        part = ((np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5) * self._step
        fy, fx = self._fy[:, None, None] + part[:, None], self._fx[:, None, None] + part
        sine2 = (fy**2 + fx**2) * (parameters["magnification"] * parameters["wavelength"]) ** 2
        cosine2 = np.maximum(1 - sine2 / parameters["medium_index"] ** 2, 1e-9)
        weight = ((sine2 <= na**2) * cosine2**apodisation).mean(axis=(1, 2))
        weight = weight * (1 + (self._fy > 0)) * (1 + (self._fx > 0))  # with mirror images
        cell = np.tensordot(weight, self._cells, 1)
        cell = cell + cell[::-1]
        cell = cell + cell[:, ::-1]
        return np.asarray(cell / cell.mean())

    def frame(self, lattice: Lattice, na: float, apodisation: float, binning: int = 1) -> Vector:
        """Return a raw white frame on a square lattice with a shape, float64, mean about 1.

        A pixel is the mean of ``binning`` points along each axis.
        """
        n, mean = self.samples, []
        for pitch in lattice.pitch[::-1]:
            cycles = fft.fftfreq(n, 1 / n) / pitch  # a pixel
            points = (np.arange(binning) - (binning - 1) / 2) / binning
            mean.append(np.cos(2 * np.pi * np.multiply.outer(cycles, points)).mean(axis=1))
        smooth = fft.ifft2(fft.fft2(self.cell(na, apodisation)) * np.multiply.outer(*mean)).real
        if lattice.shape is None:
            raise ValueError("The lattice has no frame shape: give its shape.")
        to_cells = np.linalg.inv(np.array([lattice.row, lattice.column]).T)
        offsets = np.indices(lattice.shape, float) - np.array(lattice.origin)[:, None, None]
        lenslets = np.tensordot(to_cells, offsets, 1)
        samples = (lenslets - np.round(lenslets)) * n + (n - 1) / 2
        return np.asarray(map_coordinates(smooth, samples, order=3, mode="grid-wrap"))
