"""Figure 3.4: raw image of a point in focus, with lenslets above and below the least diameter."""

import numpy as np
from common import begin, number
from drawing import bar, log_norm, new_figure, show
from matplotlib.patheffects import withStroke
from slices import camera

from clplen import PointSources
from clplen.analysis import cell_energies, crosstalk

SHOWN = 7  # cells across
CASES = {150e-6: 0.107, 100e-6: 0.185}  # d: light outside the cell, float64 simulation

run = begin(__doc__, __file__, quick="coarser pixels")
figure = new_figure(10, 4.9)
panels = figure.subplots(1, 2)
for axes, (d, reference) in zip(panels, CASES.items(), strict=True):
    cam = camera(run, pitch=d, count=51, pixels=16 if run.quick else 30)
    raw = cam.expose(PointSources((0, 0, 0)))
    values = raw.to_numpy().astype(float)
    outside = crosstalk(values, raw.cells)
    number(f"d = {d * 1e6:.0f} um: light outside the own cell", outside, reference, 0.01, ".3f")
    middle, reach = cam.mla.count[0] // 2, SHOWN // 2
    shares = cell_energies(values, raw.cells) / values.sum()
    drawn = show(axes, np.maximum(values / values.max(), 1e-5), cam.pixel_pitch,
                 norm=log_norm(np.ones(1), 5))
    for k in np.arange(-reach, reach + 1):
        for edge in (k - 0.5, k + 0.5):
            axes.axhline(edge * d * 1e3, color="w", lw=0.6, alpha=0.7)
            axes.axvline(edge * d * 1e3, color="w", lw=0.6, alpha=0.7)
        for j in range(-reach, reach + 1):
            text = f"{100 * shares[middle + j, middle + k]:.2g}"
            axes.text((k - 0.44) * d * 1e3, (j - 0.3) * d * 1e3, text, color="w", size=7,
                      path_effects=[withStroke(linewidth=1.5, foreground="k")])
    half, word = SHOWN / 2 * d * 1e3, "above" if d > 113.9e-6 else "below"
    axes.set(xlim=(-half, half), ylim=(half, -half), xlabel="x / mm", ylabel="y / mm",
             title=f"d = {d * 1e6:.0f} um, {word} the least diameter of 114 um:\n"
             f"{100 * outside:.1f} % of the light leaves its cell")
bar(figure, drawn, panels, "intensity / largest (logarithmic)", extend="min")
figure.supxlabel("numbers: share of the light in each cell, in per cent")
run.save(figure)
