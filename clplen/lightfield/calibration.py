"""Lenslet calibration: the lattice of lenslets from a white image, and decoding raw frames."""

from clplen.lightfield.lattice import Lattice
from clplen.lightfield.latticefit import estimate_lattice
from clplen.lightfield.rawdecode import decode_raw

__all__ = ["Lattice", "decode_raw", "estimate_lattice"]
