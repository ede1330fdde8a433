"""Wavefronts of the main lens: figure 4.6."""

from math import exp, pi
from typing import Any

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, number
from drawing import ROOT, show
from matplotlib.axes import Axes

from clplen.analysis import PSF
from clplen.cameras import Aberrations, Plenoptic1

LAM, NEAR = 532e-9, 1.2  # wavelength; mm shown
NAMES = {4: "defocus", 6: "astigmatism", 8: "coma", 11: "spherical"}  # by Noll's index


def show_light(axes: Axes, image: np.ndarray, pitch: float) -> Any:
    """An image from 0 to 1 about the axis, in mm."""
    axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1])
    return show(axes, np.maximum(image, 0), pitch, near=NEAR, norm=ROOT)


def main_image(cam: Plenoptic1) -> PSF:
    """The main lens' image of a point on the array."""
    field = cam.optics.array_field(cam.optics.pupil(np.zeros((1, 3)))).to_numpy()[0]
    light = np.abs(field).astype(float) ** 2
    return PSF(light / light.sum(), cam.pixel_pitch, cam.grid.origin)


def draw_strehl(axes: Axes, one: Plenoptic1, *, quick: bool) -> None:
    """Strehl ratios of the main lens' image against the rms of the wavefront."""
    ideal, rms = main_image(one), np.linspace(0, 1.2, 61)
    axes.plot(rms, np.exp(-(rms**2)), "k-", lw=1, label=r"exp(-$\sigma^2$)")
    for (j, name), colour in zip(NAMES.items(), (BLUE, ORANGE, GREEN, RED), strict=True):
        for sigma in (0.5,) if quick else (0.1, 0.3, 0.5, 0.7, 1.0):
            built = one.with_aberrations(Aberrations(main_lens={j: sigma * LAM / (2 * pi)}))
            found = main_image(built).strehl(ideal)
            if sigma <= 0.5:
                number(f"{name}, {sigma:g} rad rms: Strehl ratio", found, exp(-(sigma**2)), 0.01)
            axes.plot(sigma, found, "o", ms=4, color=colour, label=name if sigma == 0.5 else None)
    axes.set(xlabel=r"$\sigma$, rms of the wavefront / rad", ylabel="Strehl ratio of its image",
             title="main lens alone", ylim=(0, 1.03))
    axes.legend()
