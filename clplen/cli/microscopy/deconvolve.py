"""``clplen microscope deconvolve``."""

from __future__ import annotations

import json
from functools import partial
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.microscopy import series_file
from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_output,
    check_suffix,
    note,
    open_device,
    progress_bar,
    update_bar,
)
from clplen.cli.shared.setting_options import setting_options, take_settings
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings

if TYPE_CHECKING:
    from clplen.microscopy.model.point_image_files import AnyImages
    from clplen.microscopy.pipeline import Deconvolver
    from clplen.microscopy.series.starts import Start
    from clplen.microscopy.series_files import Page

_PATH = click.Path(path_type=Path)
_NAME = "{name}"
MIN_MEMORY = 1 << 20  # bytes; a smaller value is taken as a forgotten unit


@click.command()
@click.argument("frames", metavar="FRAME...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-c", "--psf", "source", required=True, metavar="PSF.h5", type=_PATH,
    help="Point images from 'clplen microscope psf'.",
)  # fmt: skip
@click.option(
    "-o", "--output", required=True, metavar="VOLUME.ome.tif|.ome.zarr", type=_PATH,
    help="Output file of the volume or series; {name} stands for the name of each frame, such as "
    "in out/{name}.ome.tif.",
)  # fmt: skip
@click.option(
    "--white", "--radiometry-frame", type=_PATH,
    help="White frame, which gives the lenslet lattice and the sensitivity of the pixels. Without "
    "it frames are assumed to be rectified.",
)  # fmt: skip
@click.option("--dark", "--dark-frame", type=_PATH, help="Dark frame, subtracted from all frames.")
@setting_options(DeconvolutionSettings)
@click.option("--warm-start", is_flag=True, help="Equivalent to --start previous.")
@setting_options(LatticeSettings)
@click.option(
    "--preview", metavar="FILE.png", type=_PATH,
    help="Output picture of the latest frame of a series, refocused on three planes.",
)  # fmt: skip
@click.option("--memory", type=options.Size(), help="Memory limit of matrices (512MiB, 4GB).")
@options.force
@options.device
def deconvolve(
    frames: tuple[Path, ...],
    source: Path,
    output: Path,
    white: Path | None,
    dark: Path | None,
    warm_start: bool,
    preview: Path | None,
    memory: int | None,
    force: bool,
    selector: str | None,
    **settings: Any,
) -> None:
    """Reconstruct a volume from each raw frame of a light-field microscope.

    FRAME is a picture, or a TIFF of a time series. Several frames are written to one file, frame by
    frame; an interrupted run continues. With {name} in the output each frame has its own file (for
    ts.tif, {name} is ts_0000, ts_0001, ...).

    The white frame gives the lenslet lattice, for rectification, and the sensitivity of the pixels;
    frames of a Fourier microscope need no white frame. A volume is skipped if it exists and its
    frame, settings and version of clplen are unchanged. Missing output folders are created. Files
    that clplen did not write are overwritten with --force only.

    \b
    Example:
      clplen microscope deconvolve guv.tif -c psf.h5 --white white.tif -o guv.ome.zarr
      clplen microscope deconvolve t*.tif -c psf.h5 --white white.tif -o series.ome.zarr
      clplen microscope deconvolve t*.tif -c psf.h5 --white white.tif -o "out/{name}.ome.tif"
    """
    from clplen.microscopy.deconvolution_files import read_picture, read_psf
    from clplen.microscopy.model.images import PointImages
    from clplen.microscopy.pipeline import provenance
    from clplen.microscopy.series.starts import Start
    from clplen.microscopy.series_files import pages_of, series_provenance

    if memory is not None and memory < MIN_MEMORY:
        raise click.UsageError(
            f"--memory must be at least 1MiB, got {memory} bytes: add a unit, such as 1GB."
        )
    if warm_start and settings["start"] not in (None, "previous"):
        raise click.UsageError(
            f"--warm-start means --start previous, but --start is {settings['start']}: leave one "
            "of them out."
        )
    settings["start"] = "previous" if warm_start else settings["start"]
    deconvolution = take_settings(DeconvolutionSettings, settings)
    lattice_settings = take_settings(LatticeSettings, settings)
    deconvolution.require_white(white is not None)
    lattice_settings.require_no_white(white is not None)
    pages = [page for path in frames for page in pages_of(path)]
    is_single_file = len(pages) > 1 and _NAME not in str(output)
    if not is_single_file:
        deconvolution.require_series(False, in_turn=True)
        if preview is not None:
            raise click.UsageError(
                "--preview needs a series in one file: give several frames, and an output without "
                f"{_NAME}."
            )
    if deconvolution.start == "previous":
        note(
            "moving objects leave a trail in the volume of the next frame: use --start limited, or "
            "none where positions of small objects matter."
        )
    inputs = (source, white, dark, lattice_settings.lattice, lattice_settings.mask)
    others = [Path(path) for path in inputs if path is not None]
    if is_single_file:
        series_file.check(output, preview, pages, others, force)
    else:
        outputs = _outputs(pages, output, others, force)
    lattice = None
    if lattice_settings.has_lattice:
        first = read_picture(pages[0].path, pages[0].number)
        lattice = lattice_settings.lattice_for((first.shape[0], first.shape[1]), pages[0].path)
    images = read_psf(source)
    if preview is not None and not isinstance(images, PointImages):
        raise click.UsageError("--preview does not support Fourier microscopes: leave it out.")
    if preview is not None and "sensor_pixels" in images.parameters:
        raise click.UsageError(
            "--preview needs rectified frames: make point images of rectified frames with 'clplen "
            "microscope psf'."
        )
    begin = Start(deconvolution.start, images, motion=deconvolution.motion)
    files: dict[str, Any] = {"white": white, "dark": dark}
    files |= {"mask": lattice_settings.mask, "lattice": lattice}
    open_series = partial(
        _open, images, deconvolution, selector, memory=memory, force=force, **files
    )
    shared = provenance(images, deconvolution, **files)
    if is_single_file:
        series_settings = series_provenance(pages, shared, begin.provenance, deconvolution.rolling)
        request = series_file.SeriesRequest(output, pages, deconvolution.batch, preview, force)
        series_file.write(request, series_settings, open_series)
        return
    jobs = _jobs(pages, shared, begin)
    todo = [not _is_done(out, job) for out, job in zip(outputs, jobs, strict=True)]
    for out in (out for out, is_due in zip(outputs, todo, strict=True) if not is_due):
        click.echo(f"{out} is up to date.")
    if not any(todo):
        return
    series, before = open_series(), None
    checks = series.checks()
    for text in checks:
        note(text)
    for page, out, job, is_due in zip(pages, outputs, jobs, todo, strict=True):
        if is_due:
            start = before if deconvolution.start else None
            click.echo(_write_volume(series, page, out, job, checks, start))
        before = out


def _open(
    images: AnyImages, settings: DeconvolutionSettings, selector: str | None, **files: Any
) -> Deconvolver:
    """Open the device, and prepare the deconvolution of all frames."""
    from clplen.microscopy.pipeline import Deconvolver

    return Deconvolver(images, settings, device=open_device(selector), **files)


def _write_volume(
    series: Deconvolver,
    page: Page,
    output: Path,
    job: dict[str, Any],
    checks: list[str],
    before: Path | None,
) -> str:
    """Write the volume of a frame, and return a summary."""
    from clplen.files import naming
    from clplen.io.results.volume_files import read_volume
    from clplen.microscopy.deconvolution_files import read_picture, write_result

    picture = read_picture(page.path, page.number)
    with naming(str(page)), progress_bar(series.how.iterations, "iteration") as bar:
        frame = series.prepared(picture)
        remarks = series.diagnose(frame)
        _note_remarks(page, remarks)
        bar.set_description(page.name)
        result = series(
            frame,
            start=None if before is None else read_volume(before)[0],
            progress=lambda done, total: update_bar(bar, done, total),
            watch=lambda now: bar.set_postfix_str(f"residual {float(now[0]):.3g}"),
        )
    result_remarks = series.diagnose(frame, result)
    _note_remarks(page, result_remarks)
    remarks = checks + remarks + result_remarks
    metadata = {"remarks": remarks, "place": series.voxel_grid(), "job": job}
    write_result(output, result, series.images, more=metadata, replace=True)
    size = " x ".join(str(n) for n in result.volume.shape)
    text = f"{output} holds {size} voxels (z, y, x) of {series.images.side * 1e6:.4g} um "
    text += (
        f"along y and x; residual {result.residuals[-1]:.3g} after {result.iterations} iterations"
    )
    if result.degenerate:
        ends = {f"{end * 1e6 + 0.0:.6g}": None for end in sorted(result.degenerate)}
        first, last = next(iter(ends)), next(reversed(ends))
        text += "; near the native plane, "
        text += f"z = {first}" + (f" to {last}" if last != first else "")
        text += " um, details finer than a lenslet are not resolved"
    return text + "."


def _outputs(pages: list[Page], output: Path, others: list[Path], force: bool) -> list[Path]:
    """Return an output file for each frame; reject inputs and files of other programs."""
    from clplen.files import check_folder
    from clplen.io.store.zarr_files import zarr_package

    check_suffix(output, (".tif", ".tiff", ".zarr"))
    paths = [Path(str(output).replace(_NAME, page.name)) for page in pages]
    duplicates = sorted({str(out) for out in paths if paths.count(out) > 1})
    if duplicates:
        raise click.UsageError(f"Two frames have the output {duplicates[0]}: rename one of them.")
    if output.suffix.lower() == ".zarr":
        zarr_package("write .ome.tif")
    read = [*{page.path for page in pages}, *others]
    for out in paths:
        check_folder(out.parent)
        check_output(out, force, read)
    return paths


def _jobs(pages: list[Page], shared: dict[str, Any], start: Start) -> list[dict[str, Any]]:
    """Return the inputs and settings of each volume, to be stored with it."""
    from clplen.io.store.digest import digest

    digests = {path: digest(path) for path in {page.path for page in pages}}
    jobs = [{"frame": digests[page.path], "number": page.number, **shared} for page in pages]
    if start.name:
        for earlier, later in pairwise(jobs):
            if start.name != "previous":
                later["begin"] = start.provenance
            later["start"] = sha256(json.dumps(earlier, sort_keys=True).encode()).hexdigest()
    return jobs


def _is_done(output: Path, job: dict[str, Any]) -> bool:
    from clplen.io.store.picture_series import describe_series

    return output.exists() and describe_series(output).get("job") == job


def _note_remarks(page: Page, remarks: list[str]) -> None:
    for text in remarks:
        note(f"{page}: {text}")
