"""Check of the order of the view axes: `LightField` in, `LightFieldReport` out."""
