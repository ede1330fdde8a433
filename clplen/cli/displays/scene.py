"""What commands for displays share: a light field, its depth, and pictures between its views."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import check_planes, note, planes_of, read
from clplen.cli.shared.pictures import Tone, drawable, read_map

if TYPE_CHECKING:
    from clplen.io.displays.display_window import DisplayWindow
    from clplen.lightfield.model.light_field import LightField

Values = np.ndarray[Any, Any]

_FAR = 99  # per cent of the pixels that move less than what is said
_FILE = click.Path(path_type=Path)

_DEPTH = (
    click.option(
        "--disparity",
        "depth_file",
        metavar="FILE",
        type=_FILE,
        help="Disparities of the centre view, by 'clplen depth'; default: computed here.",
    ),
    click.option(
        "--zero-parallax",
        "zero",
        metavar="D",
        type=options.FINITE,
        help="Disparity in the plane of the display; default: the median of the scene.",
    ),
)


class Width(click.ParamType):
    """A size in pixels as displays are sold: WIDTHxHEIGHT; (y, x)."""

    name = "WIDTHxHEIGHT"

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = str(value).lower().replace("\u00d7", "x").split("x")
        if len(parts) != 2 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(f"{value!r} is no {self.name}, for example 3360x3360.", param, ctx)
        width, height = (int(part) for part in parts)
        if not (0 < width <= options.LARGEST_SIDE and 0 < height <= options.LARGEST_SIDE):
            self.fail(
                f"{value!r} is out of range: a side has 1 to {options.LARGEST_SIDE:,} pixels.",
                param,
                ctx,
            )
        return height, width


def depth_options(command: Any) -> Any:
    """Add the options of a scene's depth."""
    for option in reversed(_DEPTH):
        command = option(command)
    return command


@dataclass(frozen=True)
class Scene:
    """A light field, its disparities (y, x), and how its pictures are scaled to 8 bits.

    ``zero`` is the disparity in the plane of the display.
    """

    lf: LightField
    disparity: Values
    zero: float
    white: float
    black: float
    curve: str | float

    def across(
        self, span: float, count: int, *, along: Literal["v", "u"] = "u"
    ) -> list[tuple[float, float]]:
        """Viewpoints (v, u) of the middle row from left to right, or of the column, downwards."""
        axis = "vu".index(along)
        middle = [(n - 1) / 2 for n in self.lf.shape[:2]]
        ends = span * middle[axis]
        return [
            (middle[0] + (axis == 0) * x, middle[1] + (axis == 1) * x)
            for x in np.linspace(-ends, ends, count).tolist()
        ]

    def shifts(self, viewpoints: list[tuple[float, float]]) -> Values:
        """Where the depth in the display's plane stands in each, (n, 2) pixels (y, x)."""
        from clplen.lightfield.model.between_views import viewpoint_step

        return np.stack([viewpoint_step(self.lf, *at) for at in viewpoints]) * self.zero

    def pictures(self, viewpoints: list[tuple[float, float]]) -> Iterator[Values]:
        """uint8 views at the viewpoints."""
        from clplen.io.formats.animation import toned
        from clplen.lightfield.model.between_views import views_between

        for view in views_between(self.lf, viewpoints, self.disparity):
            yield toned(drawable(view.to_numpy()), self.black, self.white, self.curve)

    def note_parallax(
        self,
        viewpoints: list[tuple[float, float]],
        window: DisplayWindow,
        samples: float,
        unit: str,
        *,
        along: Literal["v", "u"] = "u",
    ) -> None:
        """Say where neighbouring views differ by more than the display can show as one.

        A display of many views shows a depth without aliasing while it moves by at most a pixel
        from view to view (Zwicker et al. 2006, EGSR, 73). It has so many samples across the window
        along which the viewpoints lie; ``unit`` is what one of them is called.
        """
        from clplen.lightfield.model.between_views import viewpoint_step

        steps = np.stack([viewpoint_step(self.lf, *at) for at in viewpoints])
        axis = "vu".index(along)
        step = float(np.abs(np.diff(steps[:, axis])).max()) * samples / window.size[axis]
        away = np.abs(self.disparity - self.zero)
        moved = step * float(np.percentile(away, _FAR))
        if moved <= 1:
            return
        share = 100 * float(np.mean(step * away > 1))
        note(
            f"{share:.0f} % of the pixels move by more than 1 {unit} from view to "
            f"view, up to {step * float(away.max()):.1f}, where the display shows double edges: "
            "take a smaller part of the baseline, or more views."
        )


def open_scene(
    source: Path,
    selector: str | None,
    layout: dict[str, Any],
    tone: Tone,
    *,
    depth_file: Path | None,
    zero: float | None,
    disparities: Any,
    alphas: Any,
    along: Literal["v", "u"] = "u",
    check: Callable[[LightField], object] | None = None,
) -> Scene:
    """Read a light field and its depth, or compute it.

    ``along`` is the axis along which the viewpoints will lie; ``check`` may refuse the light field
    before its depth is computed.
    """
    from clplen.io.formats.animation import white_level
    from clplen.lightfield.focus_and_depth import depth_map

    check_planes(disparities, alphas)
    if depth_file is not None and (disparities is not None or alphas is not None):
        raise click.UsageError("--disparities and --alphas are for depth that --disparity gives.")
    lf = read(source, selector, layout)
    V, U = lf.shape[:2]
    if (V, U)["vu".index(along)] < 2:
        lines, way = {"u": ("column", "left to right"), "v": ("row", "top to bottom")}[along]
        raise click.UsageError(
            f"{source} has one {lines} of views, so that nothing moves from {way}: give a light "
            f"field of several {lines}s, or --swap-uv where rows are columns."
        )
    if check is not None:
        check(lf)
    middle = drawable(lf.view((V - 1) / 2, (U - 1) / 2).to_numpy())
    if depth_file is None:
        found = depth_map(lf, **planes_of(lf, disparities, alphas)).disparity
    else:
        found = read_map(depth_file, lf)
    known = np.isfinite(found)
    if not known.any():
        raise click.UsageError("The depth map has no disparity: give one by --disparity.")
    found = np.where(known, found, np.median(found[known]))
    srgb = bool(layout["srgb"])
    black, white = tone.limits or (0.0, white_level(middle, lf.dtype, srgb=srgb))
    curve = tone.curve or ("srgb" if srgb else "linear")
    plane = float(np.median(found)) if zero is None else zero
    return Scene(lf, found, plane, white, black, curve)
