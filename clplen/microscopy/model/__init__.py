"""Point images of a microscope: unit cells of the array, simulation, files."""
