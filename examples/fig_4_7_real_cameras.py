"""Figure 4.7: letters of stars that hide each other before cameras that one can buy."""

from pathlib import Path

import numpy as np
from common import begin, number
from drawing import new_figure
from letter_planes import VIRTUAL, exposed, focused, inside, standard

from clplen import read_camera
from clplen.cameras import Plenoptic2

FOLDER = Path(__file__).parent / "cameras"
FILES = {"lytro_illum": "Lytro Illum", "canon_50mm": "50 mm at f/4", "raytrix_r12": "Raytrix R12"}
SURE = 0.1  # least confidence of depth that is shown
ZOOM = 9  # lenslets of the raw image that are shown


def upright(picture, gamma=0.6):
    """A picture turned by 180 degrees, from 0 to 1."""
    values = np.clip(np.asarray(picture, float), 0, None)[::-1, ::-1]
    return (values / np.percentile(values, 99.7)).clip(0, 1) ** gamma


def draw(axes, camera, raw, title):
    """One row of the figure."""
    found = focused if isinstance(camera, Plenoptic2) else standard
    stack, depth, confidence, pitches, truth = found(camera, raw)
    picture, per = raw.to_numpy(), camera.pixels_per_lenslet
    middle, half = np.array(picture.shape) // 2, int(ZOOM * per / 2)
    part = picture[middle[0] - half : middle[0] + half, middle[1] - half : middle[1] + half]
    axes[0].imshow(upright(part), cmap="gray")
    axes[0].set_title(f"{title}: {ZOOM} x {ZOOM} lenslets")
    for panel, image, name in zip(axes[1:4], stack, truth, strict=True):
        panel.imshow(upright(image), cmap="gray")
        panel.set_title(f"refocused on {name}")
    low, high = min(truth.values()) - 0.5, max(truth.values()) + 0.5
    sure = np.where(confidence > SURE, depth, np.nan)[::-1, ::-1]
    shown = axes[4].imshow(sure, cmap="viridis", vmin=low, vmax=high)
    axes[4].figure.colorbar(shown, ax=axes[4], ticks=list(truth.values()))
    axes[4].set_title("virtual depth, b" if truth is VIRTUAL else "blur, lenslets")
    for name, expected in truth.items():
        where = inside(name, depth.shape, pitches) & (confidence > SURE)
        number(f"{title}, {name}: median depth", np.median(depth[where]), expected, 0.5, ".2f")


run = begin(__doc__, __file__, quick="the Illum alone, letters of fewer stars")
files = dict(list(FILES.items())[:1]) if run.quick else FILES
figure = new_figure(11, 0.3 + 2.3 * len(files))
panels = figure.subplots(len(files), 5, squeeze=False)
for axes, (file, title) in zip(panels, files.items(), strict=True):
    camera = read_camera(FOLDER / f"{file}.toml", device=run.device, count=(43, 39))
    draw(axes, camera, exposed(camera, 1.2 if run.quick else 0.8), title)
for axes in panels.flat:
    axes.set_axis_off()
run.save(figure)
