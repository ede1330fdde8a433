"""Depth of light fields: cues, depth maps, all-in-focus pictures, alpha of one object."""
