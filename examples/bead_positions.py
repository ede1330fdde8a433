"""Where the beads of a frame lie, and how far the list of their positions is to be trusted.

The lattice comes from the white frame, the focal stack from the views that are bright in it, points
from the stack. Binomial thinning splits the counts of the frame into two of independent noise, the
chequerboard of views its light field into two of other samples: each half has a list of its own.
"""

import beads
import numpy as np
from common import begin
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from scipy.ndimage import gaussian_filter

from clplen.analysis.tables import Table
from clplen.lightfield.calibration import estimate_lattice
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.refocus import FocalStack, focal_stack
from clplen.microscopy.points import Points, find_points, match_points
from clplen.plot.base import bar, new_figure

STEP = 0.05  # lenslets a pixel of a sub-image, between planes
PLANES = STEP * np.arange(-30, 31)
SIZE = (2.3, 0.64)  # planes, lenslets: sigma of a point, its width at half height over 2.35
DISTANCE = (4.0, 1.5)  # planes, lenslets: nearer ones are not told apart
LIMITS = (1.0, 0.3)  # planes, lenslets: what is to hold
WITHIN = (4 * STEP, 1.5, 1.5)  # further apart are not of the same bead
SHOWN = 12  # lenslets of the raw frame
LEAST = 1e-4  # what is nearer is drawn there


def stack_of(lf: LightField, some: np.ndarray | float = 1.0) -> FocalStack:
    """Refocused on all planes, from the bright views; linear interpolation would favour d = k/2."""
    return focal_stack(lf, disparities=PLANES, aperture=beads.bright(lf) * some,
                       interpolation="fourier")


def points_of(stack: FocalStack) -> Points:
    """The beads of a stack."""
    return find_points(stack, size=SIZE, distance=DISTANCE)


def compared(what: str, first: Points, second: Points) -> np.ndarray:
    """Differences (planes, lenslets) of two lists of the same beads, and a line on them."""
    pairs = match_points(first.positions, second.positions, within=WITHIN)
    far = first.positions[pairs[:, 0]] - second.positions[pairs[:, 1]]
    off = np.stack([np.abs(far[:, 0]) / STEP, np.hypot(far[:, 1], far[:, 2])], axis=1)
    rms, most = np.sqrt((off**2).mean(0)), off.max(0)
    held = int((off <= LIMITS).all(1).sum())
    print(f"  {what:<24} {len(first):4d} and {len(second):4d} points, {len(pairs):4d} in both, "
          f"{held:4d} within limits; rms {rms[1]:.3f} lenslets, {rms[0]:.3f} planes, "
          f"largest {most[1]:.3f}, {most[0]:.3f}")
    alone = [one.snr[np.setdiff1d(np.arange(len(one)), pairs[:, k])]
             for k, one in enumerate((first, second))]
    words = ", ".join(f"{snr:.2f}" for snr in np.sort(np.concatenate(alone))[::-1])
    print(f"    in one list only: {'snr ' + words if words else 'none'}")
    return off


run = begin(__doc__, __file__, quick="a part of the frame, fewer splits")
frame, white, words = beads.frames(run)
print(f"  {words}, {frame.shape[1]} x {frame.shape[0]} pixels")
lattice = estimate_lattice(white)
gain, zero = beads.photon_transfer(white, lattice)
print(f"  lenslets {lattice.pitch[0]:.3f} x {lattice.pitch[1]:.3f} pixels; "
      f"{gain:.3f} grey levels a count, no noise at {zero:.1f}")
flat = white - zero
lf = beads.views(run, frame - zero, lattice, flat)
stack = stack_of(lf)
found = points_of(stack)
print(f"  {len(found)} beads; width at half height, median: "
      "{:.2f} in d, {:.2f} and {:.2f} lenslets in y and x".format(*np.nanmedian(found.widths, 0)))
off = []
for seed in range(1 if run.quick else 5):
    lists = [points_of(stack_of(beads.views(run, half, lattice, flat)))
             for half in beads.halves(frame, gain, zero, seed)]
    off.append(compared(f"noise halves, seed {seed}", *lists))
v, u = np.indices(lf.shape[:2])
compared("even and odd views", *(points_of(stack_of(lf, (v + u) % 2 == k)) for k in (0, 1)))
one, other = beads.halves(white, gain, zero, 0)
none = points_of(stack_of(beads.views(run, one, lattice, other)))
print(f"  white frame alone: {len(none)} points")

header = ("disparity", "y_lenslets", "x_lenslets", "height", "snr", "width_disparity",
          "width_y_lenslets", "width_x_lenslets")
rows = np.column_stack([found.positions, found.peaks, found.snr, found.widths])
Table(header, tuple(map(tuple, rows))).write(run.picture.with_suffix(".csv"))
print(f"  -> {run.picture.with_suffix('.csv')}")

values = stack.to_numpy()
clear = np.maximum(values - gaussian_filter(values, (0, 2, 2), mode="nearest"), 0)
d, y, x = found.positions.T
figure = new_figure(11, 8.2)
panels = figure.subplot_mosaic("ab;cd", width_ratios=(1, 1.25))
grid = lf.raw.sub_images
at = np.array(grid.first) + y[:, None] * grid.row_step + x[:, None] * grid.column_step
best = int(np.argmax(found.peaks))
side = SHOWN / 2 * lattice.pitch[0]
cy, cx = (float(np.clip(c, side, n - side)) for c, n in zip(at[best], frame.shape, strict=True))
light = np.maximum(frame - zero, 0) ** 0.5
panels["a"].imshow(light, cmap="gray", vmax=np.percentile(light, 99.95))
panels["a"].set(xlim=(cx - side, cx + side), ylim=(cy + side, cy - side), xlabel="x / pixels",
                ylabel="y / pixels", title=f"raw frame about the brightest bead, {SHOWN} lenslets")
panels["b"].imshow(clear.max(0), cmap="gray", vmax=np.percentile(clear.max(0), 99))
panels["b"].set(xlabel="x / lenslets", ylabel="y / lenslets", title="refocused, highest over d")
ends = (-0.5, clear.shape[2] - 0.5, PLANES[-1] + STEP / 2, PLANES[0] - STEP / 2)
panels["d"].imshow(clear.max(1), cmap="gray", aspect="auto", extent=ends,
                   vmax=np.percentile(clear.max(1), 99))
panels["d"].set(xlabel="x / lenslets", ylabel="d / lenslets a pixel", title="highest over y")
colours = ScalarMappable(Normalize(PLANES[0], PLANES[-1]), "turbo")
for key, down, across, s in (("a", at[:, 0], at[:, 1], 700), ("b", y, x, 45), ("d", d, x, 25)):
    panels[key].scatter(across, down, s=s, facecolors="none", edgecolors=colours.to_rgba(d), lw=1)
every = np.maximum(np.concatenate(off), LEAST)
panels["c"].loglog(every[:, 1], every[:, 0], ".", ms=3)
panels["c"].plot([LEAST, LIMITS[1], LIMITS[1]], [LIMITS[0], LIMITS[0], LEAST], "k:")
panels["c"].set(xlabel="apart / lenslets", ylabel="apart / planes", xlim=(LEAST, 2),
                ylim=(LEAST, 5), title="the same bead in two noise halves; dotted: limits")
bar(figure, colours, [panels["b"], panels["d"]], "d / lenslets a pixel: nearer is larger")
figure.supxlabel(words)
run.save(figure)
