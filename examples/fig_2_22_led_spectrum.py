"""Figure 2.22: emission spectrum of the LED, with the wavelengths that stand for it."""

import numpy as np
from common import begin, number
from drawing import new_figure

from clplen import Spectrum

C, LAM, FWHM = 299792458.0, 550e-9, 30e-9
NM = np.linspace(380, 780, 4001)
HUE = {  # red, green, blue by wavelength
    380: (0.5, 0, 0.7), 440: (0, 0, 1), 490: (0, 0.9, 1), 510: (0, 0.85, 0), 580: (1, 0.9, 0),
    645: (1, 0, 0), 700: (0.8, 0, 0), 780: (0.3, 0, 0),
}


def colours(nm: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(nm, list(HUE), c) for c in zip(*HUE.values(), strict=True)], axis=-1)


run = begin(__doc__, __file__)
led, white, mercury = Spectrum.gaussian(LAM, FWHM), Spectrum.white_led(), Spectrum.mercury()
lit = NM[led.density(C / NM * 1e9) >= led.density(C / LAM) / 2]
samples = led.sample(9, span=1.5)
number("LED: wavelength of its mean frequency / nm", led.centre * 1e9, 550, 1e-4)
number("LED: width at half of the maximum / nm", np.ptp(lit), 30.02, 0.2, ".2f")
number("LED: step of 9 samples over +-1.5 FWHM / THz", samples.step / 1e12,
       3 / 8 * C * FWHM / LAM**2 / 1e12, 1e-4)
model = np.exp(-4 * np.log(2) * (NM[:, None] / [445, 560] - 1) ** 2 * [17.8**2, 4.48**2]) @ [1, 0.5]
number("white LED: wavelength of its mean frequency / nm", white.centre * 1e9,
       model.sum() / (model / NM).sum(), 0.05, ".2f")

figure = new_figure(9, 7)
panels = figure.subplots(3, sharex=True)
for axes, light in zip(panels, (led, white), strict=False):
    density = light.density(C / NM * 1e9) / NM**2  # per nm
    density /= density.max()
    picture = axes.imshow(colours(NM)[None], extent=(380, 780, 0, 1), aspect="auto", alpha=0.85)
    shape = axes.fill_between(NM, density, color="none").get_paths()[0]
    picture.set_clip_path(shape, axes.transData)
    axes.plot(NM, density, color="0.25", lw=1)
    axes.set(ylabel="density per nm / maximum")
nm, weights = samples.wavelengths * 1e9, samples.weights / samples.weights.max()
panels[0].vlines(nm, 0, weights, color="k", lw=1)
panels[0].plot(nm, weights, "ko", ms=4)
panels[0].text(593, 0.5, "dots: weights of 9 samples,\nequally spaced in frequency")
panels[0].text(500, 0.5, "FWHM\n30 nm", ha="center", va="center")
panels[0].hlines(0.5, 515, lit[-1], color="k", lw=1, ls=":")
lines = mercury.sample(6)
nm, weights = lines.wavelengths * 1e9, lines.weights / lines.weights.max()
panels[2].vlines(nm, 0, weights, colors=colours(nm), lw=2.5)
for x, y, side in zip(nm, weights, (-1, 1, 1, 1, -1, 1), strict=True):
    panels[2].text(x + 3 * side, y, f"{x:.1f}", ha="left" if side > 0 else "right", va="center")
panels[2].set(xlabel="wavelength in vacuum / nm", ylabel="power / greatest")
for axes, title in zip(panels, ("LED of the simulations: Gaussian of frequency, 550 nm, FWHM 30 nm",
        "white LED: blue die and yellow phosphor", "low-pressure mercury lamp: visible lines"),
        strict=True):
    axes.set(title=title, xlim=(380, 780), ylim=(0, 1.12))
run.save(figure)
