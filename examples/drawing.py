"""What the pictures of the examples share: empty figures, colours of values, colour bars."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

LIGHT = "inferno"  # perceptually uniform: brightness follows the value
ROOT = PowerNorm(0.5, 0, 1)  # colours follow the square root of values from 0 to 1


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, laid out so that nothing overlaps."""
    return Figure(figsize=(width, height), layout="constrained")


def bar(figure: Figure, drawn: Any, axes: Any, label: str, *, extend: str = "neither") -> None:
    """A colour bar beside one or several axes."""
    figure.colorbar(drawn, ax=axes, label=label, extend=extend, shrink=0.9, pad=0.02)


def log_norm(values: np.ndarray, decades: int) -> Normalize:
    """Colours that follow the logarithm, down from the largest value."""
    return LogNorm(float(values.max()) * 10.0**-decades, float(values.max()))


def coordinates(count: int, step: float) -> np.ndarray:
    """Millimetres from the middle of an axis of samples ``step`` metres apart."""
    return (np.arange(count) - (count - 1) / 2) * step * 1e3


def centred(shape: tuple[int, ...], step: float) -> tuple[float, float, float, float]:
    """Extent of an image of pixels of one side about its middle, row 0 at the top."""
    y, x = shape[0] * step / 2, shape[1] * step / 2
    return (-x, x, y, -y)


def show(axes: Axes, values: np.ndarray, pitch: float, *, near: float = 0, **options: Any) -> Any:
    """An image of pixels of ``pitch`` metres in mm about its middle, the part up to ``near``."""
    extent = centred(values.shape, pitch * 1e3)
    drawn = axes.imshow(values, **({"cmap": LIGHT, "extent": extent} | options))
    if near:
        axes.set(xlim=(-near, near), ylim=(near, -near))
    return drawn
