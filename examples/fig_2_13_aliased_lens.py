"""Figure 2.13: a lens sampled too coarsely: folded phase, lost peak, ghost foci."""

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import LIGHT, bar, new_figure

from clplen import Field, Grid, propagate, thin_lens

D, LAM, PITCH = 3.6e-3, 550e-9, 6.6e-6
F_MIN = D * PITCH / LAM  # where the rim is at R_max = lam f/(2 dx)
PEAKS = {0.95: 1.0, 1.0: 0.992, 1.2: 0.833, 1.5: 0.667}  # R/R_max: amplitude over D/sqrt(lam f)
MAX = r"$R_\mathrm{max}$"


def focus(ratio: float) -> np.ndarray:
    """Amplitude in the focal plane over the ideal peak, for R = ratio R_max."""
    f = F_MIN / ratio
    lens = thin_lens(plane, f, diameter=D, aliasing="allow")
    return np.abs(propagate(lens, f).to_numpy()[0]) / (D / np.sqrt(LAM * f))


run = begin(__doc__, __file__)
grid = Grid((1, 1212), PITCH)  # a cylindrical lens
plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=run.device)
x, f = grid.x * 1e3, F_MIN / 1.5
number("f_min = D dx/lam / mm", F_MIN * 1e3, 43.2, 1e-9)
for ratio, reference in PEAKS.items():
    number(f"R = {ratio} R_max: peak / ideal", focus(ratio).max(), reference, 5e-3, ".3f")
ghost = x[np.where(x > 1, focus(1.5), 0).argmax()]
number("R = 1.5 R_max: ghost focus at / mm", ghost, 2.4, 7e-3)  # to a sample

figure = new_figure(10, 7)
(phase, along), (cut, peak) = figure.subplots(2, 2)
lens, lit = thin_lens(plane, f, diameter=D, aliasing="allow"), np.abs(x) < D * 500
folded = np.unwrap(np.angle(lens.to_numpy()[0, lit]))
phase.plot(x[lit], -np.pi * grid.x[lit] ** 2 / (LAM * f), color=BLUE, label="lens")
phase.plot(x[lit], folded - folded.max(), ".", color=RED, ms=3, label="its samples, unwrapped")
phase.vlines((-1.2, 1.2), -640, 0, color="0.6", ls=":", label=rf"{MAX} = $\lambda f/(2\,dx)$")
phase.set(xlabel="x / mm", ylabel="phase / rad", title=f"$f$ = 28.8 mm: $R$ = 1.5 {MAX}")
z = np.linspace(0, 1.6, 41 if run.quick else 161) * f
rows = [np.abs(propagate(lens, place).to_numpy()[0]) ** 2 for place in z]
drawn = along.pcolormesh(z * 1e3, x, np.transpose(rows), cmap=LIGHT, norm="log", vmin=1e-2,
                         vmax=1e2, shading="gouraud")
bar(figure, drawn, along, "intensity (logarithmic)", extend="both")
along.axvline(f * 1e3, color="w", lw=0.6, ls=":")
along.set(xlabel="z / mm", ylabel="x / mm", title=f"beyond {MAX} the light goes to ghost foci")
for ratio, colour in {0.8: GREEN, 1.5: RED}.items():
    cut.semilogy(x, focus(ratio) ** 2, color=colour, lw=0.8, label=f"$R$ = {ratio} {MAX}")
cut.set(xlabel="x / mm", ylabel="intensity in the focal plane / ideal peak", ylim=(1e-7, 30),
        title=r"ghost foci at $\pm\lambda f/dx$ = $\pm$2.4 mm")
ratios = np.linspace(0.5, 2, 61)
peak.plot(ratios, np.minimum(1, 1 / ratios), color=ORANGE, label=f"min(1, {MAX}/$R$)")
peak.plot(ratios, [focus(ratio).max() for ratio in ratios], ".", color=BLUE, label="measured")
peak.set(xlabel=f"$R$/{MAX}", ylabel="peak amplitude / ideal", ylim=(0, 1.1),
         title=r"$D$ = 3.6 mm, $dx$ = 6.6 µm, 550 nm: $f_\mathrm{min}$ = 43.2 mm")
for axes, place in ((phase, "lower center"), (cut, "upper right"), (peak, "lower left")):
    axes.legend(loc=place)
run.save(figure)
