"""Raw sensor frames: pictures, Lytro containers, Raytrix calibrations, simulated frames in HDF5.

Functions take paths and return frames, lattices or `RawImage`. Modules may import
`clplen.io.formats` and `clplen.io.store`.
"""
