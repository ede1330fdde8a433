"""Figure 6.2: one phase for all lenslets of a focused camera, designed to see all depths alike."""

import lenslet_design as model
import numpy as np
from common import begin, number
from drawing import bar, new_figure

CUBIC = 0.262  # the worst contrast of the best cubic phase, float64 autocorrelation of the pupil

run = begin(__doc__, __file__, quick="one start of three, no whole camera")
lenslet, ends = model.Lenslet(run.device), model.virtual_depths(2)
plain = np.zeros(len(model.TERMS))
starts = [0.3 * model.RADIAN * np.random.default_rng(seed).normal(size=len(plain))
          for seed in range(1 if run.quick else 3)]
designs = [lenslet.design(start) for start in starts]
c, many = designs[0].c, model.virtual_depths(29)
limit = float(model.hopkins(np.array([1 / model.M]))[0])
before, after = (lenslet.contrasts(one, many) for one in (plain, c))
number("plain lenslet in focus: contrast", before.max(), limit, 0.01, ".3f")
number("plain lenslet at the ends: contrast", lenslet.contrasts(plain, ends).mean(),
       float(np.abs(model.hopkins(ends)).mean()), 0.02, ".3f")
for design in designs:
    worst = lenslet.contrasts(design.c, many).min()
    number("designed lenslet: worst contrast", worst, CUBIC, 0.005, ".3f")
    coma, trefoil = np.abs(design.c[3:5]), np.abs(design.c[5:7])
    number("  trefoil over coma", trefoil.sum() / coma.sum(), 1, 0.05, ".3f")
measured = {}
for (word, _), one in zip(model.KINDS.items(), (plain, c), strict=True):
    cam, depths = model.camera(run.device, one), model.virtual_depths(3)
    measured[word] = {v: model.camera_contrast(cam, v) for v in (() if run.quick else depths)}
if not run.quick:
    least = [min(found.values()) for found in measured.values()]
    number("whole camera, designed: worst contrast", least[1], model.sampled(CUBIC), 0.03, ".3f")
    number("whole camera, plain: worst contrast", least[0], 0, 0.03, ".3f")

figure, shown = new_figure(13, 7), model.virtual_depths(5)
left, right = figure.subfigures(1, 2, width_ratios=[1.25, 1])
panels = left.subplots(5, 5)
images = [lenslet.images(one, shown) for one in (plain, c)]
(taken, _), (coded, restored) = map(model.pictures, images)
words = ["plain", "designed", "designed,\none filter"]
model.draw_stars(panels[:3], [taken, coded, restored], words, shown)
for row, image, word in zip(panels[3:], images, words[:2], strict=True):
    model.draw_points(row, image, f"point,\n{word}")
upper, lower = right.subfigures(2, 1, height_ratios=[1, 1.3])
phase, ways = upper.subplots(1, 2)
bar(upper, model.draw_phase(phase, c), [phase], "rad")
model.draw_starts(ways, designs)
model.draw_depth(lower.subplots(), lenslet, c, limit, measured)
figure.supxlabel("lenslets of 200 um, f/4, 532 nm; stars 88 um wide on the sensor, 1000 photons a "
                 "square micrometre; v = 4.6 is the focus of the plain lenslet")
run.save(figure)
