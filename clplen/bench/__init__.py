"""Benchmarks of `clplen bench`: a device and a size come in, reports against ceilings leave."""
