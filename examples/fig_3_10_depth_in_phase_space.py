"""Figure 3.10: the same point in phase space: samples that its rays fill, and the light."""

import numpy as np
from common import begin, mm, number
from drawing import bar, new_figure
from slices import (
    DEPTHS,
    QUICK,
    axes_of,
    camera,
    draw_cells,
    draw_slice,
    slope,
    span,
    summed,
    taken,
)

SHOWN = 11  # lenslets
SLOPES = {"in focus": 0.0, "closer": 0.249, "farther": -0.158}  # float64 simulation, as measured

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
p = cam.lenslet_pitch
figure = new_figure(10, 6.6)
panels = figure.subplots(2, 3, sharex=True, sharey=True)
for (above, below), (name, dz) in zip(panels.T, DEPTHS.items(), strict=True):
    lf = taken(cam, dz)
    u, x = axes_of(lf)
    light, true = summed(lf), 1 - cam.alpha(dz)
    found = slope(light, u, x, within=1.2e-3, reach=8.5 * p)
    number(f"{name}: dx/du of the light", found, SLOPES[name], 0.004, ".3f")
    draw_cells(above, cam, dz, SHOWN)
    drawn = draw_slice(below, lf, light, SHOWN)
    ends = np.array([-0.5, 0.5]) * cam.aperture_diameter
    for axes, colour in ((above, "k"), (below, "c")):
        axes.plot(true * ends * 1e3, ends * 1e3, "--", color=colour, lw=1.1)
    if dz:
        wide = np.abs(true) * cam.aperture_diameter * 500
        span(above, (-wide, -1.5), (wide, -1.5), rf"$\Delta x$ = {2 * wide:.2f} mm",
             aside=(np.sign(true) * 34, 3))
    above.set_title(rf"{name}, dz = {mm(dz)}: 1 - $\alpha$ = {true:.3f}")
    below.locator_params(axis="x", nbins=5)
    below.set(xlabel="x on the array / mm", title=f"dx/du of the light = {found:.3f}")
for axes in panels[:, 0]:
    axes.set_ylabel("u on the main lens / mm")
bar(figure, drawn, list(panels[1]), "square root of the light / largest")
figure.supxlabel("above: a box is a lenslet and a ninth of the main lens, as strong as the share "
                 r"of its rays; dashed: x = u (1 - $\alpha$); below: by waves")
run.save(figure)
