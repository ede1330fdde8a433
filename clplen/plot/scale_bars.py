"""Scale bars of round lengths."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from clplen.checks import check_positive

_MAX_SHARE = 0.25  # largest length of a bar over the picture's width
_INSET = 0.05  # distance between edge and bar, over the picture's size
_UNITS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))


def round_length(width: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten within a quarter of a width."""
    check_positive(width=width)
    longest = _MAX_SHARE * width * (1 + 1e-9)
    power = math.floor(math.log10(longest))
    factor = next(n for n in (5, 2, 1) if n * 10.0**power <= longest or n == 1)
    return float(f"{factor}e{power}")


def length_text(length: float) -> str:
    """Format a length in metres with the unit that makes it 1 to 999."""
    size, unit = next((entry for entry in _UNITS if length >= entry[0] * (1 - 1e-9)), _UNITS[-1])
    return f"{length / size:.3g} {unit}"


def scale_bar(axes: Axes, unit: float, *, label: bool = True) -> float:
    """Draw a bar of a round length into the lower right corner of a picture.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes of a picture with limits set; the bar lies along x.
    unit : float
        Length of a unit of the axes, in metres.
    label : bool
        True to write the length above the bar.

    Returns
    -------
    float
        The length in metres.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> axes = Figure().add_subplot()
    >>> drawn = axes.imshow(np.eye(16), extent=(0, 40, 40, 0))  # micrometres
    >>> clplen.plot.scale_bar(axes, 1e-6)
    1e-05
    """
    check_positive(unit=unit)
    left, right = axes.get_xlim()
    bottom, top = axes.get_ylim()
    length = round_length(abs(right - left) * unit)
    end = right - _INSET * (right - left)
    start = end - math.copysign(length / unit, right - left)
    y = bottom + _INSET * (top - bottom)
    edge = [withStroke(linewidth=4.5, foreground="black")]
    axes.plot(
        [start, end], [y, y], color="white", lw=3, solid_capstyle="butt", path_effects=edge,
        scalex=False, scaley=False,
    )  # fmt: skip
    if label:
        axes.annotate(
            length_text(length),
            ((start + end) / 2, y),
            (0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            color="white",
            path_effects=[withStroke(linewidth=1.5, foreground="black")],
        )
    return length
