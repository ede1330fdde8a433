"""What all figures share: style, scales of values, colour bars, files."""

from __future__ import annotations

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
WHOLE: Region = (slice(None), slice(None))
_DECADES = 3
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
    """Write a figure as PNG, PDF or SVG, whole or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        What is written, as the functions of `clplen.plot` return it.
    path : path-like
        ``.png``, ``.pdf`` or ``.svg``.
    dpi : int
        Dots an inch; in PDF and SVG, of the images in it.

    Raises
    ------
    ValueError
        For another ending.
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
        raise ValueError(
            f"A figure is written as {', '.join(_ENDINGS)}, not as {path}: name a "
            "file that ends so."
        )
    check_positive(dpi=dpi)
    about = {"Software" if ending == ".png" else "Creator": MARK}
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=ending[1:], metadata=about)


def rendered(figure: Figure, *, dpi: int = 100) -> Array:
    """Return a figure as a picture, for films.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        As the functions of `clplen.plot` return it.
    dpi : int
        Dots an inch.

    Returns
    -------
    numpy.ndarray
        uint8, shape (y, x, 3), what `clplen.io.write_animation` takes.

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


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of so many inches, laid out so that nothing overlaps."""
    return Figure(figsize=(width, height), layout="constrained")


def spread(count: int, shown: int) -> list[int]:
    """At most ``shown`` of ``count`` indices in even steps, symmetric about the middle."""
    for number in range(min(count, shown), 1, -1):
        step = (count - 1) // (number - 1)
        left, odd = divmod(count - 1 - (number - 1) * step, 2)
        if not odd and left < step:
            return list(range(left, count, step))
    return [(count - 1) // 2]


def coordinates(count: int, step: float) -> Array:
    """Return millimetres from the middle of an axis of samples ``step`` metres apart."""
    return (np.arange(count) - (count - 1) / 2) * step * 1e3


def placed(region: Region, shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Extent of a part of an image in its own pixels."""
    y, x = (part.indices(n) for part, n in zip(region, shape, strict=False))
    return (x[0] - 0.5, x[1] - 0.5, y[1] - 0.5, y[0] - 0.5)


def centred(shape: tuple[int, ...], step: float) -> tuple[float, float, float, float]:
    """Return the extent of an image about its middle, row 0 at the top."""
    y, x = shape[0] * step / 2, shape[1] * step / 2
    return (-x, x, y, -y)


def norm_of(values: Array, scale: Scale, decades: int = _DECADES) -> Normalize:
    """Return how values become colours, up to the largest finite one; "log" over decades."""
    if scale not in get_args(Scale):
        raise ValueError(f"A scale of values is one of {get_args(Scale)}, not {scale!r}.")
    known = values[np.isfinite(values)]
    highest = float(known.max() if known.size else 0.0) or 1.0
    if scale == "log":
        return LogNorm(highest * 10.0**-decades, highest)
    if scale == "root":
        return PowerNorm(0.5, 0, highest)
    return Normalize(min(0.0, float(known.min(initial=0.0))), highest)


def verbatim(text: str) -> str:
    """Return a name or another foreign text as matplotlib draws it unchanged.

    Dollar signs begin no formula, and an underscore at the beginning hides no line of a legend.
    """
    hidden = "\u200b" if text.startswith("_") else ""
    return hidden + printable(text).replace("$", r"\$")


def said(scale: Scale) -> str:
    """The words that a colour bar adds."""
    return {"linear": "", "log": " (logarithmic)", "root": " (square root)"}[scale]


def cut(values: Array, norm: Normalize) -> str:
    """On which sides the colours leave values out, as the arrows of a colour bar."""
    below, above = bool((values < norm.vmin).any()), bool((values > norm.vmax).any())
    return {(False, False): "neither", (True, False): "min", (False, True): "max"}.get(
        (below, above), "both"
    )


def for_display(values: Array, norm: Normalize) -> Array:
    """Return values that the colour scale can show; colours become 0 to 1, linearly."""
    if values.ndim == 3:
        return np.clip(values / norm.vmax, 0, 1)
    return np.clip(values, norm.vmin, None)


class Shades:
    """One scale of values for the images of a figure, with one colour bar."""

    def __init__(self, values: Array, scale: Scale, decades: int = _DECADES) -> None:
        self._values, self._scale = values, scale
        self.norm = norm_of(values, scale, decades)
        self._drawn: Any = None

    def show(self, axes: Axes, values: Array, **how: Any) -> None:
        """Draw an image; ``how`` is for `imshow`."""
        shown = for_display(values, self.norm)
        self._drawn = axes.imshow(shown, cmap=LIGHT, norm=self.norm, **how)

    def bar(self, figure: Figure, label: str, **where: Any) -> None:
        """Add the colour bar beside the axes ``ax``, or into the axes ``cax``."""
        if "ax" in where:
            where |= {"shrink": 0.9, "pad": 0.02}
        extend = cut(self._values, self.norm)
        figure.colorbar(self._drawn, label=label + said(self._scale), extend=extend, **where)


def draw(figure: Figure, axes: Axes, values: Array, scale: Scale, label: str, **how: Any) -> None:
    """An image with its colour bar; no label, no bar. ``how`` is for `imshow`."""
    shades = Shades(values, scale)
    shades.show(axes, values, **{"interpolation": "antialiased"} | how)
    if label:
        shades.bar(figure, label, ax=axes)


def bar(figure: Figure, drawn: Any, axes: Any, label: str, *, extend: str = "neither") -> None:
    """Add a colour bar beside one or several axes."""
    figure.colorbar(drawn, ax=axes, label=label, extend=extend, shrink=0.9, pad=0.02)
