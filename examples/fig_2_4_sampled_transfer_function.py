"""Figure 2.4: the transfer function H sampled below, at and above its limit."""

import warnings

import numpy as np
from closed import LAM, SETUP_A, S
from common import BLUE, GREEN, RED, begin, number
from drawing import new_figure
from matplotlib.patches import Rectangle
from stages import phase, transfer

from clplen import Grid, Propagator, SamplingWarning

GRID = Grid((128, 128), 2 * LAM)  # periodic, so that these are the frequencies of H
DF = 1 / GRID.extent[1]
Z_LIM = GRID.extent[1] / 2 * np.sqrt(15)  # W/2 / tan(asin(lam f_nyq)), lam f_nyq = 1/4
F, FINE = DF * np.arange(65), DF * np.linspace(0, 64, 4001)

run = begin(__doc__, __file__)
warnings.simplefilter("ignore", SamplingWarning)  # aliasing is what is shown
options = {"wavelength": LAM, "device": run.device}
reach = Propagator(SETUP_A, S, method="as", **options).report.fully_sampled_to
number("set-up A, window 2 S: z_lim / S", reach / S, 3.873, 1e-3)
figure = new_figure(9.4, 9)
panels = figure.subplot_mosaic("abc;def;ggg", height_ratios=[1.5, 0.7, 1])
for top, middle, times, colour in zip("abc", "def", (0.5, 1, 4), (GREEN, BLUE, RED), strict=True):
    z, axes = times * Z_LIM, panels[top]
    H = transfer(Propagator(GRID, z, method="as", pad=1, **options))
    limit = Propagator(GRID, z, method="blas", pad=1, **options).report.band[1]
    cut = np.append(H[64, 64:], H[64, 0])  # 0 to Nyquist, which is the last and the first
    steps = np.angle(cut[1:] / cut[:-1]) / np.pi
    found = np.interp(1, -np.unwrap(steps, period=2), F[1:] - DF / 2, right=F[-1])
    closed = min(1 / (LAM * np.hypot(2 * DF * z, 1)), F[-1])
    number(f"z = {times} z_lim: steps of pi from f / (1/mm)", found / 1e3, closed / 1e3, 0.5, ".2f")
    number("  limit of band-limited AS / (1/mm)", limit / 1e3, closed / 1e3, 1e-2, ".2f")
    ends = np.array([-64.5, 63.5]) * DF / 1e3
    drawn = axes.imshow(np.angle(H), cmap="twilight", vmin=-np.pi, vmax=np.pi, origin="lower",
                        extent=(*ends, *ends), interpolation="nearest")
    axes.add_patch(Rectangle((-limit / 1e3,) * 2, *(limit / 500,) * 2, fill=False, ec=colour, lw=2,
                             clip_on=False))
    axes.set(xlabel="$f_x$ / (1/mm)", title=f"z = {times} $z_{{lim}}$ = {z * 1e3:.2f} mm")
    panels[middle].plot(FINE / 1e3, np.cos(phase(FINE, z)), color="0.75", lw=0.8)
    panels[middle].plot(F / 1e3, cut.real, "o", color=colour, ms=2.8)
    panels[middle].set(xlabel="$f_x$ / (1/mm)", xlim=(0, 460))
    true = np.abs(phase(F[1:], z) - phase(F[:-1], z)) / np.pi
    panels["g"].plot((F[1:] - DF / 2) / 1e3, true, color=colour, lw=1)
    panels["g"].plot((F[1:] - DF / 2) / 1e3, np.abs(steps), "o", color=colour, ms=4,
                     label=f"z = {times} $z_{{lim}}$")
panels["a"].set(ylabel="$f_y$ / (1/mm)")
panels["d"].set(ylabel="Re H at $f_y$ = 0")
figure.colorbar(drawn, ax=[panels[p] for p in "abc"], label="phase of the samples of H / rad",
                shrink=0.8, pad=0.01)
panels["g"].axhline(1, color="0.6", ls=":")
panels["g"].set(xlabel="$f_x$ / (1/mm)", ylabel="step from sample to sample / π", ylim=(0, 2.5),
                xlim=(0, 460), title="lines: H; dots: its samples. Frames above: steps up to π, "
                r"$f_x \leq 1/(\lambda\sqrt{(2 z/W)^2 + 1})$, the band of figure 2.6")
panels["g"].legend(loc="upper right")
run.save(figure)
