"""Energy on a sensor: optics, sources and light come in, an image and its report go out."""
