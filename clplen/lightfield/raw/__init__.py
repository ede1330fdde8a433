"""Raw lenslet images, lattices and sensors; may import arrays; raw images and views leave."""
