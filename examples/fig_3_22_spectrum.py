"""Figure 3.22: spectrum of a point 50 mm from the focused plane, before and after refocusing."""

import numpy as np
from common import BLUE, RED, mm, number, pixels, start
from drawing import new_figure

from clplen import refocus

CUT = 0.1  # cycles a lenslet: the focus measures count what lies above
PADDED = 400  # lenslets: so fine that the energy above the cut does not depend on it
GAINS = {-0.05: 8.150, 0.05: 3.033}  # of the energy above the cut, by a float64 simulation


def radial(image: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Power spectrum averaged over rings, over its value at zero, and the energy above the cut."""
    power = np.abs(np.fft.fft2(image, (PADDED, PADDED))) ** 2
    frequency = np.fft.fftfreq(PADDED)
    radius = np.hypot(frequency[:, None], frequency)
    ring = np.round(radius * PADDED).astype(int).ravel()
    mean = (np.bincount(ring, power.ravel()) / np.bincount(ring))[: PADDED // 2]
    return np.arange(PADDED // 2) / PADDED, mean / mean[0], power[radius > CUT].sum()


example = start(__doc__, __file__)
camera = example.camera
pitch = camera.lenslet_pitch * 1e3
figure = new_figure(8.5, 4)
panels = figure.subplots(1, 2, sharey=True)
for axes, (dz, reference) in zip(panels, GAINS.items(), strict=True):
    lf, alpha = example.point((0.0, 0.0, dz)), camera.alpha(dz)
    frequency, blurred, low = radial(pixels(lf.render()))
    _, sharp, high = radial(pixels(refocus(lf, alpha=alpha)))
    axes.semilogy(frequency, blurred, color=BLUE, label=r"as taken, $\alpha$ = 1")
    axes.semilogy(frequency, sharp, color=RED, label=rf"refocused, $\alpha$ = {alpha:.4f}")
    axes.axvspan(0, CUT, color="0.92", zorder=0, label="left out by focus measures")
    axes.set(xlabel="spatial frequency / cycles per lenslet", title=f"dz = {mm(dz)}",
             xlim=(0, 0.5), ylim=(1e-5, 15))
    above = axes.secondary_xaxis("top", functions=(lambda k: k / pitch, lambda f: f * pitch))
    above.set_xlabel("cycles per mm on the lenslets")
    axes.legend(loc="upper right")
    number(f"{mm(dz)}: energy above {CUT} c/lenslet, gain", high / low, reference, 0.002, ".3f")
panels[0].set_ylabel("power spectrum, mean over rings / its value at 0")
example.save(figure)
