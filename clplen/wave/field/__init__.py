"""Sampled complex fields and what acts on them sample by sample: arrays and transmissions come in,
fields and intensities go out."""
