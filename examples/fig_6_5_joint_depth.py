"""Figure 6.5: a sharp picture and its disparity, refined together by gradients of the views."""

import joint_depth as joint
import numpy as np
from common import BLUE, ORANGE, begin, number, pixels

from clplen import all_in_focus, depth_map
from clplen.analysis import score
from clplen.plot import bar, new_figure

NOISE, WEIGHTS = 0.05, (100.0, 50.0)  # standard deviation; of the total variations
NAMES = ("truth", "before", "refined")

run = begin(__doc__, __file__, quick="a smaller picture, 5 x 5 views")
views, size = (5, 96) if run.quick else (7, 128)
scene = joint.wall_and_ball(size)
clean, truth = scene.light_field((views, views), (size, size), device=run.device)
lf, _ = scene.light_field((views, views), (size, size), device=run.device, noise=NOISE, seed=1)
exact = clean.to_numpy()[views // 2, views // 2], np.asarray(truth.disparity, float)
depth = depth_map(lf, disparities=np.linspace(-1.4, 0.8, 23))
path = [(pixels(all_in_focus(lf, depth=depth)), np.asarray(depth.disparity, float))]
found = joint.JointFit(lf, NOISE, WEIGHTS).fit(*path[0], path.append, 30)
path.append(found)

quality = [joint.psnr(picture, exact[0]) for picture, _ in path]
error = [joint.rms(disparity, exact[1]) for _, disparity in path]
known = joint.psnr(pixels(all_in_focus(lf, depth=exact[1])), exact[0])
number("rms error of the disparity, refined / px", error[-1], 0, 0.04)
number("error refined over error before", error[-1] / error[0], 0.6, 0.15, ".2f")
number("PSNR gained / dB", quality[-1] - quality[0], 2.5, 1, ".2f")
for name, one, k in (("before", path[0][1], 0), ("refined", found[1], -1)):
    judged = score(one, exact[1], border=joint.BORDER)
    print(f"  {name}: PSNR {quality[k]:.2f} dB; disparity: rms error {error[k]:.4f} px, "
          f"BadPix 0.07 {judged.badpix_07:.1f} %, 0.03 {judged.badpix_03:.1f} %")
print(f"  PSNR of all_in_focus with the true disparity {known:.2f} dB")

figure = new_figure(14, 5.2)
panels = figure.subplots(2, 6, width_ratios=[1, 1, 1, 1, 1, 1.25])
for row, what, values, limit, colours in zip(
    panels, ("picture", "disparity"), zip(exact, path[0], found, strict=True), (0.15, 0.3),
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
for panel, values, colour, label in zip(panels[:, 5], (quality, error), (BLUE, ORANGE),
                                        ("PSNR / dB", "rms error / px"), strict=True):
    panel.plot(values, color=colour)
    panel.set(xlabel="iterations", title=label)
panels[0, 5].axhline(known, color="0.5", ls="--")
for panel in panels[:, :5].flat:
    panel.set(xticks=[], yticks=[])
figure.supxlabel("before: depth_map and all_in_focus; dashed: all_in_focus, true disparity")
run.save(figure)
