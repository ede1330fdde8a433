"""Figure 4.6: one wave of aberration in the main lens: what correction brings back."""

from aberrated import LAM, NAMES, draw_strehl, show_light
from common import begin, number, pixels
from drawing import bar, new_figure
from resolving import about, blended, exposed, focused
from slices import camera

from clplen import LightField, PointSources
from clplen.cameras import Aberrations, correct_aberrations

P = 150e-6  # pitch of the lenslets
WORDS = ("1.0, as taken", "1.0, corrected", "2.0, blended")
HIGHEST = {  # Noll's index: energy of the brightest lenslet as taken and corrected, largest value
    # of the 2.0 picture over that of the design; float64 simulations
    0: (0.891, 0.891, 1.0), 4: (0.037, 0.356, 0.142), 6: (0.064, 0.417, 0.124),
    8: (0.125, 0.163, 0.169), 11: (0.062, 0.066, 0.068)}


run = begin(__doc__, __file__, quick="one term, one rms")
one, two = camera(run, count=51, pixels=24), focused(run)
figure = new_figure(12, 5)
left, right = figure.subfigures(1, 2, width_ratios=[2.3, 1])
terms = {j: HIGHEST[j] for j in ((0, 6) if run.quick else HIGHEST)}
panels, design = left.subplots(3, len(terms), sharex=True, sharey=True), 1.0
for column, (j, references) in zip(panels.T, terms.items(), strict=True):
    name = NAMES.get(j, "design")
    wave = {j: LAM} if j else {}
    built = Aberrations(main_lens=wave)
    lf = LightField.from_raw(one.with_aberrations(built).expose(PointSources((0, 0, 0))))
    picture = blended(about(exposed(two.with_aberrations(built)), 2e-3), two.m, 12e-6)
    fine = pixels(picture)
    design = design if j else fine.max()
    images = [pixels(lf.render(total=True)),
              pixels(correct_aberrations(lf, wave).render(total=True)), fine / design]
    for axes, image, pitch, words, reference in zip(column, images, (P, P, picture.pitch), WORDS,
                                                    references, strict=True):
        number(f"{name}, {words}: highest", image.max(), reference, 0.01, ".3f")
        drawn = show_light(axes, image, pitch)
        axes.text(-1.1, 1.1, f"{image.max():.3f}", color="w", size=8)
    column[0].set_title(name)
    column[-1].set_xlabel("x / mm")
for axes, words in zip(panels[:, 0], WORDS, strict=True):
    axes.set_ylabel(f"{words}\ny / mm")
bar(left, drawn, list(panels.ravel()), "share of the light, or over the design's (square root)")
draw_strehl(right.subplots(), one, quick=run.quick)
left.supxlabel("one wave rms (Noll) in the main lens, D = 3.6 mm (1.0) and 10 mm (2.0); "
               "numbers: the highest value")
run.save(figure)
