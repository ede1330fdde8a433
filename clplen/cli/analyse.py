"""``clplen analyse``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import note, note_link, open_device, progress_bar, update_bar
from clplen.reprs import printable

if TYPE_CHECKING:
    from clplen.analysis.cameras.comparison import Comparison
    from clplen.cameras.camera_base import Plenoptic
    from clplen.config.camera_file import CameraFile

_NAMES = ("standard", "focused")
_REPORT, _PAGE = "report.md", "report.html"


def _print_example(ctx: click.Context, _: click.Parameter, kind: str | None) -> None:
    if kind:
        from clplen.config.example import pair

        click.echo(pair()[kind], nl=False)
        ctx.exit()


@click.command()
@click.argument(
    "cameras", metavar="CAMERA.toml...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.output("FOLDER", "Output folder for the report, tables (CSV) and figures (PNG).")
@click.option(
    "--only",
    metavar="NAMES",
    help="Comma-separated analyses: sampling, psf, mtf, two-points, strehl, energy, crosstalk, "
    "transfer, depth, pictures. Default: all.",
)
@click.option(
    "--depths-mm",
    type=options.Planes(),
    help="Depths of the analyses transfer and depth, in millimetres from the focused plane, "
    "farther positive. Default: 7 depths within 15 % of the object distance.",
)
@click.option(
    "--quick", is_flag=True, help="Use fewer positions of the point source and three depths."
)
@click.option(
    "--example",
    type=click.Choice(_NAMES),
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print an example camera file and exit. Both examples have equal main lenses, lenslets "
    "and sensors.",
)
@options.force_output
@options.device
def analyse(
    cameras: tuple[Path, ...],
    output: Path,
    only: str | None,
    depths_mm: Any,
    quick: bool,
    force: bool,
    selector: str | None,
) -> None:
    """Compare the image quality of plenoptic cameras.

    The report covers resolution, sampling, crosstalk, contrast and depth accuracy. The image of a
    point source is simulated by wave optics, in tens of exposures per camera. The analysis
    "pictures" renders the scene of each camera file.

    \b
    Example:
      clplen analyse --example standard > standard.toml
      clplen analyse --example focused > focused.toml
      clplen analyse standard.toml focused.toml -o compared
    """
    from clplen.analysis.cameras.comparison import (
        ANALYSES,
        OVER_DEPTH,
        check_analyses,
        compare,
        prefix_errors,
    )
    from clplen.cameras.light_field_microscope import Microscope
    from clplen.outputs import updating

    names = check_analyses(_split(only)) if only is not None else ANALYSES
    if depths_mm is not None and not set(names) & set(OVER_DEPTH):
        note(f"--depths-mm is ignored: only {' and '.join(OVER_DEPTH)} use depths.")
    files = _read(cameras)
    scenes = _scenes(files) if "pictures" in names else None
    note_link(output)
    with updating(output, _REPORT, force=force) as folder:
        device = open_device(selector)
        built: dict[str, Plenoptic] = {}
        for name, file in files.items():
            with prefix_errors(name):
                camera = file.camera.build(device)
            if isinstance(camera, Microscope):
                raise click.UsageError(
                    f"{name} is a microscope: only cameras of kind 'plenoptic1' and 'plenoptic2' "
                    "can be compared."
                )
            built[name] = camera
            click.echo(f"{name}: {built[name].describe()}\n")
        with progress_bar(0, "exposure") as bar:
            comparison = compare(
                built,
                only=names,
                depths=None if depths_mm is None else depths_mm / 1e3,
                scenes=scenes,
                quick=quick,
                progress=lambda done, total: update_bar(bar, done, total),
            )
        text, written = _write(folder, comparison)
    click.echo(text)
    click.echo(f"{output} holds {written}.")


def _split(only: str) -> list[str]:
    return [name.strip() for name in only.split(",") if name.strip()]


def _read(paths: tuple[Path, ...]) -> dict[str, CameraFile]:
    """Read the camera files into a dictionary with their stems as keys."""
    from clplen.config.camera_file import read_camera_file

    files: dict[str, CameraFile] = {}
    for path in paths:
        name = printable(path.stem)
        if name in files:
            raise click.UsageError(
                f"Two camera files are named {name}: figures and tables label cameras by their "
                "file names; rename one."
            )
        files[name] = read_camera_file(path)
    return files


def _scenes(files: dict[str, CameraFile]) -> dict[str, Any]:
    """Build the self-luminous scene of each camera file."""
    for name, file in files.items():
        if file.scene.slides():
            raise click.UsageError(
                f"{name} has a slide (mode = 'transmission'), but the analysis 'pictures' needs a "
                "self-luminous scene: leave 'pictures' out of --only, or the slide out of the "
                "scene."
            )
        if file.sensor is not None or file.coherence is not None:
            note(
                f"[sensor] and [coherence] of {name} are ignored: pictures are computed without "
                "noise."
            )
    return {name: file.scene.build() for name, file in files.items()}


def _write(folder: Path, comparison: Comparison) -> tuple[str, str]:
    """Write the report, tables and figures; return the report and the list of files."""
    from clplen import plot
    from clplen.analysis.report.page import page
    from clplen.analysis.report.summary import report
    from clplen.analysis.report.tables import tables
    from clplen.outputs import listed

    text = report(comparison)
    csv = tables(comparison)
    for name, table in csv.items():
        table.write(folder / f"{name}.csv")
    figures = plot.comparison(comparison)
    for name, figure in figures.items():
        plot.save(figure, folder / f"{name}.png")
    pictures = {name: (folder / f"{name}.png").read_bytes() for name in figures}
    (folder / _PAGE).write_text(page(comparison, pictures), encoding="utf-8")
    names = [_REPORT, _PAGE, *(f"{name}.csv" for name in csv), *(f"{name}.png" for name in figures)]
    (folder / _REPORT).write_text(f"{text}\n{listed(names)}", encoding="utf-8")
    return text, f"report.html, report.md, {_names(csv, 'csv')} and {_names(figures, 'png')}"


def _names(contents: dict[str, Any], ending: str) -> str:
    return ", ".join(f"{name}.{ending}" for name in contents) or f"no .{ending}"
