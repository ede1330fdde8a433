"""Figure 3.12: a point in focus, 0.125 m and 0.25 m beyond: raw image, rendering, phase space."""

import numpy as np
from common import BLUE, mm, number, pixels, start
from drawing import LIGHT, new_figure

from clplen import LightField, demo, estimate_alpha

DEPTHS = (0, 0.125, 0.25)
BLURS = (0, 8.219, 12.245)  # lenslets, D |1 - alpha|/p
SHOWN = 19  # lenslets

example = start(__doc__, __file__)
camera = example.camera
p = camera.lenslet_pitch * 1e3
middle = (camera.mla.count[0] - 1) // 2
part = slice(middle - SHOWN // 2, middle + SHOWN // 2 + 1)
figure = new_figure(8.4, 8.4)
panels = figure.subplots(len(DEPTHS), 3)
for row, dz, blur in zip(panels, DEPTHS, BLURS, strict=True):
    raw = demo.expose_point(camera, (0, 0, dz))
    lf = LightField.from_raw(raw)
    found = estimate_alpha(lf, at=(middle, middle), method="slope")
    if dz:
        number(f"{mm(dz)}: blur by the slope / lenslets", found.blur, blur, 0.05 * blur, ".3f")
        number(f"{mm(dz)}: dx/du", 1 - found.alpha, 1 - camera.alpha(dz), 0.02)
    number(f"{mm(dz)}: in focus", found.in_focus, dz == 0, 0, ".0f")

    edge = SHOWN * p / 2
    n = round(camera.pixels_per_lenslet)
    inside = slice(part.start * n, part.stop * n)
    samples = lf.to_numpy().astype(float)
    light = np.maximum(samples.sum(axis=(0, 2)), 0)[:, part]  # (u, x), summed over v and y
    ends = np.abs(lf.spacing[1]) * lf.shape[1] / 2 * 1e3
    pictures = (
        (raw.to_numpy()[inside, inside], (-edge, edge, edge, -edge), "raw image"),
        (pixels(lf.render())[part, part], (-edge, edge, edge, -edge), "rendering"),
        (light, (-edge, edge, -ends, ends), "phase space"),
    )
    for axes, (values, extent, name) in zip(row, pictures, strict=True):
        shown = np.sqrt(np.maximum(values, 0) / values.max())
        axes.imshow(shown, cmap=LIGHT, extent=extent, aspect="auto")
        axes.set(title=f"{name}, {mm(dz)}", xlabel="x / mm", ylabel="y / mm")
    u = np.array([-ends, ends])
    row[2].plot((1 - camera.alpha(dz)) * u, u, color=BLUE, ls="--", lw=1.2)
    row[2].set(xlim=(-edge, edge), ylabel="u on the main lens / mm")
figure.supxlabel(r"square root of the light; dashed: x = u (1 - $\alpha$)")
example.save(figure)
