"""Lattices and light fields from captured frames; may import model, raw and arrays."""
