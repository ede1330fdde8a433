"""Volumes from light-field microscopes: point images, projection."""
