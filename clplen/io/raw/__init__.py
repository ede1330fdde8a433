"""Raw sensor frames: pictures, Lytro containers, Raytrix calibrations, simulated ones in HDF5.

Paths come in, frames, lattices and `RawImage` leave; may import `clplen.io.formats` and
`clplen.io.store`.
"""
