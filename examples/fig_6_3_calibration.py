"""Figure 6.3: a camera calibrated from one raw image of three points, by Gauss-Newton on waves."""

import calibrating as cal
import numpy as np
from common import begin, number
from drawing import bar, new_figure

TRUE = np.array([2.0, 4.0, 17.0, -12.0, 1.5, 1.2, -1.8])  # in units of the array, off its design
OFF = np.array([(1.5, -1, 1, -0.1), (-2, 1, -1, 0.1), (1, 2, 1, -0.05)])  # the points' first guess
PHOTONS = 1e6  # of a point, on the sensor
FORMS = (("pitch / um", 150, 0.15, 0.01), ("rotation / mrad", 0, 1, 0.05),
         ("offset y / um", 0, 1.5, 0.06), ("offset x / um", 0, 1.5, 0.06),
         ("f_mu / mm", 10, 0.1, 0.016), ("tilt y / mrad", 0, 10, 7), ("tilt x / mrad", 0, 10, 7))

run = begin(__doc__, __file__, quick="a smaller aperture; the points' places are known")
camera = cal.design(run.device, *((19, 13, 2.4e-3) if run.quick else (27, 13, 3.6e-3)))
truth = np.r_[TRUE, np.c_[cal.PLACES / cal.PLACE, np.ones(3)].ravel()]
share = (cal.Calibration(camera, 1.0).mean(truth) - cal.BACKGROUND).sum() / 3
model = cal.Calibration(camera, PHOTONS / share)
counts = np.random.default_rng(1).poisson(model.mean(truth)).astype(float)
free = np.r_[:7, 10:19:4] if run.quick else np.arange(19)
start = truth.copy()
start[free] = (truth - np.r_[TRUE, -OFF.ravel()])[free]

path = model.fit(counts, start, free)
found = path[-1]
least = model.bounds(found, free)
white = cal.lattice_errors(camera, TRUE, 1e5)
lit = np.sort(counts.reshape(camera.mla.count[0], 13, -1, 13).sum(axis=(1, 3)).ravel())[::-1]
print(f"  photons of the 60 brightest lenslets: {lit[59]:.0f} to {lit[0]:.0f}")
print(f"  {len(path) - 1} iterations of Gauss-Newton, {len(free)} unknowns")
for (name, design, unit, within), value, true in zip(FORMS, found, TRUE, strict=False):
    number(name, design + unit * value, design + unit * true, within)
cal.print_errors((found - truth)[free], least, white)

figure = new_figure(15, 3.7)
panels = figure.subplots(1, 5, width_ratios=[1, 1, 1, 1.1, 1.2])
drawn = panels[0].imshow(np.sqrt(cal.middle(counts)), cmap="magma")
panels[0].set_title("raw image, its middle")
bar(figure, drawn, panels[0], "square root of photons")
for panel, name, one in zip(panels[1:3], ("first guess", "calibrated"), (start, found),
                            strict=True):
    mean = model.mean(one)
    rest = (counts - mean) / np.sqrt(mean)
    drawn = panel.imshow(cal.middle(rest), cmap="RdBu_r", vmin=-5, vmax=5)
    panel.set_title(f"{name}: residual {np.sqrt((rest**2).mean()):.2f} rms")
for panel in panels[:3]:
    panel.set(xticks=[], yticks=[])
bar(figure, drawn, list(panels[1:3]), "(photons - model) / noise", extend="both")
cal.draw_errors(panels[3:], abs(path[:, :7] - TRUE), least[:7], abs(white))
figure.supxlabel("errors in units of 0.1 % of the pitch, 1 mrad, 1 % of the pitch, 1 % of f_mu, "
                 "10 mrad")
run.save(figure)
