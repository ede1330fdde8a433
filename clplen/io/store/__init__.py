"""Containers of many arrays: HDF5, Zarr, OME-TIFF and OME-Zarr, with what they say of their arrays.

Open files, arrays and blocks of them come in, checked arrays and descriptions leave; may import
`clplen.io.formats`.
"""
