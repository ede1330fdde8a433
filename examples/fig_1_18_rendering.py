"""Figure 1.18: image rendered from the raw image of figure 1.11, one pixel a lenslet."""

from common import begin, number, pixels
from drawing import bar, new_figure
from extended import QUICK, camera, card, expose, ideal, like, show, show_object

from clplen import LightField

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
scene = card(cam)
raw = expose(cam, scene)
rendering, expected = pixels(LightField.from_raw(raw).render()), ideal(cam, scene)
rendering, expected = rendering / rendering.max(), expected / expected.max()
number("correlation with the ideal image", like(expected, rendering), 1, 0.02)
print(f"  with the ideal image upside down {like(expected[::-1], rendering):.2f}, "
      f"mirrored {like(expected[:, ::-1], rendering):.2f}")

figure = new_figure(11.4, 3.9)
first, *others = figure.subplots(1, 3)
show_object(first, scene)
rows, columns = rendering.shape
words = (f"rendering: {rows} x {columns} pixels", "ideal image: Airy's blur, lenslets' means")
for axes, values, title in zip(others, (rendering, expected), words, strict=True):
    drawn = show(axes, values, cam.lenslet_pitch)
    axes.set_title(title)
bar(figure, drawn, others, "value over the largest")
run.save(figure)
