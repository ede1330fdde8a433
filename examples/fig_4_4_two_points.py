"""Figure 4.4: two points by both cameras, as rendered, and their contrast against separation."""

import numpy as np
from common import begin, number
from drawing import LIGHT, new_figure
from matplotlib.axes import Axes
from resolving import COLOURS, QUICK, TRANSFERS, line_of, pair, responses, two_points

from clplen.analysis import PSF, SLIT, TwoPoints

UNIT = 532e-9 * 18e-3 / 150e-6  # lam a/d of the 2.0 camera
CONTRASTS = {0.886: 0.916, 1: 0.813, 1.22: 0.565, 1.5: 0.357}  # mid/peak, float64 simulation
EXPOSED = (78e-6, 130e-6, 225e-6, 300e-6)  # separations
NEAR = 0.36  # mm


def draw_contrast(axes: Axes, two: dict[str, TwoPoints], cams: dict[str, object]) -> None:
    """mid/peak against separation, measured and in closed form."""
    s, f = np.linspace(20e-6, 320e-6, 151), np.linspace(0, 1e5, 2001)
    x = np.arange(-120, 121) * 5e-6
    for name, cam in cams.items():
        line = np.maximum(line_of(TRANSFERS[name](cam, f), f, x), 0)
        ideal = TwoPoints.incoherent(PSF(np.outer(line, line), 5e-6), axis=1)
        axes.plot(s * 1e6, two[name].contrast(s), color=COLOURS[name], label=f"{name}, measured")
        axes.plot(s * 1e6, ideal.contrast(s), color=COLOURS[name], lw=1, ls="--",
                  label=f"{name}, closed form of lines")
    axes.plot(np.array(list(CONTRASTS)) * UNIT * 1e6, list(CONTRASTS.values()), "ko", ms=4,
              label="2.0, float64 simulation")
    axes.axhline(SLIT, color="0.6", lw=0.8)
    axes.text(200, SLIT + 0.015, r"Rayleigh: two sinc$^2$ at $\lambda a/d$", color="0.4")
    axes.set(xlabel="separation on the main lens' image / um", ylabel="middle / lower maximum",
             xlim=(20, 320), ylim=(0, 1.03))
    axes.legend()


run = begin(__doc__, __file__, quick=QUICK)
cams = pair(run)
two = {name: TwoPoints.incoherent(psf, axis=1) for name, psf in responses(run).items()}
for share, reference in CONTRASTS.items():
    found = two["2.0"].contrast(share * UNIT)
    number(f"2.0: mid/peak at {share:g} lam a/d", found, reference, 0.02, ".3f")
number("1.0: told apart from / um", two["1.0"].rayleigh(SLIT) * 1e6, 150, 15, ".0f")
exposed = EXPOSED[:1] if run.quick else EXPOSED
figure = new_figure(10, 8.4)
above, below = figure.subfigures(2, 1, height_ratios=[1.25, 1])
panels = above.subplots(2, len(exposed), sharex=True, sharey=True, squeeze=False)
for row, (name, cam) in zip(panels, cams.items(), strict=True):
    for axes, separation in zip(row, exposed, strict=True):
        values, pitch = two_points(cam, separation)
        side = values.shape[0] * pitch * 500
        axes.imshow(values, cmap=LIGHT, extent=(-side, side, side, -side), vmin=0)
        axes.plot([-separation * 500, separation * 500], [0.3, 0.3], "c|", ms=9)
        axes.set(xlim=(-NEAR, NEAR), ylim=(NEAR, -NEAR), xlabel="x / mm" if name == "2.0" else "",
                 title=f"{name}, {separation * 1e6:.0f} um apart")
    row[0].set_ylabel("y / mm")
draw_contrast(below.subplots(), two, cams)
run.save(figure)
