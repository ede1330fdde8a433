"""Figure 4.3: modulation transfer of both cameras, where it ends and what the samples carry."""

import numpy as np
from common import begin, number
from drawing import new_figure
from matplotlib.axes import Axes
from resolving import COLOURS, QUICK, TRANSFERS, focused, pair, responses

from clplen.analysis import OTF, Curve, sampling_of

HIGHEST = 25e3  # cycles a metre


def draw_limits(axes: Axes, cam: object, colour: str) -> None:
    """Nyquist's frequency of the samples, and the cut-off of the light."""
    known = sampling_of(cam)
    for f, words, style in ((known.nyquist, "Nyquist", ":"), (known.diffraction_cutoff, "cut-off",
                                                               "--")):
        if f < HIGHEST:
            axes.axvline(f * 1e-3, color=colour, ls=style, lw=1)
            axes.text(f * 1e-3 + 0.2, 0.97, f"{known.kind}: {words}\n{f * 1e-3:.2f}/mm",
                      color=colour, va="top", size=8)


run = begin(__doc__, __file__, quick=QUICK)
psfs = responses(run)
figure = new_figure(8.4, 4.8)
axes = figure.subplots()
f = np.linspace(0, HIGHEST, 2001)
for name, cam in pair(run).items():
    curve = OTF.of(psfs[name], pad=4).mtf(axis=1)
    closed = Curve(f, np.abs(TRANSFERS[name](cam, f)))
    for level in (0.5, 0.1):
        number(f"{name}: MTF{100 * level:.0f} / cycles/mm", curve.at(level) * 1e-3,
               closed.at(level) * 1e-3, 0.25, ".2f")
    shown = curve.frequency < HIGHEST
    axes.plot(curve.frequency[shown] * 1e-3, curve.value[shown], color=COLOURS[name],
              label=f"{name}, measured")
    axes.plot(f * 1e-3, closed.value, color="k" if name == "2.0" else "0.5", lw=1, ls="-.",
              label="lenslet's diffraction, pixel, interpolation" if name == "2.0"
              else "main lens' diffraction, mean over a lenslet")
    draw_limits(axes, cam, COLOURS[name])
number("2.0: falls below .01 at / cycles/mm", curve.at(0.01) * 1e-3,
       150e-6 / (532e-9 * focused(run).a) * 1e-3, 0.4, ".2f")
axes.set(xlabel="spatial frequency on the main lens' image / cycles per mm", ylabel="MTF",
         xlim=(0, HIGHEST * 1e-3), ylim=(0, 1))
axes.legend(loc="upper right", bbox_to_anchor=(1, 0.8), frameon=True, edgecolor="none")
run.save(figure)
