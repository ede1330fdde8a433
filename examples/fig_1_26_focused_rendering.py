"""Figure 1.26: rendering with the focused plenoptic camera, by patches and by integration."""

import numpy as np
import rays
from common import BLUE, ORANGE, begin, number, pixels
from drawing import new_figure
from letters import disparity, star
from matplotlib.patches import Rectangle

from clplen import MicrolensArray, PlenopticCamera, SurfaceScene, render_focused
from clplen.cameras import Plane, uniform
from clplen.lightfield import seam

ZOOM = (0.45, 1.25)  # mm on the main image, from and to, in x and y
FINE = 18  # samples a lenslet: patches drawn finer than pixels show how they join
QUICK, FULL = (35, 5.2e-3, 11.6), (75, None, 21.0)  # lenslets, D, seam of patches of m p/dx: the
# star in float64, averaged over pixels, at the places where such patches show it

run = begin(__doc__, __file__, quick="35 x 35 lenslets, a smaller aperture")
count, D, seam_of_wrong = QUICK if run.quick else FULL
array = MicrolensArray(150e-6, 3e-3, count=count, fill="full")
cam = PlenopticCamera.type2(focal_length=0.12, mla=array, wavelength=532e-9, m=0.2, match="cone",
                            pixels_per_lenslet=30, device=run.device,
                            aperture_diameter=D)
d = disparity(cam, 0.0)
raw, white = (cam.expose(SurfaceScene([Plane(d, texture=one)]), model="rays")
              for one in (star(count), uniform(1.0)))
how = {"white": white.to_numpy(), "step": 30 * cam.sub_image_scale / FINE}
wrong, right = (render_focused(raw, method="basic", patch=patch, **how)
                for patch in (6, cam.patch_size))
number("patch size m p F/(z2 dx) / px", cam.patch_size, 0.2 * 30 * 240 / 258, 1e-6, ".3f")
number("seam of patches of m p/dx = 6 px", seam(wrong), seam_of_wrong, 0.25 * seam_of_wrong,
       ".1f")
number("seam of patches of mu = 5.58 px", seam(right), 1, 0.2, ".2f")

figure = new_figure(11, 7.4)
panels = figure.subplot_mosaic("rsw;abc")
half, p = cam.grid.extent[1] * 500, cam.mla.pitch * 1e3
panels["r"].imshow(raw.to_numpy(), cmap="gray", vmin=0, vmax=1, extent=(-half, half, half, -half))
panels["r"].set(xlim=(9.5 * p, 2.5 * p), ylim=(2.5 * p, 9.5 * p), xlabel="x / mm", ylabel="y / mm",
                title="raw image behind 7 x 7 lenslets")
names = ("rendered", "patches of m p/dx = 6.00 px", "patches of mu = 5.58 px", "blended")
for name, title, one in zip("wabc", names, (right, wrong, right, render_focused(raw, **how)),
                            strict=True):
    y, x = (axis * 1e3 for axis in one.positions())
    panels[name].imshow(pixels(one), cmap="gray", extent=(x[0], x[-1], y[-1], y[0]), vmin=0,
                        vmax=1, interpolation="nearest")
    low, high = ZOOM if name in "abc" else (x[0], x[-1])
    panels[name].set(xlim=(high, low), ylim=(low, high), xlabel="x on the main image / mm",
                     title=title)
panels["w"].add_patch(Rectangle((ZOOM[0],) * 2, *[np.ptp(ZOOM)] * 2, fill=False, ec=ORANGE, lw=1.5))
sketch = rays.focused(run, 1 / 3)
rays.stripes(panels["s"], sketch, {k: "0.62" if k % 2 else "0.8" for k in range(2, 9)} | {5: BLUE})
wide = sketch.mla.diameter * 1e3 / sketch.b  # mrad
panels["s"].add_patch(Rectangle((-0.01, -wide / 2), 0.02, wide, fc=ORANGE, ec="k", alpha=0.8))
panels["s"].set(xlim=(-0.12, 0.12), ylim=(-6.2, 6.2),
                title="orange: a pixel of the blended picture,\nblue: a lenslet, a patch is a part")
run.save(figure)
