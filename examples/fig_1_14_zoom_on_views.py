"""Figure 1.14: zoom on the array of views, in its middle and where the aperture ends."""

from common import begin, number
from drawing import LIGHT, bar, new_figure
from extended import QUICK, camera, card, expose, like, mosaic

from clplen import LightField

ACROSS = 3

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
lf = LightField.from_raw(expose(cam, card(cam)))
count, height, width = lf.shape[1:]
start, edge = (count - ACROSS) // 2, round(0.07 * count)
left, right = (lf.view((count - 1) / 2, u).to_numpy() for u in (count // 4, count - 1 - count // 4))
number("in focus: views left and right, correlation", like(left, right), 1, 0.02)

figure = new_figure(11, 5.9)
panels = figure.subplots(1, 2)
for axes, first, name in zip(panels, (start, edge), ("the middle", "the corner"), strict=True):
    some = slice(first, first + ACROSS)
    drawn = axes.imshow(mosaic(lf, some, some), cmap=LIGHT, vmin=0, vmax=0.9 * left.max(),
                        interpolation="antialiased", interpolation_stage="data")
    for n in range(1, ACROSS):
        axes.axhline(n * height - 0.5, color="w", lw=0.6)
        axes.axvline(n * width - 0.5, color="w", lw=0.6)
    names = range(first + ACROSS - 1, first - 1, -1)
    axes.set_xticks([(n + 0.5) * width for n in range(ACROSS)], names)
    axes.set_yticks([(n + 0.5) * height for n in range(ACROSS)], names)
    axes.set(xlabel="column u of the view", ylabel="row v of the view",
             title=f"{name} of the {count} x {count} views")
bar(figure, drawn, panels, "value of a sample", extend="max")
run.save(figure)
