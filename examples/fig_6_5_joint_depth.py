"""Figure 6.5: a sharp picture and its disparity, refined together on the pixels of a raw image."""

import joint_depth as joint
import numpy as np
from common import begin, number, pixels
from drawing import bar, new_figure

from clplen import all_in_focus, depth_map

WEIGHTS = 60.0, 80.0  # of the total variations of picture and disparity
NAMES = ("truth", "before", "refined")

run = begin(__doc__, __file__, quick="a smaller picture")
size = 80 if run.quick else 128
scene = joint.wall_and_ball(size)
clean, truth = scene.light_field((1, 1), (size, size), device=run.device)
exact = clean.to_numpy()[0, 0], np.asarray(truth.disparity, float)
raw, white = joint.taken(scene, size, run.device)
lf, level = joint.decoded(raw, white)
depth = depth_map(lf, disparities=np.linspace(-1.4, 0.8, 23))
start = pixels(all_in_focus(lf, depth=depth)), np.asarray(depth.disparity, float)
paths = {"raw pixels": [start], "decoded light field": [start]}
joint.JointFit.to_raw(raw, white, start, WEIGHTS).fit(start, paths["raw pixels"].append, 30)
views = joint.JointFit.to_views(lf, level, start, WEIGHTS)
views.fit(start, paths["decoded light field"].append, 30)

quality = {name: [joint.psnr(one, exact[0]) for one, _ in path] for name, path in paths.items()}
error = {name: [joint.rms(one, exact[1]) for _, one in path] for name, path in paths.items()}
known = joint.psnr(pixels(all_in_focus(lf, depth=exact[1])), exact[0])
before, found = paths["raw pixels"][0], paths["raw pixels"][-1]
psnr, rms = ([values[name][-1] for name in paths] for values in (quality, error))
number("error refined over error before", rms[0] / joint.rms(before[1], exact[1]), 0.6, 0.15, ".2f")
number("PSNR gained / dB", psnr[0] - joint.psnr(before[0], exact[0]), 5.5, 1.5, ".2f")
number("PSNR over that on the decoded light field / dB", psnr[0] - psnr[1], 0.5, 0.5, ".2f")
for name, one in zip(("before", *paths), (before, *(path[-1] for path in paths.values())),
                     strict=True):
    joint.print_quality(name, one, exact)
print(f"  PSNR of all_in_focus with the true disparity {known:.2f} dB")

figure = new_figure(14, 5.2)
panels = figure.subplots(2, 6, width_ratios=[1, 1, 1, 1, 1, 1.25])
for row, what, values, limit, colours in zip(
    panels, ("picture", "disparity"), zip(exact, before, found, strict=True), (0.15, 0.3),
    ("gray", "viridis"), strict=True,
):
    for panel, name, one in zip(row, NAMES, values, strict=False):
        drawn = panel.imshow(one, cmap=colours, vmin=values[0].min(), vmax=values[0].max())
        panel.set_title(f"{what}: {name}")
    bar(figure, drawn, list(row[:3]), "brightness" if what == "picture" else "pixels a view step")
    for panel, name, one in zip(row[3:], NAMES[1:], values[1:], strict=False):
        drawn = panel.imshow(one - values[0], cmap="RdBu_r", vmin=-limit, vmax=limit)
        panel.set_title(f"error {name}")
    bar(figure, drawn, list(row[3:5]), "error", extend="both")
joint.draw_paths(panels[:, 5], (quality, error), known)
for panel in panels[:, :5].flat:
    panel.set(xticks=[], yticks=[])
figure.supxlabel("before: depth_map and all_in_focus; dashed: all_in_focus, true disparity")
run.save(figure)
