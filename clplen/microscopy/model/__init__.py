"""Point images of a microscope: the cells of its array, the waves, the files."""
