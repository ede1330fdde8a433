"""What a sensor adds to the light: photons, noise, saturation, bits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from clplen.lightfield.raw.raw_image import RawImage


@dataclass(frozen=True)
class Sensor:
    """A photon-counting model; everything is off by default.

    Parameters
    ----------
    exposure : float, optional
        Photo-electrons for one unit of energy (a source of power 1); None leaves energy units and
        switches everything else off.
    shot_noise : bool
        Poisson noise of the photo-electrons.
    read_noise : float
        Standard deviation in electrons a pixel.
    full_well : float, optional
        Electrons at which a pixel saturates.
    bit_depth : int, optional
        Round to 2^bit_depth - 1 equal steps up to ``full_well``, which is then needed.
    seed : int
        The same seed and image give the same noise; images of two devices differ by rounding, and
        with it a few of the pixels' photons.

    Raises
    ------
    ValueError
        For a value outside its range, or noise and bits asked for without an exposure.
    """

    exposure: float | None = None
    shot_noise: bool = False
    read_noise: float = 0.0
    full_well: float | None = None
    bit_depth: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("exposure", "full_well"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is a positive number of electrons, not {value!r}.")
        if not (math.isfinite(self.read_noise) and self.read_noise >= 0):
            raise ValueError(f"read_noise is not negative, in electrons, not {self.read_noise!r}.")
        if self.bit_depth is not None and (
            int(self.bit_depth) != self.bit_depth or not 1 <= self.bit_depth <= 24
        ):
            raise ValueError(
                f"bit_depth is a whole number between 1 and 24, not {self.bit_depth!r}."
            )
        if int(self.seed) != self.seed or self.seed < 0:
            raise ValueError(f"seed is a whole number, not negative, not {self.seed!r}.")
        if self.bit_depth is not None and self.full_well is None:
            raise ValueError("bit_depth needs full_well, the electrons of the largest number.")
        wants = self.shot_noise or self.read_noise or self.full_well or self.bit_depth
        if wants and self.exposure is None:
            raise ValueError("Noise, saturation and bits need exposure, electrons a unit energy.")

    def record(self, raw: RawImage) -> RawImage:
        """The raw image as this sensor delivers it.

        Parameters
        ----------
        raw : RawImage
            In units of energy.

        Returns
        -------
        RawImage
            float32: electrons, or with ``bit_depth`` whole numbers from 0 to 2^bit_depth - 1.
        """
        if self.exposure is None:
            return raw
        electrons = np.maximum(raw.to_numpy().astype(np.float64), 0) * self.exposure
        random = np.random.default_rng(self.seed)
        if self.shot_noise:
            electrons = random.poisson(electrons).astype(np.float64)
        if self.read_noise:
            electrons = electrons + random.normal(0, self.read_noise, electrons.shape)
        if self.full_well is not None:
            electrons = np.minimum(electrons, self.full_well)
        if self.bit_depth is not None and self.full_well is not None:
            top = 2**self.bit_depth - 1
            electrons = np.clip(np.rint(electrons * (top / self.full_well)), 0, top)
        return replace(raw, data=raw.device.upload(electrons.astype(np.float32)))
