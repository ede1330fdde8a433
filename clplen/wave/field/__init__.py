"""Sampled complex fields: arrays and transmissions come in, fields and intensities go out."""
