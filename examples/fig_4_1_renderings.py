"""Figure 4.1: three stars by a focused and a standard camera: raw images and renderings."""

import numpy as np
from common import begin, number, pixels
from drawing import new_figure
from stars import DEPTHS, QUICK, cameras, exposed, likeness, places, show

from clplen import LightField, refocus, render_focused
from clplen.lightfield import focused_depth

run = begin(__doc__, __file__, quick=QUICK)
focused, standard = cameras(run)
raw, other = exposed(focused), exposed(standard)
depth, lf = focused_depth(raw), LightField.from_raw(other)
centre = (np.array(raw.shape) - 1) / 2
lattice = (depth.geometry.centres - centre) / depth.geometry.pitch
figure = new_figure(9.4, 7)
left, right = figure.subplots(4, 2, sharex=True, sharey=True).T
show(left[0], focused, raw.to_numpy(), "2.0: raw image")
show(right[0], standard, other.to_numpy(), "1.0: raw image")
ways = {"a patch of every lenslet": {"method": "basic", "m": 0.2},
        "blended": {"method": "blended", "m": 0.2},
        "blended, by depth": {"method": "depth", "depth": depth}}
for axes, (words, how) in zip(left[1:], ways.items(), strict=True):
    picture = render_focused(raw, **how)
    show(axes, focused, pixels(picture), f"2.0: {words}")
    found = {name: likeness(focused, picture, name) for name in DEPTHS}
    print(f"  {words}: " + ", ".join(f"{name} {like:.3f}" for name, like in found.items()))
for name, like in found.items():
    inside = np.hypot(lattice[..., 0], lattice[..., 1] - places(focused)[name]) < 10
    m = focused.b / (focused.array_distance - focused.image_distance / focused.alpha(DEPTHS[name]))
    number(f"{name}: m of the depth map", np.median(depth.m[inside & (depth.confidence > 0.3)]), m,
           0.004)
    number(f"{name}: correlation with the star, by depth", like, 1, 0.1, ".3f")
views = {"as focused": 1.0} | {f"refocused, {name} star": standard.alpha(DEPTHS[name])
                               for name in ("near", "far")}
for axes, (words, alpha) in zip(right[1:], views.items(), strict=True):
    show(axes, standard, pixels(refocus(lf, alpha=alpha)), f"1.0: {words}")
for axes in (left[-1], right[-1]):
    axes.set_xlabel("x / mm")
for axes in left:
    axes.set_ylabel("y / mm")
figure.supxlabel("stars at dz = -6, 0 and +15 mm from left to right, by rays")
run.save(figure)
