"""Figure 2.20: a phase mask is made: points, their convolution with K, propagation by d_c."""

import numpy as np
from closed import LAM
from coherent import degree_of, phase_bar, show, show_phase, show_points, snapshot, sources
from common import BLUE, RED, begin, number
from drawing import LIGHT, new_figure

from clplen import Grid
from clplen.wave import RandomPhaseMask

P, CELLS, SHOWN = 32e-6, 32, 8  # m; a side of the window, and of the part that is drawn
GRID, PART = Grid((512, 512), 2e-6), Grid((128, 128), 2e-6)
MIDDLE, LAGS = np.s_[192:320, 192:320], np.arange(-30, 31, 2)  # samples
KERNELS = {"square": BLUE, "gaussian": RED}

run = begin(__doc__, __file__, quick="fewer masks")
d_c, masks = RandomPhaseMask(P).distance_on(GRID, LAM), 12 if run.quick else 40
number("d_c = 4 p^2/lam / mm", d_c * 1e3, 7.4473, 1e-4)
figure = new_figure(9.6, 9)
panels, um = figure.subplots(3, 3), np.linspace(-64, 64, 513)
show_points(panels[0, 0], sources(CELLS, run.device)[12:20, 12:20], SHOWN * P, 60)
dots = np.zeros(PART.shape)
dots[7::16, 7::16] = dots[7::16, 8::16] = dots[8::16, 7::16] = dots[8::16, 8::16] = 4
lights = [dots]
for axes, z in zip(panels[1:, 0], (0, d_c), strict=True):
    u = snapshot(RandomPhaseMask(P, distance=z, jitter=False), GRID, run.device)[MIDDLE]
    phases = show_phase(axes, u, PART)
    lights.append(np.abs(u) ** 2)
phase_bar(figure, phases, panels[:, 0], location="bottom", shrink=0.7, aspect=15, pad=0.02)
for axes, light in zip(panels[:, 1], lights, strict=True):
    drawn = show(axes, light, PART, cmap=LIGHT, vmin=0, vmax=4)
figure.colorbar(drawn, ax=panels[:, 1], location="bottom", label="intensity / mean", extend="max",
                shrink=0.7, aspect=15, pad=0.02)
for kernel, colour in KERNELS.items():
    profile = np.abs(um) <= 16 if kernel == "square" else 2.0 ** -((um / 16) ** 2)
    panels[0, 2].plot(um, profile, color=colour, label=kernel)
    for axes, z in zip(panels[1:, 2], (0, d_c), strict=True):
        mask = RandomPhaseMask(P, kernel=kernel, distance=z)
        mu, error = degree_of(mask, GRID, run.device, masks, LAGS)
        number(f"{kernel}, {z * 1e3:.2f} mm: rms of mu - stated", error, 0, 0.01)
        axes.plot(um, mask.degree(0, um * 1e-6), color=colour, lw=1)
        axes.plot(LAGS * 2, mu, "o", color=colour, ms=3)
        axes.set(title="degree of coherence $\\mu$", xlabel="displacement / µm", xlim=(-64, 64))
panels[0, 2].set(title="kernel K: amplitude of a cell", xlabel="x / µm", xlim=(-64, 64))
panels[0, 2].legend(loc="upper right")
panels[1, 2].text(-61, 0.88, f"dots: measured\nfrom {masks} masks")
for row, words in zip(panels, ("points of random phase", "convolved with the square K",
                               f"propagated by $d_c$ = {d_c * 1e3:.2f} mm"), strict=True):
    row[0].set_title(f"{words}: phase")
    row[1].set_title("intensity")
    for axes in row[:2]:
        axes.set(xlabel="x / mm", ylabel="y / mm", xticks=(-0.1, 0, 0.1), yticks=(-0.1, 0, 0.1))
run.save(figure)
