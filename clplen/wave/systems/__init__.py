"""Optical systems: elements and distances along an axis."""
