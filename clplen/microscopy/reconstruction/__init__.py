"""Reconstruction of volumes: projectors, Richardson-Lucy deconvolution, priors."""
