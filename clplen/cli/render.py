"""``clplen render``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import check_planes, planes_of, read
from clplen.cli.shared.focused import (
    RawInput,
    check_raw_picture,
    fraction,
    is_focused_raw,
    picture_options,
    refuse_options,
    suitable_ms,
)
from clplen.cli.shared.focused import read as open_raw
from clplen.cli.shared.pictures import (
    PICTURES,
    Tone,
    animate,
    check_film,
    check_output,
    depth_map,
    read_map,
    tone,
    write,
    write_preview,
)

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField

_FRAMES = 24  # pictures of a round trip through the viewpoints
_PLANES = 17  # planes of a focus sweep: 32 pictures there and back
_ELLIPSE = 0.8  # half axes of the path, as a fraction of the way to the outermost views


@click.command(cls=options.Command)
@options.source
@options.output(
    "OUT.tif|OUT.png|OUT.gif|OUT.mp4",
    "Output: TIFF of linear float32, or PNG, GIF or MP4 scaled for viewing.",
)
@click.option(
    "--viewpoint",
    type=options.FINITE,
    nargs=2,
    metavar="V U",
    help="Viewpoint in view numbers; fractions lie between views. Default: the centre.",
)
@options.aperture
@click.option(
    "--flatten",
    type=click.Choice(["mean", "variance", "median", "max", "min"]),
    default=None,
    help="Statistic over the views of a pixel. Default: mean.",
)
@click.option(
    "--disparity",
    type=options.FINITE,
    help="Disparity of the plane on which the views are aligned, in pixels per view step.",
)
@depth_map
@tone
@click.option(
    "--sweep",
    type=click.Choice(["views", "focus"]),
    help="Make a GIF or MP4 that moves around the viewpoints (views), or through the planes and "
    f"back (focus, {_PLANES} planes by default).",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.02, 3600),
    help="Duration of each picture of a sweep, in seconds. Default: 0.1.",
)
@picture_options
@options.plane_range
@options.layout
@options.device
def render(
    source: Path,
    output: Path,
    viewpoint: Any,
    aperture: Any,
    flatten: str | None,
    disparity: float | None,
    depth_file: Path | None,
    limits: Any,
    curve: Any,
    sweep: str | None,
    seconds: float | None,
    method: str | None,
    ms: Any,
    patch: float | None,
    view: Any,
    focused: bool,
    image: Path | None,
    disparities: Any,
    alphas: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Render another viewpoint, another aperture or a sweep.

    \b
    Example:
      clplen render flower -o left.tif --viewpoint 4.5 1.3 --disparity -0.65
      clplen render flower -o through.tif --flatten median --disparity -0.65
      clplen render flower -o around.gif --sweep views --disparity -0.65
      clplen render flower -o through.mp4 --sweep focus --seconds 0.05
      clplen render simulated/raw.h5 -o sharp.tif --method depth
      clplen render shot.xml -o patches.png --method basic --m 0.2
    """
    check_planes(disparities, alphas)
    if seconds is not None and not sweep:
        raise click.UsageError("--seconds needs --sweep.")
    raw_settings = {"method": method, "m": ms, "patch": patch, "view": view}
    if is_focused_raw(source, raw_settings | {"focused": focused, "image": image}):
        refuse_options(viewpoint=viewpoint, flatten=flatten, disparity=disparity)
        refuse_options(depth_map=depth_file, limits=limits, curve=curve)
        refuse_options(disparities=disparities, alphas=alphas)
        _check_output(source, output, layout, sweep)
        check_raw_picture(source, image, output)
        raw_input = open_raw(source, selector, layout, image)
        raw_settings |= {"step": layout["step"], "aperture": fraction(aperture)}
        description = _render_focused(raw_input, output, sweep, seconds, raw_settings)
        click.echo(f"{output}: {description}.")
        return
    _check_words(
        sweep,
        choice=any(word is not None for word in (viewpoint, aperture, flatten)),
        planes=disparities is not None or alphas is not None,
    )
    if depth_file is not None and (disparity is not None or sweep):
        raise click.UsageError("--depth-map cannot be combined with --disparity or --sweep.")
    scaling = Tone(limits, curve)
    scaling.check(output)
    _check_output(source, output, layout, sweep)
    lf = read(source, selector, layout)
    if sweep:
        frames = _views(lf, disparity) if sweep == "views" else _planes(lf, disparities, alphas)
        linear = layout["srgb"] or lf.linear
        description = animate(output, frames, lf.dtype, srgb=linear, seconds=seconds)
    else:
        surface = disparity if depth_file is None else read_map(depth_file, lf)
        picture = _picture(lf, viewpoint, aperture, flatten, surface)
        linear = layout["srgb"] or lf.linear
        is_brightness = flatten != "variance"
        description = write(
            output, picture, lf, srgb=linear, brightness=is_brightness, tone=scaling
        )
    click.echo(f"{output}: {description}.")


def _check_output(source: Path, output: Path, layout: dict[str, Any], sweep: str | None) -> None:
    if sweep:
        check_film(source, output, layout)
    else:
        check_output(source, output, layout, PICTURES)


def _check_words(sweep: str | None, *, choice: bool, planes: bool) -> None:
    if sweep and choice:
        raise click.UsageError(
            "--sweep cannot be combined with --viewpoint, --aperture or --flatten: leave them out."
        )
    if sweep != "focus" and planes:
        raise click.UsageError("--disparities and --alphas need --sweep focus.")


def _picture(
    lf: LightField, viewpoint: Any, aperture: Any, flatten: str | None, disparity: Any
) -> np.ndarray[Any, Any]:
    if viewpoint is not None and aperture is None and flatten is None:
        return lf.view(*viewpoint, disparity=disparity).to_numpy()
    surface = 0.0 if disparity is None else disparity
    return lf.flatten(
        flatten or "mean", disparity=surface, aperture=aperture, viewpoint=viewpoint
    ).to_numpy()


def _views(lf: LightField, disparity: float | None) -> np.ndarray[Any, Any]:
    """Render views from an ellipse around the centre."""
    turn = 2 * np.pi * np.arange(_FRAMES) / _FRAMES
    middle = [(n - 1) / 2 for n in lf.shape[:2]]
    v, u = middle[0] * (1 + _ELLIPSE * np.sin(turn)), middle[1] * (1 + _ELLIPSE * np.cos(turn))
    viewpoints = zip(v, u, strict=True)
    return np.stack([lf.view(*at, disparity=disparity).to_numpy() for at in viewpoints])


def _planes(lf: LightField, disparities: Any, alphas: Any) -> np.ndarray[Any, Any]:
    from clplen.lightfield.stacks import focal_stack

    stack = focal_stack(lf, **planes_of(lf, disparities, alphas, count=_PLANES)).to_numpy()
    return np.concatenate((stack, stack[-2:0:-1]))


def _render_focused(
    raw_input: RawInput,
    output: Path,
    sweep: str | None,
    seconds: float | None,
    settings: dict[str, Any],
) -> str:
    """Write a picture or sweep of a focused raw image, and return its description."""
    from clplen.io import write_focused
    from clplen.lightfield.focused.focused_rendering import render_focused

    method, ms = settings.pop("method"), settings.pop("m")
    arguments = {name: value for name, value in settings.items() if value is not None}
    arguments["white"] = raw_input.white
    if sweep:
        if method not in (None, "blended") or "patch" in arguments or "view" in arguments:
            raise click.UsageError(
                "--sweep cannot be combined with --method, --patch or --view: leave them out."
            )
        sweep_frames = _around if sweep == "views" else _through
        frames = sweep_frames(raw_input, ms, arguments)
        return animate(output, frames, np.dtype(np.float32), seconds=seconds)
    picture = render_focused(raw_input.raw, method=method or "blended", m=_single(ms), **arguments)
    size = abs(picture.ratio) * picture.geometry.pitch
    description = f"{method or 'blended'}, m = {picture.m:.4g}, patches of {size:.2f} px"
    if output.suffix.lower() == ".png":
        scaling = write_preview(output, picture.to_numpy(), np.dtype(np.float32))
        return f"{description}, {scaling}"
    write_focused(output, picture)
    return f"{description}, linear float32"


def _single(ms: Any) -> float | None:
    if ms is not None and len(ms) != 1:
        raise click.UsageError(
            f"--m must be a single plane, got {len(ms)}: use --sweep focus or 'clplen stack' for "
            "several planes."
        )
    return None if ms is None else float(ms[0])


def _around(raw_input: RawInput, ms: Any, arguments: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Render viewpoints on a circle, each with a small aperture."""
    from clplen.lightfield.focused.focused_rendering import render_focused

    m = _single(ms)
    first = render_focused(raw_input.raw, m=m, **arguments)
    pitch = first.geometry.pitch
    radius = _ELLIPSE * (1 - abs(first.ratio)) * pitch / 2
    aperture = min(arguments["aperture"], max(abs(first.ratio), 2 / pitch))
    turn = 2 * np.pi * np.arange(_FRAMES) / _FRAMES
    arguments = arguments | {"m": first.m, "aperture": aperture}
    views = [(radius * float(np.sin(t)), radius * float(np.cos(t))) for t in turn]
    frames = [render_focused(raw_input.raw, view=view, **arguments).to_numpy() for view in views]
    return np.stack(frames)


def _through(raw_input: RawInput, ms: Any, arguments: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Render the planes forth and back."""
    from clplen.lightfield.focused.focused_rendering import focused_stack

    planes = suitable_ms(raw_input, _PLANES) if ms is None else ms
    stack = focused_stack(raw_input.raw, ms=planes, **arguments).to_numpy()
    return np.concatenate((stack, stack[-2:0:-1]))
