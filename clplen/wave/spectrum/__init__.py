"""Spectra of light: lines and tables come in, coherence in time and wavelengths go out."""
