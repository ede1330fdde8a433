"""Figure 5.4: beads found by Richardson and Lucy's iteration, and one in the native plane."""

import microscope as lfm
import numpy as np
from common import BLUE, ORANGE, begin, number

from clplen.microscopy.deconvolution import deconvolve
from clplen.microscopy.projector import Projector
from clplen.microscopy.psf import point_images
from clplen.plot.base import bar, new_figure

RESIDUALS = {10: 0.067, 20: 0.025, 30: 0.0135}  # independent simulation, full size
BEADS = ((20e-6, 22, 18), (20e-6, 22, 26), (-20e-6, 15, 22))  # z and voxel (y, x), full size
COUNT, PHOTONS = 9, 2e6

run = begin(__doc__, __file__, quick="3 planes, 3 x 3 voxels a lenslet, 10 iterations")
cam = lfm.camera(run, count=COUNT)
v, z = (3, np.array([-20, 0, 20]) * 1e-6) if run.quick else (5, np.arange(-40, 41, 10) * 1e-6)
images = point_images(cam, z, voxels_per_lenslet=v, cut=5e-3)
projector = Projector(images, (COUNT, COUNT), device=run.device)
truth = np.zeros((2, *projector.volume_shape), np.float32)  # beads; one in the native plane
middle = (truth.shape[-1] - 1) // 2
for depth, *place in BEADS:
    at = [middle + round((k - 22) * v / 5) for k in place]
    truth[0, np.abs(z - depth).argmin(), at[0], at[1]] = 1
truth[1, np.abs(z).argmin(), middle, middle] = 1
means = projector.forward(truth)
means *= PHOTONS / means.sum(axis=(1, 2), keepdims=True)
frames = np.random.default_rng(0).poisson(means)
found = deconvolve(frames, projector, iterations=10 if run.quick else 31)
print(f"  {found}")

lit, steps = truth[0].sum(axis=(1, 2)) > 0, np.diff(found.residuals, axis=1)
number("beads: light in their planes", found.volume[0, lit].sum() / found.volume[0].sum(), 1, 0.05)
number("iterations that raised a residual", np.count_nonzero(steps >= 0), 0, 0, ".0f")
for k, reference in RESIDUALS.items() if not run.quick else ():
    number(f"residual after {k} iterations", found.residuals[0, k], reference, 0.2 * reference)
share = found.volume[1][truth[1] > 0].sum() / found.volume[1].sum()
print(f"  one bead in the native plane: {100 * share:.0f} % of its light on its own voxel")

figure = new_figure(12, 5.8)
panels = figure.subplots(2, 5, width_ratios=[1, 1, 1, 1, 1.1])
for row, frame, volume, is_true, name in zip(panels, frames, found.volume, truth > 0,
                                             ("beads", "native plane"), strict=True):
    drawn = lfm.draw_volume(row, frame, volume, cam, z, is_true)
    row[0].set_title(f"{name}: raw frame")
curves, planes = panels[:, 4]
for k, (colour, name) in enumerate(((BLUE, "beads"), (ORANGE, "in the native plane"))):
    light = found.volume[k].sum(axis=(1, 2))
    curves.semilogy(found.residuals[k], color=colour, label=name)
    planes.plot(z * 1e6, light / light.sum(), "o-", color=colour, label=name)
curves.set(xlabel="iterations", title="relative residual")
curves.legend(loc="upper right")
planes.set(xlabel="z / um", title="share of the light in a plane", ylim=(0, 1.05))
bar(figure, drawn, list(panels[:, 3]), "root of the voxel / largest")
figure.supxlabel("largest voxels along z, y and x; circles: true places")
run.save(figure)
