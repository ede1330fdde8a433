"""Light-field microscopes: frames and cameras come in, point images and volumes go out."""
