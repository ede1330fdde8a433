"""Figure 6.4: one frame of a light-field microscope, deconvolved with three kinds of knowledge."""

import microscope as lfm
import numpy as np
import priors
from common import begin, number
from drawing import bar, new_figure

from clplen import Projector, point_images

COUNT, PHOTONS, MANY = 9, 6e4, 48  # lenslets along an axis; of a frame; volumes to learn from
STRENGTH, STEPS = 0.01, 200  # of the total variation; of the training

run = begin(__doc__, __file__, quick="3 planes, 3 x 3 voxels a lenslet; a network hardly trained")
cam = lfm.camera(run, count=COUNT)
v, z = (3, np.array([-16, 0, 16]) * 1e-6) if run.quick else (5, np.arange(-32, 33, 8) * 1e-6)
images = point_images(cam, z, voxels_per_lenslet=v, cut=5e-3)
projector = Projector(images, (COUNT, COUNT), device=run.device)
x = (np.arange(COUNT * v) - (COUNT * v - 1) / 2) * images.side
volumes, rng = priors.Volumes(z, x, PHOTONS), np.random.default_rng(7)
true, frame = (one[0] for one in volumes.taken(volumes.drawn(rng)[None], projector, rng))
counts = [2, 5, 10] if run.quick else [5, 10, 20, 30, 40, 60, 80, 120, 160]
passed = priors.richardson_lucy(frame, projector, counts)
errors = [priors.error(volume, true) for volume in passed]
best = int(np.argmin(errors))
flat = priors.fista(frame, projector, STRENGTH, iterations=10 if run.quick else 60,
                    dark=0.2 * frame.mean(), start=passed[2])
found = {f"Richardson-Lucy, {counts[best]} iterations": passed[best],
         "FISTA, total variation": flat}
steps, many, others = (10, 6, 1) if run.quick else (STEPS, MANY, 6)
learned = priors.trained(volumes, projector, steps=steps, channels=32, many=many)
if learned:
    found["network, trained"] = learned(frame)
priors.print_others(volumes, projector, STRENGTH, learned, others)

print(f"  Richardson-Lucy's error after {counts[-1]} iterations {errors[-1]:.3f}")
kept = projector.forward(passed[best]).sum() / frame.sum()
number("counts of Richardson-Lucy's HV over the frame's", kept, 1, 1e-3)
for name, volume in {"truth": true, **found}.items():
    words = f"{name}: error {priors.error(volume, true):.3f}, misfit"
    number(words, priors.misfit(volume, frame, projector), 1, 0.15, ".2f")

figure = new_figure(14, 6)
panels = figure.subplots(2, 5)
priors.draw_frame(panels[0, 0], frame, volumes)
for column, (name, volume) in zip(panels.T[1:], {"truth": true, **found}.items(), strict=False):
    words = f"{name}\nerror {priors.error(volume, true):.2f}" if name != "truth" else name
    drawn = priors.draw(column, volume, true.max(), volumes, words)
priors.draw_missing(panels[:, 2 + len(found):])
priors.draw_errors(panels[1, 0], counts, errors, found, true)
bar(figure, drawn, list(panels[:, 4]), "square root of the voxel / largest true")
figure.supxlabel(f"largest voxels along z and y; the network has seen {many} other volumes of such "
                 "beads and filaments, the others none")
run.save(figure)
