"""A spectrum as a few wavelengths, and the temporal coherence that is left of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from clplen.wave.spectrum.lineshapes import C, Complex, Vector

BLOCK = 4096  # delays at a time


@dataclass(frozen=True, eq=False)
class SpectralSamples:
    """A spectrum as a few wavelengths.

    Parameters
    ----------
    wavelengths : numpy.ndarray
        In metres, shape (n,), float64.
    weights : numpy.ndarray
        Share of the power of each, shape (n,), float64, sum 1.
    step : float
        Step in Hz, the largest where there are several; 0 where the samples are the whole
        spectrum (sharp lines), infinite for a single sample of a band or of a line with a width.
    """

    wavelengths: Vector
    weights: Vector
    step: float

    @property
    def revival(self) -> float:
        """Path difference c/step in metres at which light of these samples is coherent again.

        Entirely where its steps are equal, in part where they are not.
        """
        return math.inf if self.step == 0 else C / self.step

    def gamma(self, tau: ArrayLike) -> Complex:
        """Complex degree of temporal coherence of the samples at delays in seconds.

        Parameters
        ----------
        tau : array_like
            Delays in seconds, of any shape.

        Returns
        -------
        numpy.ndarray
            complex128, the shape of ``tau``: sum of weight exp(-2 pi i nu tau).
        """
        delays = np.asarray(tau, dtype=float)
        nu = C / self.wavelengths
        found = [np.exp(-2j * np.pi * part * nu) @ self.weights for part in _blocks(delays)]
        return np.concatenate(found).reshape(delays.shape)


def _blocks(delays: Vector) -> list[Vector]:
    """The delays as columns of few at a time."""
    return np.array_split(delays.reshape(-1, 1), max(1, math.ceil(delays.size / BLOCK)))
