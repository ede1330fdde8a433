"""Figure 2.1: the paraxial field of Fresnel against that of Rayleigh and Sommerfeld."""

import numpy as np
from closed import LAM, SETUP_A, S, exact_slit, fresnel_slit, slit
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import LIGHT, bar, new_figure

from clplen import Field, Grid, propagate

GRID, WIDTHS = Grid((1, 1000), LAM / 2), {20e-6: GREEN, 40e-6: BLUE, 80e-6: RED}
WIDTH, NEAR = 40e-6, 30e-6  # of the pictures


def fresnel(field: Field, z: float) -> Field:
    """By the transfer function or the impulse response, whichever is sampled."""
    near = z < 2 * field.grid.extent[1] * field.grid.pitch[1] / LAM
    return propagate(field, z, method="fresnel-tf" if near else "fresnel-ir")


def apart(paraxial: np.ndarray, exact: np.ndarray, inside: np.ndarray) -> float:
    """Relative distance of two fields in a part of the window."""
    return np.linalg.norm((paraxial - exact).T[inside]) / np.linalg.norm(exact.T[inside])


run = begin(__doc__, __file__)
wide, far = slit(Grid((1, 2048), 1e-6), 500e-6, run.device), slit(SETUP_A, S / 2, run.device)
for what, field, u in (("Fresnel, slit 0.5 mm, 0.1 m", fresnel(wide, 0.1), 1.13282 + 0.25616j),
                       ("exact, set-up A, 64 S", propagate(far, 64 * S), 0.83167 - 0.14483j)):
    for part in ("real", "imag"):
        middle = getattr(field.to_numpy()[0, field.shape[1] // 2], part)
        number(f"{what}: U(0), {part}", middle, getattr(u, part), 5e-4)
figure = new_figure(10, 7.6)
(left, right), (cut, error) = figure.subplots(2, 2)
z, x = np.geomspace(8e-6, 2e-3, 24 if run.quick else 240), GRID.x[280:721]
exact = np.transpose([exact_slit(x, d, width=WIDTH) for d in z])
beyond = exact - np.transpose([fresnel_slit(x, d, width=WIDTH) for d in z])
for axes, values, what in ((left, exact, "abs(exact)"), (right, beyond, "abs(Fresnel - exact)")):
    drawn = axes.pcolormesh(z * 1e6, x * 1e6, np.abs(values), cmap=LIGHT, norm="log", vmin=1e-3,
                            vmax=1.5, shading="gouraud")
    bar(figure, drawn, axes, "amplitude (logarithmic)", extend="min")
    axes.set(xscale="log", xlabel="z / µm", ylabel="x / µm", title=f"{what}: slit of 40 µm, 550 nm")
x = np.linspace(0, 28e-6, 1001)
for of, look, name in ((exact_slit, BLUE, "exact"), (fresnel_slit, ORANGE, "Fresnel")):
    cut.plot(x * 1e6, np.abs(of(x, NEAR, width=WIDTH)) ** 2, color=look, lw=1.2, label=name)
cut.set(xlabel="x / µm", ylabel="intensity", title="slit of 40 µm, z = 30 µm")
z, fine = np.geomspace(1e-5, 1e-2, 13), np.geomspace(8e-6, 1e-2, 20 if run.quick else 100)
for w, colour in WIDTHS.items():
    light, inside = slit(GRID, w, run.device), np.abs(GRID.x) < w
    found = [apart(fresnel(light, d).to_numpy(), propagate(light, d).to_numpy(), inside) for d in z]
    x = np.arange(-w, w, LAM / 4)[1:]  # near the slit Fresnel's fringes are finer than lam
    closed = [apart(fresnel_slit(x, d, width=w), exact_slit(x, d, width=w), ...) for d in fine]
    error.loglog(fine * 1e6, closed, color=colour, lw=1)
    error.loglog(z * 1e6, found, "o", color=colour, ms=4, label=f"w = {w * 1e6:g} µm")
    error.axvline((np.pi * w**4 / (4 * LAM)) ** (1 / 3) * 1e6, color=colour, lw=1, ls=":")
error.set(xlabel="z / µm", ylabel="relative error of Fresnel's field, -w < x < w",
          title=r"lines: closed forms; dots: clplen; dotted: $z^3 = \pi w^4/(4\lambda)$")
cut.legend()
error.legend()
run.save(figure)
