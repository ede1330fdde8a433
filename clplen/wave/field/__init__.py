"""Sampled complex fields: grids, transmissions, intensities and their gradients."""
