"""Light field, depth and intermediate views for the commands for displays."""

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

_PERCENTILE = 99  # of the motion between views that triggers the note; ignores outliers of depth
_FILE = click.Path(path_type=Path)

_DEPTH = (
    click.option(
        "--disparity",
        "depth_file",
        metavar="FILE",
        type=_FILE,
        help="Disparity map of the centre view from 'clplen depth'. Default: estimated from INPUT.",
    ),
    click.option(
        "--zero-parallax",
        "zero",
        metavar="D",
        type=options.FINITE,
        help="Disparity in the plane of the display. Default: the median of the scene.",
    ),
)


class Width(click.ParamType):
    """Size in pixels from WIDTHxHEIGHT, as a pair (y, x)."""

    name = "WIDTHxHEIGHT"

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        parts = str(value).lower().replace("\u00d7", "x").split("x")
        if len(parts) != 2 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(f"{value!r} is not {self.name}: give for example 3360x3360.", param, ctx)
        width, height = (int(part) for part in parts)
        if not (0 < width <= options.MAX_SIDE and 0 < height <= options.MAX_SIDE):
            self.fail(
                f"{value!r} is out of range: a side has 1 to {options.MAX_SIDE:,} pixels.",
                param,
                ctx,
            )
        return height, width


def depth_options(command: Any) -> Any:
    """Add the options for the depth of a scene."""
    for option in reversed(_DEPTH):
        command = option(command)
    return command


@dataclass(frozen=True)
class Scene:
    """Light field, its disparities (y, x), and the scaling of its pictures to 8 bits.

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
        """Return viewpoints (v, u) along the middle row (rightwards) or column (downwards)."""
        axis = "vu".index(along)
        middle = [(n - 1) / 2 for n in self.lf.shape[:2]]
        ends = span * middle[axis]
        return [
            (middle[0] + (axis == 0) * x, middle[1] + (axis == 1) * x)
            for x in np.linspace(-ends, ends, count).tolist()
        ]

    def shifts(self, viewpoints: list[tuple[float, float]]) -> Values:
        """Return the shift of the display's plane in each view, (n, 2) pixels (y, x)."""
        from clplen.lightfield.model.between_views import viewpoint_step

        return np.stack([viewpoint_step(self.lf, *at) for at in viewpoints]) * self.zero

    def pictures(self, viewpoints: list[tuple[float, float]]) -> Iterator[Values]:
        """Yield the views at the viewpoints as uint8."""
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
        """Warn if the depth exceeds the range that the display shows without aliasing.

        A point may move by at most one display pixel from view to view (Zwicker et al. 2006, EGSR,
        73). ``samples`` is the number of display pixels across the window, ``unit`` their name.
        """
        from clplen.lightfield.model.between_views import viewpoint_step

        steps = np.stack([viewpoint_step(self.lf, *at) for at in viewpoints])
        axis = "vu".index(along)
        step = float(np.abs(np.diff(steps[:, axis])).max()) * samples / window.size[axis]
        distances = np.abs(self.disparity - self.zero)
        motion = step * float(np.percentile(distances, _PERCENTILE))
        if motion <= 1:
            return
        share = 100 * float(np.mean(step * distances > 1))
        note(
            f"{share:.0f} % of the pixels move by more than 1 {unit} from view to "
            f"view, by up to {step * float(distances.max()):.1f}, and will show double edges: "
            "reduce --span, or use more views."
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
    """Read a light field; read or compute its depth.

    ``along`` is the axis of the viewpoints. ``check`` may reject the light field before its depth
    is computed.
    """
    from clplen.io.formats.animation import white_level
    from clplen.lightfield.focus_and_depth import depth_map

    check_planes(disparities, alphas)
    if depth_file is not None and (disparities is not None or alphas is not None):
        raise click.UsageError(
            "--disparities and --alphas cannot be combined with --disparity, which gives the depth."
        )
    lf = read(source, selector, layout)
    V, U = lf.shape[:2]
    if (V, U)["vu".index(along)] < 2:
        lines, way = {"u": ("column", "left to right"), "v": ("row", "top to bottom")}[along]
        raise click.UsageError(
            f"{source} has a single {lines} of views and no parallax from {way}: give a light "
            f"field with several {lines}s, or --swap-uv if rows and columns are exchanged."
        )
    if check is not None:
        check(lf)
    middle = drawable(lf.view((V - 1) / 2, (U - 1) / 2).to_numpy())
    if depth_file is None:
        disparity = depth_map(lf, **planes_of(lf, disparities, alphas)).disparity
    else:
        disparity = read_map(depth_file, lf)
    valid = np.isfinite(disparity)
    if not valid.any():
        raise click.UsageError("The depth map has no finite disparity: give a map by --disparity.")
    disparity = np.where(valid, disparity, np.median(disparity[valid]))
    srgb = bool(layout["srgb"])
    black, white = tone.limits or (0.0, white_level(middle, lf.dtype, srgb=srgb))
    curve = tone.curve or ("srgb" if srgb else "linear")
    plane = float(np.median(disparity)) if zero is None else zero
    return Scene(lf, disparity, plane, white, black, curve)
