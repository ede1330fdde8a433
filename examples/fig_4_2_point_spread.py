"""Figure 4.2: the image of a point by a standard and by a focused camera of the same parts."""

import numpy as np
from common import begin, number
from drawing import ROOT, bar, new_figure, show
from resolving import (
    COLOURS,
    QUICK,
    TRANSFERS,
    about,
    draw_cells,
    exposed,
    half_width,
    line_of,
    pair,
    rendered,
    responses,
)

NEAR = 0.45e-3  # metres to either side of the point
PEAK = 60.9  # FWHM in um of the image of a point by the 2.0 camera, in a float64 simulation


run = begin(__doc__, __file__, quick=QUICK)
cams, psfs = pair(run), responses(run)
figure = new_figure(11, 6.8)
panels = figure.subplots(2, 3)
f, x = np.linspace(0, 1e5, 4001), np.linspace(-NEAR, NEAR, 601)
for row, (name, cam) in zip(panels, cams.items(), strict=True):
    raw, psf, closed = exposed(cam), psfs[name], line_of(TRANSFERS[name](cam, f), f, x)
    at, line = psf.line_spread(axis=1)
    found = half_width(at, line)
    number(f"{name}: width of the image of a line / um", found * 1e6,
           half_width(x, closed) * 1e6, 3, ".1f")
    values = about(raw, NEAR + 50e-6).to_numpy().astype(float)
    pictures = (values, cam.pixel_pitch, "raw image"), (*rendered(raw, psf), "rendered")
    for axes, (image, pitch, words) in zip(row, pictures, strict=False):
        drawn = show(axes, image / image.max(), pitch, near=NEAR * 1e3, norm=ROOT)
        axes.set(xlabel="x / mm", ylabel="y / mm", title=f"{name}: {words}")
    draw_cells(row[0], cam)
    row[2].plot(at * 1e3, line / line.max(), color=COLOURS[name], label="measured")
    row[2].plot(x * 1e3, closed, "k--", lw=1, label="closed form")
    row[2].set(xlim=(-0.3, 0.3), ylim=(-0.05, 1.35), xlabel="x / mm", ylabel="intensity / largest",
               title=f"{name}: image of a line, {found * 1e6:.0f} um wide")
    row[2].legend(loc="upper right", ncols=2)
number("2.0: width of the image of a point / um", psfs["2.0"].fwhm(axis=1) * 1e6, PEAK, 1, ".1f")
bar(figure, drawn, list(panels[:, 1]), "intensity / largest (square root)")
figure.supxlabel("places on the main lens' image (raw images: on the sensor, grid: cells); the "
                 "image of a line by the 1.0 camera is that of a line that moves across a lenslet")
run.save(figure)
