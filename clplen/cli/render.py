"""``clplen render``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import check_planes, planes_of, read
from clplen.cli.shared.focused import (
    Opened,
    check_kept,
    fraction,
    is_meant,
    picture_words,
    refuse,
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
    write_shown,
)

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField

_FRAMES = 24
_PLANES = 17  # there and back: 32 frames
_ROUND = 0.8  # of the way to the outermost views


@click.command(cls=options.Command)
@options.source
@options.output(
    "OUT.tif|OUT.png|OUT.gif|OUT.mp4",
    "TIFF holds linear float32; PNG, GIF and MP4 are scaled, to look at.",
)
@click.option(
    "--viewpoint",
    type=options.FINITE,
    nargs=2,
    metavar="V U",
    help="Viewpoint, also between views; default: the centre.",
)
@options.aperture
@click.option(
    "--flatten",
    type=click.Choice(["mean", "variance", "median", "max", "min"]),
    default=None,
    help="Statistic over all views of a pixel; default: mean.",
)
@click.option(
    "--disparity",
    type=options.FINITE,
    help="Disparity, in pixels a view step, in focus on which views are combined.",
)
@depth_map
@tone
@click.option(
    "--sweep",
    type=click.Choice(["views", "focus"]),
    help="Make a GIF or MP4 that goes round the viewpoints, or through the planes (default "
    "17) and back.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.02, 3600),
    help="Seconds for which each picture of a sweep is shown; default: 0.1.",
)
@picture_words
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
    """Make a picture from another viewpoint, through another aperture, or a sweep of them.

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
        raise click.UsageError("--seconds belongs to --sweep.")
    own = {"method": method, "m": ms, "patch": patch, "view": view}
    if is_meant(source, own | {"focused": focused, "image": image}):
        refuse(viewpoint=viewpoint, flatten=flatten, disparity=disparity, depth_map=depth_file)
        refuse(limits=limits, curve=curve)
        refuse(disparities=disparities, alphas=alphas)
        _check_output(source, output, layout, sweep)
        check_kept(source, image, output)
        opened = open_raw(source, selector, layout, image)
        words = {"step": layout["step"], "aperture": fraction(aperture)}
        said = _of_focused(opened, output, sweep, seconds, own | words)
        click.echo(f"{output}: {said}.")
        return
    _check_words(
        sweep,
        choice=any(word is not None for word in (viewpoint, aperture, flatten)),
        planes=disparities is not None or alphas is not None,
    )
    if depth_file is not None and (disparity is not None or sweep):
        raise click.UsageError("--depth-map takes the place of --disparity, and makes no --sweep.")
    shown = Tone(limits, curve)
    shown.check(output)
    _check_output(source, output, layout, sweep)
    lf = read(source, selector, layout)
    if sweep:
        frames = _views(lf, disparity) if sweep == "views" else _planes(lf, disparities, alphas)
        linear = layout["srgb"] or lf.linear
        said = animate(output, frames, lf.dtype, srgb=linear, seconds=seconds)
    else:
        surface = disparity if depth_file is None else read_map(depth_file, lf)
        picture = _picture(lf, viewpoint, aperture, flatten, surface)
        linear = layout["srgb"] or lf.linear
        words = {"srgb": linear, "brightness": flatten != "variance", "tone": shown}
        said = write(output, picture, lf, **words)
    click.echo(f"{output}: {said}.")


def _check_output(source: Path, output: Path, layout: dict[str, Any], sweep: str | None) -> None:
    if sweep:
        check_film(source, output, layout)
    else:
        check_output(source, output, layout, PICTURES)


def _check_words(sweep: str | None, *, choice: bool, planes: bool) -> None:
    if sweep and choice:
        raise click.UsageError(
            "--sweep chooses its own viewpoints or planes: leave out --viewpoint, --aperture and "
            "--flatten."
        )
    if sweep != "focus" and planes:
        raise click.UsageError("--disparities and --alphas belong to --sweep focus.")


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
    """Viewpoints on an ellipse round the middle."""
    turn = 2 * np.pi * np.arange(_FRAMES) / _FRAMES
    middle = [(n - 1) / 2 for n in lf.shape[:2]]
    v, u = middle[0] * (1 + _ROUND * np.sin(turn)), middle[1] * (1 + _ROUND * np.cos(turn))
    at = zip(v, u, strict=True)
    return np.stack([lf.view(*one, disparity=disparity).to_numpy() for one in at])


def _planes(lf: LightField, disparities: Any, alphas: Any) -> np.ndarray[Any, Any]:
    from clplen.lightfield.stacks import focal_stack

    stack = focal_stack(lf, **planes_of(lf, disparities, alphas, count=_PLANES)).to_numpy()
    return np.concatenate((stack, stack[-2:0:-1]))


def _of_focused(
    opened: Opened,
    output: Path,
    sweep: str | None,
    seconds: float | None,
    words: dict[str, Any],
) -> str:
    """Write a picture of a focused raw image, or a sweep; what was made."""
    from clplen.io import write_focused
    from clplen.lightfield.focused.focused_rendering import render_focused

    method, ms = words.pop("method"), words.pop("m")
    known = {name: value for name, value in words.items() if value is not None}
    known["white"] = opened.white
    if sweep:
        if method not in (None, "blended") or "patch" in known or "view" in known:
            raise click.UsageError(
                "--sweep blends and chooses its own views or planes: leave out --method, --patch "
                "and --view."
            )
        frames = _around(opened, ms, known) if sweep == "views" else _through(opened, ms, known)
        return animate(output, frames, np.dtype(np.float32), seconds=seconds)
    picture = render_focused(opened.raw, method=method or "blended", m=_single(ms), **known)
    size = abs(picture.ratio) * picture.geometry.pitch
    said = f"{method or 'blended'}, m = {picture.m:.4g}, patches of {size:.2f} px"
    if output.suffix.lower() == ".png":
        return f"{said}, {write_shown(output, picture.to_numpy(), np.dtype(np.float32))}"
    write_focused(output, picture)
    return f"{said}, linear float32"


def _single(ms: Any) -> float | None:
    if ms is not None and len(ms) != 1:
        raise click.UsageError(
            f"--m is one plane here, not {len(ms)}: give --sweep focus for several, or use "
            "'clplen stack'."
        )
    return None if ms is None else float(ms[0])


def _around(opened: Opened, ms: Any, known: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Places in the sub-images on a circle, through a small part of each."""
    from clplen.lightfield.focused.focused_rendering import render_focused

    m = _single(ms)
    first = render_focused(opened.raw, m=m, **known)
    pitch = first.geometry.pitch
    radius = _ROUND * (1 - abs(first.ratio)) * pitch / 2
    aperture = min(known["aperture"], max(abs(first.ratio), 2 / pitch))
    turn = 2 * np.pi * np.arange(_FRAMES) / _FRAMES
    words = known | {"m": first.m, "aperture": aperture}
    views = [(radius * float(np.sin(t)), radius * float(np.cos(t))) for t in turn]
    frames = [render_focused(opened.raw, view=view, **words).to_numpy() for view in views]
    return np.stack(frames)


def _through(opened: Opened, ms: Any, known: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Planes there and back."""
    from clplen.lightfield.focused.focused_rendering import focused_stack

    planes = suitable_ms(opened, _PLANES) if ms is None else ms
    stack = focused_stack(opened.raw, ms=planes, **known).to_numpy()
    return np.concatenate((stack, stack[-2:0:-1]))
