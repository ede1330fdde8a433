"""Partially coherent light: models, spectra, averages and exact means of intensities."""
