"""Letters at three depths seen from both sides of the main lens: figures 1.15 and 1.16."""

import numpy as np
from common import Run, mm, number, pixels
from drawing import LIGHT, bar, new_figure
from extended import DEPTHS, PLACES, across, camera, expose, letters, show
from matplotlib.axes import Axes

from clplen import LightField
from clplen.cameras import Plenoptic1

COUNT = 41  # lenslets
RIM = 0.25  # of the views, those outside of the two


def draw(run: Run, axis: int, names: tuple[str, str]) -> None:
    """Two views and the slice between them: ``axis`` 0 for top and bottom, 1 for left and right."""
    cam = camera(run, count=COUNT)
    lf = LightField.from_raw(expose(cam, letters(cam)))
    count, middle = lf.shape[0], (lf.shape[0] - 1) / 2
    ends = (round(RIM * count), count - 1 - round(RIM * count))
    low, high = (pixels(lf.view(*((n, middle) if axis == 0 else (middle, n)))) for n in ends)
    reach = (PLACES[1] - PLACES[0]) / 2 * across(cam)
    across_lens = (ends[0] - ends[1]) * lf.spacing[axis] / cam.lenslet_pitch  # in lenslets
    for (name, dz), image in zip(DEPTHS.items(), _images(cam), strict=True):
        moved = _place(low, axis, image, reach) - _place(high, axis, image, reach)
        number(f"{name}, dz = {mm(dz)}: d{'yx'[axis]}/d{'vu'[axis]} on the lens",
               moved / across_lens, 1 - cam.alpha(dz), 0.06 if run.quick else 0.04, ".3f")
    figure = new_figure(11.4, 3.9)
    panels = figure.subplots(1, 3)
    # Pixels of a sub-image run against u: the first views are those of the largest u.
    for axes, view, name, n in zip(panels, (high, low), names, ends[::-1], strict=False):
        drawn = show(axes, view, cam.lenslet_pitch, high.max())
        axes.set_title(f"from the {name} of the lens, {'vu'[axis]} = "
                       f"{(n - middle) * lf.spacing[axis] * 1e3:+.2f} mm")
    bar(figure, drawn, panels[:2], "value of a sample", extend="max")
    _show_slice(panels[2], cam, lf, axis)
    for axes in panels:
        for at in _images(cam) * cam.lenslet_pitch:
            (axes.axhline if axis == 0 else axes.axvline)(at * 1e3, color="c", lw=0.8, ls=":")
    run.save(figure)


def _images(cam: Plenoptic1) -> np.ndarray:
    """Where the letters are imaged through the lens' centre, in lenslets from the axis."""
    return (0.5 - np.array(PLACES)) * across(cam)


def _place(view: np.ndarray, axis: int, image: float, reach: float) -> float:
    """Centroid along an axis of the squares of a letter's pixels."""
    at = np.arange(view.shape[axis]) - (view.shape[axis] - 1) / 2
    near = abs(at - image) < reach
    profile = (view**2 * near[:, None] * near).sum(axis=1 - axis)
    return float(np.average(at, weights=profile))


def _show_slice(axes: Axes, cam: Plenoptic1, lf: LightField, axis: int) -> None:
    """All views across the lens, summed along the other axis of the picture."""
    middle, views = lf.shape[0] // 2, lf.to_numpy()
    lines = (views[:, middle] if axis == 0 else views[middle]).sum(axis=2 - axis)
    steps = (cam.lenslet_pitch, abs(lf.spacing[axis]))
    side, end = (n * step * 500 for n, step in zip(lines.shape[::-1], steps, strict=True))
    if axis == 0:
        axes.imshow(lines.T, cmap=LIGHT, extent=(end, -end, side, -side), aspect="auto")
        axes.set(xlim=(-end, end), ylim=(-side, side), xlabel="v on the lens / mm", ylabel="y / mm")
    else:
        axes.imshow(lines, cmap=LIGHT, extent=(-side, side, -end, end), aspect="auto")
        axes.set(xlim=(side, -side), ylim=(-end, end), xlabel="x / mm", ylabel="u on the lens / mm")
    axes.set_box_aspect(1)
    axes.set_title(f"all views, summed along {'xy'[axis]}")
