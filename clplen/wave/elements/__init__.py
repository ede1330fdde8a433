"""Optical elements of one plane and the beams that light them: a field comes in, the field behind
the element goes out."""
