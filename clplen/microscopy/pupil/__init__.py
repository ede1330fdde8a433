"""The pupil of a microscope: what frames tell of its aberrations, its NA and its apodisation."""
