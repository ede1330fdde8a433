"""Figure 3.20: alpha = F/F' against the object's place, for +-10 cm about the focused plane."""

import numpy as np
from common import BLUE, COLOURS, mm, number, start
from drawing import new_figure

from clplen import demo

REFERENCE = {-0.1: 0.285714, -0.05: 0.736842, -0.025: 0.883721, -0.01: 0.956522, 0.01: 1.04,
             0.025: 1.094340, 0.05: 1.172414, 0.1: 1.294118}

example = start(__doc__, __file__)
camera = example.camera
for place, reference in REFERENCE.items():
    number(f"alpha at {mm(place)}", camera.alpha(place), reference, 1e-6, ".6f")
tolerance = camera.describe()["focus tolerance"]
dz = np.linspace(-0.1, 0.1, 401)
alpha = camera.alpha(dz)
step = tolerance * (camera.object_distance + dz) ** 2 / camera.image_distance

figure = new_figure(6.5, 6)
upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1])
upper.plot(dz * 1e3, alpha, color=BLUE, label=r"$\alpha$ = (2f + 2 dz)/(2f + dz)")
upper.plot(dz * 1e3, 1 + dz / camera.object_distance, "--", color="0.5", lw=1,
           label="tangent in the focused plane")
for name, (_, _, place) in demo.POINTS.items():
    upper.plot(place * 1e3, camera.alpha(place), "o", color=COLOURS[name], ms=5)
    upper.annotate(rf"{name}: $\alpha$ = {camera.alpha(place):.4f}",
                   (place * 1e3, camera.alpha(place)), (9, -10), textcoords="offset points")
upper.axhspan(1 - tolerance, 1 + tolerance, color="0.9", zorder=0,
              label=r"in focus: $|1 - \alpha|$ < p/D")
upper.set(ylabel=r"$\alpha$ = F/F'")
upper.legend()
lower.plot(dz * 1e3, step * 1e3, color=BLUE)
lower.set(xlabel="dz / mm (positive: farther from the lens)", ylim=(0, None),
          ylabel="depth that moves\n" + r"$\alpha$ by p/D / mm")
for axes in (upper, lower):
    axes.grid(color="0.9", lw=0.6)
    axes.set_xlim(-100, 100)
example.save(figure)
