"""``clplen microscope deconvolve``."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from clplen.cli.microscopy import series_file
from clplen.cli.microscopy.frames import Page, Place, pages_of, told_lattice
from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_output,
    check_suffix,
    note,
    open_device,
    progress_bar,
    update_bar,
)

if TYPE_CHECKING:
    from clplen.batch.work.deconvolution import DeconvolutionSettings, Deconvolver
    from clplen.batch.work.deconvolution_files import AnyImages
    from clplen.microscopy.frames.prepared import Prepared
    from clplen.microscopy.series.starts import Start

_PATH = click.Path(path_type=Path)
_NAME = "{name}"
_LEAST_MEMORY = 1 << 20


class Residual(click.ParamType):
    """A positive number, or noise."""

    name = "number|noise"

    def convert(self, value: Any, param: Any, ctx: Any) -> float | str:
        """As click asks."""
        if value == "noise":
            return "noise"
        try:
            found = float(value)
        except ValueError:
            found = math.nan
        if not 0 < found < math.inf:
            self.fail(f"{value!r} is no positive number, nor noise.", param, ctx)
        return found


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
@click.option(
    "--lattice", type=_PATH,
    help="JSON of a lattice (Lattice.save, CalInfo.json) where there is no white frame ...",
)  # fmt: skip
@click.option("--pitch", type=options.FINITE, help="... or its pitch in pixels,")
@click.option(
    "--offset", type=Place(),
    help="the centre of a lenslet in pixels, whose centres are integers; default: in the corner,",
)  # fmt: skip
@click.option(
    "--rotation", type=options.FINITE, help="and its angle in degrees, from +x towards +y.",
)  # fmt: skip
@click.option("--mask", type=_PATH, help="Picture that is not 0 where pixels are left out.")
@click.option(
    "--radiometric", is_flag=True,
    help="Let the white frame correct the pupil of the point images, too.",
)  # fmt: skip
@click.option("--keep-hot", is_flag=True, help="Keep pixels that stand out as no light does.")
@click.option(
    "--iterations", "--max-iter", type=click.IntRange(1), default=20, show_default=True,
    help="Of Richardson and Lucy.",
)  # fmt: skip
@click.option(
    "--background", "--background-level", type=options.FINITE, default=0.0,
    help="Counts of a pixel above the dark frame that come from nowhere in the volume.",
)  # fmt: skip
@click.option(
    "--gain", type=options.FINITE, help="Counts of a photon, for --residual noise and --prior; "
    "default 1.",
)  # fmt: skip
@click.option(
    "--residual", type=Residual(), help="Stop when the residual is below this, or that of noise.",
)  # fmt: skip
@click.option(
    "--haze", is_flag=True,
    help="Tell light from far beyond the volume from it: white frame, as dark as in the darkest "
    "lenslets.",
)  # fmt: skip
@click.option("--accelerate", is_flag=True, help="Fewer iterations, but memory for four volumes.")
@click.option(
    "--prior", type=click.Choice(["tv", "gaussian", "time"]),
    help="tv: against noise; gaussian: nothing finer than a lenslet about the native plane; time: "
    "voxels of a series seldom change.",
)  # fmt: skip
@click.option("--strength", type=options.FINITE, help="Of the prior; default 1.")
@click.option(
    "--saturation", type=options.FINITE,
    help="Level from which on pixels are left out; default: the largest of an integer type.",
)  # fmt: skip
@click.option("--warm-start", is_flag=True, help="As --start previous.")
@click.option(
    "--start", type=click.Choice(["none", "previous", "decayed", "limited"]),
    help="Begin with the volume before: itself, with half its contrast, or as wide as things move.",
)  # fmt: skip
@click.option(
    "--motion-um", type=options.FINITE,
    help="How far things move from frame to frame, for --start limited; default half a voxel.",
)  # fmt: skip
@click.option(
    "--batch", type=click.IntRange(1), help="Frames of a series that are found together.",
)  # fmt: skip
@click.option(
    "--rolling-background", type=click.IntRange(2), metavar="N",
    help="Of a series: the minimum of each pixel over N frames is background.",
)  # fmt: skip
@click.option(
    "--preview", metavar="FILE.png", type=_PATH,
    help="Of a series: the latest frame, refocused on three planes.",
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
    lattice: Path | None,
    pitch: float | None,
    offset: tuple[float, float] | None,
    rotation: float | None,
    mask: Path | None,
    radiometric: bool,
    keep_hot: bool,
    iterations: int,
    background: float,
    gain: float | None,
    haze: bool,
    residual: float | Literal["noise"] | None,
    accelerate: bool,
    prior: Literal["tv", "gaussian", "time"] | None,
    strength: float | None,
    saturation: float | None,
    warm_start: bool,
    start: str | None,
    motion_um: float | None,
    batch: int | None,
    rolling_background: int | None,
    preview: Path | None,
    memory: int | None,
    force: bool,
    selector: str | None,
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
    from clplen.batch.work.deconvolution import DeconvolutionSettings, provenance
    from clplen.batch.work.deconvolution_files import read_psf
    from clplen.microscopy.model.images import PointImages
    from clplen.microscopy.series.starts import Start

    if background < 0:
        raise click.UsageError(f"--background is not negative, not {background:g}.")
    if gain is not None and gain <= 0:
        raise click.UsageError(f"--gain is positive, not {gain:g}.")
    if haze and white is None:
        raise click.UsageError("--haze looks like the white frame: give --white.")
    if radiometric and white is None:
        raise click.UsageError("--radiometric corrects by the white frame: give --white.")
    if strength is not None and prior is None:
        raise click.UsageError("--strength is of a --prior: give tv, gaussian or time.")
    if strength is not None and strength <= 0:
        raise click.UsageError(f"--strength is positive, not {strength:g}.")
    if memory is not None and memory < _LEAST_MEMORY:
        raise click.UsageError(f"--memory is at least 1MiB, not {memory} bytes: did you mean 1GB?")
    name = _start_name(start, warm_start, motion_um)
    _tell_what_is_missing(gain, residual, prior, white, dark)
    pages = [page for path in frames for page in pages_of(path)]
    others = [path for path in (source, white, dark, lattice, mask) if path is not None]
    grid = told_lattice(lattice, pitch, offset, rotation, white, pages[0].path, pages[0].number)
    how = DeconvolutionSettings(
        iterations=iterations,
        background=background,
        gain=1.0 if gain is None else gain,
        saturation=saturation,
        haze=haze,
        residual=residual,
        accelerate=accelerate,
        prior=prior,
        strength=1.0 if strength is None else strength,
        radiometric=radiometric,
        keep_hot=keep_hot,
    )
    in_one = len(pages) > 1 and _NAME not in str(output)
    if in_one:
        series_file.check(output, preview, pages, others, force)
    else:
        in_time = "time" if prior == "time" else None
        _refuse_without_series(batch, rolling_background, preview, in_time)
        outputs = _outputs(pages, output, others, force)
    images = read_psf(source)
    if preview is not None and not isinstance(images, PointImages):
        raise click.UsageError("--preview refocuses lenslets: a Fourier microscope has none there.")
    if preview is not None and "sensor_pixels" in images.parameters:
        raise click.UsageError("--preview is of rectified frames: make point images of them.")
    begin = Start(name, images, motion=None if motion_um is None else motion_um * 1e-6)
    opened = partial(
        _opened, images, how, selector,
        white=white, dark=dark, memory=memory, force=force, begin=begin, lattice=grid, mask=mask,
    )  # fmt: skip
    shared = provenance(images, how, white, dark, mask=mask, lattice=grid)
    if in_one:
        asked = series_file.Asked(output, pages, batch, rolling_background, preview, force)
        series_file.write(asked, shared, begin, opened)
        return
    jobs = _jobs(pages, shared, begin)
    todo = [not _is_done(out, job) for out, job in zip(outputs, jobs, strict=True)]
    for out in (out for out, wanted in zip(outputs, todo, strict=True) if not wanted):
        click.echo(f"{out} is there already, of the same frame and words.")
    if not any(todo):
        return
    series, before, tally = opened(), None, _Tally()
    checks = series.checks()
    for text in checks:
        note(text)
    for page, out, job, wanted in zip(pages, outputs, jobs, todo, strict=True):
        if wanted:
            click.echo(_made(series, page, out, job, tally, checks, before if name else None))
        before = out
    tally.tell()


def _opened(
    images: AnyImages, how: DeconvolutionSettings, selector: str | None, **files: Any
) -> Deconvolver:
    """What all frames share, on the device."""
    from clplen.batch.work.deconvolution import Deconvolver

    return Deconvolver(images, how, device=open_device(selector), **files)


def _start_name(start: str | None, warm_start: bool, motion_um: float | None) -> Any:
    """The start by its name, None for an even one; what is asked for twice has to be the same."""
    if warm_start and start not in (None, "previous"):
        raise click.UsageError(f"--warm-start is --start previous, and --start is {start}.")
    name = "previous" if warm_start else start
    if motion_um is not None and (name != "limited" or motion_um <= 0):
        raise click.UsageError("--motion-um is a positive length, of --start limited.")
    if name == "previous":
        note(
            "what moves leaves a trail in the volume of the next frame: --start limited, or none "
            "where places of small things matter."
        )
    return None if name == "none" else name


def _refuse_without_series(
    batch: int | None,
    rolling_background: int | None,
    preview: Path | None,
    in_time: str | None,
) -> None:
    given = {
        "--batch": batch,
        "--rolling-background": rolling_background,
        "--preview": preview,
        "--prior time": in_time,
    }
    for name, value in given.items():
        if value is not None:
            raise click.UsageError(
                f"{name} is of a series in one file: give several frames, and an output without "
                f"{_NAME}."
            )


def _tell_what_is_missing(
    gain: float | None, residual: Any, prior: str | None, white: Path | None, dark: Path | None
) -> None:
    if gain is None and (residual == "noise" or prior in ("tv", "time")):
        what = "--residual noise" if residual == "noise" else f"--prior {prior}"
        note(f"{what} takes each count as a photon: give the --gain of the camera.")
    if white is not None and dark is None:
        note(
            "without --dark the offset of the camera counts as light: do not compare residuals and "
            "volumes with those made with a dark frame."
        )


@dataclass
class _Tally:
    """Of the pixels of a series that do not count."""

    frames: int = 0
    size: int = 0
    left_out: int = 0
    negative: int = 0

    def add(self, frame: Prepared) -> None:
        """One frame more."""
        self.frames += 1
        self.size += frame.size
        self.left_out += frame.left_out
        self.negative += frame.negative

    def tell(self) -> None:
        """All of them, where there are several frames."""
        if self.frames > 1 and self.left_out + self.negative:
            parts = ((self.left_out, "left out"), (self.negative, "below 0 and taken as 0"))
            said = (f"{n:,} ({100 * n / self.size:.2g} %) are {what}" for n, what in parts if n)
            note(f"of all {self.frames} frames' pixels {' and '.join(said)}.")


def _made(
    series: Deconvolver,
    page: Page,
    output: Path,
    job: dict[str, Any],
    tally: _Tally,
    checks: list[str],
    before: Path | None,
) -> str:
    """Write the volume of a frame; what it holds, in words."""
    from clplen.batch.work.deconvolution_files import read_picture, write_result
    from clplen.files import naming
    from clplen.io.results.volume_files import read_volume

    picture = read_picture(page.path, page.number)
    with naming(str(page)), progress_bar(series.how.iterations, "iteration") as bar:
        frame = series.prepared(picture)
        tally.add(frame)
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
    more = {"remarks": checks + said + judged, "place": series.place(), "job": job}
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
                later["begin"] = begin.words
            later["start"] = sha256(json.dumps(earlier, sort_keys=True).encode()).hexdigest()
    return jobs


def _is_done(output: Path, job: dict[str, Any]) -> bool:
    from clplen.io.store.picture_series import describe_series

    return output.exists() and describe_series(output).get("job") == job


def _tell(page: Page, remarks: list[str]) -> None:
    for text in remarks:
        note(f"{page}: {text}")
