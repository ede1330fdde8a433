"""Tiled processing of light fields larger than memory, with results equal to whole ones."""
