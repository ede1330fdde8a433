"""Pupil of a microscope: estimates of aberrations, NA and apodisation from frames."""
