"""``clplen view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import check_output, check_suffix, note
from clplen.cli.shared.shown import Shown, series_of_times

if TYPE_CHECKING:
    from clplen.io.page.samples import Content

_LARGE = 60e6  # bytes of a page that some mail servers and browsers refuse


@click.command()
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    metavar="OUT.html",
    type=click.Path(path_type=Path),
    help="Write one file that holds everything, instead of opening a browser.",
)
@click.option("--title", help="Of the page; default: the names of the inputs.")
@click.option(
    "--depth/--no-depth",
    default=True,
    show_default=True,
    help="Find the depth of light fields: then clicks focus by it and all can be in focus.",
)
@click.option(
    "--depth-map",
    "depth_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The depth of the light field, of 'clplen depth', instead.",
)
@click.option("--compare", is_flag=True, help="Show the inputs side by side, with one cursor.")
@click.option(
    "--truth",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The true disparity: with --compare the scores of disparity maps are shown.",
)
@click.option("--time", is_flag=True, help="The inputs are the times of one series.")
@click.option(
    "--most-views",
    type=click.IntRange(min=1),
    nargs=2,
    metavar="V U",
    default=None,
    help="Keep at most so many views, those in the middle.",
)
@click.option(
    "--downscale",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    help="Keep the means of N x N pixels.",
)
@click.option(
    "--quality",
    type=click.IntRange(min=1, max=100),
    help="Keep views as JPEG of this quality; default: without loss.",
)
@options.layout
@options.device
def view(
    sources: tuple[Path, ...],
    output: Path | None,
    title: str | None,
    depth: bool,
    depth_file: Path | None,
    compare: bool,
    truth: Path | None,
    time: bool,
    most_views: tuple[int, int] | None,
    downscale: int,
    quality: int | None,
    selector: str | None,
    **layout: Any,
) -> None:
    """Look at light fields, raw images, focal stacks, volumes and depth maps in a browser.

    Of several inputs each has a tab; --compare shows them side by side, --time one after the other.

    \b
    Example:
      clplen view flower -o flower.html --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen view energy.pfm combined.pfm --compare --truth gt.pfm -o compared.html
      clplen view volume_*.tif --time -o series.html
    """
    from clplen.io.page.light_field_item import PageOptions
    from clplen.io.page.samples import Content

    _check_words(len(sources), compare, time, truth)
    if output is not None:
        check_suffix(output, (".html", ".htm"))
        check_output(output, layout["force"], sources)
    content = Content()
    shown = Shown(
        content,
        PageOptions(quality, downscale, most_views),
        layout,
        selector,
        depth,
        depth_file,
    )
    found = [item for source in sources for item in shown.items(source)]
    name = title or ", ".join(source.stem for source in sources)
    content.about = {
        "title": name,
        "items": [series_of_times(found, name)] if time else found,
    }
    if compare:
        content.about |= {"compare": True, "scores": _scores(sources, truth)}
    if output is None:
        raise click.UsageError("Give -o page.html.")
    _write(output, content)


def _check_words(count: int, compare: bool, time: bool, truth: Path | None) -> None:
    if compare and time:
        raise click.UsageError("Give --compare or --time, not both.")
    if (compare or time) and count < 2:
        raise click.UsageError(
            f"--{'compare' if compare else 'time'} takes at least two inputs, not {count}."
        )
    if truth is not None and not compare:
        raise click.UsageError("--truth goes with --compare, whose maps it judges.")


def _write(output: Path, content: Content) -> None:
    from clplen.io.page.html_page import write_page

    size = write_page(output, content)
    items = content.about["items"]
    views = sum(item["shape"][0] * item["shape"][1] for item in items if "weights" in item)
    what = f"{views} views, " if views else ""
    click.echo(f"{output}: {what}{size / 1e6:.1f} MB, opens in any browser and asks no network.")
    if size > _LARGE:
        note(
            f"{output} has {size / 1e6:.0f} MB: --downscale 2 or --quality 90 makes it smaller, "
            "--most-views 9 9 too."
        )


def _scores(sources: tuple[Path, ...], truth: Path | None) -> dict[str, Any] | None:
    """A table of the scores of disparity maps, as `clplen score` gives them."""
    from clplen.analysis.quality import score
    from clplen.io import read_disparity

    if truth is None:
        return None
    known = read_disparity(truth)
    rows = []
    for source in sources:
        found = score(read_disparity(source), known)
        numbers = (found.mse, found.badpix_07, found.q25)
        rows.append([source.stem, *(f"{number:.4g}" for number in numbers)])
    return {"columns": ["MSE x 100", "BadPix .07 (%)", "Q25"], "rows": rows}
