"""Beads in a deconvolved volume, beside those of the refocused frame.

The objective of the real frame is not known: 40x/0.8 in water is assumed, which scales z. Planes
are compared as disparities, d = -M^2 z dx/(n f_mu p), as the focal stack has them without it.
"""

import beads
import numpy as np
from beads import compared, points_of, stack_of
from common import begin
from drawing import bar, new_figure
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from clplen import Projector, decode_raw, deconvolve, estimate_lattice, point_images
from clplen.analysis import Table
from clplen.microscopy import Points, find_points, match_points, preparation

VOXELS = 3  # of a lenslet along an axis
DEPTH = 1.5  # |d| of the outermost planes
ITERATIONS = 30
OFF = 0.25  # |d| from which on a ratio of disparities says something


def volume_of(frame: np.ndarray, some: np.ndarray | float = 1.0) -> np.ndarray:
    """The volume that explains some pixels of a frame, in counts."""
    got = prepared(frame)
    found = deconvolve(got.counts / gain, projector, iterations=ITERATIONS, white=got.white * some)
    print(f"  {ITERATIONS} iterations, relative residual from {found.residuals[0]:.3f} to "
          f"{found.residuals[-1]:.3f}")
    return found.volume


def points_in(volume: np.ndarray) -> Points:
    """Its beads: d of a view's step, y and x in lenslets."""
    return find_points(volume, axes=axes)


def coloured(volume: np.ndarray, axis: int) -> np.ndarray:
    """Highest along an axis, bright in the colour of its plane."""
    highest = volume.max(axis)
    d = axes[0][volume.argmax(0)] if axis == 0 else np.broadcast_to(axes[0][:, None], highest.shape)
    level = np.clip(highest / np.percentile(highest, 98.5), 0, 1)
    return colours.to_rgba(d)[..., :3] * level[..., None] ** 0.7


run = begin(__doc__, __file__, quick="a part of the frame, three planes about the native one")
frame, white, words = beads.frames(run)
cam = beads.camera(run)
print(f"  {words}; {cam.magnification:g}x/{cam.na:g}" + (", assumed" if beads.REAL else ""))
pixels = int(cam.pixels_per_lenslet)
lattice = estimate_lattice(white)
gain, zero = beads.photon_transfer(white, lattice)
flat = white - zero
prepared = preparation(pixels, device=run.device, white=flat)
lf = decode_raw(frame - zero, lattice, device=run.device, white=flat)
scale = pixels / lf.shape[1]  # pixels of a view's step, in which the focal stack has d
d = np.linspace(-0.2, 0.2, 3) if run.quick else np.linspace(-DEPTH, DEPTH, 31)
images = point_images(cam, cam.z(d[::-1] / scale), voxels_per_lenslet=VOXELS, store="float16")
projector = Projector(images, lf.shape[2:], device=run.device)
places = ((np.arange(VOXELS * n) - (VOXELS - 1) / 2) / VOXELS for n in lf.shape[2:])
axes = (d[::-1], *places)
volume = volume_of(frame - zero)
found = points_in(volume)
print(f"  {len(found)} beads; width at half height, median: "
      "{:.2f} in d, {:.2f} and {:.2f} lenslets in y and x".format(*np.nanmedian(found.widths, 0)))
if not run.quick:
    lists = [points_in(volume_of(half / 2)) for half in beads.halves(frame, gain, zero, 0)]
    compared("noise halves", *lists, step=d[1] - d[0])
    square = np.add.outer(*(np.arange(n) // 2 for n in projector.frame_shape)) % 2
    lists = [points_in(volume_of(frame - zero, square == k)) for k in (0, 1)]
    compared("chequerboard of pixels", *lists, step=d[1] - d[0])
refocused = points_of(stack_of(lf))
pairs = match_points(refocused.positions, found.positions, tolerance=(0.2, 1, 1))
first, second = refocused.positions[pairs[:, 0]], found.positions[pairs[:, 1]]
apart = np.hypot(*(first - second)[:, 1:].T)
far = np.abs(second[:, 0]) > OFF
print(f"  {len(pairs)} of {len(refocused)} refocused points in the volume, median distance "
      f"{np.median(apart):.2f} lenslets")
if far.any():
    print(f"  their d is {np.median(first[far, 0] / second[far, 0]):.3f} times that in the volume "
          f"(median of {far.sum()} with abs(d) > {OFF})")

header = ("z_m", "disparity", "y_lenslets", "x_lenslets", "height", "snr", "width_disparity",
          "width_y_lenslets", "width_x_lenslets")
rows = np.column_stack([cam.z(found.positions[:, 0] / scale), found.positions, found.peaks,
                        found.snr, found.widths])
Table(header, tuple(map(tuple, rows))).write(run.picture.with_suffix(".csv"))
print(f"  -> {run.picture.with_suffix('.csv')}")

reach = float(np.percentile(np.abs(found.positions[:, 0]), 97))
colours = ScalarMappable(Normalize(-reach, reach), "turbo")
figure = new_figure(12, 9)
panels = figure.subplot_mosaic("aac;bbd", height_ratios=(1.5, 1), width_ratios=(1, 1, 1.1))
height, width = (n - 0.5 for n in lf.shape[2:])
panels["a"].imshow(coloured(volume, 0), extent=(-0.5, width, height, -0.5))
panels["a"].set(xlabel="x / lenslets", ylabel="y / lenslets", title="volume, highest over z")
ends = (d[0] - (d[1] - d[0]) / 2, d[-1] + (d[1] - d[0]) / 2)
panels["b"].imshow(coloured(volume, 1), extent=(-0.5, width, *ends), aspect="auto")
panels["b"].set(xlabel="x / lenslets", ylabel="d / lenslets a pixel",
                title="volume, highest over y")
sharp = beads.clear(stack_of(lf).to_numpy())
panels["c"].imshow(sharp.max(0), cmap="gray", vmax=np.percentile(sharp.max(0), 99),
                   extent=(-0.5, width, height, -0.5))
panels["c"].set(xlabel="x / lenslets", title="refocused, highest over d; points")
refocused_d, y, x = refocused.positions.T
panels["c"].scatter(x, y, s=12, facecolors="none", edgecolors=colours.to_rgba(refocused_d), lw=0.8)
panels["d"].axline((0, 0), slope=1, color="0.6", lw=0.8, label="the same")
panels["d"].axline((0, 0), slope=1.12, color="0.6", lw=0.8, ls=":", label="12 % more")
panels["d"].plot(second[:, 0], first[:, 0], "k.", ms=3)
panels["d"].set(xlabel="d in the volume", ylabel="d refocused", xlim=ends, ylim=ends)
panels["d"].legend(loc="upper left")
bar(figure, colours, [panels["a"], panels["b"]], "d / lenslets a pixel: nearer is larger",
    extend="both")
figure.supxlabel(words + (", objective assumed" if beads.REAL else ""))
run.save(figure)
