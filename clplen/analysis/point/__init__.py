"""Measures of a single picture, point or wavefront."""
