"""Figure 4.5: the focused camera against m = b/a: sharper places for fewer views."""

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure
from resolving import QUICK, draw_spots, focused, response2, standard, transfer2

from clplen.analysis import OTF, Curve, sampling_of

WIDTHS = {0.1: 115.1, 0.15: 81.5, 0.2: 60.9, 0.3: 44.1, 0.4: 35.1}  # um, float64 simulation
F = np.linspace(0, 60e3, 3001)


run = begin(__doc__, __file__, quick=QUICK)
shown = {m: WIDTHS[m] for m in ((0.2, 0.4) if run.quick else WIDTHS)}
figure = new_figure(11, 7)
above, below = figure.subfigures(2, 1, height_ratios=[1, 1.5])
panels = above.subplots(1, len(shown), sharey=True)
panels[0].set_ylabel("y / mm")
left, middle, right = below.subplots(1, 3)
for axes, (m, reference) in zip(panels, shown.items(), strict=True):
    cam = focused(run, m)
    draw_spots(axes, cam)
    psf = response2(cam, 0.8e-6 / m)
    width, curve = psf.fwhm(axis=1), OTF.of(psf).mtf(axis=1)
    number(f"m = {m:g}: width of the image of a point / um", width * 1e6, reference,
           round(0.02 * reference, 1), ".1f")
    closed = Curve(F, np.maximum(transfer2(cam, F), 0))
    number(f"m = {m:g}: MTF50 / cycles/mm", curve.at(0.5) * 1e-3, closed.at(0.5) * 1e-3,
           round(0.06e-3 * closed.at(0.5), 2), ".2f")
    left.plot(m, width * 1e6, "o", color=BLUE)
    middle.plot(m, curve.at(0.5) * 1e-3, "o", color=BLUE)
ms = np.linspace(0.08, 0.45, 38)
known = [sampling_of(focused(run, m)) for m in ms]
light = np.array([one.diffraction_cutoff for one in known])
left.plot(ms, 0.886e6 / light, "-", color=ORANGE, label=r"lenslet, 0.886 $\lambda a/d$")
left.plot(ms, [one.spatial_pitch * 1e6 for one in known], ":", color=GREEN, label="pixel, dx/m")
left.axhline(standard(run).lenslet_pitch * 1e6, color=RED, ls="--", lw=1, label="1.0 camera, p")
left.set(ylabel="width of the image of a point / um", ylim=(0, 170))
middle.plot(ms, [Curve(F, np.maximum(transfer2(focused(run, m), F), 0)).at(0.5) * 1e-3 for m in ms],
            "-", color=BLUE, label="MTF50, closed form")
middle.plot(ms, light * 1e-3, "-", color=ORANGE, label=r"cut-off, $d/(\lambda a)$")
middle.plot(ms, [one.nyquist * 1e-3 for one in known], ":", color=GREEN, label="Nyquist, m/(2 dx)")
middle.set(ylabel="cycles per mm", ylim=(0, None))
right.plot(ms, [focused(run, m).views for m in ms], "-", color=RED, label="views, D a/(F p)")
right.plot(ms, 1 / ms, "--", color="0.4", label="1/m")
right.set(ylabel="views of a point, a row", ylim=(0, None))
for axes in (left, middle, right):
    axes.set_xlabel("m = b/a")
    axes.legend()
run.save(figure)
