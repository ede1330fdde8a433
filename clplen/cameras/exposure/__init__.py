"""Exposures: energy on a sensor from optics, sources and light."""
