"""Figure 2.21: random phase masks of 10, 50, 100 and 200 sources a side, and their coherence."""

import numpy as np
from closed import LAM
from coherent import WINDOW, degree_of, phase_bar, show_phase, snapshot
from common import BLUE, RED, begin, number
from drawing import new_figure
from matplotlib.patches import Rectangle

from clplen import Grid
from clplen.wave import RandomPhaseMask

MASKS = {10: (15, 400), 50: (8, 16), 100: (8, 4), 200: (8, 1)}  # samples a cell, masks: of mu
DISTANCES = {10: 29.0909, 50: 1.1636, 100: 0.2909, 200: 0.0727}  # m
PART = 1e-3  # m, half of what is enlarged
FINE, KINDS = np.linspace(0, 2, 201), {"field": BLUE, "phase": RED}

run = begin(__doc__, __file__, quick="1010 samples a side instead of 3030")
size = 1010 if run.quick else 3030
grid, figure = Grid((size, size), WINDOW / size), new_figure(11, 8.2)
panels = figure.subplots(3, 4, height_ratios=[1.1, 1, 0.9])
for (whole, part, law), (cells, (samples, masks)) in zip(panels.T, MASKS.items(), strict=True):
    p = WINDOW / cells
    mask = RandomPhaseMask(p)
    d_c = mask.distance_on(grid, LAM)
    number(f"{cells} sources: d_c / m", d_c, DISTANCES[cells], 1e-4)
    u = snapshot(mask, grid, run.device)
    drawn = show_phase(whole, u, grid)
    near = np.abs(grid.x) <= PART
    show_phase(part, u[np.ix_(near, near)], Grid((near.sum(), near.sum()), grid.pitch))
    whole.add_patch(Rectangle((-1, -1), 2, 2, fill=False, ec="w", lw=1.2))
    small, lags = Grid((samples * cells,) * 2, p / samples), np.arange(2 * samples + 1)
    for kind, colour in KINDS.items():
        given = RandomPhaseMask(p, kind=kind)
        mu, error = degree_of(given, small, run.device, masks, lags)
        number(f"{cells} sources, {kind}: rms of mu - stated", error, 0, 0.01)
        law.plot(FINE, given.degree(0, FINE * p), color=colour, lw=1)
        law.plot(lags / samples, mu, "o", color=colour, ms=3, label=kind)
    whole.set_title(f"{cells} x {cells} sources\np = {p * 1e3:g} mm, $d_c$ = {d_c:.3g} m")
    talbot = "; fractional Talbot\ndistance: squares of p/5" if cells == 10 else ""
    part.set_title(f"enlarged{talbot}")
    for axes, half in ((whole, 10), (part, 1)):
        ticks = (-half, 0, half)
        axes.set(xlabel="x / mm", ylabel="y / mm", xticks=ticks, yticks=ticks)
    law.set(title=f"degree of coherence\nmeasured from {masks} mask" + "s" * (masks > 1),
            xlabel="displacement / p", ylabel="$\\mu$")
panels[2, 0].legend(title="mask:")
phase_bar(figure, drawn, panels[:2], shrink=0.5)
run.save(figure)
