"""Figure 5.4: beads and a helix found by Richardson and Lucy's iteration; the native plane."""

import microscope as lfm
import numpy as np
from common import BLUE, ORANGE, begin, number
from drawing import bar, new_figure

from clplen import Projector, deconvolve, point_images

RESIDUALS = {10: 0.067, 20: 0.025, 30: 0.0135}  # independent simulation, full size
BEADS = ((20e-6, 22, 18), (20e-6, 22, 26), (-20e-6, 15, 22))  # z and voxel (y, x), full size
HELIX = (11e-6, 1.5)  # radius and turns
COUNT, PHOTONS = 9, 2e6

run = begin(__doc__, __file__, quick="3 planes, 3 x 3 voxels a lenslet, 10 iterations")
cam = lfm.camera(run, count=COUNT)
v, z = (3, np.array([-20, 0, 20]) * 1e-6) if run.quick else (5, np.arange(-40, 41, 10) * 1e-6)
images = point_images(cam, z, voxels_per_lenslet=v, cut=5e-3)
projector = Projector(images, (COUNT, COUNT), device=run.device)
truth = np.zeros((2, *projector.volume_shape), np.float32)
middle = (truth.shape[-1] - 1) // 2
for depth, *place in BEADS:
    at = [middle + round((k - 22) * v / 5) for k in place]
    truth[0, np.abs(z - depth).argmin(), at[0], at[1]] = 1
truth[1] = lfm.helix(cam, projector.volume_shape, *HELIX)
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
shares = lfm.placed(found.volume[1], truth[1])
words = ", ".join(f"{share:.2f}" for share in shares)
print(f"  helix: share of a plane's light within a voxel of the true ones: {words}")

figure = new_figure(13, 6)
panels = figure.subplots(2, 5, width_ratios=[1, 1, 1, 1, 1.1])
for row, frame, volume, true, name in zip(panels, frames, found.volume, truth, ("beads", "helix"),
                                          strict=True):
    drawn = lfm.draw_volume(row, frame, volume, cam, z, true)
    row[0].set_title(f"{name}: raw frame")
bar(figure, drawn, list(panels[:, 3]), "square root of the voxel / largest")
curves, planes = panels[:, 4]
for values, colour, name in zip(found.residuals, (BLUE, ORANGE), ("beads", "helix"), strict=True):
    curves.semilogy(values, color=colour, label=name)
curves.set(xlabel="iterations", title="relative residual")
curves.legend(loc="upper right")
planes.plot(z * 1e6, shares, "o-", color=ORANGE)
planes.set(xlabel="z / um", title="helix: light in its voxels", ylim=(0, 1.05))
figure.supxlabel("largest voxels along z, y and x; circles and lines: true places; at z = 0 "
                 "nothing is resolved within a lenslet, 6.25 um")
run.save(figure)
