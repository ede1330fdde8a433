"""What a lenslet of a microscope sees of even fluorescence: the image of the pupil.

Even incoherent light is the same on every plane: defocus is a phase of the pupil, and drops out of
its mutual intensity. So it is a sum of plane waves on the array, each with the pupil's weight
cos^(2e); behind a periodic array each stays periodic but for a phase that its intensity does not
have (Bloch), and one cell of the array is all that must be propagated:

    E(u) = int |P(f)|^2 |t A_f|^2(u) df,   A_f = exp(2 pi i f_mu sqrt(1/lam^2 - (g + f)^2))

with the transmission t of a lenslet, frequencies g of the cell and the angular spectrum A_f over
the focal length f_mu. Independent of planes and voxels, it is what point images of an even volume
add up to where both are fine enough.
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
LARGER = 1.15  # times the stated NA, up to which others can be asked for
FINEST = 5  # plane waves between two of the array's orders: right to 7e-4 (3: to 4e-3)
SAMPLES = 2e7  # of all cells together, for which there is memory and time
PARTS = 8  # of a step of frequencies along an axis, for the rim of the pupil


class EvenLight:
    """Cells of even light behind an array, of any NA and apodisation.

    Parameters
    ----------
    about : dict
        `PointImages.parameters`, in metres.

    Attributes
    ----------
    samples : int
        Of a cell along an axis, enough for its finest detail.
    largest : float
        NA up to which cells can be asked for.

    Raises
    ------
    ValueError
        If a parameter is missing.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        missing = [name for name in NEEDED if name not in about]
        if missing:
            raise ValueError(f"Even light needs {missing[0]} among the parameters of the images.")
        check_finite(**{name: one for name, one in about.items() if isinstance(one, Real)})
        self._about = about
        self.largest = min(LARGER * about["na"], 0.999 * about["medium_index"])
        pitch, lam = about["lenslet_pitch"], about["wavelength"]
        slope = self.largest / about["magnification"]
        slope += about["lenslet_diameter"] / (2 * about["lenslet_focal_length"])
        self.samples = smooth_length(math.ceil(4 * slope * pitch / lam))
        cutoff = self.largest / (about["magnification"] * lam)
        density = self._density(cutoff * pitch)
        self._step = 1 / (density * pitch)
        k = np.arange(math.ceil(cutoff / self._step) + 1) * self._step
        fy, fx = (one.ravel() for one in np.meshgrid(k, k, indexing="ij"))
        near = np.hypot(fy, fx) <= cutoff + self._step
        self._fy, self._fx = fy[near], fx[near]
        self._cells = np.stack([self._behind(*f) for f in zip(self._fy, self._fx, strict=True)])

    def __repr__(self) -> str:
        about = self._about
        return (
            f"<EvenLight {about['magnification']:g}x, up to NA {self.largest:.3g}, "
            f"{self.samples} x {self.samples} samples a cell>"
        )

    def _density(self, orders: float) -> int:
        """Plane waves between two orders of the array, an odd number."""
        for density in range(FINEST, 1, -2):
            if np.pi / 4 * (orders * density) ** 2 * self.samples**2 <= SAMPLES:
                return density
        return 1

    def _behind(self, fy: float, fx: float) -> Vector:
        """Intensity of a plane wave on one cell of the sensor, float32."""
        about, n = self._about, self.samples
        lam, focal = about["wavelength"], about["lenslet_focal_length"]
        step = about["lenslet_pitch"] / n
        x = (np.arange(n) - (n - 1) / 2) * step
        r2 = x[:, None] ** 2 + x**2
        lens = np.exp(-1j * np.pi * r2 / (lam * focal))
        half = about["lenslet_diameter"] / 2
        if about["lenslet_fill"] == "circular":
            lens = lens * (r2 <= half**2)
        elif half < about["lenslet_pitch"] / 2:
            lens = lens * (abs(x[:, None]) <= half) * (abs(x) <= half)
        g = fft.fftfreq(n, step)
        square = np.maximum(1 / lam**2 - ((g + fy) ** 2)[:, None] - (g + fx) ** 2, 0)
        field = fft.ifft2(fft.fft2(lens) * np.exp(2j * np.pi * focal * np.sqrt(square)))
        return (abs(field) ** 2).astype(np.float32)

    def cell(self, na: float, apodisation: float) -> Vector:
        """Return even light behind a lenslet, float64, shape (samples, samples), mean 1.

        ``na`` is that of the pupil, up to ``largest``; ``apodisation`` is e of the amplitude
        cos(theta)^e. Raise ValueError for another NA.
        """
        if not 0 < na <= self.largest:
            raise ValueError(f"The NA lies between 0 and {self.largest:.4g} here, not {na!r}.")
        check_finite(apodisation=apodisation)
        about = self._about
        part = ((np.arange(PARTS) + 0.5) / PARTS - 0.5) * self._step
        fy, fx = self._fy[:, None, None] + part[:, None], self._fx[:, None, None] + part
        sine2 = (fy**2 + fx**2) * (about["magnification"] * about["wavelength"]) ** 2
        cosine2 = np.maximum(1 - sine2 / about["medium_index"] ** 2, 1e-9)
        weight = ((sine2 <= na**2) * cosine2**apodisation).mean(axis=(1, 2))
        weight = weight * (1 + (self._fy > 0)) * (1 + (self._fx > 0))  # and their mirror images
        found = np.tensordot(weight, self._cells, 1)
        found = found + found[::-1]
        found = found + found[:, ::-1]
        return np.asarray(found / found.mean())

    def frame(self, lattice: Lattice, na: float, apodisation: float, binning: int = 1) -> Vector:
        """Return a raw white frame on a square lattice with a shape, float64, about 1 in the mean.

        ``binning`` is the number of points of a pixel along an axis, whose mean it takes.
        """
        n, mean = self.samples, []
        for pitch in lattice.pitch[::-1]:
            cycles = fft.fftfreq(n, 1 / n) / pitch  # a pixel
            points = (np.arange(binning) - (binning - 1) / 2) / binning
            mean.append(np.cos(2 * np.pi * np.multiply.outer(cycles, points)).mean(axis=1))
        smooth = fft.ifft2(fft.fft2(self.cell(na, apodisation)) * np.multiply.outer(*mean)).real
        if lattice.shape is None:
            raise ValueError("The lattice does not tell the shape of its frame: give it.")
        to_cells = np.linalg.inv(np.array([lattice.row, lattice.column]).T)
        away = np.indices(lattice.shape, float) - np.array(lattice.origin)[:, None, None]
        places = np.tensordot(to_cells, away, 1)
        samples = (places - np.round(places)) * n + (n - 1) / 2
        return np.asarray(map_coordinates(smooth, samples, order=3, mode="grid-wrap"))
