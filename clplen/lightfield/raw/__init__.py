"""Raw lenslet images, lattices and sensors; this folder may import arrays."""
