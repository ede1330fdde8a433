"""The images of a volume's voxels behind a light-field microscope."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Vector = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, repr=False)
class PointImages:
    """Point images of a microscope. Made by `clplen.microscopy.point_images`.

    Attributes
    ----------
    parameters : dict
        Everything that they depend on, by name: numbers in SI units and strings.
    planes : numpy.ndarray
        float64, shape (planes,): z of each plane in metres, farther positive.
    voxels : int
        v, of a lenslet along an axis.
    pixels : int
        n, of a lenslet along an axis.
    stored : tuple of numpy.ndarray
        For each plane the different images, float32 or float16, shape (u, n k, n k), k = 2 r + 1
        lenslets about that of the voxel; of the phases (a, b), a <= b <= (v - 1)/2, in the order of
        `unique_phases`.
    scales : numpy.ndarray
        float64, shape (planes,): what the stored numbers are multiplied by.
    notes : dict
        Numbers that tell more of them, without which they are the same: "sensor_pixels", pixels a
        lenslet of the sensor by the parameters, before rectification; "binning_error", how far an
        image is from that of pixels twice as fine, norm over norm.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> images
    <PointImages of 2 planes, 3 x 3 voxels and 11 x 11 pixels a lenslet, ... MiB>
    >>> f"voxels of {images.side * 1e6:.0f} um"
    'voxels of 2 um'
    """

    parameters: dict[str, Any]
    planes: Vector
    voxels: int
    pixels: int
    stored: tuple[Vector, ...]
    scales: Vector
    notes: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        size = sum(one.nbytes for one in self.stored) / 2**20
        return (
            f"<PointImages of {len(self.planes)} planes, {self.voxels} x {self.voxels} voxels and "
            f"{self.pixels} x {self.pixels} pixels a lenslet, {size:.3g} MiB>"
        )

    @property
    def side(self) -> float:
        """Of a voxel along y and x, in metres."""
        about = self.parameters
        return float(about["lenslet_pitch"] / (about["magnification"] * self.voxels))

    @property
    def radii(self) -> tuple[int, ...]:
        """r of each plane: lenslets from that of the voxel to the last one with light."""
        return tuple((one.shape[1] // self.pixels - 1) // 2 for one in self.stored)

    def image(self, plane: int, phase: tuple[int, int]) -> Vector:
        """The image of one voxel of energy 1.

        Parameters
        ----------
        plane : int
        phase : tuple of int
            (sy, sx) of the voxel in its lenslet, each from 0 to v - 1.

        Returns
        -------
        numpy.ndarray
            float32, shape (n k, n k): energy on the pixels of the k x k lenslets about its own.
        """
        v = self.voxels
        if not all(0 <= s < v for s in phase):
            raise ValueError(f"A lenslet has voxels (0, 0) to ({v - 1}, {v - 1}), not {phase!r}.")
        folded = [min(s, v - 1 - s) for s in phase]
        number = unique_phases(v).index((min(folded), max(folded)))
        found = self.stored[plane][number]
        if folded[0] > folded[1]:
            found = found.T
        turned = tuple(-1 if s != f else 1 for s, f in zip(phase, folded, strict=True))
        values = found[:: turned[0], :: turned[1]].astype(np.float32)
        return np.ascontiguousarray(values * np.float32(self.scales[plane]))

    def kept(self, plane: int) -> float:
        """The least share of a voxel's light in its images of a plane."""
        sums = self.stored[plane].astype(np.float64).sum(axis=(1, 2))
        return float(sums.min() * self.scales[plane])


def count_phases(voxels: int) -> int:
    """How many `unique_phases` there are, h (h + 1)/2 with h = ceil(v/2)."""
    half = (voxels + 1) // 2
    return half * (half + 1) // 2


def unique_phases(voxels: int) -> list[tuple[int, int]]:
    """Phases (a, b), a <= b, of voxels whose images are not mirror images of others."""
    half = (voxels + 1) // 2
    return [(a, b) for a in range(half) for b in range(a, half)]
