"""Figure 3.25: error of the estimated alpha against the object's place."""

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, number, start
from drawing import new_figure

from clplen import demo

RMS = {"thesis": 0.0529, "energy": 0.0200, "compensated": 0.0038}  # at the thesis' four depths
STYLE = {"thesis": ("^", GREEN), "energy": ("o", ORANGE), "compensated": ("D", RED)}
KAPPA = 0.889  # 1/(1 + s^2/U^2) of the section 1.5 camera


def rms(errors: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


example = start(__doc__, __file__)
camera = example.camera
more = () if example.quick else np.linspace(-0.06, 0.06, 13)
depths = np.union1d(np.round(more, 3), demo.DEPTHS)
found = [demo.estimates(camera, dz) for dz in depths]
true = camera.alpha(depths)
own = np.array(demo.THESIS_ALPHAS) - camera.alpha(demo.DEPTHS)
number("the thesis' own points, rms error", rms(own), 0.0694, 1e-4)

figure = new_figure(7, 4.6)
axes = figure.add_subplot()
dz = np.linspace(-0.062, 0.062, 201)
near = [camera.dz(1 + sign * camera.describe()["focus tolerance"]) * 1e3 for sign in (-1, 1)]
axes.axvspan(*near, color="0.92", label=r"in focus: $|1 - \alpha|$ < p/D")
axes.axhline(0, color="0.3", lw=1)
axes.plot(dz * 1e3, (KAPPA - 1) * (camera.alpha(dz) - 1), "--", color=ORANGE, lw=1,
          label=r"bias of the energy, $(\kappa - 1)(\alpha - 1)$")
axes.plot(np.array(demo.DEPTHS) * 1e3, own, "s", color=BLUE, mfc="none", label="the thesis' own")
for method, (marker, colour) in STYLE.items():
    errors = np.array([methods[method].alpha for methods in found]) - true
    number(f"method '{method}', rms error at four depths",
           rms(errors[np.isin(depths, demo.DEPTHS)]), RMS[method], 0.0022)
    axes.plot(depths * 1e3, errors, marker=marker, color=colour, mfc="none", ls="-", lw=0.7,
              label=f"method '{method}'")
axes.set(xlabel="dz / mm (positive: farther from the lens)", ylabel=r"error of $\alpha$",
         title="points on the axis")
axes.legend()
example.save(figure)
