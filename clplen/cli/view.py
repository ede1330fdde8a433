"""``clplen view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import check_output, check_suffix, note
from clplen.cli.shared.focused import read as open_raw
from clplen.cli.shared.focused import suitable_ms, tells
from clplen.errors import ShapeError

if TYPE_CHECKING:
    from clplen.io.page.samples import Content
    from clplen.viewer.file_items import PageBuilder

_MS = 15  # planes of a focused raw image
_LARGE = 60e6  # bytes of a page that some mail servers and browsers refuse


@click.command(cls=options.Command)
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.file(
    "-o",
    "--output",
    help="Write one file that holds everything, instead of opening a browser.",
    metavar="OUT.html",
)
@click.option("--title", help="Title of the page; default: the names of the inputs.")
@click.option(
    "--depth/--no-depth",
    default=True,
    show_default=True,
    help="Find the depth of light fields: then clicks focus by it and all can be in focus.",
)
@options.file(
    "--depth-map", "depth_file", help="Depth map of 'clplen depth', in place of the computed one."
)
@click.option("--compare", is_flag=True, help="Show the inputs side by side, with one cursor.")
@options.file("--truth", help="True disparity, against which --compare scores disparity maps.")
@click.option("--time", is_flag=True, help="Show the inputs as the times of one series.")
@options.file(
    "--tracks",
    "tracks_file",
    help="Table of 'clplen microscope track', drawn over the volumes.",
    metavar="TRACKS.csv",
)
@click.option(
    "--most-views",
    type=click.IntRange(min=1),
    nargs=2,
    metavar="V U",
    default=None,
    help="Largest number of views to keep, those in the middle.",
)
@click.option(
    "--downscale",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    help="Number of pixels along each axis that are averaged to one.",
)
@click.option(
    "--quality",
    type=click.IntRange(min=1, max=100),
    help="Keep views as JPEG of this quality; default: without loss.",
)
@options.memory
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port of the server; default: any free one.",
)
@click.option("--keep", is_flag=True, help="Serve until Ctrl-C, also after the page was closed.")
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
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
    tracks_file: Path | None,
    most_views: tuple[int, int] | None,
    downscale: int,
    quality: int | None,
    memory: int | None,
    port: int,
    keep: bool,
    no_browser: bool,
    selector: str | None,
    **layout: Any,
) -> None:
    """Look at light fields, raw images, focal stacks, volumes and depth maps in a browser.

    Without -o the page is served on this computer alone, until it is closed; then depth and exact
    pictures can be asked of the device. Of several inputs each has a tab; --compare shows them side
    by side, --time one after the other.

    \b
    Example:
      clplen view flower --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen view flower -o flower.html --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen view energy.pfm combined.pfm --compare --truth gt.pfm -o compared.html
      clplen view volume_*.tif --time -o series.html
    """
    from clplen.io.page.light_field_item import PageOptions
    from clplen.io.page.samples import Content
    from clplen.viewer.file_items import PageBuilder

    if memory is not None and depth_file is not None:
        raise click.UsageError("--depth-map goes without --memory.")
    _check_words(len(sources), compare, time, truth)
    if output is not None:
        _check_served(port=port, keep=keep, no_browser=no_browser)
        check_suffix(output, (".html", ".htm"))
        check_output(output, layout["force"], [*sources, *filter(None, [tracks_file])])
    content = Content()

    def focused(source: Path) -> Any:
        if not tells(source):
            return None
        opened = open_raw(source, selector, layout, None)
        return opened, suitable_ms(opened, _MS)

    shown = PageBuilder(
        content, PageOptions(quality, downscale, most_views), layout, selector, depth, focused,
        note, depth_file, memory,
    )  # fmt: skip
    with shown.held:
        served = (port, keep, no_browser)
        _show(shown, sources, output, title, compare, truth, time, tracks_file, served)


def _show(
    shown: PageBuilder,
    sources: tuple[Path, ...],
    output: Path | None,
    title: str | None,
    compare: bool,
    truth: Path | None,
    time: bool,
    tracks_file: Path | None,
    served: tuple[int, bool, bool],
) -> None:
    """Write the page of the inputs, or serve it."""
    content = shown.content
    found = [item for source in sources for item in shown.items(source)]
    name = title or ", ".join(source.stem for source in sources)
    if time:
        found = [_series_of_times(found, name)]
    content.about = {"title": name, "items": found}
    if tracks_file is not None:
        _add_tracks(content, tracks_file, shown.options.downscale)
    if compare:
        content.about |= {"compare": True, "scores": _scores(sources, truth)}
    if output is not None:
        _write(output, content)
    else:
        port, keep, no_browser = served
        _serve(content, shown, port=port, keep=keep, opens=not no_browser)


def _series_of_times(items: list[dict[str, Any]], name: str) -> dict[str, Any]:
    from clplen.viewer.file_items import series_of_times

    try:
        return series_of_times(items, name)
    except ShapeError as error:
        raise click.UsageError(str(error)) from error


def _add_tracks(content: Content, path: Path, downscale: int) -> None:
    """Draw tracks over all volumes."""
    from clplen.io.page.track_item import add_tracks
    from clplen.microscopy import Tracks

    tracks = Tracks.from_csv(path)
    if tracks.unit != "m":
        raise click.ClickException(f"{path} has positions in voxels: give a table in metres.")
    for item in content.about["items"]:
        add_tracks(item, tracks.frames, tracks.ids, tracks.positions, downscale=downscale)


def _check_words(count: int, compare: bool, time: bool, truth: Path | None) -> None:
    if compare and time:
        raise click.UsageError("Give --compare or --time, not both.")
    if (compare or time) and count < 2:
        raise click.UsageError(
            f"--{'compare' if compare else 'time'} takes at least two inputs, not {count}."
        )
    if truth is not None and not compare:
        raise click.UsageError("--truth goes with --compare, whose maps it judges.")


def _check_served(**words: Any) -> None:
    given = [name for name, value in words.items() if value]
    if given:
        option = given[0].replace("_", "-")
        raise click.UsageError(f"--{option} goes with a page that is served, not with -o.")


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


def _serve(content: Content, shown: PageBuilder, *, port: int, keep: bool, opens: bool) -> None:
    """Serve the page to the browser of this computer until it is closed."""
    from clplen.io.page.html_page import page_of
    from clplen.viewer.device_computing import DeviceComputing
    from clplen.viewer.server import ViewerServer

    items = content.about["items"]
    numbers = [n for n, item in enumerate(items) if item["kind"] == "light field"]
    light_fields = dict(zip(numbers, shown.light_fields, strict=True))
    computing = DeviceComputing(shown.device(), light_fields, shown.memory)
    page = page_of(content, None)
    with ViewerServer(page, content.blobs, computing, port=port, keep=keep) as server:
        click.echo(f"Open {server.url}")
        click.echo("It is for this computer alone, and ends by Ctrl-C", nl=keep)
        if not keep:
            click.echo(" or when the page is closed.")
        if opens and not open_browser(server.url):
            note("no browser could be opened: open the address above in one.")
        server.run()


def open_browser(url: str) -> bool:
    """Open an address in the user's browser; whether one was found."""
    import webbrowser

    try:
        return webbrowser.open(url)
    except (OSError, webbrowser.Error):
        return False


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
