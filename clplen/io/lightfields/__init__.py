"""Read and write light fields: views, mosaics, raw frames, arrays, HDF5, Zarr.

Functions take paths and layout options and return `LightField` or `StoredLightField`. Modules may
import the rooms `formats`, `store` and `raw` of `clplen.io`.
"""
