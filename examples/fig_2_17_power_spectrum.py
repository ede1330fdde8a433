"""Figure 2.17: power spectrum of the image of a point by each method: the ideal is a disc."""

import numpy as np
from closed import LAM
from common import begin, number
from drawing import LIGHT, bar, new_figure
from two_f import GRID, METHODS, D, N, Z, airy_image, image

RADIUS = D / (2 * LAM * Z)  # cycles a metre
OUTSIDE = {  # share of the energy in %, colour: an independent float64 implementation
    "Airy": (0.1059, "0.8"), "multi-step, pad 1": (88.9125, "C0--"),
    "multi-step, pad 2": (0.1066, "C0"), "AS, pad 1": (88.8888, "C1--"),
    "AS, pad 2": (0.1081, "C1"), "BLAS, pad 1": (0.1868, "C2--"), "BLAS, pad 2": (0.1022, "C2"),
    "corrected BLAS": (0.1022, "C3"), "Fresnel IR, pad 2": (0.1061, "C4"), "auto": (0.1022, "k:")}

run = begin(__doc__, __file__)
number("radius of the disc, D/(2 lam z2) / m^-1", RADIUS, 13636.3636, 1e-3)
chirp = np.exp(-1j * np.pi * (GRID.y[:, None] ** 2 + GRID.x**2) / (LAM * Z))  # makes the image flat
step = GRID.fx[1]
f = np.hypot(GRID.fy[:, None], GRID.fx)
ring = np.rint(f / step).astype(int).ravel()
edges = np.array([-N / 2 - 0.5, N / 2 - 0.5] * 2) * step / 1e3
angle = np.linspace(0, 2 * np.pi, 361)

figure = new_figure(10.6, 8.2)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.35, 1])
images, means = upper.subplots(2, 5, sharex=True, sharey=True), lower.subplots()
shares = {}
for axes, (name, (reference, style)) in zip(images.flat, OUTSIDE.items(), strict=True):
    u = image(name, run.device) if name in METHODS else airy_image()
    power = np.abs(np.fft.fft2(u * chirp)) ** 2
    shares[name] = 100 * power[f > RADIUS].sum() / power.sum()
    number(f"{name}: energy outside the disc / %", shares[name], reference, 2e-3)
    if name == "Airy":
        disc = power[f < 0.9 * RADIUS].mean()
    drawn = axes.imshow((np.fft.fftshift(power) / disc).clip(1e-7), cmap=LIGHT, norm="log",
                        vmin=1e-6, vmax=1, extent=edges, origin="lower")
    axes.plot(RADIUS / 1e3 * np.cos(angle), RADIUS / 1e3 * np.sin(angle), "w:", lw=0.8)
    axes.set(xticks=(-50, 0, 50), yticks=(-50, 0, 50), title=f"{name}: {shares[name]:.3g} %",
             xlabel="$f_x$ / mm$^{-1}$", ylabel="$f_y$ / mm$^{-1}$")
    axes.label_outer()
    means.semilogy(np.arange(N // 2) * step / 1e3, (np.bincount(ring, power.ravel())
                   / np.bincount(ring))[: N // 2] / disc, style, lw=5 if name == "Airy" else 1,
                   label=name)
best = min(share for name, share in shares.items() if name in METHODS)
number("energy outside: auto over the lowest", shares["auto"] / best, 1.0, 1.0)
bar(upper, drawn, images, "power / that of the disc", extend="both")
means.axvline(RADIUS / 1e3, color="0.5", ls=":")
means.set(xlim=(0, 75.7), ylim=(1e-10, 30), xlabel="f / mm$^{-1}$", ylabel="mean power of a ring")
means.legend(ncols=2)
run.save(figure)
