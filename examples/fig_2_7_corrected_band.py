"""Figure 2.7: the band that reaches the output window, its guard, and what they are worth."""

import numpy as np
from closed import LAM, SETUP_A, S, line_source
from common import BLUE, ORANGE, RED, begin, number
from drawing import new_figure
from stages import phase

from clplen import Propagator

Z = 64 * S
NARROW = {"method": "cblas", "guard": 0, "support": S / 2}
WAYS = {  # options of Propagator, width of the input / S, guard, colour
    "band-limited": ({"method": "blas"}, 1, 0, BLUE),
    "corrected, guard 0, slit S/2": (NARROW, 0.5, 0, ORANGE),
    "corrected, guard 6": ({"method": "cblas", "guard": 6}, 1, 6, RED),
}
LINES = {64: 473, 512: 209, 4096: 139}  # frequencies in the corrected band, for z/S


def lines(plan: Propagator) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies from the lowest and their weights; the plan of an FFT holds one half."""
    f, weights = plan.description.factor.frequencies[1], plan.description.factor.weights[1]
    n = (f.size - 1) * (f[0] == 0)  # to be mirrored
    return np.append(-f[n:0:-1], f), np.append(weights[n:0:-1], weights)


run = begin(__doc__, __file__)
fine, x = np.linspace(0, 80e3, 2001), np.linspace(0, 1.25 * S, 1501)
figure = new_figure(10, 7.6)
panels = figure.subplot_mosaic("ab;cc", height_ratios=[1, 1.15])
panels["b"].fill_between(fine / 1e3, np.abs(np.sinc(fine * S / 2)), color="0.8", lw=0)
for name, (options, width, guard, colour) in WAYS.items():
    plan = Propagator(SETUP_A, Z, wavelength=LAM, device=run.device, **options)
    reach, end = (width + 1) / 2 * S, plan.report.band[1]
    r = np.hypot(Z, reach)  # cos theta = Z/r
    closed = reach / (LAM * r) + guard * Z / np.sqrt(LAM * r**3)
    number(f"{name}: band ends at / (1/mm)", end / 1e3, closed / 1e3, 0.01, ".3f")
    f, weights = lines(plan)
    panels["a"].plot([0, Z * 1e3], (np.array([0, Z * np.tan(np.arcsin(LAM * end))])
                                    - width * S / 2) * 1e3, color=colour)
    panels["b"].step(np.append(f, end) / 1e3, np.append(weights, 0), where="mid", color=colour)
    h = np.exp(2j * np.pi * x[:, None] * f + 1j * phase(f, Z)) @ weights * (f[1] - f[0])
    panels["c"].semilogy(x / S, np.abs(h / line_source(x, Z) - 1), color=colour, lw=1, label=name)
for n, count in LINES.items():
    plan = Propagator(SETUP_A, n * S, wavelength=LAM, method="cblas", guard=6, device=run.device)
    number(f"z = {n} S: frequencies of the band", lines(plan)[0].size, count, 2, ".0f")
panels["a"].vlines(0, -S * 250, S * 250, color="0.7", lw=8)
panels["a"].vlines([0, Z * 1e3], -S * 500, S * 500, color="k", lw=2.5)
panels["a"].set(xlabel="z / mm", ylabel="x / mm", ylim=(-1, 1.9),
                title="steepest rays; black: input and output, S; grey: slit, S/2")
panels["b"].set(xlabel="$f_x$ / (1/mm)", ylabel="weight", xlim=(0, 80),
                title=r"$X/(\lambda\sqrt{X^2+z^2}) + g\sqrt{\cos^3\theta/\lambda z}$; grey: slit")
panels["c"].vlines((0.75, 1), 1e-11, 5, color=(ORANGE, "0.5"), ls=":")
panels["c"].set(xlim=(0, 1.25), ylabel="relative error of the wave from one point",
                xlabel="sideways displacement X / S; dotted: the largest from input to output",
                title="z = 64 S = 72.1 mm, S = 1.1264 mm, 550 nm; reference: Rayleigh-Sommerfeld")
panels["c"].legend(loc="center left")
run.save(figure)
