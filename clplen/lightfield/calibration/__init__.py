"""From captured frames to lattices and light fields: imports model, raw and arrays."""
