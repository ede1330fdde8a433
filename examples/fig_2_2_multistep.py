"""Figure 2.2: Fresnel propagation in many steps of one size, with and without a border."""

import numpy as np
from closed import LAM, err_db, fresnel_slit, slit
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import LIGHT, bar, new_figure
from matplotlib.colors import LogNorm

from clplen import Field, Grid, propagate

N, PITCH, STEPS = 1024, 6.6e-6, "fresnel-multistep"
GRID, WINDOW = Grid((1, N), PITCH), Grid((1, 2 * N), PITCH)
WIDTH, UNIT = N * PITCH / 4, N * PITCH**2 / LAM  # the slit; one step without padding
SHOWN = (1, 4, 8, 16, 64)  # z/UNIT
TABLE = {  # (pad, border): dB at SHOWN, an independent float64 implementation; colour
    (1, 0): ((35, 28, 23, 19, 13), "0.6"),
    (1, 0.2): ((35, 31, 30, 28, 23), "k"),
    (2, 0): ((36, 44, 33, 27, 20), ORANGE),
    (2, 0.2): ((36, 47, 36, 37, 52), GREEN),
    (2, 0.4): ((36, 51, 45, 54, 85), BLUE),
    (4, 0.4): ((36, 55, 63, 54, 88), RED),
}


def history(field: Field, border: float) -> np.ndarray:
    """Intensity in the whole window, step by step, shape (33, 2 N)."""
    rows = []
    for _ in range(33):
        rows.append(field.intensity().to_numpy()[0])
        field = propagate(field, 2 * UNIT, method=STEPS, pad=1, border=border)
    return np.array(rows)


run, figure = begin(__doc__, __file__), new_figure(10.5, 7.6)
panels = figure.subplot_mosaic("abc;ddd", height_ratios=[1.4, 1])
light, start = (slit(grid, WIDTH, run.device) for grid in (GRID, WINDOW))
z = 2 * UNIT * np.append(1e-9, np.arange(1, 33))
maps = {"single-FFT steps, window 2 S, border 0": history(start, 0),
        "border 0.4; dotted: S": history(start, 0.4),
        "closed form": np.abs([fresnel_slit(WINDOW.x, d, width=WIDTH) for d in z]) ** 2}
for axes, (name, rows) in zip((panels[p] for p in "abc"), maps.items(), strict=True):
    drawn = axes.pcolormesh(WINDOW.x * 1e3, z, rows + 1e-9, cmap=LIGHT, norm=LogNorm(1e-5, 2))
    axes.vlines((-N * PITCH * 500, N * PITCH * 500), 0, z[-1], color="w", ls=":", lw=0.8)
    axes.set(xlabel="x / mm", ylabel="z / m", title=name)
bar(figure, drawn, [panels[p] for p in "abc"], "intensity (logarithmic)", extend="min")
steps = list(SHOWN) if run.quick else [*range(1, 17), *range(18, 65, 2)]
for (pad, border), (table, colour) in TABLE.items():
    way, name = {"method": STEPS, "pad": pad, "border": border}, f"window {pad} S, border {border}"
    found = [err_db(fresnel_slit(GRID.x, n * UNIT, width=WIDTH),
                    propagate(light, n * UNIT, **way).to_numpy()[0]) for n in steps]
    panels["d"].plot(steps, found, color=colour, lw=1.2, label=name)
    panels["d"].plot(SHOWN, table, "o", color=colour, ms=4)
    for n, decibels in zip(SHOWN, table, strict=True):
        number(f"{name}, z = {n} dz: error / dB", found[steps.index(n)], decibels, 0.6, ".1f")
panels["d"].set(xscale="log", xticks=SHOWN, xticklabels=SHOWN, ylim=(0, 95),
                xlabel="z/dz, dz = N dx²/λ = 81.1 mm", ylabel="error / dB",
                title="slit S/4 = 1.69 mm, N = 1024, dx = 6.6 µm, 550 nm; dots: float64")
panels["d"].legend(ncols=2)
run.save(figure)
