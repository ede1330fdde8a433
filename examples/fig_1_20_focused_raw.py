"""Figure 1.20: raw image of a point before a plenoptic camera 2.0 with m = 0.3."""

from common import begin, number
from drawing import bar, new_figure
from matplotlib.patches import Rectangle
from spots import QUICK, show, spots

run = begin(__doc__, __file__, quick=QUICK)
found = spots(run, 0.3)
camera, raw = found.camera, found.raw.to_numpy()
number("m from the pitch of the spots", found.m, 0.2888, 0.015)
number("energy on the sensor", raw.sum(dtype=float), 1, 2e-3)
number("lenslets in a row that see the point, D a/(F p)", camera.views, 3.935, 1e-3, ".3f")

figure = new_figure(10.4, 5)
left, right = figure.subplots(1, 2)
show(left, found, 61, grid=False)
left.set_title("the whole sensor, 61 x 61 lenslets")
drawn = show(right, found, 15, grid=False)
right.set_title(f"15 x 15 lenslets; m = {found.m:.4f} by the pitch of the spots")
edge = 7.5 * camera.mla.pitch * 1e3
left.add_patch(Rectangle((-edge, -edge), 2 * edge, 2 * edge, fill=False, ec="c", lw=1))
bar(figure, drawn, [left, right], "energy of a pixel / largest (square root)")
run.save(figure)
