"""Lenses, arrays and sensors: lengths and positions come in, fields and rays go out."""
