"""Scenes: points, pictures and surfaces before a camera."""
