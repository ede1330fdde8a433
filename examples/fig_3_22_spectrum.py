"""Figure 3.22: spectrum of a point 50 mm from the focused plane, before and after refocusing."""

import numpy as np
from common import BLUE, RED, mm, number, pixels, start

from clplen.lightfield.refocus import refocus
from clplen.plot.base import new_figure

CUT = 0.1  # cycles a lenslet: the focus measures count what lies above
GAINS = {-0.05: 8.233, 0.05: 3.047}  # of the energy above the cut, by a float64 simulation


def radial(image):
    """Power spectrum averaged over rings, over its value at zero, and the energy above the cut."""
    power = np.abs(np.fft.fft2(image)) ** 2
    radius = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, image.shape), indexing="ij"))
    ring = np.round(radius * image.shape[0]).astype(int).ravel()
    mean = np.bincount(ring, power.ravel()) / np.bincount(ring)
    keep = np.arange(image.shape[0] // 2 + 1)
    return keep / image.shape[0], mean[keep] / mean[0], power[radius > CUT].sum()


example = start(__doc__, __file__)
camera = example.camera
figure = new_figure(8.5, 4)
panels = figure.subplots(1, 2, sharey=True)
for axes, (dz, reference) in zip(panels, GAINS.items(), strict=True):
    lf, alpha = example.point((0.0, 0.0, dz)), camera.alpha(dz)
    frequency, blurred, low = radial(pixels(lf.render()))
    _, sharp, high = radial(pixels(refocus(lf, alpha=alpha)))
    axes.semilogy(frequency, blurred, color=BLUE, label=r"as taken, $\alpha$ = 1")
    axes.semilogy(frequency, sharp, color=RED, label=rf"refocused, $\alpha$ = {alpha:.4f}")
    axes.axvspan(0, CUT, color="0.92", zorder=0)
    axes.set(xlabel="spatial frequency / cycles per lenslet", title=f"dz = {mm(dz)}",
             xlim=(0, 0.5), ylim=(1e-6, 2))
    axes.secondary_xaxis("top", functions=(lambda k: k / camera.lenslet_pitch / 1e3,
                                           lambda k: k * camera.lenslet_pitch * 1e3))
    axes.legend()
    number(f"{mm(dz)}: energy above {CUT} c/lenslet, gain", high / low, reference)
panels[0].set_ylabel("power spectrum, mean over rings / its value at 0")
example.save(figure)
