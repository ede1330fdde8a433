"""Lattices and light fields from captured frames; imports model, raw and arrays only."""
