"""Lenslet arrays and what they need: figures 3.1 to 3.3."""

import numpy as np
from common import BLUE, ORANGE, RED
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import AxesImage
from rays import PURPLE, draw_camera, names, stage
from slices import span

from clplen import Grid, MicrolensArray
from clplen.cameras import Plenoptic1

LAM = 532e-9


def draw_sub_images(axes: Axes, cam: Plenoptic1) -> None:
    """The last 13 mm: every lenslet makes a picture of the main lens, which fills its sub-image."""
    F, f_mu, p = 1e3 * np.array([cam.image_distance, cam.lenslet_focal_length, cam.lenslet_pitch])
    stage(axes, (F - 3, F + f_mu + 0.6), (-2.6 * p, 2.6 * p))
    draw_camera(axes, cam, pixels=False)
    for k in range(-2, 3):
        axes.axhspan((k - 0.5) * p, (k + 0.5) * p, color="0.96" if k % 2 else "0.9", lw=0)
        for u, colour in zip((-0.5, 0, 0.5), (ORANGE, "0.45", PURPLE), strict=True):
            top = u * cam.aperture_diameter * 1e3
            x = k * p + np.linspace(-0.45, 0.45, 5) * p
            axes.plot([F - 3, F], [x - (x - top) / F * 3, x], color=colour, lw=0.7)
            axes.plot([F, F + f_mu], [x, k * p + (x - top) * f_mu / F], color=colour, lw=0.7)
    names(axes, {F: "lenslets", F + f_mu: "sensor"})


def draw_whole(axes: Axes, array: MicrolensArray) -> None:
    """All cells, with N and W."""
    p, W = array.pitch * 1e3, array.extent[1] * 1e3
    edges = np.arange(array.count[0] + 1) * p - W / 2
    lines = [[(e, -W / 2), (e, W / 2)] for e in edges] + [[(-W / 2, e), (W / 2, e)] for e in edges]
    axes.add_collection(LineCollection(lines, colors=BLUE, linewidths=0.25))
    span(axes, (-W / 2, -W / 2 - 1), (W / 2, -W / 2 - 1), f"W = N p = {W:.2f} mm",
         aside=(0, -3), va="top")
    span(axes, (-W / 2 - 1, -W / 2), (-W / 2 - 1, W / 2), f"N = {array.count[0]} lenslets",
         aside=(-4, 0), ha="right", va="center", rotation=90)
    axes.set(xlim=(-W / 2 - 3.2, W / 2 + 0.5), ylim=(-W / 2 - 3, W / 2 + 0.5), aspect="equal")
    axes.set_axis_off()


def draw_lenslets(axes: Axes, array: MicrolensArray, behind: np.ndarray, grid: Grid) -> AxesImage:
    """Phase of the lenslets in a few cells, grey where the array is opaque, with p and d."""
    height, width = (side * 1e3 for side in grid.extent)
    phase = np.where(np.abs(behind) > 0.5, np.angle(behind), np.nan)
    drawn = axes.imshow(phase, cmap="twilight", vmin=-np.pi, vmax=np.pi,
                extent=(-width / 2, width / 2, height / 2, -height / 2))
    y, x = np.moveaxis(array.centres()[4:6, 4:8] * 1e3, -1, 0)
    axes.plot(x, y, "w.", ms=3)
    half = array.diameter * 500
    span(axes, (x[0, 1], y[0, 1]), (x[0, 2], y[0, 2]), "p", color="w", weight="bold")
    span(axes, (x[1, 1] - half, y[1, 1]), (x[1, 1] + half, y[1, 1]), "d", color="w", weight="bold")
    axes.set(facecolor="0.75", xlabel="x / mm", aspect="equal", xticks=[-0.2, 0, 0.2],
             ylim=(0.3, -0.3))
    return drawn


def draw_least(axes: Axes, f_mu: float) -> None:
    """d = sqrt(2.44 lam f_mu), the diameter of Airy's disc, and the cameras of figure 3.4."""
    f = np.linspace(0, 20e-3, 201)
    least = np.sqrt(2.44 * LAM * f) * 1e6
    axes.plot(f * 1e3, least, color=RED, label=r"$\sqrt{2.44\,\lambda f_\mu}$")
    axes.fill_between(f * 1e3, 0, least, color=RED, alpha=0.1, lw=0)
    axes.text(11.5, 45, "diffraction into\nneighbouring sub-images", color=RED, ha="center")
    axes.text(5.5, 190, "acceptable", ha="center")
    for d in (100, 150):
        axes.plot(f_mu * 1e3, d, "o", color=BLUE)
        axes.annotate(f"d = {d} um", (f_mu * 1e3, d), (7, -4), textcoords="offset points",
                      color=BLUE, bbox={"fc": "w", "ec": "none", "alpha": 0.7, "pad": 0.5})
    axes.set(xlabel=r"focal length $f_\mu$ / mm", ylabel="diameter d = p of a lenslet / um",
             xlim=(0, 20), ylim=(0, 220))
    axes.legend(loc="lower right")
