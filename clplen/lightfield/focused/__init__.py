"""Geometry, depth and pictures of focused (plenoptic 2.0) cameras: imports raw and arrays."""
