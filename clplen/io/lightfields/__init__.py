"""Light fields from files of any kind, and back: views, mosaics, raw frames, arrays, HDF5, Zarr.

Paths and words of layout come in, `LightField` and `StoredLightField` leave; may import the rooms
`formats`, `store` and `raw` of `clplen.io`.
"""
