"""Commands of the light-field microscope: what it would record, and volumes from frames."""
