"""Figures of raw images, views, stacks, depth and optical systems (matplotlib, no display).

Every function returns a `matplotlib.figure.Figure`; `save` writes it. Values are shown linearly
unless the colour bar says otherwise.
"""

from clplen.plot.base import Region, Scale, save
from clplen.plot.depths import alpha_curve, depth, energy_curves, phase_space
from clplen.plot.pictures import montage, picture, raw_image, refocused, views
from clplen.plot.systems import system

__all__ = [
    "Region",
    "Scale",
    "alpha_curve",
    "depth",
    "energy_curves",
    "montage",
    "phase_space",
    "picture",
    "raw_image",
    "refocused",
    "save",
    "system",
    "views",
]
