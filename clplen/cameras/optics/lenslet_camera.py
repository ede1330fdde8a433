"""Lengths of the array of lenslets, as every camera with one tells them."""

from __future__ import annotations

from clplen.compute.device import Device, as_device
from clplen.wave.field import Grid
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.quantity import metres


class Arrayed:
    """Attributes of what has an array ``mla``."""

    mla: MicrolensArray
    grid: Grid
    device: Device

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    @property
    def _sensor(self) -> str:
        """Lenslets and pixels in a few words, for a representation."""
        (rows, columns), (ny, nx) = self.mla.count, self.grid.shape
        lenslets = f"{rows} x {columns} lenslets of {metres(self.mla.pitch)}"
        return f"{lenslets}, {ny} x {nx} pixels"

    @property
    def lenslet_pitch(self) -> float:
        """p in metres."""
        return self.mla.pitch

    @property
    def lenslet_diameter(self) -> float:
        """d in metres."""
        return self.mla.diameter

    @property
    def lenslet_focal_length(self) -> float:
        """f_mu in metres; of several kinds of lenslets the first."""
        return self.mla.f

    @property
    def lenslet_fill(self) -> str:
        """Aperture of a lenslet: "circular", a disc, or "full", the cell of the lattice."""
        return self.mla.fill

    @property
    def lenslet_lattice(self) -> str:
        """Lattice of the lenslets, "square" or "hexagonal"."""
        return self.mla.lattice
