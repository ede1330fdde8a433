"""The Fourier light-field microscope: lenslets on the conjugate pupil of an objective."""
