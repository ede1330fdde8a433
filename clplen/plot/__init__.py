"""Figures of fields, raw images, views, stacks, depth and optical systems (no display needed).

Every function returns a `matplotlib.figure.Figure`; `save` writes it. Values are shown linearly
unless the colour bar says otherwise.
"""

from clplen.plot.base import Region, Scale, save
from clplen.plot.comparisons import comparison
from clplen.plot.depths import alpha_curve, depth, energy_curves, magnification, phase_space
from clplen.plot.fields import intensity, phase
from clplen.plot.pictures import epi, montage, picture, raw_image, refocused, views
from clplen.plot.systems import system

__all__ = [
    "Region",
    "Scale",
    "alpha_curve",
    "comparison",
    "depth",
    "energy_curves",
    "epi",
    "intensity",
    "magnification",
    "montage",
    "phase",
    "phase_space",
    "picture",
    "raw_image",
    "refocused",
    "save",
    "system",
    "views",
]
