"""A device against NumPy in double precision."""
