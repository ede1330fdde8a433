"""Side views of optical systems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from clplen.plot.base import Array, new_figure, styled
from clplen.plot.rays import (
    LINE,
    Label,
    Rays,
    in_rows,
    is_on_lenslets,
    lenslet_rows,
    names,
    opening,
    rays_through,
    spans,
)
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.systems.components import ConvergingLight, Lens, Part, Stop, length_of
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.space import Space

_AXIAL, _OBLIQUE, _GLASS, _RIM, _LIGHT = "#0072b2", "#cc3311", "#d7e8f4", "#33536b", "#e69f00"
_WIDTH, _LEFT, _RIGHT, _HEIGHT = 7.8, 0.68, 0.22, 2.7  # inches: figure, margins, drawing
_MARGIN = 0.07  # of the length, beyond the first and the last plane
_HEADROOM = 1.12  # height of the view over that of its content
_ASIDE, _MIN_GAP = 0.13, 0.1  # inches from a focal point to its name, from a name to a ray


@dataclass(frozen=True)
class _View:
    """Axes of the drawing in metres, with metres per inch along z and y."""

    figure: Figure
    axes: Axes
    z_inch: float
    y_inch: float
    reach: float

    def below(self, inches: float) -> float:
        """Return the height in metres of a position in inches below the drawing."""
        return -self.reach - inches * self.y_inch

    def above(self, inches: float) -> float:
        """Return the height in metres of a position in inches above the drawing."""
        return self.reach + inches * self.y_inch


@styled
def system(
    optics: OpticalSystem, *, extent: float | None = None, height: float | None = None
) -> Figure:
    """Draw a side view of an optical system to scale along z, with paraxial rays.

    The drawing contains the optical axis, lenses, stops and lenslets in their size, distances,
    focal points, and two bundles of rays that just pass every opening: from the axis, and from an
    off-axis point with its chief ray. For a first element in the first plane, the light is
    collimated. Arrows are the object and its images, except images on lenslets.

    Parameters
    ----------
    optics : OpticalSystem
        Optical system of parts and distances.
    extent : float, optional
        Height of the view in metres; default the height of its content.
    height : float, optional
        Height of the off-axis object point in metres; default 70 % of the widest half opening, less
        if an image is larger than the object. Ignored for collimated light.

    Returns
    -------
    matplotlib.figure.Figure
        Heights in mm; labels give distances, focal lengths and diameters.

    Raises
    ------
    TypeError
        If ``optics`` is not an `OpticalSystem`.
    ValueError
        If the extent is not positive, or the height is not finite.

    Examples
    --------
    >>> optics = clplen.OpticalSystem([0.24, clplen.wave.Lens(0.12, diameter=3.6e-3), 0.24])
    >>> figure = clplen.plot.system(optics)
    >>> texts = [" ".join(text.get_text().split()) for text in figure.axes[0].texts]
    >>> [text for text in texts if "mm" in text]
    ['lens f = 120 mm D = 3.6 mm', '240 mm', '240 mm']
    """
    if not isinstance(optics, OpticalSystem):
        raise TypeError(
            f"optics must be an OpticalSystem, got {type(optics).__name__}: create it from a list "
            "of parts and distances, OpticalSystem([...])."
        )
    if extent is not None and not 0 < extent < np.inf:
        raise ValueError(f"extent must be positive, in metres, got {extent!r}.")
    if height is not None and not np.isfinite(height):
        raise ValueError(f"height must be finite, in metres, got {height!r}.")
    rays = rays_through(optics, height=height)
    reach = _reach(optics, rays) if extent is None else extent / 2
    first, last = _ends(optics, reach)
    z_inch = (last - first) / (_WIDTH - _LEFT - _RIGHT)
    above, below = in_rows(names(optics, rays), z_inch), in_rows(spans(optics), z_inch)
    top = 0.12 + sum(LINE * max(len(label.lines) for label in row) + 0.06 for row in above)
    view = _new_view((first, last), reach, top, 0.45 + 0.19 * max(len(below), 1))
    _draw_frame(view.axes)
    _draw_rays(view, optics, rays)
    for part, z in zip(optics, optics.positions, strict=True):
        _draw_part(view, part, z)
    _draw_planes(view, optics, rays)
    _draw_focal_points(view, optics, rays)
    _write_names(view, above)
    _write_spans(view, below)
    return _with_caption(view, rays)


def _new_view(ends: tuple[float, float], reach: float, top: float, bottom: float) -> _View:
    """Create an empty drawing with margins for labels above and below, in inches."""
    total = _HEIGHT + top + bottom
    width = _WIDTH - _LEFT - _RIGHT
    figure = new_figure(_WIDTH, total)
    figure.set_layout_engine("none")
    axes = figure.add_axes(
        (_LEFT / _WIDTH, bottom / total, width / _WIDTH, _HEIGHT / total),
        xlim=ends,
        ylim=(-reach, reach),
    )
    return _View(figure, axes, (ends[1] - ends[0]) / width, 2 * reach / _HEIGHT, reach)


def _ends(optics: OpticalSystem, reach: float) -> tuple[float, float]:
    """Return the limits of the view along z in metres."""
    z = [*optics.positions, optics.length]
    length = max(z) - min(z) or 2 * reach
    return min(z) - _MARGIN * length, max(z) + _MARGIN * length


def _reach(optics: OpticalSystem, rays: Rays) -> float:
    """Return half the height in metres of openings, rays and images."""
    heights = [abs(rays.height), *(abs(image.height) for image in rays.images)]
    heights += [abs(bound) for part in optics for bound in opening(part) or ()]
    for bundle in (rays.axial, rays.oblique):
        if bundle is not None:
            heights.append(float(np.nanmax(np.abs(bundle))))
    return _HEADROOM * max(heights) or 1e-3


def _draw_frame(axes: Axes) -> None:
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color("0.6")
    axes.tick_params(color="0.6", labelcolor="0.35")
    axes.set_xticks([])
    axes.set_ylabel("y / mm", color="0.35")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value * 1e3:.6g}".replace("-", "\u2212"))
    axes.axhline(0, color="0.45", lw=0.8, ls=(0, (14, 3, 2, 3)), zorder=1)


def _draw_rays(view: _View, optics: OpticalSystem, rays: Rays) -> None:
    """Draw both bundles, filled up to the first lenslets."""
    first = [i for i, part in enumerate(optics) if isinstance(part, MicrolensArray)]
    filled = slice(0, (first[0] if first else len(optics)) + 1)
    for bundle, colour, tilt in ((rays.oblique, _OBLIQUE, rays.tilt), (rays.axial, _AXIAL, 0.0)):
        if bundle is None:
            continue
        z, heights = _extended(view, rays, bundle, tilt)
        filled_part = slice(0, filled.stop + rays.distant)
        view.axes.fill_between(
            z[filled_part],
            heights[filled_part, 0],
            heights[filled_part, -1],
            color=colour,
            alpha=0.1,
            lw=0,
            zorder=2,
        )
        view.axes.plot(z, heights[:, [0, -1]], color=colour, lw=1.1, zorder=2)
        if first:
            view.axes.plot(z, heights[:, 1:-1], color=colour, lw=0.4, alpha=0.8, zorder=2)
    if rays.chief is not None:
        z, chief = _extended(view, rays, rays.chief, rays.tilt)
        view.axes.plot(z, chief, color=_OBLIQUE, lw=0.9, ls=(0, (5, 2)), zorder=3)


def _extended(view: _View, rays: Rays, heights: Array, tilt: float) -> tuple[Array, Array]:
    """Extend collimated rays to the edge of the drawing."""
    if not rays.distant:
        return rays.z, heights
    left = view.axes.get_xlim()[0]
    before = heights[:1] - tilt * (rays.z[0] - left)
    return np.array([left, *rays.z]), np.concatenate([before, heights])


def _draw_part(view: _View, part: Part, z: float) -> None:
    if isinstance(part, Space):
        return
    if isinstance(part, Lens):
        half = view.reach if part.diameter is None else part.diameter / 2
        _draw_lenses(view, z, [0.0], half, part.focal_length)
        if part.diameter is not None:
            _draw_walls(view, z, -half, half, min(view.reach, half + 0.17 * view.y_inch), 2.0)
    elif isinstance(part, MicrolensArray):
        _draw_lenses(view, z, lenslet_rows(part), part.diameter / 2, part.focal_length)
    elif isinstance(part, Stop):
        low, high = part.centre[0] - part.diameter / 2, part.centre[0] + part.diameter / 2
        _draw_walls(view, z, low, high, view.reach, 3.0)
    elif isinstance(part, ConvergingLight):
        _draw_light(view, z, part.z)
    else:
        ends = (z, z + length_of(part))
        view.axes.axvspan(*ends, color="0.5", alpha=0.15, lw=0)
        view.axes.vlines(ends, -view.reach, view.reach, color="0.5", lw=0.9, ls=(0, (3, 2)))


def _draw_lenses(
    view: _View, z: float, centres: Sequence[float] | Array, half: float, f: float
) -> None:
    """Draw biconvex or biconcave outlines of equal size, with a thickness for legibility."""
    inches = half / view.y_inch
    thick = min(0.085, 0.3 * inches + 0.008) * view.z_inch
    y = np.linspace(-1, 1, 41)
    bulge = thick * (1 - y**2 if f > 0 else 0.25 + 0.75 * y**2)
    outline = np.column_stack([np.r_[z + bulge, (z - bulge)[::-1]], np.r_[y, y[::-1]] * half])
    shapes = [outline + np.array([0.0, centre]) for centre in centres]
    glass = PolyCollection(
        shapes, facecolor=_GLASS, edgecolor=_RIM, lw=min(1.0, 0.25 + inches), zorder=4, alpha=0.9
    )
    view.axes.add_collection(glass, autolim=False)


def _draw_walls(view: _View, z: float, low: float, high: float, end: float, width: float) -> None:
    """Draw the opaque parts of a stop."""
    view.axes.vlines([z, z], [-end, high], [low, end], color="0.15", lw=width, zorder=5)


def _draw_light(view: _View, z: float, focus: float) -> None:
    """Draw light that converges to a point on the axis behind a plane."""
    left = z - 0.8 * (z - view.axes.get_xlim()[0])
    for share in (-0.6, -0.3, 0.3, 0.6):
        y = share * view.reach
        style = {"arrowstyle": "-|>", "color": _LIGHT, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
        start = (left, y * (z + focus - left) / focus)
        view.axes.annotate("", (z, y), start, arrowprops=style, annotation_clip=False)
        view.axes.plot([z, z + focus], [y, 0], color=_LIGHT, lw=0.8, ls=":", zorder=2)


def _draw_planes(view: _View, optics: OpticalSystem, rays: Rays) -> None:
    """Draw first and last plane, the object and its images."""
    tall = 0.97 * view.reach
    planes = ([] if rays.distant else [0.0]) + (
        [] if _ends_with_element(optics) else [optics.length]
    )
    view.axes.vlines(planes, -tall, tall, color="0.35", lw=0.9, zorder=4)
    style = {"arrowstyle": "-|>", "color": "0.1", "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    arrows = [(0.0, rays.height), *((image.z, image.height) for image in rays.images)]
    for z, height in arrows:
        if height and not is_on_lenslets(optics, z):
            view.axes.annotate("", (z, height), (z, 0), arrowprops=style, zorder=6)


def _ends_with_element(optics: OpticalSystem) -> bool:
    """Return True if the last plane has its own drawing."""
    return not length_of(optics[-1]) and not isinstance(optics[-1], Space | ConvergingLight)


def _draw_focal_points(view: _View, optics: OpticalSystem, rays: Rays) -> None:
    """Draw focal points within the view; number the lenses if there are several."""
    halo = [withStroke(linewidth=2.5, foreground="w", alpha=0.8)]
    lenses = [
        (part.focal_length, z)
        for part, z in zip(optics, optics.positions, strict=True)
        if isinstance(part, Lens) and np.isfinite(part.focal_length)
    ]
    labels: dict[float, str] = {}
    first, last = view.axes.get_xlim()
    for number, (f, z) in enumerate(lenses, 1):
        index = f"_{number}" if len(lenses) > 1 else ""
        for focus, name in ((z - f, f"$F{index}$"), (z + f, f"$F'{index}$")):
            position = next((p for p in labels if abs(p - focus) < 0.05 * view.z_inch), focus)
            if first < focus < last:
                labels[position] = f"{labels[position]}, {name}" if position in labels else name
    for focus, name in labels.items():
        view.axes.plot(focus, 0, "o", color="0.15", ms=3.2, zorder=6)
        centre = _label_position(view, rays, focus, 0.13 + 0.12 * name.count(","))
        text = view.axes.text(*centre, name, ha="center", va="center", size=8, color="0.15")
        text.set(zorder=6, path_effects=halo)


def _label_position(view: _View, rays: Rays, z: float, offset: float) -> tuple[float, float]:
    """Return a label position near a point of the axis, clear of marginal and chief rays."""
    inch = np.array([view.z_inch, view.y_inch])
    lines = []
    for bundle, tilt in ((rays.axial, 0.0), (rays.oblique, rays.tilt), (rays.chief, rays.tilt)):
        if bundle is not None:
            along, heights = _extended(view, rays, bundle, tilt)
            lines += [np.column_stack([along, y]) / inch for y in (heights[:, 0], heights[:, -1])]
    distances = (_ASIDE, 1.5 * _ASIDE, 2 * _ASIDE)
    sides = [(x, y) for far in distances for y in (-far, far) for x in (offset, -offset, 0.0)]
    positions = [np.array([z / view.z_inch, 0.0]) + side for side in sides]
    gaps = [
        min((_distance(position, line) for line in lines), default=_MIN_GAP)
        for position in positions
    ]
    best = next((i for i, gap in enumerate(gaps) if gap >= _MIN_GAP), int(np.argmax(gaps)))
    return float(positions[best][0] * inch[0]), float(positions[best][1] * inch[1])


def _distance(point: Array, line: Array) -> float:
    """Return the distance from a point to a polyline of shape (points, 2), ignoring NaN."""
    start, step = line[:-1], np.diff(line, axis=0)
    squares = np.maximum((step**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(((point - start) * step).sum(axis=1) / squares, 0, 1)
    gaps = np.hypot(*(start + share[:, None] * step - point).T)
    return float(np.min(gaps[np.isfinite(gaps)], initial=np.inf))


def _write_names(view: _View, rows: list[list[Label]]) -> None:
    inches = 0.08
    style: dict[str, Any] = {"ha": "center", "va": "bottom", "bbox": {"color": "w", "pad": 0.8}}
    for row in rows:
        for label in row:
            high = view.above(inches)
            if inches > 0.1:
                view.axes.plot(
                    [label.z] * 2, [view.reach, high], color="0.75", lw=0.6, clip_on=False
                )
            view.axes.text(label.z, high, label.text, linespacing=1.15, **style)
        inches += LINE * max(len(label.lines) for label in row) + 0.06


def _write_spans(view: _View, rows: list[list[Label]]) -> None:
    """Write distances as in a technical drawing."""
    line = view.below(0.16)
    style = {"arrowstyle": "<|-|>", "color": "0.25", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    style["mutation_scale"] = 7
    for row, members in enumerate(rows):
        for label in members:
            for z in label.ends:
                view.axes.plot(
                    [z, z], [-view.reach, view.below(0.22)], color="0.6", lw=0.6, clip_on=False
                )
            narrow = abs(label.ends[1] - label.ends[0]) < 0.2 * view.z_inch
            view.axes.annotate(
                "",
                (label.ends[1], line),
                (label.ends[0], line),
                annotation_clip=False,
                arrowprops=style | {"arrowstyle": "-"} if narrow else style,
            )
            low = view.below(0.24 + 0.19 * row)
            view.axes.text(label.z, low, label.text, ha="center", va="top", size=8.5)


def _with_caption(view: _View, rays: Rays) -> Figure:
    """Add the legend of colours and the ratio of the axes."""
    notes = []
    if rays.axial is not None:
        notes.append(f"blue: rays {'along' if rays.distant else 'from'} the axis")
    if rays.oblique is not None:
        notes.append("red: tilted rays" if rays.distant else "red: rays from a point beside it")
    if rays.chief is not None:
        notes.append("chief ray dashed")
    notes.append(f"heights to lengths {view.z_inch / view.y_inch:.4g} : 1")
    low = 0.07 / view.figure.get_figheight()
    right = 1 - _RIGHT / _WIDTH
    view.figure.text(right, low, "; ".join(notes), ha="right", size=7.5, color="0.35")
    return view.figure
