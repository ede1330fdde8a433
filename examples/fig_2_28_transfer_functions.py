"""Figure 2.28: coherent and incoherent transfer functions of the 2f system, fc and 2 fc."""

import numpy as np
from common import BLUE, RED, begin, number
from drawing import LIGHT, new_figure
from responses import FC, PLANE, filtered, point_image, transfer_of_grating
from target import COHERENT, LAMP

from clplen import Grid
from clplen.wave import otf

RATIOS = (0.5, 0.91, 1.09, 1.5, 1.91, 2.09)  # of the gratings' frequencies to fc
FINE = (0.96, 0.98, 1.0, 1.02, 1.04)  # where the transfer function ends
GRID = Grid((140, 1120), (0.4 / FC, 0.05 / FC))  # 56 periods of fc

run = begin(__doc__, __file__)
figure = new_figure(11.4, 7.2)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.35, 1])
curves, panels = upper.subplots(), lower.subplots(2, len(RATIOS), sharex=True, sharey=True)
f, fx = np.linspace(0, 2.2 * FC, 401), PLANE.fx[:512]
curves.plot(np.array([0, FC, FC, 2.2 * FC]) / 1e3, (1, 1, 0, 0), color=BLUE,
            label=r"coherent: 1 up to $f_c$ = D/(2 $\lambda z_2$)")
curves.plot(f / 1e3, otf(f / FC / 2), color=RED, label="incoherent: overlap of two pupils")
point = point_image(run.device)
lamp = np.abs(np.fft.fft(point.sum(axis=0)))[:512] / point.sum()
curves.plot(fx / 1e3, lamp, "+", color=RED, label="incoherent: image of a point, whole system")
styles = {"ls": "", "mfc": "none", "ms": 9}
for column, ratio in zip(panels.T, RATIOS, strict=True):
    cycles, exact, last = round(56 * ratio), float(otf(ratio / 2)), ratio == RATIOS[-1]
    wave = (1 + np.cos(2 * np.pi * cycles * np.arange(1120) / 1120)) / 2 * np.ones(GRID.shape)
    # an amplitude (1 + cos)/2 in coherent light, such an intensity in incoherent light
    for axes, t, light in zip(column, (wave, np.sqrt(wave)), (COHERENT, LAMP), strict=True):
        image = filtered(t, GRID, light, run.device)
        contrast = np.ptp(image) / (image.max() + image.min())
        axes.imshow(image[:1] / image.mean(), cmap=LIGHT, vmin=0, vmax=2, aspect="auto",
                    extent=(0, 56e3 / FC, 0, 1))
        axes.set(title=f"{ratio:g} $f_c$: contrast {contrast:.3f}", xlim=(0, 0.4), yticks=[])
    found = 2 * np.abs(np.fft.fft(image.mean(axis=0)))[cycles] / image.mean() / 1120
    number(f"pupil, incoherent, f/fc = {ratio}", found, exact, 0.006, ".3f")
    curves.plot(ratio * FC / 1e3, found, "s", color=RED, **styles,
                label="incoherent: gratings, pupil as a filter" if last else None)
    found = np.interp(ratio * FC, fx, lamp)
    number(f"whole system, incoherent, f/fc = {ratio}", found, exact, 0.004, ".3f")
    found = transfer_of_grating(ratio * FC, run.device)
    number(f"whole system, coherent, f/fc = {ratio}", found, float(ratio < 1), 0.02, ".3f")
    curves.plot(ratio * FC / 1e3, found, "o", color=BLUE, **styles,
                label="coherent: gratings, whole system" if last else None)
near = [transfer_of_grating(ratio * FC, run.device) for ratio in FINE]
cut_off = np.interp(-np.sqrt(0.5), -np.array(near), FINE) * FC  # half the power passes
number("whole system: fc / mm^-1", cut_off / 1e3, FC / 1e3, 0.05, ".3f")
curves.set(xlabel="f / mm$^{-1}$", ylabel="transfer", xlim=(0, 30), ylim=(-0.03, 1.08))
for at, word in ((FC, "$f_c$"), (2 * FC, "$2 f_c$")):
    curves.text(at / 1e3 - 0.2, 0.8, ha="right", s=f"{word} = {at / 1e3:.2f} mm$^{{-1}}$")
    curves.axvline(at / 1e3, color="0.7", ls=":", zorder=0)
curves.legend(loc="lower left", bbox_to_anchor=(0, 0.05))
lower.supxlabel("x / mm")
for axes, word in zip(panels[:, 0], ("coherent", "incoherent"), strict=True):
    axes.set_ylabel(word)
run.save(figure)
