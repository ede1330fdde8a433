"""``clplen microscope``: point images, projection and the group of commands."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from click.core import ParameterSource

from clplen.cli.microscopy import fourier
from clplen.cli.microscopy.frames import check_frames
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
    from clplen.cameras.description import Description
    from clplen.cameras.light_field_microscope import Microscope
    from clplen.compute.device import Device
    from clplen.config.fourier_microscope import FourierFile
    from clplen.config.microscope import MicroscopeFile
    from clplen.microscopy.model.fourier_images import FourierPointImages
    from clplen.microscopy.model.images import PointImages

_PATH = click.Path(path_type=Path)
VOXELS = 5
CUT = 2e-3
_OF_THE_ARRAY = ("lenslets", "field of view")  # point images are those of an endless one
_FAR = 2  # light-field ranges from the native plane: farther away little is left to find


@click.group()
def microscope() -> None:
    """Light-field microscopes: point images (psf), frames (project), volumes (deconvolve) ..."""


def _print_example(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from clplen.config.example import MICROSCOPE

        click.echo(MICROSCOPE, nl=False)
        ctx.exit()


@microscope.command()
@click.argument("camera", metavar="CAMERA.toml", type=_PATH)
@click.option("-o", "--output", required=True, metavar="PSF.h5", type=_PATH)
@click.option(
    "--planes-um",
    type=options.Planes(),
    help="z of the planes from the native one, farther from the objective positive.",
)
@click.option("--num-slices", type=click.IntRange(1), help="Planes about the native one ...")
@click.option("--um-per-slice", type=float, help="... and their distance.")
@click.option(
    "--voxels",
    "--supersample",
    type=click.IntRange(1),
    help=f"Voxels of a lenslet along an axis; default {VOXELS}.",
)
@click.option(
    "--binning",
    type=click.IntRange(1),
    help="Parts of a pixel along an axis, added up, that light is simulated on; default: as many "
    "as the apertures of objective and lenslets ask for.",
)
@click.option(
    "--pixels", type=click.IntRange(1),
    help="Of a lenslet of rectified frames; default: the number by pitch and pixels, made whole.",
)  # fmt: skip
@click.option(
    "--frame", type=_PATH, help="Frame that will be deconvolved: checked before anything is made.",
)  # fmt: skip
@click.option(
    "--white", "--radiometry-frame", type=_PATH, help="Its white frame, checked likewise.",
)  # fmt: skip
@click.option(
    "--cut", type=float, default=CUT, show_default=True,
    help="Share of a voxel's light that may be left out.",
)  # fmt: skip
@click.option(
    "--unrectified", is_flag=True,
    help="For frames that are not rectified: pixels 1.5 times as fine, brought onto those of the "
    "frames. Always of hexagonal arrays and of several focal lengths.",
)  # fmt: skip
@click.option(
    "--beads", type=_PATH, metavar="STACK.tif",
    help="Of a Fourier microscope: measure point images on frames of one bead, a frame a plane.",
)  # fmt: skip
@click.option("--half", is_flag=True, help="Keep point images as float16: half of the memory.")
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented CAMERA.toml, that of a giant vesicle, and stop.",
)
@click.option(
    "--fourier", is_flag=True, is_eager=True, expose_value=False, callback=fourier.print_example,
    help="Print a commented CAMERA.toml of a Fourier microscope, and stop.",
)  # fmt: skip
@options.force
@options.device
def psf(camera: Path, output: Path, force: bool, selector: str | None, **sampling: Any) -> None:
    """Simulate the point images of a microscope, and keep them in a file.

    CAMERA.toml is a camera file with kind = "microscope", or has the names of LFAnalyze:
    magnification, na, medium_index, wavelength (nm), tubelens_focal_length (mm), ulens_pitch,
    ulens_focal_length and pixel_size (um), num_slices, um_per_slice, supersample; apodisation and
    cover. Plane 0 is the one nearest to the objective. With kind = "fourier_microscope" it is of a
    Fourier microscope, whose lenslets lie on the pupil: --fourier prints one.

    \b
    Example:
      clplen microscope psf --example > guv.toml
      clplen microscope psf guv.toml -o psf.h5 --planes-um -19:19:20 --voxels 5
      clplen microscope deconvolve guv.tif -c psf.h5 --white white.tif -o volume.ome.tif
    """
    from clplen.config.fourier_microscope import is_fourier_file, read_fourier_file
    from clplen.config.microscope import read_microscope_file

    check_suffix(output, (".h5", ".hdf5"))
    if is_fourier_file(camera):
        planes = _planes_of(read_fourier_file(camera), sampling, camera)
        source = click.get_current_context().get_parameter_source("cut")
        cut = None if source is ParameterSource.DEFAULT else sampling["cut"]
        with _ended_politely():
            fourier.simulate(
                camera, output, planes, sampling, cut=cut, force=force, selector=selector
            )
        return
    if sampling["beads"]:
        raise click.UsageError(f"--beads is of a Fourier microscope, and {camera} is of another.")
    file = read_microscope_file(
        camera,
        binning=sampling["binning"],
        pixels=sampling["pixels"],
        rectified=not sampling["unrectified"],
    )
    for sentence in file.taken:
        note(sentence)
    if file.binning < file.least:
        raise click.UsageError(
            f"--binning {file.binning} does not sample the light, which takes at least "
            f"{file.least} x {file.least} parts of a pixel: leave it out, or give {file.least}."
        )
    z = _planes_of(file, sampling, camera)
    check_output(output, force, [camera])
    if file.rectified:
        check_frames(file, sampling["frame"], sampling["white"], force)
    with _ended_politely():
        images = _simulated(file, z, sampling, open_device(selector), output)
    kept = min(images.captured_share(plane) for plane in range(len(z)))
    click.echo(f"{output} holds {images!r}; at least {kept:.2%} of the light of a voxel is kept.")
    if "binning_error" in images.notes:
        click.echo(
            f"Pixels in {file.binning} x {file.binning} parts: an image differs from that of parts "
            f"half as large by {images.notes['binning_error']:.2g} of its norm (--binning)."
        )


@microscope.command()
@click.argument("volume", metavar="VOLUME", type=_PATH)
@click.option("-c", "--psf", "source", required=True, metavar="PSF.h5", type=_PATH)
@click.option("-o", "--output", required=True, metavar="FRAME.tif", type=_PATH)
@click.option("--memory", type=options.Size(), help="Bytes for matrices (512MiB, 4GB).")
@options.force_output
@options.device
def project(
    volume: Path,
    source: Path,
    output: Path,
    memory: int | None,
    force: bool,
    selector: str | None,
) -> None:
    """Project a volume to the raw frame that the microscope would take, without noise.

    VOLUME is OME-TIFF, OME-Zarr or .npy, shape (planes, rows of voxels, columns of voxels), on the
    planes of the point images.

    \b
    Example:
      clplen microscope project volume.ome.tif -c psf.h5 -o frame.tif
    """
    from clplen.io import write_picture
    from clplen.io.results.volume_files import read_volume
    from clplen.microscopy.deconvolution_files import read_psf
    from clplen.microscopy.model.fourier_images import FourierPointImages
    from clplen.microscopy.reconstruction.fourier_projector import FourierProjector
    from clplen.microscopy.reconstruction.projector import Projector

    check_suffix(output, (".tif", ".tiff"))
    check_output(output, force, [volume, source])
    values, about = read_volume(volume)
    images = read_psf(source)
    _check_planes(volume, values, about, images)
    if "sensor_pixels" in images.parameters:
        raise click.ClickException(
            f"{source} is of frames that are not rectified, whose lattice a white frame tells: "
            "make point images without --unrectified, or use clplen.microscopy.FrameProjector."
        )
    v, is_fourier = images.voxels, isinstance(images, FourierPointImages)
    if any(n % v or n == 0 for n in values.shape[1:]):
        raise click.ClickException(
            f"{volume} has {values.shape[1]} x {values.shape[2]} voxels, no whole number of "
            f"{'pixels' if is_fourier else 'lenslets'} of {v} x {v}."
        )
    shape = (values.shape[1] // v, values.shape[2] // v)
    kind: Any = FourierProjector if is_fourier else Projector
    frame = kind(images, shape, device=open_device(selector), memory=memory).forward(values)
    write_picture(output, frame)
    share = frame.sum(dtype=float) / max(values.sum(dtype=float), 1e-300)
    if isinstance(images, FourierPointImages):
        what = f"{frame.shape[0]} x {frame.shape[1]} pixels, {len(images.centres)} sub-images"
        rest = "between lenslets, beyond the field stop or beside the sensor"
    else:
        what = f"{shape[0]} x {shape[1]} lenslets of {images.pixels} x {images.pixels} pixels"
        kept = min(images.captured_share(plane) for plane in range(len(images.planes)))
        rest = (
            "beside the frame, or beyond the point images, which keep at least "
            f"{kept:.2%} of a voxel's light"
        )
    text = f"{output} holds {what}, with {share:.2%} of the light of the volume"
    click.echo(f"{text}: the rest falls {rest}.")


def _planes_of(file: MicroscopeFile | FourierFile, sampling: dict[str, Any], path: Path) -> Any:
    """z of the planes in metres, of the options, else of the file."""
    count = sampling["num_slices"] or file.slices
    step = sampling["um_per_slice"] or file.um_per_slice
    if sampling["planes_um"] is not None:
        if sampling["num_slices"] or sampling["um_per_slice"]:
            raise click.UsageError("Give --planes-um, or --num-slices and --um-per-slice.")
        return _rising(sampling["planes_um"] / 1e6)
    if count is None or step is None:
        raise click.UsageError(
            f"Neither the options nor {path} tell the planes: give --planes-um START:STOP:N, or "
            "--num-slices and --um-per-slice."
        )
    if not 0 < step < np.inf:
        raise click.UsageError(f"--um-per-slice is a positive number of micrometres, not {step}.")
    return (np.arange(count) - (count - 1) / 2) * step / 1e6


def _rising(z: Any) -> Any:
    """Planes in the order of files: the nearest to the objective first."""
    if z[0] <= z[-1]:
        return z
    note(
        f"planes rise, so that plane 0 is the nearest to the objective: they are taken from "
        f"{z[-1] * 1e6:g} to {z[0] * 1e6:g} um."
    )
    return z[::-1]


def _note_far(camera: Microscope, z: Any) -> None:
    """Say that planes lie where little is found, and what they cost."""
    from clplen.microscopy.model.psf import lenslets_across

    far = np.abs(z) > _FAR * camera.depth_range
    if not far.any():
        return
    farthest = float(z[np.abs(z).argmax()])
    across, finest = lenslets_across(camera, farthest), 1e6 / camera.band_limit(farthest)
    note(
        f"{far.sum():,} of {options.planes(len(z))} lie more than {_FAR} light-field ranges of "
        f"{camera.depth_range * 1e6:.3g} um from the native plane: at z = {farthest * 1e6:g} um a "
        f"point covers {across} x {across} lenslets, and no detail below {finest:.3g} um is seen."
    )


@contextmanager
def _ended_politely() -> Iterator[None]:
    """Take a request to end (SIGTERM) as Ctrl-C, so that no part of a file is left."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _simulated(
    file: MicroscopeFile,
    z: Any,
    sampling: dict[str, Any],
    device: Device,
    output: Path,
) -> PointImages:
    """The point images of a file's microscope, kept in ``output``."""
    from clplen.cameras.light_field_microscope import Microscope
    from clplen.microscopy.model.binning import binning_error
    from clplen.microscopy.model.psf import point_images

    camera = file.camera.build(device)
    assert isinstance(camera, Microscope)
    click.echo(described(camera))
    _note_far(camera, z)
    pixels = camera.pixels_per_lenslet / file.binning
    if file.binning > 1 and file.rectified and sampling["binning"] is None:
        note(
            f"Pixels of {camera.lenslet_pitch / pixels * 1e6:.4g} um "
            f"{'do not sample' if file.least > 1 else 'integrate'} the light: it is simulated on "
            f"{file.binning} x {file.binning} parts of each, which are added up."
        )
    if not file.rectified:
        note(
            f"Frames are not rectified: images have {pixels:g} pixels a lenslet, for the "
            f"{file.pixels:.6g} of the camera."
        )
    elif abs(file.pixels - pixels) > 1e-6:
        note(f"A lenslet has {file.pixels:.6g} pixels: frames are rectified to {pixels:g}.")
    notes = {}
    if file.rectified and not output.exists():
        notes = {
            "sensor_pixels": file.pixels,
            "binning_error": binning_error(camera, z, file.binning),
        }
    with progress_bar(0, "image") as bar:
        return point_images(
            camera,
            z,
            voxels_per_lenslet=sampling["voxels"] or file.voxels or VOXELS,
            binning=file.binning,
            sensor_pixels=None if file.rectified else file.pixels,
            cut=sampling["cut"],
            store="float16" if sampling["half"] else "float32",
            path=output,
            progress=lambda done, total: update_bar(bar, done, total),
            notes=notes,
        )


def described(camera: Any) -> Description:
    """What a camera's lengths are, without those of the array that is built beside them."""
    known = camera.describe()
    rows = [
        replace(row, text="") if row.name == "pixel pitch" else row
        for row in known.rows
        if row.name not in _OF_THE_ARRAY
    ]
    return replace(known, rows=tuple(rows))


def _check_planes(
    path: Path, values: Any, about: dict[str, Any], images: PointImages | FourierPointImages
) -> None:
    """Refuse a volume on other planes, or of no light."""
    wanted, found = images.planes * 1e6, about.get("planes_um", [])
    if len(values) != len(wanted):
        raise click.ClickException(
            f"{path} has {options.planes(len(values))}, the point images have {len(wanted)}: "
            "make them for the same planes."
        )
    for number, (here, there) in enumerate(zip(found, wanted, strict=False)):
        if abs(here - there) > 1e-6:
            raise click.ClickException(
                f"Plane {number} (from 0) of {path} lies at z = {here:g} um, that of the point "
                f"images at {there:g} um: make them for the same planes."
            )
    bad = int(np.count_nonzero(~np.isfinite(values) | (values < 0)))
    if bad:
        raise click.ClickException(f"{path} has {bad:,} voxels that are negative or not finite.")
