"""Shared parts of all figures: style, colour scales, colour bars, files."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, get_args

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

from clplen.checks import check_positive
from clplen.files import PathLike, replacing
from clplen.outputs import MARK
from clplen.reprs import printable

Array = np.ndarray[Any, Any]
Scale = Literal["linear", "log", "root"]
Region = tuple[slice, slice]

LIGHT = "inferno"  # perceptually uniform: brightness follows the value
FULL_REGION: Region = (slice(None), slice(None))
_DECADES = 3  # range of a logarithmic scale
_NOTEBOOK_DPI = 100  # dots per inch of a picture in a notebook
_ENDINGS = (".png", ".pdf", ".svg")
styled = matplotlib.rc_context(
    {
        "font.size": 9,
        "axes.titlesize": 9,
        "legend.fontsize": 8,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "image.interpolation": "nearest",
    }
)


def save(figure: Figure, path: PathLike, *, dpi: int = 150) -> None:
    """Write a figure atomically as PNG, PDF or SVG.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure, such as the functions of `clplen.plot` return.
    path : path-like
        Output file, ``.png``, ``.pdf`` or ``.svg``.
    dpi : int
        Resolution in dots per inch; in PDF and SVG, resolution of the images.

    Raises
    ------
    ValueError
        If the file has another ending.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> lf = clplen.LightField.from_array(np.ones((3, 3, 16, 16), np.float32))
    >>> clplen.plot.save(clplen.plot.views(lf), "views.png", dpi=50)
    >>> Path("views.png").read_bytes()[1:4]
    b'PNG'
    """
    ending = Path(path).suffix.lower()
    if ending not in _ENDINGS:
        raise ValueError(f"path must end in {', '.join(_ENDINGS)}, got {path}.")
    check_positive(dpi=dpi)
    metadata = {"Software" if ending == ".png" else "Creator": MARK}
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=ending[1:], metadata=metadata)


def rendered(figure: Figure, *, dpi: int = 100) -> Array:
    """Render a figure as an array, for animations.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure, such as the functions of `clplen.plot` return.
    dpi : int
        Resolution in dots per inch.

    Returns
    -------
    numpy.ndarray
        Picture, uint8, shape (y, x, 3), for `clplen.io.write_animation`.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 3, 16, 16), np.float32))
    >>> picture = clplen.plot.rendered(clplen.plot.views(lf), dpi=50)
    >>> picture.dtype, picture.shape[2]
    (dtype('uint8'), 3)
    """
    check_positive(dpi=dpi)
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _png(figure: Figure) -> bytes:
    data = BytesIO()
    figure.savefig(data, format="png", dpi=_NOTEBOOK_DPI)
    return data.getvalue()


class NotebookFigure(Figure):
    """Figure that a notebook shows as the last line of a cell, without pyplot."""

    def _repr_png_(self) -> bytes:
        """Return the figure as PNG."""
        return _png(self)


class FigureDict(dict[str, Figure]):
    """Figures by name, all of which a notebook shows."""

    def _repr_html_(self) -> str:
        """Return the figures as images of a page."""
        pictures = (
            (escape(name, quote=True), b64encode(_png(figure)).decode())
            for name, figure in self.items()
        )
        return "".join(
            f'<img alt="{name}" src="data:image/png;base64,{data}">' for name, data in pictures
        )


def new_figure(width: float, height: float) -> Figure:
    """Create an empty figure of a size in inches, with a layout that avoids overlaps."""
    return NotebookFigure(figsize=(width, height), layout="constrained")


def spread(count: int, limit: int) -> list[int]:
    """Return up to ``limit`` of ``count`` indices in even steps, symmetric about the middle."""
    for number in range(min(count, limit), 1, -1):
        step = (count - 1) // (number - 1)
        left, odd = divmod(count - 1 - (number - 1) * step, 2)
        if not odd and left < step:
            return list(range(left, count, step))
    return [(count - 1) // 2]


def coordinates(count: int, step: float) -> Array:
    """Return coordinates in millimetres from the middle of an axis, sampled every ``step`` m."""
    return (np.arange(count) - (count - 1) / 2) * step * 1e3


def placed(region: Region, shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Return the extent of a part of an image in its own pixels."""
    y, x = (part.indices(n) for part, n in zip(region, shape, strict=False))
    return (x[0] - 0.5, x[1] - 0.5, y[1] - 0.5, y[0] - 0.5)


def centred(shape: tuple[int, ...], step: float) -> tuple[float, float, float, float]:
    """Return the extent of an image about its middle, row 0 at the top."""
    y, x = shape[0] * step / 2, shape[1] * step / 2
    return (-x, x, y, -y)


def norm_of(values: Array, scale: Scale, decades: int = _DECADES) -> Normalize:
    """Return the colour normalization up to the largest finite value; "log" spans decades."""
    if scale not in get_args(Scale):
        raise ValueError(f"scale must be one of {get_args(Scale)}, got {scale!r}.")
    finite = values[np.isfinite(values)]
    highest = float(finite.max() if finite.size else 0.0) or 1.0
    if scale == "log":
        return LogNorm(highest * 10.0**-decades, highest)
    if scale == "root":
        return PowerNorm(0.5, 0, highest)
    return Normalize(min(0.0, float(finite.min(initial=0.0))), highest)


def verbatim(text: str) -> str:
    """Escape a text so that matplotlib draws it unchanged.

    Dollar signs start no formula, and a leading underscore hides no line of a legend.
    """
    hidden = "\u200b" if text.startswith("_") else ""
    return hidden + printable(text).replace("$", r"\$")


def scale_suffix(scale: Scale) -> str:
    """Return the suffix of a colour bar's label for a scale."""
    return {"linear": "", "log": " (logarithmic)", "root": " (square root)"}[scale]


def clipped_sides(values: Array, norm: Normalize) -> str:
    """Return the sides beyond the colour range, as the ``extend`` of a colour bar."""
    below, above = bool((values < norm.vmin).any()), bool((values > norm.vmax).any())
    return {(False, False): "neither", (True, False): "min", (False, True): "max"}.get(
        (below, above), "both"
    )


def for_display(values: Array, norm: Normalize) -> Array:
    """Clip values to the colour range; scale colour pictures linearly to 0 to 1."""
    if values.ndim == 3:
        return np.clip(values / norm.vmax, 0, 1)
    return np.clip(values, norm.vmin, None)


class Shades:
    """Common colour scale of the images of a figure, with a colour bar."""

    def __init__(self, values: Array, scale: Scale, decades: int = _DECADES) -> None:
        self._values, self._scale = values, scale
        self.norm = norm_of(values, scale, decades)
        self._drawn: Any = None

    def show(self, axes: Axes, values: Array, **options: Any) -> None:
        """Draw an image; ``options`` go to `imshow`."""
        picture = for_display(values, self.norm)
        self._drawn = axes.imshow(picture, cmap=LIGHT, norm=self.norm, **options)

    def bar(self, figure: Figure, label: str, **options: Any) -> None:
        """Add the colour bar beside the axes ``ax``, or into the axes ``cax``."""
        if "ax" in options:
            options = {"shrink": 0.9, "pad": 0.02} | options
        extend = clipped_sides(self._values, self.norm)
        figure.colorbar(
            self._drawn, label=label + scale_suffix(self._scale), extend=extend, **options
        )


def draw(
    figure: Figure, axes: Axes, values: Array, scale: Scale, label: str, **options: Any
) -> None:
    """Draw an image, and its colour bar if it has a label; ``options`` go to `imshow`."""
    shades = Shades(values, scale)
    shades.show(axes, values, **{"interpolation": "antialiased"} | options)
    if label:
        shades.bar(figure, label, ax=axes)


def bar(figure: Figure, drawn: Any, axes: Any, label: str, *, extend: str = "neither") -> None:
    """Add a colour bar beside one or several axes."""
    figure.colorbar(drawn, ax=axes, label=label, extend=extend, shrink=0.9, pad=0.02)
