"""Where the beads of a frame lie, and how far the list of their positions is to be trusted.

The lattice comes from the white frame, the focal stack from the views that are bright in it, points
from the stack. Binomial thinning splits the counts of the frame into two of independent noise, the
chequerboard of views its light field into two of other samples: each half has a list of its own.
"""

import beads
import numpy as np
from beads import LIMITS, PLANES, SIZE, STEP, compared, points_of, stack_of
from common import begin
from drawing import bar, new_figure
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from clplen import decode_raw, estimate_lattice
from clplen.analysis import Table
from clplen.microscopy import Points, find_points

SHOWN = 12  # lenslets of the raw frame
LEAST = 1e-4  # what is nearer is drawn there


def favoured(points: Points) -> float:
    """Share of the points off the native plane that lie within half a plane of d = k/2."""
    d = points.positions[:, 0]
    d = d[np.abs(d) > 2 * STEP]
    return float(np.mean(np.abs(d - np.rint(2 * d) / 2) < STEP / 2))


run = begin(__doc__, __file__, quick="a part of the frame, fewer splits")
frame, white, words = beads.frames(run)
print(f"  {words}, {frame.shape[1]} x {frame.shape[0]} pixels")
lattice = estimate_lattice(white)
gain, zero = beads.photon_transfer(white, lattice)
print(f"  lenslets {lattice.pitch[0]:.3f} x {lattice.pitch[1]:.3f} pixels; "
      f"{gain:.3f} grey levels a count, no noise at {zero:.1f}")
flat = white - zero
lf = decode_raw(frame - zero, lattice, device=run.device, white=flat)
stack = stack_of(lf)
found = points_of(stack)
print(f"  {len(found)} beads; width at half height, median: "
      "{:.2f} in d, {:.2f} and {:.2f} lenslets in y and x".format(*np.nanmedian(found.widths, 0)))
print(f"  at d = k/2, k not 0, where 10% lie by chance: {favoured(found):.0%} of them", end="")
for interpolation in ("linear", "fourier"):
    rough = find_points(stack_of(lf, interpolation=interpolation), size=(0, SIZE[1]))
    print(f"; not smoothed over planes, {interpolation} interpolation, {favoured(rough):.0%} of "
          f"{len(rough)}", end="")
print()
off = []
for seed in range(1 if run.quick else 5):
    lists = [points_of(stack_of(decode_raw(half, lattice, device=run.device, white=flat)))
             for half in beads.halves(frame, gain, zero, seed)]
    off.append(compared(f"noise halves, seed {seed}", *lists))
v, u = np.indices(lf.shape[:2])
compared("even and odd views", *(points_of(stack_of(lf, (v + u) % 2 == k)) for k in (0, 1)))
one, other = beads.halves(white, gain, zero, 0)
none = points_of(stack_of(decode_raw(one, lattice, device=run.device, white=other)))
print(f"  white frame alone: {len(none)} points")

header = ("disparity", "y_lenslets", "x_lenslets", "height", "snr", "width_disparity",
          "width_y_lenslets", "width_x_lenslets")
rows = np.column_stack([found.positions, found.peaks, found.snr, found.widths])
Table(header, tuple(map(tuple, rows))).write(run.picture.with_suffix(".csv"))
print(f"  -> {run.picture.with_suffix('.csv')}")

clear = beads.clear(stack.to_numpy())
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
