"""Figures of epipolar slices, with axes that say what they are."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from clplen.lightfield.model.phase_space import PhaseSpace
from clplen.plot.base import LIGHT, Array, Scale, bar, cut, for_display, new_figure, norm_of, styled
from clplen.plot.base import said as scale_said

_MILLI = {"m": 1e3, "rad": 1e3}


@styled
def epi(found: PhaseSpace, *, title: str = "", scale: Scale = "linear") -> Figure:
    """An epipolar slice or phase space: position across, place on the main lens down.

    With a camera, a second axis gives the angle of the rays at the middle of the picture,
    theta = -u/F, in milliradians.

    Parameters
    ----------
    found : PhaseSpace
    title : str
    scale : {"linear", "log", "root"}
        Of the values; colour slices are always linear.
    """
    norm = norm_of(found.values, scale)
    figure = new_figure(7.4, 3.2)
    axes = figure.add_subplot()
    down, across = (
        values * _MILLI.get(unit, 1.0)
        for values, unit in zip((found.direction, found.position), found.units, strict=True)
    )
    drawn = axes.imshow(
        for_display(found.values, norm),
        cmap=LIGHT,
        norm=norm,
        extent=(*_ends(across), *_ends(down)[::-1]),
        aspect="auto",
    )
    views, pixels = found.axes
    places = {"m": f"{views} on the main lens / mm", "view": f"{views} from the middle / view"}
    place = places.get(found.units[0], rf"$\{views}$ / mrad")
    where = "on the image plane / mm" if found.units[1] == "m" else "from the middle / pixel"
    axes.set(
        xlabel=f"{pixels} {where}",
        ylabel=place,
        title=title or f"epipolar slice ({pixels}, {views.replace('_', ' ')})",
    )
    if found.theta is not None and found.units[0] == "m":
        ratio = _milliradians(found)
        other = axes.secondary_yaxis(
            "right",
            functions=(lambda u: np.asarray(u) * ratio, lambda theta: np.asarray(theta) / ratio),
        )
        other.set_ylabel(rf"$\theta = -{views}/F$ at {pixels} = 0 / mrad")
    if found.values.ndim == 2:
        label = f"value of a sample{scale_said(scale)}"
        bar(figure, drawn, axes, label, extend=cut(found.values, norm))
    return figure


def _ends(values: Array) -> tuple[float, float]:
    """Outer borders of the samples of an axis."""
    half = (values[1] - values[0]) / 2 if len(values) > 1 else 0.5
    return float(values[0] - half), float(values[-1] + half)


def _milliradians(found: PhaseSpace) -> float:
    """Angle for a millimetre on the main lens, negative."""
    if found.theta is None or len(found.direction) < 2:
        return -1.0
    step = found.direction[1] - found.direction[0]
    return float((found.theta[1, 0] - found.theta[0, 0]) / step)
