"""Figure 2.23: degree of temporal coherence of the LED, sampled spectrum against closed form."""

import numpy as np
from common import BLUE, GREEN, ORANGE, PAPER, RED, begin, number
from drawing import new_figure

from clplen import Spectrum

LAM, FWHM = 550e-9, 30e-9
LENGTHS = {"goodman": 6.698, "fwhm": 8.899, "oct": 4.449}  # um
SAMPLED = {  # samples, span: unit, error within 3 l_c by an independent implementation, colour
    (9, 1.5): (1, 0.20, ORANGE), (15, 2): (1e-4, 3.1, GREEN), (21, 2): (1e-6, 1.1, RED),
}

run = begin(__doc__, __file__)
led, um = Spectrum.gaussian(LAM, FWHM), np.linspace(0, 56, 300 if run.quick else 3000)
closed = np.exp(-((np.pi * FWHM * um * 1e-6 / (2 * LAM**2 * np.sqrt(np.log(2)))) ** 2))
within = 3 * led.coherence_length()
for definition, length in LENGTHS.items():
    number(f"coherence length, {definition} / um", led.coherence_length(definition) * 1e6,
           length, 1e-3, ".3f")
figure = new_figure(9, 6.4)
panels = figure.subplot_mosaic("aa;bc", height_ratios=[1.1, 1])
panels["a"].plot(um, closed, color="0.8", lw=6, label="closed form")
for (n, span), (unit, reference, colour) in SAMPLED.items():
    samples, name = led.sample(n, span=span), f"{n} samples over ±{span:g} FWHM"
    error = led.error(n, within, span=span) / unit
    number(f"largest error within 3 l_c, n = {n} / {unit:g}", error, reference, 0.05, ".2f")
    number(f"path of the revival, n = {n} / um", samples.revival * 1e6,
           (n - 1) / (2 * span) * LAM**2 / FWHM * 1e6, 1e-3, ".3f")
    found = np.abs(samples.gamma(um * 1e-6 / 299792458.0))
    panels["a"].plot(um, found, color=colour, lw=1.2, label=name)
    panels["b"].semilogy(um, np.abs(found - closed), color=colour, lw=1, label=name)
    panels["a"].text(samples.revival * 1e6, 1.03, f"n = {n} again", color=colour, ha="center")
for at, height, text in ((LENGTHS["fwhm"] / 2, 0.5, "half of the FWHM, 4.45 µm"),
                         (LENGTHS["goodman"], 0.209, r"$c\int|\gamma|^2d\tau$ = 6.70 µm")):
    panels["a"].plot(at, height, "ko", ms=4)
    panels["a"].text(at + 0.5, height + 0.02, text, bbox=PAPER)
panels["b"].axvline(within * 1e6, color="0.5", ls=":")
panels["b"].text(within * 1e6 + 0.7, 3e-10, r"$3\,l_c$", color="0.35")
others = {"white LED": (Spectrum.white_led(), BLUE), "this LED": (led, "0.7"),
          "mercury, lines of 1 nm": (Spectrum.mercury(fwhm=1e-9), RED)}
for name, (light, colour) in others.items():
    panels["c"].plot(um[um <= 12], light.degree(um[um <= 12] * 1e-6), color=colour, label=name)
for panel, title in zip("abc", ("LED of 550 nm, FWHM 30 nm: fringe visibility of equal beams",
                                "error of the sampled spectrum", "three lamps"), strict=True):
    panels[panel].set(title=title, xlabel="path difference / µm")
    panels[panel].set_xlim(0, 12 if panel == "c" else 56)
    panels[panel].grid(color="0.93", lw=0.6)
panels["a"].legend(loc=(0.1, 0.62))
panels["c"].legend(loc="upper right")
panels["a"].set(ylabel=r"$|\gamma|$", ylim=(0, 1.12))
panels["b"].set(ylabel=r"$||\gamma_n| - |\gamma||$", ylim=(1e-10, 3))
panels["c"].set(ylabel=r"$|\gamma|$", ylim=(0, 1.35))
run.save(figure)
