"""Depth and pictures from raw images of focused (plenoptic 2.0) cameras; may import raw."""
