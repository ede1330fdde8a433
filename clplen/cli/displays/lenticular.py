"""``clplen lenticular``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np
from click.core import ParameterSource

from clplen.cli.displays.scene import Scene, depth_options, open_scene
from clplen.cli.shared import console, options
from clplen.cli.shared.pictures import PICTURES, Tone, check_output, tone

if TYPE_CHECKING:
    from clplen.io.displays.display_window import DisplayWindow

Values = np.ndarray[Any, Any]

_INCH = 0.0254  # metres
MAX_VIEWS = 64  # default maximum number of views under a lens
MIN_LENSES = 4  # smallest useful print
_PITCH_TEST_OPTIONS = (
    "output",
    "lpi",
    "dpi",
    "width",
    "lenses",
    "pitch_test",
    "spread",
    "force",
    "selector",
)
_POSITIVE = click.FloatRange(0, 1e6, min_open=True)


@click.command(cls=options.Command)
@click.argument("source", metavar="[INPUT]", required=False, type=click.Path(path_type=Path))
@options.output("OUT.tif|OUT.png", "Output: 8-bit picture that stores its dpi.")
@click.option(
    "--lpi", type=_POSITIVE, required=True, help="Number of lenses per inch, from a pitch test."
)
@click.option(
    "--dpi",
    type=_POSITIVE,
    default=720.0,
    show_default=True,
    help="Number of printed pixels per inch.",
)
@click.option(
    "--width",
    type=options.Length("positive"),
    default="0.15",
    show_default=True,
    help="Width of the print, with a unit (15cm) or in metres.",
)
@click.option(
    "--height",
    type=options.Length("positive"),
    help="Height of the print. Default: by the aspect ratio of the views.",
)
@click.option(
    "--lenses",
    type=click.Choice(["vertical", "horizontal"]),
    default="vertical",
    show_default=True,
    help="Direction of the lenses: vertical for depth, horizontal for an effect on tilting.",
)
@click.option(
    "--strips",
    type=int,
    metavar="N",
    help=f"Number of views under a lens. Default: its number of pixels, at most {MAX_VIEWS}.",
)
@click.option(
    "--distance",
    type=options.Length("positive"),
    help="Viewing distance, together with --thickness, for a nominal --lpi. Default: infinity, or "
    "the distance of the pitch test.",
)
@click.option(
    "--thickness",
    type=options.Length("positive"),
    help="Thickness of the sheet, together with --distance.",
)
@click.option(
    "--index",
    type=click.FloatRange(1, 4),
    default=1.57,
    show_default=True,
    help="Refractive index of the sheet.",
)
@click.option(
    "--span",
    type=click.FloatRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Fraction of the recorded baseline that the views span.",
)
@click.option(
    "--pitch-test",
    is_flag=True,
    help="Make a test print that measures the lpi of the sheet; takes no INPUT.",
)
@click.option(
    "--spread",
    type=click.FloatRange(0, 20, min_open=True),
    default=1.0,
    show_default=True,
    help="Range of the pitch test around --lpi, in per cent to either side.",
)
@depth_options
@tone
@options.plane_range
@options.layout
@options.device
def lenticular(
    source: Path | None,
    output: Path,
    lpi: float,
    dpi: float,
    width: float,
    height: float | None,
    lenses: Any,
    strips: int | None,
    distance: float | None,
    thickness: float | None,
    index: float,
    span: float,
    pitch_test: bool,
    spread: float,
    depth_file: Path | None,
    zero: float | None,
    limits: Any,
    curve: Any,
    disparities: Any,
    alphas: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Make a print for a lenticular sheet.

    The print has a strip of every view under each lens. Intermediate views are rendered with the
    depth of the scene. Print the picture at its size, without scaling. Print a pitch test first,
    and look at it from the viewing distance: it shows the lpi of the sheet on this printer. With a
    nominal lpi, give --distance and --thickness.

    \b
    Example:
      clplen lenticular --pitch-test -o test.tif --lpi 60 --dpi 720
      clplen lenticular flower.h5 -o print.tif --lpi 60.06 --dpi 720 --width 15cm
      clplen lenticular flower.h5 -o near.tif --lpi 60 --width 15cm --distance 0.4 --thickness 0.6mm
    """
    from clplen.io import lens_pitch, write_picture
    from clplen.io.displays.display_window import display_window

    _check_words(source, pitch_test=pitch_test, distance=distance, thickness=thickness)
    if source is None:
        console.check_suffix(output, PICTURES)
        console.check_output(output, layout["force"], ())
        click.echo(_write_test(output, lpi, dpi, width, spread, lenses))
        return
    pitch = lens_pitch(lpi, dpi, distance=distance, thickness=thickness or 0.0, index=index)
    sides = [None if side is None else round(side / _INCH * dpi) for side in (width, height)]
    sheet = _Sheet(lenses, pitch, sides[0] or 1, sides[1])
    count = sheet.strips(strips)
    check_output(source, output, layout, PICTURES)
    scene = open_scene(
        source,
        selector,
        layout,
        Tone(limits, curve),
        depth_file=depth_file,
        zero=zero,
        disparities=disparities,
        alphas=alphas,
        along=sheet.along,
        check=lambda lf: sheet.check(lf.shape[2:4]),
    )
    viewpoints = scene.across(span, count, along=sheet.along)
    shifts = scene.shifts(viewpoints)
    aspect = None if sheet.height is None else sheet.width / sheet.height
    window = display_window(scene.lf.shape[2:4], shifts, aspect)
    size = sheet.check(window.size)
    scene.note_parallax(viewpoints, window, size[sheet.axis] / pitch, "lens", along=sheet.along)
    pictures = _pictures(scene, viewpoints, shifts, sheet, window, size)
    write_picture(output, sheet.interlaced(pictures, count), dpi=dpi)
    first, last = (at[sheet.axis] for at in (viewpoints[0], viewpoints[-1]))
    click.echo(
        f"{output}: {size[1]} x {size[0]} pixels, {size[1] / dpi * 2.54:.2f} x "
        f"{size[0] / dpi * 2.54:.2f} cm at {dpi:g} dpi; {count} views from {sheet.along} = "
        f"{first:g} to {last:g} under each lens of {pitch:.6g} pixels; disparity {scene.zero:.3g} "
        "lies in the plane of the print."
    )


@dataclass(frozen=True)
class _Sheet:
    """Print under lenses with a pitch in pixels; without height, the views set it."""

    lenses: str
    pitch: float
    width: int
    height: int | None

    @property
    def along(self) -> Literal["v", "u"]:
        """Axis of the viewpoints."""
        return "u" if self.lenses == "vertical" else "v"

    @property
    def axis(self) -> int:
        """Index of the viewpoint axis in pairs (v, u) and (y, x)."""
        return "vu".index(self.along)

    def strips(self, count: int | None) -> int:
        """Return the number of views under a lens."""
        limit = math.floor(self.pitch)
        if count is None:
            return min(limit, MAX_VIEWS)
        if not 2 <= count <= limit:
            raise click.UsageError(
                f"--strips must be 2 to {limit}, the number of pixels under a lens of "
                f"{self.pitch:.4g} pixels, got {count}."
            )
        return count

    def check(self, window: tuple[float, ...]) -> tuple[int, int]:
        """Return the size (y, x) of the print of a window (height, width) in pixels."""
        from clplen.io.displays.lenticular import check_print

        height = self.height
        if height is None:
            height = max(round(self.width * window[0] / window[1]), 1)
        size = (height, self.width)
        check_print(size, 3)
        if size[self.axis] < MIN_LENSES * self.pitch:
            raise click.UsageError(
                f"The print must cover at least {MIN_LENSES} lenses of {self.pitch:.4g} pixels, "
                f"got {size[self.axis] / self.pitch:.2g} lenses with {size[1]} x {size[0]} pixels: "
                "make it larger."
            )
        return size

    def samples(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the number of resolved samples (y, x) of a print: one per lens."""
        across = max(round(size[self.axis] / self.pitch), 1)
        return (size[0], across) if self.axis == 1 else (across, size[1])

    def interlaced(self, pictures: Iterator[Values], count: int) -> Values:
        """Return the interlaced print of the views."""
        from clplen.io import interlace

        return interlace(pictures, self.pitch, count=count, lenses=self.lenses)


def _check_words(
    source: Path | None, *, pitch_test: bool, distance: float | None, thickness: float | None
) -> None:
    """Raise an error if options contradict each other."""
    if not pitch_test:
        if source is None:
            raise click.UsageError("INPUT is missing: give a light field, or --pitch-test.")
        if (distance is None) != (thickness is None):
            raise click.UsageError(
                "--distance and --thickness must be given together: give both or none of them."
            )
    context = click.get_current_context()
    flags = {
        parameter.name: "INPUT" if parameter.name == "source" else parameter.opts[0]
        for parameter in context.command.params
        if context.get_parameter_source(parameter.name or "") == ParameterSource.COMMANDLINE
    }
    others = [flag for name, flag in flags.items() if name not in _PITCH_TEST_OPTIONS]
    if pitch_test and others:
        raise click.UsageError(
            f"{others[0]} cannot be combined with --pitch-test, which uses --lpi, --dpi, --width, "
            "--lenses and --spread only."
        )
    if not pitch_test and "spread" in flags:
        raise click.UsageError("--spread needs --pitch-test.")


def _write_test(
    output: Path, lpi: float, dpi: float, width: float, spread: float, lenses: str
) -> str:
    """Write a pitch test, and return its description."""
    from clplen.io import pitch_test, write_picture

    picture = pitch_test(lpi, dpi, width, spread=spread)
    if lenses == "horizontal":
        picture = np.rot90(picture)
    write_picture(output, picture, dpi=dpi)
    height, across = (n / dpi * 2.54 for n in picture.shape)
    low, high = (lpi * (1 + part * spread / 100) for part in (-1, 1))
    return (
        f"{output}: {picture.shape[1]} x {picture.shape[0]} pixels, {across:.2f} x {height:.2f} cm "
        f"at {dpi:g} dpi; bars of {low:.5g} to {high:.5g} lpi. Print it without scaling and put "
        "the sheet on it: the uniform band shows the lpi."
    )


def _pictures(
    scene: Scene,
    viewpoints: list[tuple[float, float]],
    shifts: Values,
    sheet: _Sheet,
    window: DisplayWindow,
    size: tuple[int, int],
) -> Iterator[Values]:
    with console.progress_bar(len(viewpoints), "view") as bar:
        for picture, shift in zip(scene.pictures(viewpoints), shifts, strict=True):
            console.advance(bar, "views")
            yield window.render(picture, shift, size, sheet.samples(size))
