"""Figure 1.23: raw images of a point for m = 1, 0.5, 0.25 and 0.1."""

from common import begin, number
from drawing import bar, new_figure
from matplotlib.patches import Circle
from spots import QUICK, show, spots

SHOWN = 17  # lenslets
# m: lenslets of the row above half of the brightest one's energy, m by the pitch of the spots
REFERENCES = {1.0: (1, None), 0.5: (1, 0.416), 0.25: (5, 0.241), 0.1: (13, 0.0998)}

run = begin(__doc__, __file__, quick=QUICK)
figure = new_figure(9.4, 8.6)
panels = figure.subplots(2, 2, sharex=True, sharey=True)
for axes, (m, (row, pitch)) in zip(panels.flat, REFERENCES.items(), strict=True):
    found = spots(run, m)
    camera = found.camera
    number(f"m = {m:g}: lenslets of the row above half", found.row, row, 0, ".0f")
    if pitch:
        number(f"m = {m:g}: m from the pitch of the spots", found.m, pitch, 0.03 * pitch)
    drawn = show(axes, found, SHOWN)
    a, b = camera.a * 1e3, camera.b * 1e3
    blur = camera.aperture_diameter * 1e3 * a / (camera.image_distance * 1e3)
    axes.add_patch(Circle((0, 0), blur / 2, fill=False, ec="c", ls="--", lw=1))
    axes.set_title(f"m = {m:g}: a = {a:.0f} mm, b = {b:g} mm, "
                   f"D = {camera.aperture_diameter * 1e3:.2f} mm,\n"
                   f"blur of {blur / camera.mla.pitch * 1e-3:.2f} lenslets")
    axes.label_outer()
bar(figure, drawn, list(panels.flat), "energy of a pixel / largest (square root)")
figure.supxlabel("white: cells of the lenslets; dashed: blur of the point on the array, D a/F")
run.save(figure)
