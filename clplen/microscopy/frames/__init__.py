"""Preparation of raw frames: dark frame, hot pixels, lattice, rectification."""
