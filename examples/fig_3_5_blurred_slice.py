"""Figure 3.5: crosstalk in phase space: it widens a rendered point."""

import numpy as np
from common import BLUE, RED, begin, number, pixels
from drawing import bar, new_figure
from slices import axes_of, camera, draw_slice, span, summed

from clplen import LightField, PointSources

WINDOW = 1.2e-3  # metres to either side of the point, for its width: rms has no limit without
CASES = {150e-6: (0.441, 66.21), 100e-6: (0.815, 81.55)}  # d: rms width, float64 simulation


def width(lf: LightField) -> float:
    """rms width of the rendered point along x in metres, within the window."""
    image, (_, x) = pixels(lf.render()), axes_of(lf)
    near = np.abs(x) < WINDOW
    line = image[np.ix_(near, near)].sum(axis=0)
    return float(np.sqrt(np.average(x[near] ** 2, weights=line)))


run = begin(__doc__, __file__, quick="nothing less: this is quick")
figure = new_figure(9.4, 6.4)
panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.4, 1])
for (above, below), (d, references) in zip(panels.T, CASES.items(), strict=True):
    cam = camera(run, pitch=d, count=51, pixels=24)
    lf = LightField.from_raw(cam.expose(PointSources((0, 0, 0))))
    rms = width(lf)
    lenslets, um = references
    number(f"d = {d * 1e6:.0f} um: rms width / lenslets", rms / d, lenslets, 0.005, ".3f")
    number(f"d = {d * 1e6:.0f} um: rms width / um", rms * 1e6, um, 0.5, ".2f")
    _, x = axes_of(lf)
    drawn = draw_slice(above, lf, summed(lf), 2 * WINDOW / d)
    line = pixels(lf.render()).sum(axis=0)
    below.bar(x * 1e3, line / line.max(), d * 1e3, color=BLUE, ec="w", lw=0.3)
    span(below, (-rms * 1e3, 0.6), (rms * 1e3, 0.6), "", color=RED)
    below.text(rms * 1e3 + 0.05, 0.6, rf"$\Delta x$ = {2e6 * rms:.0f} um = {2 * rms / d:.2f} p",
               color=RED, va="center")
    below.set(yscale="log", ylim=(1e-4, 2), xlabel="x on the array / mm",
              ylabel="rendering, summed over y / largest")
    word = "above" if d > 113.9e-6 else "below"
    above.set(ylabel="u on the main lens / mm",
              title=f"d = {d * 1e6:.0f} um, {word} the least diameter of 114 um")
bar(figure, drawn, list(panels[0]), "square root of the light / largest")
run.save(figure)
