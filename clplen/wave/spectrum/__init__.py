"""Spectra of light: temporal coherence, and wavelengths for sampling."""
