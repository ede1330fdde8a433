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
_REPORT = "report.md"


def _print_example(ctx: click.Context, _: click.Parameter, kind: str | None) -> None:
    if kind:
        from clplen.config.example import pair

        click.echo(pair()[kind], nl=False)
        ctx.exit()


@click.command()
@click.argument(
    "cameras", metavar="CAMERA.toml...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.output("FOLDER", "Folder for report.md, tables (CSV) and figures (PNG).")
@click.option(
    "--only",
    metavar="NAMES",
    help="Analyses with commas between them: sampling, psf, mtf, two-points, strehl, energy, "
    "crosstalk, transfer, depth, pictures; default: all.",
)
@click.option(
    "--depths-mm",
    type=options.Planes(),
    help="Depths z of transfer and depth, from the focused plane, farther positive; default: 7 up "
    "to 15 % of the object distance on either side.",
)
@click.option("--quick", is_flag=True, help="Take fewer places of the point, and three depths.")
@click.option(
    "--example",
    type=click.Choice(_NAMES),
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print the camera file of one of a pair with the same main lens, lenslets and sensor, and "
    "stop.",
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
    """Compare plenoptic cameras: resolution, samples, crosstalk, contrast and depth over depth.

    The picture of a point is simulated by waves, tens of exposures for each camera; the scene of a
    file is what its picture shows.

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
        note(f"--depths-mm is not used: depths belong to {' and '.join(OVER_DEPTH)}.")
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
                    f"{name} is a microscope: cameras of kind 'plenoptic1' and 'plenoptic2' can be "
                    "compared."
                )
            built[name] = camera
            click.echo(f"{name}: {built[name].describe()}\n")
        with progress_bar(0, "exposure") as bar:
            found = compare(
                built,
                only=names,
                depths=None if depths_mm is None else depths_mm / 1e3,
                scenes=scenes,
                quick=quick,
                progress=lambda done, total: update_bar(bar, done, total),
            )
        text, written = _write(folder, found)
    click.echo(text)
    click.echo(f"{output} holds {written}.")


def _split(only: str) -> list[str]:
    return [name.strip() for name in only.split(",") if name.strip()]


def _read(paths: tuple[Path, ...]) -> dict[str, CameraFile]:
    """The camera files by their names without ending."""
    from clplen.config.camera_file import read_camera_file

    found: dict[str, CameraFile] = {}
    for path in paths:
        name = printable(path.stem)
        if name in found:
            raise click.UsageError(
                f"Two camera files are named {name}: figures and tables tell cameras apart "
                "by the names of their files; rename one."
            )
        found[name] = read_camera_file(path)
    return found


def _scenes(files: dict[str, CameraFile]) -> dict[str, Any]:
    """What shines by itself in each file's scene."""
    for name, file in files.items():
        if file.scene.slides():
            raise click.UsageError(
                f"{name} has a slide (mode = 'transmission'), and pictures are made of what shines "
                "by itself: leave 'pictures' out of --only, or the slide out of the scene."
            )
        if file.sensor is not None or file.coherence is not None:
            note(
                f"[sensor] and [coherence] of {name} do not count here: pictures are without noise."
            )
    return {name: file.scene.build() for name, file in files.items()}


def _write(folder: Path, found: Comparison) -> tuple[str, str]:
    """The report, and what was written in words."""
    from clplen import plot
    from clplen.analysis.report.summary import report
    from clplen.analysis.report.tables import tables
    from clplen.outputs import listed

    text = report(found)
    csv = tables(found)
    for name, table in csv.items():
        table.write(folder / f"{name}.csv")
    figures = plot.comparison(found)
    for name, figure in figures.items():
        plot.save(figure, folder / f"{name}.png")
    names = [_REPORT, *(f"{name}.csv" for name in csv), *(f"{name}.png" for name in figures)]
    (folder / _REPORT).write_text(f"{text}\n{listed(names)}", encoding="utf-8")
    return text, f"report.md, {_names(csv, 'csv')} and {_names(figures, 'png')}"


def _names(found: dict[str, Any], ending: str) -> str:
    return ", ".join(f"{name}.{ending}" for name in found) or f"no .{ending}"
