"""Figure 3.8: a microscope's frame rendered with the full aperture and with a pixel a lenslet."""

import numpy as np
import vesicle
from common import begin, number
from drawing import LIGHT, bar, new_figure
from matplotlib.axes import Axes

from clplen import decode_raw, estimate_lattice

PITCH = (15.387, 15.410)  # pixels along x and y, of the white frame in an independent fit
SHOWN = 6  # lenslets of the zoom

run = begin(__doc__, __file__, quick="where there is no frame, one of fewer points")
cam = vesicle.camera(run.device)
frame, white, dark, words = vesicle.frames(run)
print(f"  {words}")
lattice = estimate_lattice(white, dark=dark)
for axis, pitch, expected in zip("xy", lattice.pitch, PITCH, strict=True):
    number(f"pitch of the lenslets along {axis} / pixels", pitch, expected, 0.04, ".3f")
number("disparity of 1 um / lenslets a pixel", cam.disparity(-1e-6), 0.0693, 1e-4)
lf = decode_raw(frame, lattice, device=run.device, white=white, dark=dark)
count = lf.shape[0]


def show(axes: Axes, values: np.ndarray, ends: tuple[float, ...], title: str) -> object:
    """A picture in um, from 0 to its largest but a few."""
    drawn = axes.imshow(values / np.percentile(values, 99.7), cmap=LIGHT, vmin=0, vmax=1,
                        extent=ends)
    axes.set(xlabel="x/M / um", title=title)
    axes.locator_params(nbins=5)
    return drawn


figure = new_figure(12, 3.5)
panels = figure.subplots(1, 4)
light = np.maximum(frame.astype(float) - dark, 0)
pixel = cam.pixel_pitch / cam.magnification * 1e6
half, middle = round(SHOWN / 2 * lattice.pitch[0]), light.shape[0] // 2
left = round(light.shape[1] / 2 + vesicle.radius() * 1e6 / pixel)
whole, top = light.shape[1] * pixel / 2, half * pixel
at = (left - light.shape[1] / 2) * pixel
show(panels[0], light, (-whole, whole, whole, -whole), "raw frame")
panels[0].plot(at + top * np.array([-1, 1, 1, -1, -1]), top * np.array([-1, -1, 1, 1, -1]), "w",
               lw=0.8)
zoom = light[middle - half:middle + half, left - half:left + half]
show(panels[1], zoom, (at - top, at + top, top, -top), f"{SHOWN} x {SHOWN} lenslets of its rim")
across = lf.shape[3] * cam.mla.pitch / cam.magnification * 5e5
for axes, kept, title in zip(panels[2:], (None, 1), (f"{count} x {count} pixels", "1 pixel"),
                             strict=True):
    values = lf.render(aperture=kept).to_numpy().astype(float)
    drawn = show(axes, values, (-across, across, across, -across), f"{title} a lenslet")
    print(f"  {title} a lenslet: light beyond the rim over that of the rim "
          f"{vesicle.beyond(values, cam.mla.pitch / cam.magnification):.3f}")
panels[0].set_ylabel("y/M / um")
bar(figure, drawn, list(panels), "light / 99.7 % of it")
figure.supxlabel(words)
run.save(figure)
