"""Lenslet calibration: the lattice of lenslets from a white image, and decoding raw images."""

from clplen.lightfield.lattice import Lattice
from clplen.lightfield.latticefit import estimate_lattice

__all__ = ["Lattice", "estimate_lattice"]
