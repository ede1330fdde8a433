"""Figure 2.25: images of a USAF target for different iota, the sources in a resolution cell."""

import numpy as np
import target as t
from common import begin, number
from drawing import bar, new_figure

TABLE = {  # contrast of elements 3-4, 4-1, 4-3 (11.3, 16.0, 20.2 /mm): independent, float64
    "coherent": (0.973, 0.296, -0.042), "16": (0.957, 0.41, 0.025), "56": (0.885, 0.526, 0.163),
    "224": (0.696, 0.439, 0.224), "incoherent": (0.656, 0.396, 0.208)}
COLOURS = {"coherent": "k", "16": "C0", "56": "C1", "224": "C3", "incoherent": "0.6"}

run = begin(__doc__, __file__)
count = 40 if run.quick else 300
thing, bars = t.usaf(448, run.device), t.elements()
named = {(bar.group, bar.element): bar for bar in bars}
frequency = np.array([bar.frequency for bar in bars])
figure = new_figure(11.4, 8)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.8, 1])
panels, curves = upper.subplots(2, 5, sharex="row", sharey="row"), lower.subplots()
for (whole, close), (name, expected) in zip(panels.T, TABLE.items(), strict=True):
    if name.isdigit():
        light = t.masked(thing, int(name), "phase")
        mean = t.averages(thing, light, (count,))[count].to_numpy() / t.passed(thing, light)
        title = f"{name} x {name} cells: iota = {t.iota_of(thing, int(name)):.2g}"
    else:
        light = t.COHERENT if name == "coherent" else t.LAMP
        mean, title = t.image(thing, light) / t.passed(thing, light), name
    drawn, near = t.show(whole, mean, thing.grid), t.show(close, mean, thing.grid, 0.7)
    whole.set(title=title, xlabel="")
    close.set(**t.CLOSE_UP)
    for key, value in zip(((3, 4), (4, 1), (4, 3)), expected, strict=True):
        found = t.contrast(mean, thing.grid, named[key])
        number(f"{title}: contrast of element {key[0]}-{key[1]}", found, value,
               (0.15 if run.quick else 0.05) if name.isdigit() else 0.008, ".3f")
    seen = [t.contrast(mean, thing.grid, bar) for bar in bars]
    curves.plot(frequency / 1e3, seen, "o-" if name.isdigit() else "--", ms=3,
                color=COLOURS[name], label=title)
for row, image_of in zip(panels, (drawn, near), strict=True):
    bar(upper, image_of, row, "intensity / clear field", extend="max")
for at, word in ((t.FC, "$f_c$"), (2 * t.FC, "$2 f_c$")):
    curves.axvline(at / 1e3, color="0.5", ls=":")
    curves.text(at / 1e3, 0.9, f" {word}")
curves.axhline(0, color="0.8", lw=0.6, zorder=0)
curves.set(xlabel="line pairs / mm", ylabel="contrast of the vertical bars", ylim=(-0.2, 1.05),
           title="below 0 the gaps are brighter than the bars")
curves.legend(loc="lower left")
run.save(figure)
