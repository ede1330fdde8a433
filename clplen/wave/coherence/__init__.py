"""Partially coherent light: a spatial model, a spectrum and a system come in, a mean intensity
with its error goes out."""
