"""Raw lenslet images, their lattices and sensors: imports arrays; raw images and views leave."""
