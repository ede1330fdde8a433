"""Figure 6.1: a lens' wavefront from three pictures of a star, found by gradients."""

import numpy as np
import retrieval as model
from common import BLUE, GREEN, ORANGE, begin, number
from drawing import bar, new_figure
from matplotlib.colors import PowerNorm

RMS, SHOWN = 80e-9, 1e4
BOUNDS = {1e4: 2.406, 1e6: 0.224, 1e3: 8.936, 1e5: 0.721, 1e7: 0.071}  # photons: rms / nm
COLOURS = {"no noise": GREEN, 1e6: BLUE, SHOWN: ORANGE}

run = begin(__doc__, __file__, quick="two numbers of photons in place of five, one draw of two")
camera, true = model.Camera(run.device), model.true_wavefront(RMS)
light = model.simulated(true)
known = list(BOUNDS)[: 2 if run.quick else None]
covariances = camera.bounds(true, known)
first, errors = {"no noise": camera.retrieve(model.counts_of(light, 1e9), 1e9)}, {}
off = 1e9 * np.linalg.norm(first["no noise"].c - true)
number("no noise: rms error / nm", off, 0, 0.1, ".3f")
for photons, limit in zip(known, model.rms(covariances), strict=True):
    draws = [model.counts_of(light, photons, seed) for seed in range(1 if run.quick else 2)]
    fits = [camera.retrieve(counts, photons) for counts in draws]
    errors[photons] = [1e9 * np.linalg.norm(fit.c - true) for fit in fits]
    number(f"{photons:.0e} photons: bound of the rms / nm", limit, BOUNDS[photons], 0.003, ".3f")
    for error in errors[photons]:  # three standard deviations or so
        number("  rms error / nm", error, BOUNDS[photons], round(0.7 * BOUNDS[photons], 3), ".3f")
    first[photons] = fits[0]
    if photons == SHOWN:
        counts, found = draws[0], fits[0].c
mean = camera.expected(found, SHOWN)
number("chi^2 a pixel", np.mean((counts - mean) ** 2 / mean), 1, 0.1, ".3f")

figure = new_figure(13, 6)
upper, lower = figure.subfigures(2, 1, height_ratios=[1, 1.3])
left, right = upper.subfigures(1, 2)
pictures, paths = (part.subplots(1, 3, sharey=True) for part in (left, right))
for axes, picture, dz in zip(pictures, counts, model.DEFOCUS, strict=True):
    word = f"{dz * 1e3:+.1f} mm" if dz else "in focus"
    drawn = model.draw_picture(axes, picture, PowerNorm(0.5, 0, counts.max()), word)
pictures[0].set_ylabel("y / um")
bar(left, drawn, list(pictures), "counts")
for axes, c, word in zip(paths, (true, found, 10 * (found - true)),
                         ("true wavefront", "found", "difference x 10"), strict=True):
    drawn = model.draw_wavefront(axes, c, word, 3 * RMS)
bar(right, drawn, list(paths), "path / nm")
terms, ways, curve = lower.subplots(1, 3)
model.draw_terms(terms, true, found, covariances[known.index(SHOWN)])
for photons, colour in COLOURS.items():
    model.draw_way(ways, first[photons], true, colour, photons)
model.draw_errors(curve, camera, true, errors)
figure.supxlabel("f = 30 mm, f/25, 532 nm, pixels of 6.5 um; above: ten thousand photons in all; "
                 "pictures by an independent float64 simulation")
run.save(figure)
