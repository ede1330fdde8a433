"""The light-field microscope of chapter 5: figures 5.1 to 5.4.

M = 20, NA = 0.5 in air, 525 nm; 15 x 15 lenslets of 125 um, f/20, with 25 pixels of 5 um each.
Phase space has x in the medium, X/M, and the optical momentum p = n sin(theta): M times the angle
behind the tube lens, s/f_mu for a pixel s from the middle of its sub-image.
"""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from common import BLUE, GREEN, ORANGE, RED, Run
from drawing import LIGHT
from matplotlib.axes import Axes
from scipy.ndimage import maximum_filter
from scipy.optimize import minimize

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, focal_stack
from clplen.cameras import Microscope

SHOWN = 32  # um of x in a slice


def camera(run: Run, *, count: int = 15) -> Microscope:
    """The microscope."""
    lenslets = MicrolensArray(125e-6, 2.5e-3, count=count, fill="full")
    return PlenopticCamera.microscope(magnification=20, na=0.5, mla=lenslets, wavelength=525e-9,
                                      pixels_per_lenslet=25, device=run.device)


def taken(cam: Microscope, places: Any, *, steps: int = 1) -> LightField:
    """Light field of points at (x, y, z) in metres, sampled every p/steps along x.

    The points are taken `steps` times, each time moved by a part of a pitch: lenslets between
    lenslets.
    """
    moves = (np.arange(steps) - (steps - 1) / 2) * cam.mla.pitch / (cam.magnification * steps)
    fields = [LightField.from_raw(cam.expose(PointSources(np.array(places) - (move, 0, 0))))
              for move in moves]
    samples = np.stack([one.to_numpy() for one in fields], axis=-1)
    dv, du, dy, dx = fields[0].spacing
    return LightField.from_array(samples.reshape(*samples.shape[:3], -1), device=cam.device,
                                 spacing=(dv, du, dy, dx / steps), camera=cam)


def slab(near: float, far: float, wide: float, *, planes: int) -> np.ndarray:
    """Places (x, 0, z) of points that fill a slab evenly."""
    x, z = np.meshgrid(np.linspace(-wide / 2, wide / 2, 13), np.linspace(near, far, planes))
    return np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)


def axes_of(cam: Microscope, lf: LightField) -> tuple[np.ndarray, np.ndarray]:
    """p of the rows and x of the columns of a slice."""
    n, m = lf.shape[1], lf.shape[3]
    p = (np.arange(n) - (n - 1) / 2) * cam.pixel_pitch / cam.mla.f * cam.magnification
    return p, (np.arange(m) - (m - 1) / 2) * lf.spacing[3] / cam.magnification


def summed(lf: LightField) -> np.ndarray:
    """The slice (p, x) of all light: summed over v and y, p rising."""
    return lf.to_numpy().astype(float).sum(axis=(0, 2))


def refocused(lf: LightField, planes: Any, interpolation: str) -> np.ndarray:
    """Slices of the light fields whose sums are the focal stack, column by column of the views."""
    disparities = lf.camera.disparity(planes) * lf.spacing[2] / lf.spacing[3]
    slices = []
    for column in np.eye(lf.shape[1]):
        aperture = np.broadcast_to(column, lf.shape[:2])
        stack = focal_stack(lf, disparities=disparities, aperture=aperture,
                            interpolation=interpolation)
        slices.append(stack.to_numpy().astype(float).sum(axis=1) * lf.shape[0])
    return np.stack(slices, axis=1)


def area(light: np.ndarray, p: np.ndarray, x: np.ndarray, share: float = 0.9) -> float:
    """The least area of a slice that holds a share of its light, in metres."""
    falling = np.sort(light, axis=None)[::-1]
    held = np.concatenate([[0], np.cumsum(falling)])
    return float(np.interp(share * held[-1], held, np.arange(held.size))
                 * (p[1] - p[0]) * (x[1] - x[0]))


def through(cam: Microscope, x: Any, p: Any, z: float) -> Any:
    """Where rays of momentum p from x in the plane z meet the native plane, x + z tan(theta)."""
    return x + z * p / np.sqrt(cam.medium_index**2 - np.square(p))


def draw_slice(axes: Axes, light: np.ndarray, p: np.ndarray, x: np.ndarray, title: str) -> Any:
    """A slice: square root of the light over the largest, x in um."""
    dp, dx = (p[1] - p[0]) / 2, (x[1] - x[0]) / 2 * 1e6
    extent = (x[0] * 1e6 - dx, x[-1] * 1e6 + dx, p[0] - dp, p[-1] + dp)
    drawn = axes.imshow(np.sqrt(np.maximum(light, 0) / light.max()), cmap=LIGHT, aspect="auto",
                        origin="lower", extent=extent, vmin=0, vmax=1)
    axes.set(xlim=(-SHOWN, SHOWN), ylim=extent[2:], xlabel="x / um", title=title)
    return drawn


def draw_objective(axes: Axes, cam: Microscope, momenta: np.ndarray) -> None:
    """Rays of the axis point to the sphere of radius n f and on to the pupil."""
    radius, pupil = cam.object_distance * 1e3, cam.aperture_diameter * 500
    sine = momenta / cam.medium_index
    z, x = radius * np.sqrt(1 - sine**2), radius * sine  # where they meet the sphere
    turn = np.linspace(-1, 1, 101) * np.arcsin(cam.na / cam.medium_index) * 1.15
    axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.3", lw=2)
    axes.axhline(0, color="0.5", lw=0.7, ls=(0, (14, 3, 2, 3)))
    for at, height, colour in zip(z, x, colours(len(momenta)), strict=True):
        axes.plot([0, at, 14], [0, height, height], color=colour, lw=1)
    axes.plot([14, 14], [-pupil, -9], "k-", [14, 14], [pupil, 9], "k-", lw=3)
    axes.plot(0, 0, "ko", ms=4)
    axes.text(7.4, -6.1, f"objective: sphere,\nradius n f = {radius:g} mm", ha="right", va="center")
    axes.text(13.7, 6.1, "pupil", ha="right", va="center")
    axes.set(xlim=(-0.6, 14.15), ylim=(-7, 7), aspect="equal", xlabel="z / mm", ylabel="x / mm",
             title=f"sine condition: height on the pupil = f p, up to f NA = {pupil:g} mm")
    focal = cam.focal_length * 1e3
    beside = axes.secondary_yaxis("right", functions=(lambda x: x / focal, lambda p: p * focal))
    beside.set(ylabel="p on the pupil", yticks=np.linspace(-cam.na, cam.na, 5))


def draw_pixels(axes: Axes, cam: Microscope, momenta: np.ndarray) -> float:
    """The same rays behind the lenslet that they meet; the step of p from pixel to pixel."""
    pitch, f, dx = cam.mla.pitch * 1e6, cam.mla.f * 1e3, cam.pixel_pitch * 1e6
    step = cam.pixel_pitch / cam.mla.f * cam.magnification
    for momentum, colour in zip(momenta, colours(len(momenta)), strict=True):
        s = momentum / cam.magnification * f * 1e3
        for x in (-0.4 * pitch, 0, 0.4 * pitch):  # of one angle: to one place behind the lenslet
            axes.plot([-0.8, 0, f], [x - 0.8e3 * momentum / cam.magnification, x, s],
                      color=colour, lw=0.6)
    axes.plot([0, 0], [-pitch / 2, pitch / 2], color="#33536b", lw=4, solid_capstyle="butt")
    for n in range(round(cam.pixels_per_lenslet) + 1):
        edge = n * dx - pitch / 2
        axes.plot([f, f + 0.1], [edge, edge], color="0.2", lw=0.6)
    axes.plot([f, f], [-pitch / 2, pitch / 2], color="0.2", lw=1)
    axes.text(0, 0.58 * pitch, "lenslet", ha="center", va="bottom")
    axes.text(f, 0.58 * pitch, "pixels", ha="right", va="bottom")
    axes.set(xlim=(-0.9, f + 0.12), ylim=(-0.72 * pitch, 0.72 * pitch),
             xlabel="z from the array / mm", ylabel="x / um",
             title=f"behind a lenslet: a pixel is a step of {step:.2f} in p, "
             f"{2 * cam.na / step:.0f} pixels 2 NA")
    of_x = step / dx
    beside = axes.secondary_yaxis("right", functions=(lambda x: x * of_x, lambda p: p / of_x))
    beside.set(ylabel="p on the sensor", yticks=np.linspace(-cam.na, cam.na, 5))
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
    left, right = (through(cam, x, p, z) - focus * p / cam.medium_index
                   for x in (-wide / 2, wide / 2))
    return np.array([np.concatenate([left, right[::-1]]) * 1e6, [*p, *p[::-1]]])


def draw_lines(axes: Axes, cam: Microscope, z: float, focus: float = 0.0) -> None:
    """Where geometry puts the light of a point on the axis."""
    p = np.linspace(-cam.na, cam.na, 101)
    axes.plot((z - focus) * p / cam.medium_index * 1e6, p, "c--", lw=1)
    axes.plot((through(cam, 0, p, z) - focus * p / cam.medium_index) * 1e6, p, "w:", lw=1)


def draw_bands(axes: Axes, cam: Microscope, depths: Any, wide: float) -> list[float]:
    """What rays of a line fill from several planes; the areas in um."""
    edges = [outline(cam, z, wide) for z in depths]
    for (x, p), z, colour in zip(edges, depths, (BLUE, GREEN, RED), strict=True):
        axes.fill(x, p, color=colour, alpha=0.4, lw=0)
        axes.text(z * 1.05e6, 0.44 if z else -0.44, f"{z * 1e6:+.0f} um" if z else "z = 0",
                  ha="center", va="center")
    axes.set(xlim=(-SHOWN, SHOWN), ylim=(-cam.na, cam.na), xlabel="x / um",
             title=f"rays of a line {wide * 1e6:g} um wide: one area")
    return [enclosed(x, p) for x, p in edges]


def draw_areas(axes: Axes, cam: Microscope, fields: dict[str, LightField], planes: np.ndarray,
               way: str) -> dict[str, np.ndarray]:
    """Areas of light fields refocused to planes, by an interpolation, over those as taken."""
    found = {}
    for (name, lf), colour in zip(fields.items(), (BLUE, ORANGE), strict=True):
        p, x = axes_of(cam, lf)
        areas = [area(light, p, x) for light in refocused(lf, planes, way)]
        found[name] = np.array(areas) / area(summed(lf), p, x)
        axes.plot(planes * 1e6, found[name], "o-" if way == "cubic" else "s--", color=colour,
                  ms=4, lw=1, label=f"{name}: every {(x[1] - x[0]) * 1e6:.3g} um, {way}")
    axes.set(xlabel="refocused to z / um", ylim=(0.9, 1.7),
             title="area of 90 % of the light / as taken")
    axes.legend(loc="upper left")
    return found


def helix(cam: Microscope, shape: tuple[int, ...], radius: float, turns: float) -> np.ndarray:
    """A volume with light along a helix about z, from the first plane to the last."""
    t = np.linspace(0, 1, 400, endpoint=False)
    angle, voxel = 2 * np.pi * turns * (t - 0.5), cam.grid.extent[0] / cam.magnification / shape[-1]
    y, x = (radius / voxel * way(angle) + (shape[-1] - 1) / 2 for way in (np.sin, np.cos))
    volume = np.zeros(shape, np.float32)
    volume[(t * shape[0]).astype(int), np.rint(y).astype(int), np.rint(x).astype(int)] = 1
    return volume


def placed(volume: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Share of each plane's light that lies within a voxel of those that are true."""
    near = maximum_filter(true, (1, 3, 3)) > 0
    return (volume * near).sum(axis=(1, 2)) / volume.sum(axis=(1, 2))


def draw_volume(row: Any, frame: np.ndarray, volume: np.ndarray, cam: Microscope, z: np.ndarray,
                true: np.ndarray) -> Any:
    """A frame and the largest voxels of its volume along z, y and x, root of the largest; in um."""
    side, (low, high) = cam.grid.extent[0] / cam.magnification * 5e5, z[[0, -1]] * 1e6
    step = (high - low) / (len(z) - 1) / 2
    row[0].imshow(np.sqrt(frame / frame.max()), cmap=LIGHT, extent=(-side, side, side, -side))
    row[0].set(xlabel="x/M / um", ylabel="y/M / um")
    across, deep = (-side, side), (low - step, high + step)
    views = ((0, "x", "y", across[::-1]), (1, "x", "z", deep), (2, "y", "z", deep))
    few = np.count_nonzero(true) < 9
    for axes, (axis, right, up, ends) in zip(row[1:], views, strict=False):
        picture = np.sqrt(volume.max(axis=axis) / volume.max())
        extent = (*across, *ends)
        drawn = axes.imshow(picture, cmap=LIGHT, vmin=0, vmax=1, aspect="equal", extent=extent,
                            origin="lower" if axis else "upper")
        axes.set(xlabel=f"{right} / um", ylabel=f"{up} / um")
        mask, (height, width) = true.max(axis=axis) > 0, picture.shape
        if few:
            y, x = np.argwhere(mask).T
            axes.plot((x + 0.5) / width * 2 * side - side,
                      (y + 0.5) / height * (ends[1] - ends[0]) * (1 if axis else -1)
                      + ends[0 if axis else 1], "o", mfc="none", mec="c", ms=11, mew=0.8)
        else:
            edges = np.kron(mask, np.ones((20, 20)))  # so that they run around voxels
            axes.contour(edges, [0.5], colors="c", linewidths=0.6, extent=extent,
                         origin="lower" if axis else "upper")
    return drawn


def leaving(cam: Microscope) -> float:
    """2 n f_mu/M^2: nearer to the native plane spots leave the lenslets beside the axis."""
    return 2 * cam.medium_index * cam.mla.f / cam.magnification**2


def spot_pitch(cam: Microscope, frame: np.ndarray, z: float) -> float:
    """Pitch over p of a point's spots behind the lenslets beside the axis; NaN if they leave."""
    n = round(cam.pixels_per_lenslet)
    middle = len(frame) // n // 2
    row = frame[middle * n:(middle + 1) * n].sum(axis=0).reshape(-1, n) ** 2
    at = row @ np.arange(n) / row.sum(axis=1)
    pitch = 1 + (at[middle + 1] - at[middle - 1]) / (2 * n)
    return float(pitch) if abs(z) >= leaving(cam) else np.nan


def draw_frame(axes: Axes, cam: Microscope, light: np.ndarray, shown: int, norm: Any) -> Any:
    """The middle lenslets of a frame over its largest pixel, with their edges."""
    reach, side = cam.grid.extent[0] / cam.mla.pitch / 2, shown / 2
    drawn = axes.imshow(np.maximum(light / light.max(), norm.vmin), cmap=LIGHT, norm=norm,
                        extent=(-reach, reach, reach, -reach), interpolation="antialiased")
    for edge in np.arange(shown + 1) - side:
        axes.axhline(edge, color="w", lw=0.3, alpha=0.6)
        axes.axvline(edge, color="w", lw=0.3, alpha=0.6)
    axes.set(xlim=(-side, side), ylim=(side, -side), xticks=[], yticks=[])
    return drawn


def draw_curve(axes: Axes, z: np.ndarray, found: np.ndarray, colour: str, depths: Any, known: Any,
               words: str) -> None:
    """A number over depth, and as known at some depths."""
    axes.plot(z * 1e6, found, "-", color=colour, lw=1.2)
    axes.plot(np.array(list(depths)) * 1e6, known, "ko", ms=4)
    axes.set(xlabel="z / um", ylabel=words)


def draw_pitch(axes: Axes, cam: Microscope, end: float) -> None:
    """The pitch of the spots by rays, 1 + n f_mu/(M^2 z), as far as a depth."""
    for sign in (-1, 1):
        z = sign * np.linspace(leaving(cam), end, 50)
        axes.plot(z * 1e6, 1 + leaving(cam) / (2 * z), "--", color="0.4", lw=1)
