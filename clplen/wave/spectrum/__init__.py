"""Spectra of light: lines, widths and tables come in, temporal coherence and weighted wavelengths
go out."""
