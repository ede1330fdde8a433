"""Measures of plenoptic cameras: cameras and raw images come in; `Comparison` and curves leave."""
