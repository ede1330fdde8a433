"""Optics of the cameras: fields and rays through lenses, arrays and sensors."""
