"""Figure 1.11: raw image of an extended object in focus, a self-luminous test card."""

from common import begin, number, pixels
from drawing import bar, new_figure
from extended import QUICK, camera, card, compare, expose, show, show_object

from clplen import LightField

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
scene = card(cam)
raw = expose(cam, scene)
values = raw.to_numpy()
number("energy over that of the object", values.sum(dtype=float) / scene.image.sum(), 1, 5e-3)
compare(cam, scene, pixels(LightField.from_raw(raw).render()))

figure = new_figure(11, 7.2)
left, right = figure.subplots(1, 2, width_ratios=[2.6, 1])
drawn = show(left, values, cam.pixel_pitch)
left.set(title=f"raw image: {cam.mla.count[0]} x {cam.mla.count[1]} lenslets of "
         f"{cam.pixels_per_lenslet:.0f} x {cam.pixels_per_lenslet:.0f} pixels, axes turned")
bar(figure, drawn, left, "energy of a pixel")
show_object(right, scene)
run.save(figure)
