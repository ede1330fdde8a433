"""``clplen render``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli import options
from clplen.cli.common import check_planes, planes_of, read
from clplen.cli.pictures import PICTURES, check_output, drawable, scaled, write
from clplen.lightfield.rays import STATISTICS

if TYPE_CHECKING:
    from clplen.lightfield.lightfield import LightField

_FRAMES = 24
_PLANES = 17  # there and back: 32 frames
_ROUND = 0.8  # of the way to the outermost views


@click.command()
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT.tif|OUT.png|OUT.gif",
    type=click.Path(path_type=Path),
    help="TIFF holds linear float32; PNG and GIF are scaled, to look at.",
)
@click.option(
    "--viewpoint",
    type=options.FINITE,
    nargs=2,
    metavar="V U",
    help="Also between views; default: centre.",
)
@click.option(
    "--aperture",
    type=options.Aperture(),
    help="Part of the main lens to use: views across (9), fraction of the diameter (0.5) or "
    "f-number (f/66); default: all views, or with --viewpoint that one.",
)
@click.option(
    "--flatten",
    type=click.Choice(STATISTICS),
    default=None,
    help="What is taken of all views of a pixel; default: mean.",
)
@click.option(
    "--disparity",
    type=options.FINITE,
    help="Of the scene, pixels a view step: views are combined in focus on it.",
)
@click.option(
    "--sweep",
    type=click.Choice(["views", "focus"]),
    help="A GIF that goes round the viewpoints, or through the planes (default 17) and back.",
)
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
    sweep: str | None,
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
    """
    check_planes(disparities, alphas)
    _check_words(
        sweep,
        choice=any(word is not None for word in (viewpoint, aperture, flatten)),
        planes=disparities is not None or alphas is not None,
    )
    check_output(source, output, layout, (".gif",) if sweep else PICTURES)
    lf = read(source, selector, layout)
    if sweep:
        frames = _views(lf, disparity) if sweep == "views" else _planes(lf, disparities, alphas)
        said = _animate(output, frames, lf, srgb=layout["srgb"])
    else:
        picture = _picture(lf, viewpoint, aperture, flatten, disparity)
        said = write(output, picture, lf, srgb=layout["srgb"], brightness=flatten != "variance")
    click.echo(f"{output}: {said}.")


def _check_words(sweep: str | None, *, choice: bool, planes: bool) -> None:
    if sweep and choice:
        raise click.UsageError(
            "--sweep chooses its own viewpoints or planes: leave out --viewpoint, --aperture and "
            "--flatten."
        )
    if sweep != "focus" and planes:
        raise click.UsageError("--disparities and --alphas belong to --sweep focus.")


def _picture(
    lf: LightField, viewpoint: Any, aperture: Any, flatten: str | None, disparity: float | None
) -> np.ndarray[Any, Any]:
    if viewpoint is not None and aperture is None and flatten is None:
        return lf.view(*viewpoint, disparity=disparity).to_numpy()
    return lf.flatten(
        flatten or "mean", disparity=disparity or 0.0, aperture=aperture, viewpoint=viewpoint
    ).to_numpy()


def _views(lf: LightField, disparity: float | None) -> np.ndarray[Any, Any]:
    """Viewpoints on an ellipse round the middle."""
    turn = 2 * np.pi * np.arange(_FRAMES) / _FRAMES
    middle = [(n - 1) / 2 for n in lf.shape[:2]]
    v, u = middle[0] * (1 + _ROUND * np.sin(turn)), middle[1] * (1 + _ROUND * np.cos(turn))
    at = zip(v, u, strict=True)
    return np.stack([lf.view(*one, disparity=disparity).to_numpy() for one in at])


def _planes(lf: LightField, disparities: Any, alphas: Any) -> np.ndarray[Any, Any]:
    from clplen.lightfield.refocus import focal_stack

    stack = focal_stack(lf, **planes_of(lf, disparities, alphas, count=_PLANES)).to_numpy()
    return np.concatenate((stack, stack[-2:0:-1]))


def _animate(output: Path, frames: np.ndarray[Any, Any], lf: LightField, *, srgb: bool) -> str:
    from clplen.io.animation import write_animation
    from clplen.io.shown import to_look_at, white_of

    white = white_of(frames, lf.dtype, srgb=srgb)
    drawable(frames[0])
    pictures = [drawable(to_look_at(frame, white, srgb=srgb)) for frame in frames]
    write_animation(output, pictures)
    return f"{len(pictures)} frames, {scaled(white, srgb)}"
