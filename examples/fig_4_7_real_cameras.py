"""Figure 4.7: letters that hide each other before cameras that one can buy: raw, stack, depth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from common import begin, number, pixels
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath

from clplen import LightField, PicturePlane, depth_map, read_camera, refocus, render_focused
from clplen.cameras import Plenoptic2
from clplen.lightfield import focused_depth
from clplen.plot import new_figure

FOLDER = Path(__file__).parent / "cameras"
FILES = {"lytro_illum": "Lytro Illum", "canon_50mm": "50 mm at f/4", "raytrix_r12": "Raytrix R12"}
BLURS = {"A": -2.6, "B": 0.0, "C": 2.6}  # lenslets: near, in focus, far
VIRTUAL = {"A": 3.4, "B": 4.6, "C": 6.2}  # depths of the focused camera, in b
PLACES = {"A": (4.0, -8.0), "B": (0.0, 0.0), "C": (-4.0, 8.0)}  # (y, x), lenslets, seen upright
SIZE, ZOOM = 17.0, 9  # of the font, and of the raw image that is shown, in lenslets
SURE, DARK = 0.1, 0.15  # least confidence and brightness of depth that is shown
HALF = 16  # lenslets, of the pictures


def mask(letter, n, step):
    """Samples of a letter, upright, in an n x n square of so many lenslets a sample."""
    lines = TextPath((0, 0), letter, size=SIZE, prop={"weight": "bold"}).to_polygons()
    ends = np.vstack(lines)
    middle = (ends.max(axis=0) + ends.min(axis=0)) / 2
    at = (np.arange(n) - n // 2) * step
    y, x = np.meshgrid(at - PLACES[letter][0], at - PLACES[letter][1], indexing="ij")
    points = np.stack([x.ravel(), -y.ravel()], axis=-1) + middle
    return sum(Outline(line).contains_points(points) for line in lines).reshape(n, n) % 2


def distances(camera):
    """dz of the letters."""
    if isinstance(camera, Plenoptic2):
        z2, b = camera.array_distance, camera.b
        return {name: float(camera.dz(camera.image_distance / (z2 + v * b)))
                for name, v in VIRTUAL.items()}
    tolerance = camera.mla.pitch / camera.aperture_diameter
    return {name: float(camera.dz(1 + blur * tolerance)) for name, blur in BLURS.items()}


def exposed(camera, step):
    """The raw image of the letters, each of which hides what is behind it."""
    planes = []
    for name, dz in distances(camera).items():
        samples = mask(name, 2 * int(HALF / step) + 1, step)
        pitch = step * camera.mla.pitch / abs(float(camera.array_scale(dz)))
        planes.append(PicturePlane(samples, pitch * len(samples), dz, opacity=samples))
    return camera.expose(planes)


def inside(name, shape, pitches):
    """Which samples of a map a letter covers alone; the map is upside down, pitches in lenslets."""
    found, n = {}, 4 * HALF + 1
    at = []
    for m, pitch in zip(shape, pitches, strict=True):
        place = -(np.arange(m) - (m - 1) / 2) * pitch / 0.5
        at.append(np.clip(np.rint(place).astype(int) + n // 2, 0, n - 1))
    for letter in BLURS:
        found[letter] = mask(letter, n, 0.5)[np.ix_(*at)] > 0
    others = [found[other] for other in found if other != name]
    return found[name] & ~np.any(others, axis=0)


def upright(picture, gamma=0.6):
    """A picture turned by 180 degrees, from 0 to 1."""
    values = np.clip(np.asarray(picture, float), 0, None)[::-1, ::-1]
    return (values / np.percentile(values, 99.7)).clip(0, 1) ** gamma


def standard(camera, raw):
    """Stack and depth (alpha) of a 1.0 camera, and what the letters' depth should be.

    The outermost views count nothing: behind lenslets as fast as the main lens they hold light of
    the neighbours.
    """
    lf = LightField.from_raw(raw)
    v, u = (np.abs(np.arange(n) - (n - 1) / 2) / n for n in lf.shape[:2])
    lf = replace(lf, weights=(np.hypot(v[:, None], u) < 0.47).astype(np.float32))
    stack = [pixels(refocus(lf, alpha=camera.alpha(dz))) for dz in distances(camera).values()]
    alphas = 1 + np.linspace(-4, 4, 33) * camera.mla.pitch / camera.aperture_diameter
    depth = depth_map(lf, alphas=alphas)
    blur = (np.asarray(lf.alpha(depth.disparity)) - 1) * camera.aperture_diameter / camera.mla.pitch
    return stack, blur, depth.confidence, np.divide(lf.spacing[2:], camera.mla.pitch), BLURS


def focused(camera, raw):
    """The same of a 2.0 camera, with the virtual depth -1/m."""
    stack = [pixels(render_focused(raw, method="blended", m=-1 / v)) for v in VIRTUAL.values()]
    depth = focused_depth(raw)
    grid = render_focused(raw, method="blended", m=-1 / VIRTUAL["B"]).grid
    pitch = grid.step / camera.pixels_per_lenslet
    return stack, -1 / depth.on(grid), np.ones(grid.shape), (pitch, pitch), VIRTUAL


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
    confidence = np.where(stack[1] > DARK * stack[1].max(), confidence, 0)
    low, high = min(truth.values()) - 0.5, max(truth.values()) + 0.5
    sure = np.where(confidence > SURE, depth, np.nan)[::-1, ::-1]
    shown = axes[4].imshow(sure, cmap="viridis", vmin=low, vmax=high)
    axes[4].figure.colorbar(shown, ax=axes[4], ticks=list(truth.values()))
    axes[4].set_title("virtual depth, b" if truth is VIRTUAL else "blur, lenslets")
    for name, expected in truth.items():
        where = inside(name, depth.shape, pitches) & (confidence > SURE)
        number(f"{title}, {name}: median depth", np.median(depth[where]), expected, 0.5, ".2f")


run = begin(__doc__, __file__, quick="the Illum alone, letters of fewer points")
files = dict(list(FILES.items())[:1]) if run.quick else FILES
figure = new_figure(11, 0.3 + 2.3 * len(files))
panels = figure.subplots(len(files), 5, squeeze=False)
for axes, (file, title) in zip(panels, files.items(), strict=True):
    camera = read_camera(FOLDER / f"{file}.toml", device=run.device, count=(43, 39))
    draw(axes, camera, exposed(camera, 1.2 if run.quick else 0.8), title)
for axes in panels.flat:
    axes.set_axis_off()
run.save(figure)
