"""Figure 3.9: how the lenslets sample the light of a point in focus, closer and farther: rays."""

import numpy as np
from common import begin, mm, number
from drawing import new_figure
from matplotlib.axes import Axes
from rays import draw_camera, draw_rays, go_on, image, stage, trace
from slices import COLOURS, DEPTHS, QUICK, camera, draw_end, zones

from clplen import LightField, PointSources, estimate_alpha
from clplen.cameras import Plenoptic1

BLURS = {"closer": 6.316, "farther": 4.138}  # lenslets, D |1 - alpha|/p
REACH = 5.2  # lenslets shown to either side of the axis


def draw_whole(axes: Axes, cam: Plenoptic1, dz: float, name: str) -> None:
    """From the main lens to the sensor, and to the image behind it."""
    stage(axes, (-12, 340), (-2.1, 2.1), f"{name}, dz = {mm(dz)}: the image lies "
          + ("on the lenslets" if not dz else "behind them" if dz < 0 else "before them"))
    draw_camera(axes, cam, pixels=False)
    draw_rays(axes, cam, (0.0, dz), zones(cam)[:, 0], COLOURS)
    if dz < 0:
        go_on(axes, cam, (0.0, dz), zones(cam)[:, 0], COLOURS)
    axes.plot(image(cam, (0.0, dz))[0] * 1e3, 0, "ko", ms=3.5, zorder=7)


run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
middle = (cam.mla.count[0] - 1) // 2
figure = new_figure(11, 7.4)
panels = figure.subplots(3, 3, width_ratios=[2.3, 1.15, 0.45])
for row, (name, dz) in zip(panels, DEPTHS.items(), strict=True):
    raw = cam.expose(PointSources((0, 0, dz)))
    found = estimate_alpha(LightField.from_raw(raw), at=(middle, middle), method="slope")
    if dz:
        reach = np.ptp(trace(cam, (0.0, dz), [-cam.aperture_diameter / 2,
                                              cam.aperture_diameter / 2])[2])
        number(f"{name}: light on the array, rays / lenslets", reach / cam.lenslet_pitch,
               BLURS[name], 1e-3, ".3f")
        number(f"{name}: by the slope in the light field", found.blur, BLURS[name], 0.3, ".3f")
    draw_whole(row[0], cam, dz, name)
    draw_end(row[1], row[2], cam, dz, raw.to_numpy().astype(float).sum(axis=1), REACH)
panels[0, 1].set_title("lenslets and sensor")
panels[0, 2].set_title("light there, waves")
figure.supxlabel("lengths to scale, heights larger; colour: zone of the main lens; bands: cells; "
                 "right: square root of the light on the sensor, summed along the other axis")
run.save(figure)
