"""Optical elements in a plane, and beams: each maps a field to the field behind it."""
