"""Resolution, sampling, crosstalk and depth error of plenoptic cameras."""
