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
_LEAST_MEMORY = 1 << 20


@click.command()
@click.argument("frames", metavar="FRAME...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-c", "--psf", "source", required=True, metavar="PSF.h5", type=_PATH,
    help="Point images, by 'clplen microscope psf'.",
)  # fmt: skip
@click.option(
    "-o", "--output", required=True, metavar="VOLUME.ome.tif|.ome.zarr", type=_PATH,
    help="Of several frames with {name} for the name of the frame: out/{name}.ome.tif",
)  # fmt: skip
@click.option(
    "--white", "--radiometry-frame", type=_PATH,
    help="White frame: lattice and sensitivity; without it frames are rectified already.",
)  # fmt: skip
@click.option("--dark", "--dark-frame", type=_PATH, help="Dark frame.")
@setting_options(DeconvolutionSettings)
@click.option("--warm-start", is_flag=True, help="Same as --start previous.")
@setting_options(LatticeSettings)
@click.option(
    "--preview", metavar="FILE.png", type=_PATH,
    help="Picture of the latest frame of a series, refocused on three planes.",
)  # fmt: skip
@click.option("--memory", type=options.Size(), help="Bytes for matrices (512MiB, 4GB).")
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
    **given: Any,
) -> None:
    """Find the volume behind raw frames of a light-field microscope, one each.

    FRAME is a picture, or a TIFF of a whole time series. Several frames go to one file, which is
    written while it runs and goes on if it was ended; or, with {name} in the output, to one each
    (of ts.tif {name} is ts_0000, ts_0001, ...).

    The white frame tells the lattice of lenslets, with which frames are rectified, and how
    sensitive pixels are; frames of a Fourier microscope need none. Each volume is written whole
    before the next frame begins; those that are there already, of the same frame, words and version
    of clplen, are not made again. Folders of volumes are made; a file that clplen did not write is
    replaced with --force only.

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

    if memory is not None and memory < _LEAST_MEMORY:
        raise click.UsageError(f"--memory is at least 1MiB, not {memory} bytes: did you mean 1GB?")
    if warm_start and given["start"] not in (None, "previous"):
        raise click.UsageError(
            f"--warm-start is --start previous, and --start is {given['start']}."
        )
    given["start"] = "previous" if warm_start else given["start"]
    how = take_settings(DeconvolutionSettings, given)
    of_lattice = take_settings(LatticeSettings, given)
    how.require_white(white is not None)
    of_lattice.require_no_white(white is not None)
    pages = [page for path in frames for page in pages_of(path)]
    in_one = len(pages) > 1 and _NAME not in str(output)
    if not in_one:
        how.require_series(False, in_turn=True)
        if preview is not None:
            raise click.UsageError(
                "--preview is of a series in one file: give several frames, and an output without "
                f"{_NAME}."
            )
    if how.start == "previous":
        note(
            "what moves leaves a trail in the volume of the next frame: --start limited, or none "
            "where places of small things matter."
        )
    beside = (source, white, dark, of_lattice.lattice, of_lattice.mask)
    others = [Path(path) for path in beside if path is not None]
    if in_one:
        series_file.check(output, preview, pages, others, force)
    else:
        outputs = _outputs(pages, output, others, force)
    lattice = None
    if of_lattice.has_lattice:
        first = read_picture(pages[0].path, pages[0].number)
        lattice = of_lattice.lattice_for((first.shape[0], first.shape[1]), pages[0].path)
    images = read_psf(source)
    if preview is not None and not isinstance(images, PointImages):
        raise click.UsageError("--preview refocuses lenslets: a Fourier microscope has none there.")
    if preview is not None and "sensor_pixels" in images.parameters:
        raise click.UsageError("--preview is of rectified frames: make point images of them.")
    begin = Start(how.start, images, motion=how.motion)
    files: dict[str, Any] = {"white": white, "dark": dark}
    files |= {"mask": of_lattice.mask, "lattice": lattice}
    opened = partial(_opened, images, how, selector, memory=memory, force=force, **files)
    shared = provenance(images, how, **files)
    if in_one:
        words = series_provenance(pages, shared, begin.provenance, how.rolling)
        asked = series_file.Asked(output, pages, how.batch, preview, force)
        series_file.write(asked, words, opened)
        return
    jobs = _jobs(pages, shared, begin)
    todo = [not _is_done(out, job) for out, job in zip(outputs, jobs, strict=True)]
    for out in (out for out, wanted in zip(outputs, todo, strict=True) if not wanted):
        click.echo(f"{out} is there already, of the same frame and words.")
    if not any(todo):
        return
    series, before = opened(), None
    checks = series.checks()
    for text in checks:
        note(text)
    for page, out, job, wanted in zip(pages, outputs, jobs, todo, strict=True):
        if wanted:
            click.echo(_made(series, page, out, job, checks, before if how.start else None))
        before = out


def _opened(
    images: AnyImages, how: DeconvolutionSettings, selector: str | None, **files: Any
) -> Deconvolver:
    """What all frames share, on the device."""
    from clplen.microscopy.pipeline import Deconvolver

    return Deconvolver(images, how, device=open_device(selector), **files)


def _made(
    series: Deconvolver,
    page: Page,
    output: Path,
    job: dict[str, Any],
    checks: list[str],
    before: Path | None,
) -> str:
    """Write the volume of a frame; what it holds, in words."""
    from clplen.files import naming
    from clplen.io.results.volume_files import read_volume
    from clplen.microscopy.deconvolution_files import read_picture, write_result

    picture = read_picture(page.path, page.number)
    with naming(str(page)), progress_bar(series.how.iterations, "iteration") as bar:
        frame = series.prepared(picture)
        said = series.diagnose(frame)
        _tell(page, said)
        bar.set_description(page.name)
        found = series(
            frame,
            start=None if before is None else read_volume(before)[0],
            progress=lambda done, total: update_bar(bar, done, total),
            watch=lambda now: bar.set_postfix_str(f"residual {float(now[0]):.3g}"),
        )
    judged = series.diagnose(frame, found)
    _tell(page, judged)
    more = {"remarks": checks + said + judged, "place": series.voxel_grid(), "job": job}
    write_result(output, found, series.images, more=more, replace=True)
    size = " x ".join(str(n) for n in found.volume.shape)
    text = f"{output} holds {size} voxels (z, y, x) of {series.images.side * 1e6:.4g} um "
    text += f"along y and x; residual {found.residuals[-1]:.3g} after {found.iterations} iterations"
    if found.degenerate:
        ends = {f"{end * 1e6 + 0.0:.6g}": None for end in sorted(found.degenerate)}
        first, last = next(iter(ends)), next(reversed(ends))
        text += "; near the native plane, "
        text += f"z = {first}" + (f" to {last}" if last != first else "")
        text += " um, nothing finer than a lenslet is resolved"
    return text + "."


def _outputs(pages: list[Page], output: Path, others: list[Path], force: bool) -> list[Path]:
    """A file for each frame, none of them one that is read or that clplen did not write."""
    from clplen.files import check_folder
    from clplen.io.store.zarr_files import zarr_package

    check_suffix(output, (".tif", ".tiff", ".zarr"))
    made = [Path(str(output).replace(_NAME, page.name)) for page in pages]
    doubled = sorted({str(out) for out in made if made.count(out) > 1})
    if doubled:
        raise click.UsageError(f"Two frames would be written to {doubled[0]}: rename one.")
    if output.suffix.lower() == ".zarr":
        zarr_package("write .ome.tif")
    read = [*{page.path for page in pages}, *others]
    for out in made:
        check_folder(out.parent)
        check_output(out, force, read)
    return made


def _jobs(pages: list[Page], shared: dict[str, Any], begin: Start) -> list[dict[str, Any]]:
    """What each volume depends on, kept with it."""
    from clplen.io.store.digest import digest

    digests = {path: digest(path) for path in {page.path for page in pages}}
    jobs = [{"frame": digests[one.path], "number": one.number, **shared} for one in pages]
    if begin.name:
        for earlier, later in pairwise(jobs):
            if begin.name != "previous":
                later["begin"] = begin.provenance
            later["start"] = sha256(json.dumps(earlier, sort_keys=True).encode()).hexdigest()
    return jobs


def _is_done(output: Path, job: dict[str, Any]) -> bool:
    from clplen.io.store.picture_series import describe_series

    return output.exists() and describe_series(output).get("job") == job


def _tell(page: Page, remarks: list[str]) -> None:
    for text in remarks:
        note(f"{page}: {text}")
