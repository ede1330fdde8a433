"""Lenslet calibration: the lattice of lenslets from a white image, and decoding raw images."""

from clplen.lightfield.lattice import Lattice

__all__ = ["Lattice"]
