"""Figures of volumes reconstructed from a light-field microscope."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clplen.checks import check_finite
from clplen.errors import ShapeError
from clplen.microscopy.reconstruction.deconvolution import DeconvolutionResult
from clplen.plot.base import Scale, Shades, new_figure, styled

Pair = tuple[float, float]

_MICRONS = 1e6
_WIDTH = 7.0  # inches
_MIN_DEPTH = 0.15  # smallest width of the depth panels over the picture's side
_PROJECTIONS: dict[str, Any] = {"maximum": np.max, "mean": np.mean}


@styled
def volume(
    result: DeconvolutionResult,
    *,
    title: str = "",
    scale: Scale = "linear",
    projection: str = "maximum",
) -> Figure:
    """Draw three projections of a volume: along z, and along x and y beside and below it.

    Axes are in micrometres from the middle of the volume and from the native plane if the result
    has planes and voxels, else in voxels. Planes are drawn in even steps.

    Parameters
    ----------
    result : DeconvolutionResult
        Deconvolution of one frame.
    title : str
        Title over the projection along z; default the kind of projection.
    scale : {"linear", "log", "root"}
        Colour scale.
    projection : {"maximum", "mean"}
        Projection of the voxels along a line.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels with a common colour scale.

    Raises
    ------
    ShapeError
        If the result is a series of volumes.
    ValueError
        If the projection or the scale is unknown.

    Examples
    --------
    >>> voxels = np.random.default_rng(1).random((5, 16, 16), np.float32)
    >>> planes = np.linspace(-20e-6, 20e-6, 5)
    >>> result = clplen.microscopy.DeconvolutionResult(
    ...     voxels, np.ones(3), 3, (), planes=planes, voxel=(2e-6, 2e-6))
    >>> figure = clplen.plot.volume(result)
    >>> [axes.get_xlabel() for axes in figure.axes[1:3]]
    ['z / µm', 'x / µm']
    """
    if projection not in _PROJECTIONS:
        raise ValueError(f'projection must be "maximum" or "mean", got {projection!r}.')
    if result.volume.ndim != 3:
        raise ShapeError(
            f"volume must have shape (planes, y, x), got {result.volume.shape}: draw one frame."
        )
    along = _PROJECTIONS[projection]
    from_z, from_y, from_x = (along(result.volume, axis=axis) for axis in range(3))
    z, y, x, unit = _ends(result)
    deep = max(_MIN_DEPTH, min(1.0, abs(z[1] - z[0]) / abs(x[1] - x[0])))
    ratio = min(2.0, abs(y[1] - y[0]) / abs(x[1] - x[0]))
    figure = new_figure(_WIDTH, _WIDTH * 0.8 * (ratio + deep) / (1 + deep) + 0.4)
    panels = figure.subplots(2, 2, width_ratios=(1, deep), height_ratios=(ratio, deep))
    shades = Shades(np.concatenate([a.ravel() for a in (from_z, from_y, from_x)]), scale)
    for panel, values, across, down in (
        (panels[0, 0], from_z, x, y), (panels[0, 1], from_x.T, z, y), (panels[1, 0], from_y, x, z)
    ):  # fmt: skip
        shades.show(panel, values, extent=(*across, *down[::-1]), aspect="auto")
    panels[0, 0].set(ylabel=f"y / {unit[1]}", title=title or f"{projection} along z, y and x")
    panels[0, 1].set(xlabel=f"z / {unit[0]}", yticklabels=[])
    panels[1, 0].set(xlabel=f"x / {unit[1]}", ylabel=f"z / {unit[0]}")
    panels[1, 1].set_axis_off()
    shades.bar(figure, "energy of a voxel", ax=list(panels.ravel()))
    return figure


def _ends(result: DeconvolutionResult) -> tuple[Pair, Pair, Pair, tuple[str, str]]:
    """Return outer edges along z, y and x, and the units of z and of y and x."""
    count, ny, nx = result.volume.shape
    z, units = (-0.5, count - 0.5), ["plane", "voxel"]
    if result.planes is not None:
        first, last = (float(result.planes[k]) * _MICRONS for k in (0, -1))
        half = (last - first) / (count - 1) / 2 if count > 1 else 0.5
        z, units[0] = (first - half, last + half), "µm"
    steps = (1.0, 1.0)
    if result.voxel is not None:
        check_finite(voxel=result.voxel)
        steps = (result.voxel[0] * _MICRONS, result.voxel[1] * _MICRONS)
        units[1] = "µm"
    y, x = ((-n * step / 2, n * step / 2) for n, step in zip((ny, nx), steps, strict=True))
    return z, y, x, (units[0], units[1])
