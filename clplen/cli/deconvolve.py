"""``clplen microscope deconvolve``."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli import options
from clplen.cli.common import bar_of, check_suffix, opened, reach
from clplen.cli.messages import note
from clplen.cli.microscope import planes_of, sampled, simulated

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.microscopy.images import PointImages
    from clplen.microscopy.prepare import Preparation, Prepared
    from clplen.microscopy.projector import Projector

_PATH = click.Path(path_type=Path)
_NAME = "{name}"
_FLOOR = 1e-3  # of the mean voxel: a warm start leaves none at 0, where it would stay


@click.command()
@click.argument("frames", metavar="FRAME...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-c", "--psf", "source", required=True, metavar="PSF.h5|CAMERA.toml", type=_PATH,
    help="Point images, or the microscope that they are simulated of each time.",
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
    "--iterations", "--max-iter", type=click.IntRange(1), default=20, show_default=True,
    help="Of Richardson and Lucy.",
)  # fmt: skip
@click.option(
    "--background", "--background-level", type=options.FINITE, default=0.0,
    help="Counts of a pixel above the dark frame that come from nowhere in the volume.",
)  # fmt: skip
@click.option("--residual", type=options.FINITE, help="Stop when the residual is below this.")
@click.option(
    "--saturation", type=options.FINITE,
    help="Level from which on pixels are left out; default: the largest of an integer type.",
)  # fmt: skip
@click.option("--warm-start", is_flag=True, help="Begin each frame with the volume before it.")
@sampled
@click.option("--memory", type=options.Size(), help="Bytes for matrices (512MiB, 4GB).")
@options.device
def deconvolve(
    frames: tuple[Path, ...],
    source: Path,
    output: Path,
    white: Path | None,
    dark: Path | None,
    iterations: int,
    background: float,
    residual: float | None,
    saturation: float | None,
    warm_start: bool,
    memory: int | None,
    selector: str | None,
    **sampling: Any,
) -> None:
    """Find the volume behind raw frames of a light-field microscope.

    The white frame tells the lattice of lenslets, with which frames are rectified, and how
    sensitive pixels are. Each volume is written whole before the next frame begins; those that are
    there already, of the same frame and the same words, are not made again.

    \b
    Example:
      clplen microscope deconvolve guv.tif -c psf.h5 --white white.tif -o guv.ome.zarr
      clplen microscope deconvolve t*.tif -c psf.h5 --white white.tif -o "out/{name}.ome.tif"
    """
    from clplen.files import naming
    from clplen.microscopy.prepare import preparation

    if background < 0:
        raise click.UsageError(f"--background is not negative, not {background:g}.")
    outputs = _outputs(frames, output, [source, white, dark])
    beside = {name: _picture(path) for name, path in (("white", white), ("dark", dark)) if path}
    found: Device | None = None
    if source.suffix.lower() == ".toml":
        found = opened(selector)
        images = _from_camera(source, sampling, found)
    else:
        images = _from_file(source, sampling)
    words = _Words(iterations, background, residual, saturation, warm_start)
    jobs = _jobs(frames, images, words, white, dark)
    todo = [not _is_done(out, job) for out, job in zip(outputs, jobs, strict=True)]
    for out in (out for out, wanted in zip(outputs, todo, strict=True) if not wanted):
        click.echo(f"{out} is there already, of the same frame and words.")
    if not any(todo):
        return
    found = found or opened(selector)
    with naming(white or "The dark frame"):
        prepare = preparation(images.pixels, device=found, saturation=saturation, **beside)
    series = _Series(images, prepare, words, memory)
    for frame, out, job, wanted in zip(frames, outputs, jobs, todo, strict=True):
        if wanted:
            click.echo(series.make(frame, out, job))
        else:
            series.before = out


@dataclass(frozen=True)
class _Words:
    """What is asked for, of every frame."""

    iterations: int
    background: float
    residual: float | None
    saturation: float | None
    warm_start: bool


class _Series:
    """Frames one after the other, with one projector."""

    def __init__(
        self, images: PointImages, prepare: Preparation, words: _Words, memory: int | None
    ) -> None:
        self.images, self.prepare, self.words, self.memory = images, prepare, words, memory
        self.before: Path | None = None  # the volume of the frame before
        self.projector: Projector | None = None

    def make(self, path: Path, output: Path, job: dict[str, Any]) -> str:
        """Write the volume of a frame; what it holds, in words."""
        from clplen.files import naming
        from clplen.io.volume import write_volume
        from clplen.microscopy.deconvolution import deconvolve as richardson_lucy

        words = self.words
        picture = _picture(path)
        with naming(path), bar_of(words.iterations, "iteration") as bar:
            frame = self.prepare(picture, saturation=words.saturation)
            _tell(path, frame)
            bar.set_description(path.name)
            result = richardson_lucy(
                frame.counts,
                self._projector(frame.counts.shape),
                iterations=words.iterations,
                background=words.background * self.prepare.area,
                white=frame.white,
                start=self._start(),
                residual=words.residual,
                progress=lambda done, total: reach(bar, done, total),
                watch=lambda now: bar.set_postfix_str(f"residual {float(now[0]):.3g}"),
            )
        about = self.images.parameters
        side = about["lenslet_pitch"] / (self.images.voxels * about["magnification"])
        write_volume(
            output,
            result.volume,
            planes=self.images.planes,
            voxel=(side, side),
            description={
                "values": "energy of a voxel, counts of the frame",
                "residuals": [float(one) for one in result.residuals],
                "degenerate_um": [round(z * 1e6, 9) for z in result.degenerate],
                "job": job,
            },
            durable=True,
        )
        self.before = output
        size = " x ".join(str(n) for n in result.volume.shape)
        text = f"{output} holds {size} voxels (z, y, x) of {side * 1e6:.4g} um along y and x; "
        text += f"residual {result.residuals[-1]:.3g} after {result.iterations} iterations"
        if result.degenerate:
            ends = [min(result.degenerate) * 1e6, max(result.degenerate) * 1e6]
            text += f"; not resolved beyond a lenslet from z = {ends[0]:g} to {ends[1]:g} um"
        return text + "."

    def _projector(self, shape: tuple[int, ...]) -> Projector:
        from clplen.microscopy.projector import Projector

        lenslets = (shape[0] // self.images.pixels, shape[1] // self.images.pixels)
        if self.projector is None or self.projector.shape != lenslets:
            device = self.prepare.device
            self.projector = Projector(self.images, lenslets, device=device, memory=self.memory)
        return self.projector

    def _start(self) -> Any:
        """The volume of the frame before, or None."""
        from clplen.io.volume import read_volume

        if not self.words.warm_start or self.before is None:
            return None
        volume, _ = read_volume(self.before)
        return np.maximum(volume, np.float32(_FLOOR * volume.mean(dtype=np.float64)))


def _outputs(frames: tuple[Path, ...], output: Path, others: list[Path | None]) -> list[Path]:
    """A file for each frame, none of them one that is read."""
    from clplen.io import check_writable

    check_suffix(output, (".tif", ".tiff", ".zarr"))
    if len(frames) > 1 and _NAME not in str(output):
        raise click.UsageError(
            f"{len(frames)} frames need as many volumes: put {_NAME} into the output, as in "
            f"{output.with_name(_NAME + '.ome' + output.suffix)}."
        )
    made = [Path(str(output).replace(_NAME, frame.stem)) for frame in frames]
    doubled = sorted({str(out) for out in made if made.count(out) > 1})
    if doubled:
        raise click.UsageError(f"Two frames would be written to {doubled[0]}: rename one.")
    read = [path for path in (*frames, *others) if path is not None and path.exists()]
    for out in made:
        if not (out.suffix == ".zarr" and out.is_dir()):
            check_writable(out)
        if out.exists() and any(out.samefile(path) for path in read):
            raise click.UsageError(f"{out} is one of the files that are read: name another output.")
    return made


def _from_camera(path: Path, sampling: dict[str, Any], device: Device) -> PointImages:
    from clplen.config.microscope import read_microscope_file

    file = read_microscope_file(path)
    return simulated(file, planes_of(file, sampling, path), sampling, device)


def _from_file(path: Path, sampling: dict[str, Any]) -> PointImages:
    from clplen.microscopy import psffile

    given = [name for name, value in sampling.items() if value is not None and value is not False]
    if given:
        raise click.UsageError(
            f"--{given[0].replace('_', '-')} belongs to a CAMERA.toml: the point images in {path} "
            "have theirs."
        )
    return psffile.read(path)


def _jobs(
    frames: tuple[Path, ...],
    images: PointImages,
    words: _Words,
    white: Path | None,
    dark: Path | None,
) -> list[dict[str, Any]]:
    """What each volume depends on, kept with it."""
    from clplen.io.digest import digest
    from clplen.microscopy.psffile import digest as digest_of

    shared = {
        **asdict(words),
        "psf": digest_of(images),
        "white": digest(white) if white else None,
        "dark": digest(dark) if dark else None,
    }
    jobs = [{"frame": digest(frame), **shared} for frame in frames]
    if words.warm_start:
        for earlier, later in pairwise(jobs):
            later["start"] = sha256(json.dumps(earlier, sort_keys=True).encode()).hexdigest()
    return jobs


def _is_done(output: Path, job: dict[str, Any]) -> bool:
    from clplen.io.volume import describe_volume

    return output.exists() and describe_volume(output).get("job") == job


def _picture(path: Path) -> Any:
    """A frame of one channel."""
    from clplen.errors import FormatError
    from clplen.io.raw import read_frame

    picture, _ = read_frame(path)
    if picture.ndim != 2:
        raise FormatError(f"{path} has shape {picture.shape}; a raw frame has one channel.")
    return picture


def _tell(path: Path, frame: Prepared) -> None:
    """Pixels that do not count."""
    if frame.left_out:
        note(f"{path}: {frame.left_out:,} saturated or not finite pixels are left out.")
    if frame.negative:
        note(f"{path}: {frame.negative:,} pixels below 0 are taken as 0.")
