"""A few wavelengths that represent light of a spectrum on filters of known sensitivity.

An image varies smoothly with the frequency nu = c/lam, as polynomials of nu do. The nodes are those
of Gauss quadrature for the total signal of all spectra and filters (Golub and Welsch 1969, from the
matrix of Lanczos' recurrence). Each pair of a spectrum and a filter has its own weights, which
integrate the polynomial through the nodes exactly. Each filter therefore gets the correct energy,
however ragged its curve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from clplen.wave.spectrum.lineshapes import C, Lines, Rectangle, Table
from clplen.wave.spectrum.spectrum import Spectrum

Vector = np.ndarray[Any, np.dtype[np.float64]]
Response = Callable[[Vector], Vector]  # wavelengths (m,) to signals of filters (m, filters)

REACH = 2.5  # half range of a Gaussian line in full widths; it is 3e-8 of the peak there
PIECES = 64  # number of pieces of a Gaussian line
NODES = 8  # Gauss-Legendre nodes on a piece, on which all curves are smooth
MIN_SHARE = 1e-15  # minimum signal of a frequency, relative to the largest


@dataclass(frozen=True)
class Signal:
    """Signal of spectra on filters, as masses at many frequencies."""

    nu: Vector  # frequencies in Hz, shape (m,)
    # signal at each frequency for a unit of energy of a spectrum, shape (m, spectra, filters)
    masses: Vector

    @classmethod
    def of(cls, spectra: Sequence[Spectrum], response: Response, knots: Sequence[float]) -> Signal:
        """Return the signal of spectra for the response of filters to a unit of energy."""
        smooth = [s for s in spectra if _sharp_lines(s) is None]
        nu, steps = _frequencies(smooth, knots) if smooth else (np.zeros(0), np.zeros(0))
        shapes = [lines for lines in map(_sharp_lines, spectra) if lines is not None]
        sharp = np.unique([centre for lines in shapes for centre in lines.centres])
        powers = np.zeros((nu.size + sharp.size, len(spectra)))
        for column, spectrum in enumerate(spectra):
            lines = _sharp_lines(spectrum)
            if lines is None:
                powers[: nu.size, column] = spectrum.density(nu) * steps
            else:
                rows = nu.size + np.searchsorted(sharp, lines.centres)
                np.add.at(powers[:, column], rows, lines.powers)
        frequencies = np.concatenate([nu, sharp])
        masses = powers[:, :, None] * response(C / frequencies)[:, None, :]
        order = np.argsort(frequencies, kind="stable")
        return cls(frequencies[order], masses[order])

    @property
    def totals(self) -> Vector:
        """Signal of each spectrum on each filter, shape (spectra, filters)."""
        return np.asarray(self.masses.sum(axis=0))

    def rule(self, n: int) -> tuple[Vector, Vector]:
        """Return n wavelengths and their weights."""
        nu, masses = self._lit
        total = masses.sum(axis=(1, 2))
        middle, half = (nu[0] + nu[-1]) / 2, max((nu[-1] - nu[0]) / 2, nu[0] * 1e-12)
        basis, nodes, vectors = _lanczos((nu - middle) / half, total, n)
        root = np.sqrt(total)
        moments = np.tensordot(basis / root[:, None], masses, (0, 0))  # (n, spectra, filters)
        weights = np.sqrt(total.sum()) * np.tensordot(vectors * vectors[0], moments, (0, 0))
        return C / (middle + half * nodes), weights

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency with a signal, in Hz."""
        nu, _ = self._lit
        return float(nu[0]), float(nu[-1])

    @property
    def _lit(self) -> tuple[Vector, Vector]:
        total = self.masses.sum(axis=(1, 2))
        lit = total > MIN_SHARE * total.max()
        return self.nu[lit], self.masses[lit]


def _lanczos(x: Vector, mass: Vector, n: int) -> tuple[Vector, Vector, Vector]:
    """Return basis (m, n), nodes (n,) and eigenvectors (n, n) of Lanczos' recurrence."""
    n = min(n, x.size)
    basis = np.zeros((x.size, n))
    basis[:, 0] = np.sqrt(mass / mass.sum())
    matrix = np.zeros((n, n))
    for j in range(n):
        v = x * basis[:, j]
        matrix[j, j] = v @ basis[:, j]
        for _ in range(2):  # twice keeps the basis orthogonal to rounding
            v -= basis[:, : j + 1] @ (basis[:, : j + 1].T @ v)
        length = float(np.linalg.norm(v))
        if j + 1 == n:
            break
        if length < 1e-10:  # there are no more nodes than lines
            basis, matrix = basis[:, : j + 1], matrix[: j + 1, : j + 1]
            break
        matrix[j, j + 1] = matrix[j + 1, j] = length
        basis[:, j + 1] = v / length
    nodes, vectors = np.linalg.eigh(matrix)
    return basis, nodes, vectors


def _sharp_lines(spectrum: Spectrum) -> Lines | None:
    """Return the shape of a spectrum of sharp lines, None for other spectra."""
    shape = spectrum.shape
    return shape if isinstance(shape, Lines) and shape.is_sharp else None


def _frequencies(spectra: Sequence[Spectrum], knots: Sequence[float]) -> tuple[Vector, Vector]:
    """Return frequencies in Hz of a quadrature of smooth densities, and its weights."""
    edges = np.concatenate([_edges(spectrum) for spectrum in spectra])
    inner = C / np.asarray(knots, np.float64)
    inner = inner[(inner > edges.min()) & (inner < edges.max())]
    edges = np.unique(np.concatenate([edges, inner]))
    x, w = legendre.leggauss(NODES)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    return (middle[:, None] + half[:, None] * x).ravel(), np.outer(half, w).ravel()


def _edges(spectrum: Spectrum) -> Vector:
    """Return frequencies between which a density is smooth."""
    shape = spectrum.shape
    if isinstance(shape, Table):
        return C / np.array(shape.wavelengths)
    if isinstance(shape, Rectangle):
        return np.linspace(shape.low, shape.high, 9)
    assert isinstance(shape, Lines)
    ends = [
        np.linspace(centre - REACH * width, centre + REACH * width, PIECES + 1)
        for centre, width in zip(shape.centres, shape.widths, strict=True)
    ]
    frequencies = np.concatenate(ends)
    return np.asarray(frequencies[frequencies > 0])
