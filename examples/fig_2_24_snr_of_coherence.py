"""Figure 2.24: signal-to-noise ratio of the image of a target against the coherence index C."""

import numpy as np
from common import begin, number
from drawing import new_figure
from target import COHERENT, LAMP, averages, image, iota_of, masked, show, snr, three_bars, usaf

TABLE = {  # three bars: dB after 25, 100, 300 snapshots, by cells: mean of six float64 runs
    "field": {4: (8.2, 8.8, 8.9), 8: (8.1, 8.8, 9.1), 32: (9.5, 10.5, 10.8),
              128: (13.9, 18.4, 20.6)},
    "phase": {4: (8.9, 8.9, 8.9), 8: (9.1, 9.2, 9.3), 32: (10.7, 11.2, 11.3),
              128: (14.2, 18.8, 21.1)}}
EXACT = {4: 8.93, 8: 9.18, 32: 10.95, 128: 22.25}  # field masks: float64 sum over the source
COUNTS = {1: "0.75", 5: "C0", 25: "C1", 100: "C2", 300: "C3"}  # snapshots: colour
TICKS = (0.5, 1, 2, 5, 10, 20)

run = begin(__doc__, __file__)
counts = [n for n in COUNTS if n <= (100 if run.quick else 300)]
usaf_masks, bar_masks = (8, 56, 112), (4, 8, 32, 128)
if not run.quick:
    usaf_masks, bar_masks = (4, 8, 16, 28, 56, 112), (4, 8, 16, 32, 64, 128)
targets = {"USAF target, groups 2 to 4": (usaf(224, run.device), usaf_masks, {}),
           "bars of 8, 5, 3, 2, 1 samples": (three_bars(run.device), bar_masks, TABLE)}
figure = new_figure(11.4, 7)
panels = figure.subplots(2, 3, width_ratios=[0.8, 1, 1])
for row, (name, (thing, masks, table)) in zip(panels, targets.items(), strict=True):
    lamp = image(thing, LAMP)
    show(row[0], lamp, thing.grid, lamp.max())
    row[0].set_title(f"{name}: incoherent image")
    limit = snr(thing, image(thing, COHERENT))
    number(f"{name}: coherent / dB", limit, 8.68 if table else 11.48, 0.1, ".2f")
    C = 1 / np.array([iota_of(thing, cells) for cells in masks])
    for axes, kind in zip(row[1:], TABLE, strict=True):
        lights = [masked(thing, cells, kind) for cells in masks]
        exact = [snr(thing, image(thing, light)) for light in lights]
        axes.semilogx(C, exact, "k", lw=4, alpha=0.3, label="exact")
        found = np.array([[snr(thing, mean.to_numpy()) for mean in
                           averages(thing, light, counts).values()] for light in lights])
        for values, n in zip(found.T, counts, strict=True):
            axes.semilogx(C, values, "o-", ms=3, color=COUNTS[n], label=f"M = {n}")
        for cells, expected in table.get(kind, {}).items():
            at = masks.index(cells)
            if kind == "field":
                number(f"exact, iota {1 / C[at]:.2f} / dB", exact[at], EXACT[cells], 0.1, ".2f")
            for n, value in zip((25, 100, 300), expected, strict=True):
                label = "independent, float64" if (cells, n) == (4, 25) else None
                axes.plot(C[at], value, "s", ms=7, mfc="none", color=COUNTS[n], label=label)
                if n in counts:
                    number(f"{kind} masks, iota {1 / C[at]:.2f}, {n} snapshots / dB",
                           found[at, counts.index(n)], value, 1.5 if n == 25 else 1, ".1f")
        axes.axhline(limit, color="k", ls=":", lw=1)
        axes.set(title=f"{kind} masks", xlabel=r"C = 1/$\iota$ = cell / Airy radius", ylim=(0, 26),
                 xlim=(0.4, 24), xticks=TICKS, xticklabels=TICKS, ylabel="SNR / dB")
        axes.grid(color="0.93", lw=0.6)
        axes.legend(ncols=2, title="M snapshots; dotted: coherent light")
run.save(figure)
