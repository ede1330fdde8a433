"""Figure 3.23: focus measure E(alpha) of points at four depths, with its peak."""

import numpy as np
from common import mm, number, start

from clplen import demo, plot

THESIS_METHOD = (0.82, 0.92, 1.08, 1.12)  # on an independent simulation of the raw images
KAPPA = 0.887  # how far the peak of the plain energy lies out, over the truth

example = start(__doc__, __file__)
camera = example.camera
found = [demo.estimates(camera, dz) for dz in demo.DEPTHS]
true = np.array([camera.alpha(dz) for dz in demo.DEPTHS])
for dz, methods, reference in zip(demo.DEPTHS, found, THESIS_METHOD, strict=True):
    number(f"method 'thesis', peak at {mm(dz)}", methods["thesis"].alpha, reference, 0.02, ".3f")
energy = np.array([methods["energy"].alpha for methods in found])
kappa = ((energy - 1) @ (true - 1)) / ((true - 1) @ (true - 1))
number("method 'energy', (peak - 1)/(alpha - 1), pooled", kappa, KAPPA, 0.023, ".3f")

groups = {
    f"method '{method}'": [
        (mm(dz), methods[method], truth)
        for dz, methods, truth in zip(demo.DEPTHS, found, true, strict=True)
    ]
    for method in demo.METHODS
}
example.save(plot.energy_curves(groups))
