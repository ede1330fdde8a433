"""``clplen view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import check_output, check_suffix, note
from clplen.cli.shared.focused import is_self_describing, suitable_ms
from clplen.cli.shared.focused import read as open_raw
from clplen.errors import ShapeError

if TYPE_CHECKING:
    from clplen.io.page.samples import Content
    from clplen.viewer.file_items import PageBuilder

FOCUSED_PLANES = 15  # number of planes of a focused raw image in a page
MAX_PAGE_BYTES = 60e6  # larger pages are refused by some mail servers and browsers


@click.command(cls=options.Command)
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.file(
    "-o",
    "--output",
    help="Output file: write a self-contained page instead of opening a browser.",
    metavar="OUT.html",
)
@click.option("--title", help="Title of the page. Default: the names of the inputs.")
@click.option(
    "--depth/--no-depth",
    default=True,
    show_default=True,
    help="Compute depth maps of light fields, for click-to-focus and all-in-focus pictures.",
)
@options.file(
    "--depth-map", "depth_file", help="Depth map from 'clplen depth', used instead of computing it."
)
@click.option("--compare", is_flag=True, help="Show the inputs side by side with a common cursor.")
@options.file("--truth", help="True disparity map; --compare scores the other maps against it.")
@click.option("--time", is_flag=True, help="Show the inputs as a time series.")
@options.file(
    "--tracks",
    "tracks_file",
    help="Table from 'clplen microscope track' to draw over the volumes.",
    metavar="TRACKS.csv",
)
@click.option(
    "--most-views",
    type=click.IntRange(min=1),
    nargs=2,
    metavar="V U",
    default=None,
    help="Maximum number of views; the central views are kept.",
)
@click.option(
    "--downscale",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    help="Downscaling factor: blocks of N x N pixels are averaged.",
)
@click.option(
    "--quality",
    type=click.IntRange(min=1, max=100),
    help="JPEG quality of the views, 1 to 100. Default: lossless.",
)
@options.memory
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port of the server. Default: any free port.",
)
@click.option("--keep", is_flag=True, help="Keep the server running after the page is closed.")
@click.option("--no-browser", is_flag=True, help="Print the address without opening a browser.")
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
    """Show light fields, stacks, volumes and maps in a browser.

    Without -o the page is served to this computer only, until it is closed; depth and exact
    pictures are then computed on demand by the device. Each input has a tab; --compare shows the
    inputs side by side, --time as a time series.

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
        raise click.UsageError("--depth-map cannot be combined with --memory.")
    _check_words(len(sources), compare, time, truth)
    if output is not None:
        _check_served(port=port, keep=keep, no_browser=no_browser)
        check_suffix(output, (".html", ".htm"))
        check_output(output, layout["force"], [*sources, *filter(None, [tracks_file])])
    content = Content()

    def focused(source: Path) -> Any:
        if not is_self_describing(source):
            return None
        raw_input = open_raw(source, selector, layout, None)
        return raw_input, suitable_ms(raw_input, FOCUSED_PLANES)

    builder = PageBuilder(
        content, PageOptions(quality, downscale, most_views), layout, selector, depth, focused,
        note, depth_file, memory,
    )  # fmt: skip
    with builder.open_files:
        server_options = (port, keep, no_browser)
        _show(builder, sources, output, title, compare, truth, time, tracks_file, server_options)


def _show(
    builder: PageBuilder,
    sources: tuple[Path, ...],
    output: Path | None,
    title: str | None,
    compare: bool,
    truth: Path | None,
    time: bool,
    tracks_file: Path | None,
    server_options: tuple[int, bool, bool],
) -> None:
    """Write the page of the inputs, or serve it."""
    content = builder.content
    items = [item for source in sources for item in builder.items(source)]
    name = title or ", ".join(source.stem for source in sources)
    if time:
        items = [_series_of_times(items, name)]
    content.about = {"title": name, "items": items}
    if tracks_file is not None:
        _add_tracks(content, tracks_file, builder.options.downscale)
    if compare:
        content.about |= {"compare": True, "scores": _scores(sources, truth)}
    if output is not None:
        _write(output, content)
    else:
        port, keep, no_browser = server_options
        _serve(content, builder, port=port, keep=keep, opens=not no_browser)


def _series_of_times(items: list[dict[str, Any]], name: str) -> dict[str, Any]:
    from clplen.viewer.file_items import series_of_times

    try:
        return series_of_times(items, name)
    except ShapeError as error:
        raise click.UsageError(str(error)) from error


def _add_tracks(content: Content, path: Path, downscale: int) -> None:
    """Add tracks to all volumes of the page."""
    from clplen.io.page.track_item import add_tracks
    from clplen.microscopy import Tracks

    tracks = Tracks.from_csv(path)
    if tracks.unit != "m":
        raise click.ClickException(f"{path} has positions in voxels: give a table in metres.")
    for item in content.about["items"]:
        add_tracks(item, tracks.frames, tracks.ids, tracks.positions, downscale=downscale)


def _check_words(count: int, compare: bool, time: bool, truth: Path | None) -> None:
    if compare and time:
        raise click.UsageError("--compare and --time cannot be combined: give one of them.")
    if (compare or time) and count < 2:
        raise click.UsageError(
            f"--{'compare' if compare else 'time'} needs at least two inputs, got {count}."
        )
    if truth is not None and not compare:
        raise click.UsageError("--truth needs --compare.")


def _check_served(**arguments: Any) -> None:
    names = [name for name, value in arguments.items() if value]
    if names:
        option = names[0].replace("_", "-")
        raise click.UsageError(f"--{option} applies to a served page, not to a file (-o).")


def _write(output: Path, content: Content) -> None:
    from clplen.io.page.html_page import write_page

    size = write_page(output, content)
    items = content.about["items"]
    views = sum(item["shape"][0] * item["shape"][1] for item in items if "weights" in item)
    what = f"{views} views, " if views else ""
    click.echo(
        f"{output}: {what}{size / 1e6:.1f} MB; it opens in any browser, also without a network."
    )
    if size > MAX_PAGE_BYTES:
        note(
            f"{output} has {size / 1e6:.0f} MB: make it smaller with --downscale 2, --quality 90 "
            "or --most-views 9 9."
        )


def _serve(content: Content, builder: PageBuilder, *, port: int, keep: bool, opens: bool) -> None:
    """Serve the page to the browser of this computer until it is closed."""
    from clplen.io.page.html_page import page_of
    from clplen.viewer.device_computing import DeviceComputing
    from clplen.viewer.server import ViewerServer

    items = content.about["items"]
    numbers = [n for n, item in enumerate(items) if item["kind"] == "light field"]
    light_fields = dict(zip(numbers, builder.light_fields, strict=True))
    computing = DeviceComputing(builder.device(), light_fields, builder.memory)
    page = page_of(content, None)
    with ViewerServer(page, content.blobs, computing, port=port, keep=keep) as server:
        click.echo(f"Open {server.url}")
        ending = "" if keep else " or close the page"
        click.echo(f"Accessible from this computer only. Press Ctrl-C{ending} to stop.")
        if opens and not open_browser(server.url):
            note("no browser could be started: open the address above in a browser.")
        server.run()


def open_browser(url: str) -> bool:
    """Open an address in the user's browser; return True on success."""
    import webbrowser

    try:
        return webbrowser.open(url)
    except (OSError, webbrowser.Error):
        return False


def _scores(sources: tuple[Path, ...], truth: Path | None) -> dict[str, Any] | None:
    """Return a table of the scores of `clplen score` for disparity maps."""
    from clplen.analysis.quality import score
    from clplen.io import read_disparity

    if truth is None:
        return None
    reference = read_disparity(truth)
    rows = []
    for source in sources:
        scores = score(read_disparity(source), reference)
        numbers = (scores.mse, scores.badpix_07, scores.q25)
        rows.append([source.stem, *(f"{number:.4g}" for number in numbers)])
    return {"columns": ["MSE x 100", "BadPix .07 (%)", "Q25"], "rows": rows}
