"""Figure 3.14: one ray in two parametrisations: (x, u) on the array, (x', u) on another plane."""

import numpy as np
from common import BLUE, ORANGE, RED, begin, number
from drawing import new_figure
from matplotlib.axes import Axes
from rays import distance, draw_camera, mark_plane, names, note, say_scale, stage
from slices import camera

from clplen import OpticalSystem
from clplen.cameras import Plenoptic1
from clplen.plot import trace

CASES = {-50e-3: (1.2e-3, -0.9e-3), 50e-3: (-1.2e-3, 1.0e-3)}  # dz: u, x'


def draw(axes: Axes, cam: Plenoptic1, dz: float, u: float, x_new: float) -> float:
    """The ray and its triangles in mm; x where it meets the array, by following it."""
    F, alpha, high = cam.image_distance * 1e3, cam.alpha(dz), 2.3
    F_new = F / alpha
    space = OpticalSystem([min(F, F_new) / 1e3, abs(F_new - F) / 1e3])
    _, heights = trace(space, u, (x_new - u) / F_new * 1e3)
    x = float(heights[1 if F_new > F else 2, 0])
    u, x, x_new = u * 1e3, x * 1e3, x_new * 1e3
    stage(axes, (-16, 350), (-high, high))
    draw_camera(axes, cam, pixels=False)
    mark_plane(axes, F_new, high, RED)
    axes.plot([0, max(F, F_new)], [u, u + (x_new - u) / F_new * max(F, F_new)], color=BLUE, lw=1.6,
              zorder=5)
    axes.plot([0, max(F, F_new)], [u, u], color="0.5", lw=0.8, ls=":")
    marks = ((0, u, "u", "k", 10), (F, x, "x", ORANGE, -12), (F_new, x_new, "x'", RED, 10))
    for z, height, text, colour, aside in marks:
        axes.plot(z, height, "o", color=colour, ms=6, zorder=7)
        note(axes, z + aside, height + 0.4 * np.sign(height), text, color=colour, size=11,
             ha="center")
        if z:
            axes.annotate("", (z, u), (z, height), zorder=6,
                          arrowprops={"arrowstyle": "<->", "color": colour, "lw": 1,
                                      "shrinkA": 0, "shrinkB": 0})
    names(axes, {0: "main lens", F: "array", F_new: "new plane"})
    distance(axes, 0, F, f"F = {F:.0f} mm", row=0.0 if F_new > F else 0.11)
    distance(axes, 0, F_new, f"F' = {F_new:.1f} mm", row=0.11 if F_new > F else 0.0)
    where = "farther from the lens than the array" if alpha < 1 else "nearer to the lens"
    axes.set_title(rf"$\alpha$ = F/F' = {alpha:.4f}: the new plane lies {where}", pad=18)
    return x


run = begin(__doc__, __file__)
cam = camera(run)
figure = new_figure(9, 6.6)
for axes, (dz, (u, x_new)) in zip(figure.subplots(2, 1), CASES.items(), strict=True):
    x, alpha = draw(axes, cam, dz, u, x_new), cam.alpha(dz)
    reference = 1e3 * (alpha * x_new + u * (1 - alpha))
    number(f"dz = {dz * 1e3:+.0f} mm: the ray meets the array at x / mm", x, reference, 1e-6)
    print(f"  x = alpha x' + u (1 - alpha), x' = {x_new * 1e3:g} mm, u = {u * 1e3:g} mm")
say_scale(figure, axes, r"similar triangles: (x - u)/F = (x' - u)/F', so x = $\alpha$ x' + "
          r"u (1 - $\alpha$)")
run.save(figure)
