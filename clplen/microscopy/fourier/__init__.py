"""The Fourier light-field microscope: point images, projector, calibration from beads."""
