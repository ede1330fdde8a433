"""The light-field microscope of chapter 5: figures 5.1 to 5.4.

M = 20, NA = 0.5 in air, 525 nm; 15 x 15 lenslets of 125 um, f/20, with 25 pixels of 5 um each.
Phase space has x in the medium, X/M, and the optical momentum p = n sin(theta): M times the angle
behind the tube lens, s/f_mu for a pixel s from the middle of its sub-image.
"""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from common import BLUE, GREEN, RED, Run
from matplotlib.axes import Axes
from scipy.optimize import minimize

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras.microscope import Microscope
from clplen.lightfield.refocus import refocus
from clplen.plot.base import LIGHT


def camera(run: Run, *, count: int = 15) -> Microscope:
    """The microscope."""
    lenslets = MicrolensArray(125e-6, 2.5e-3, count=count, fill="full")
    return PlenopticCamera.microscope(magnification=20, na=0.5, mla=lenslets, wavelength=525e-9,
                                      pixels_per_lenslet=25, device=run.device)


def taken(cam: Microscope, places: Any) -> LightField:
    """Light field of points at (x, y, z) in metres."""
    return LightField.from_raw(cam.expose(PointSources(places)))


def axes_of(cam: Microscope, lf: LightField) -> tuple[np.ndarray, np.ndarray]:
    """p of the rows and x of the columns of a slice."""
    n, m = lf.shape[1], lf.shape[3]
    p = (np.arange(n) - (n - 1) / 2) * cam.pixel_pitch / cam.mla.f * cam.magnification
    return p, (np.arange(m) - (m - 1) / 2) * cam.mla.pitch / cam.magnification


def summed(lf: LightField) -> np.ndarray:
    """The slice (p, x) of all light: summed over v and y, p rising."""
    return lf.to_numpy().astype(float).sum(axis=(0, 2))


def sheared(lf: LightField, disparity: float) -> np.ndarray:
    """The slice (p, x) of the light field that `refocus` sums up, column by column of the views."""
    rows = []
    for u in range(lf.shape[1]):
        column = np.zeros(lf.shape[:2])
        column[:, u] = 1
        one = LightField.from_array(lf.data, device=lf.device, spacing=lf.spacing, weights=column,
                                    camera=lf.camera)
        image = refocus(one, disparity=disparity, interpolation="fourier")
        rows.append(image.to_numpy().astype(float).sum(axis=0) * lf.shape[0])
    return np.array(rows)


def area(light: np.ndarray, p: np.ndarray, x: np.ndarray) -> float:
    """(sum L)^2/sum L^2 samples: the area that an even light of this sum and power would fill."""
    return float(light.sum() ** 2 / (light**2).sum() * (p[1] - p[0]) * (x[1] - x[0]))


def through(cam: Microscope, x: Any, p: Any, z: float) -> Any:
    """Where rays of momentum p from x in the plane z meet the native plane, x + z tan(theta)."""
    return x + z * p / np.sqrt(cam.medium_index**2 - np.square(p))


def draw_slice(axes: Axes, light: np.ndarray, p: np.ndarray, x: np.ndarray) -> Any:
    """A slice: square root of the light over the largest, x in um."""
    dp, dx = (p[1] - p[0]) / 2, (x[1] - x[0]) / 2 * 1e6
    extent = (x[0] * 1e6 - dx, x[-1] * 1e6 + dx, p[0] - dp, p[-1] + dp)
    drawn = axes.imshow(np.sqrt(np.maximum(light, 0) / light.max()), cmap=LIGHT, aspect="auto",
                        origin="lower", extent=extent, vmin=0, vmax=1)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x / um")
    return drawn


def draw_objective(axes: Axes, cam: Microscope, momenta: np.ndarray) -> np.ndarray:
    """Rays of the axis point to the sphere of radius n f and on to the pupil; heights in metres."""
    radius, pupil = cam.object_distance * 1e3, cam.aperture_diameter * 500
    sine = momenta / cam.medium_index
    z, x = radius * np.sqrt(1 - sine**2), radius * sine  # where they meet the sphere
    turn = np.linspace(-1, 1, 101) * np.arcsin(cam.na / cam.medium_index) * 1.1
    axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.3", lw=1.5)
    for at, height, colour in zip(z, x, colours(len(momenta)), strict=True):
        axes.plot([0, at, 14], [0, height, height], color=colour, lw=1)
    axes.axhline(0, color="0.5", lw=0.7, ls=(0, (14, 3, 2, 3)))
    axes.plot([14, 14], [-pupil, -1.3 * pupil], "k-", [14, 14], [pupil, 1.3 * pupil], "k-", lw=3)
    axes.plot(0, 0, "ko", ms=4)
    axes.text(7.3, -6.2, f"sphere, radius n f = {radius:g} mm", ha="center", va="center")
    axes.text(13.8, 6.2, "pupil", ha="right", va="center")
    axes.set(xlim=(-0.6, 14.4), ylim=(-7, 7), aspect="equal", xlabel="z / mm", ylabel="x / mm",
             title=f"sine condition: height on the pupil = f p, at most {pupil:g} mm")
    return x * 1e-3


def draw_pixels(axes: Axes, cam: Microscope, momenta: np.ndarray) -> float:
    """The same rays behind the lenslet that they meet; the step of p from pixel to pixel."""
    p, f, dx = cam.mla.pitch * 1e6, cam.mla.f * 1e3, cam.pixel_pitch * 1e6
    step = cam.pixel_pitch / cam.mla.f * cam.magnification
    for momentum, colour in zip(momenta, colours(len(momenta)), strict=True):
        s = momentum / cam.magnification * f * 1e3
        for x in (-0.4 * p, 0, 0.4 * p):  # parallel in front of the lenslet: one place behind it
            axes.plot([-0.8, 0, f], [x - 0.8e3 * momentum / cam.magnification, x, s],
                      color=colour, lw=0.6)
    axes.plot([0, 0], [-p / 2, p / 2], color="#33536b", lw=3, solid_capstyle="butt")
    for n in range(round(cam.pixels_per_lenslet) + 1):
        edge = n * dx - p / 2
        axes.plot([f, f + 0.12], [edge, edge], color="0.4", lw=0.6)
    axes.plot([f, f], [-p / 2, p / 2], color="0.4", lw=1)
    axes.set(xlim=(-0.9, f + 0.2), ylim=(-1.05 * p, 1.05 * p), xlabel="z from the array / mm",
             ylabel="x / um", title=f"behind a lenslet: a pixel is {step:.2f} of p, "
             f"{2 * cam.na / step:.0f} pixels are 2 NA")
    return step


def colours(count: int) -> np.ndarray:
    """One for each ray, by its momentum."""
    return matplotlib.colormaps["plasma"](np.linspace(0, 0.88, count))


def fermat(n: np.ndarray, thick: np.ndarray, end: float) -> np.ndarray:
    """Steps along x in each layer of the shortest optical path to a height behind them."""
    def path(steps: np.ndarray) -> float:
        return float(n @ np.hypot(thick, [*steps, end - steps.sum()]))

    steps = minimize(path, np.full(len(n) - 1, end / len(n)), tol=1e-9).x
    return np.array([*steps, end - steps.sum()])


def enclosed(x: np.ndarray, y: np.ndarray) -> float:
    """Area of a polygon."""
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2)


def outline(cam: Microscope, z: float, wide: float, focus: float = 0.0) -> np.ndarray:
    """Edge (x, p) of what rays of a line in the plane z fill, refocused to another; x in um."""
    p = np.linspace(-cam.na, cam.na, 201)
    middle = through(cam, 0, p, z) - focus * p / cam.medium_index
    x = np.concatenate([middle - wide / 2, (middle + wide / 2)[::-1]])
    return np.array([x * 1e6, [*p, *p[::-1]]])


def draw_lines(axes: Axes, cam: Microscope, z: float) -> None:
    """Where geometry puts the light of a point on the axis."""
    p = np.linspace(-cam.na, cam.na, 101)
    axes.plot(z * p / cam.medium_index * 1e6, p, "c--", lw=1)
    axes.plot(through(cam, 0, p, z) * 1e6, p, "w:", lw=1)


def draw_bands(axes: Axes, cam: Microscope, depths: Any, wide: float) -> list[float]:
    """What rays of a line fill from several planes; the areas in um."""
    edges = [outline(cam, z, wide) for z in depths]
    for (x, p), z, colour in zip(edges, depths, (BLUE, GREEN, RED), strict=True):
        axes.fill(x, p, color=colour, alpha=0.4, label=f"z = {z * 1e6:+.0f} um")
    axes.set(xlim=(-46.875, 46.875), xlabel="x / um", title=f"rays of {wide * 1e6:g} um: one area")
    axes.legend(loc="upper left")
    return [enclosed(x, p) for x, p in edges]


def draw_volume(row: Any, frame: np.ndarray, volume: np.ndarray, cam: Microscope, z: np.ndarray,
                true: np.ndarray) -> Any:
    """A frame and the largest voxels of its volume along z, y and x, root of the largest; in um."""
    side, (low, high) = cam.grid.extent[0] / cam.magnification * 5e5, z[[0, -1]] * 1e6
    step = (high - low) / (len(z) - 1) / 2
    across = (-side, side)
    row[0].imshow(np.sqrt(frame / frame.max()), cmap=LIGHT, extent=(*across, *across[::-1]))
    row[0].set(xlabel="x/M / um", ylabel="y/M / um")
    places = np.argwhere(true) - (0, *(np.array(volume.shape[1:]) - 1) / 2)
    y, x = (places[:, 1:] * 2 * side / volume.shape[1]).T
    deep, ends = z[np.argwhere(true)[:, 0]] * 1e6, (low - step, high + step)
    views = ((0, x, y, across[::-1], "y"), (1, x, deep, ends, "z"), (2, y, deep, ends, "z"))
    for axes, (axis, at, up, vertical, word) in zip(row[1:], views, strict=False):
        picture = np.sqrt(volume.max(axis=axis) / volume.max())
        drawn = axes.imshow(picture, cmap=LIGHT, vmin=0, vmax=1, aspect="auto",
                            origin="upper" if axis == 0 else "lower", extent=(*across, *vertical))
        axes.plot(at, up, "o", mfc="none", mec="c", ms=11, mew=0.8)
        axes.set(xlabel="xxy"[axis] + " / um", ylabel=f"{word} / um")
    return drawn
