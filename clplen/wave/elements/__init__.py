"""Optical elements of one plane, and beams: a field comes in, the field behind goes out."""
