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
VOXELS = 5  # default number per lenslet along an axis
CUT = 2e-3  # default fraction of the light of a voxel
_ARRAY_ROWS = ("lenslets", "field of view")  # point images assume an infinite array
# Light-field ranges from the native plane beyond which little detail is resolved.
MAX_RANGES = 2


@click.group()
def microscope() -> None:
    """Simulate and process light-field microscopes."""


def _print_example(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    if is_set:
        from clplen.config.example import MICROSCOPE

        click.echo(MICROSCOPE, nl=False)
        ctx.exit()


@microscope.command()
@click.argument("camera", metavar="CAMERA.toml", type=_PATH)
@click.option("-o", "--output", required=True, metavar="PSF.h5", type=_PATH, help="Output file.")
@click.option(
    "--planes-um",
    type=options.Planes(),
    help="z of the planes in micrometres from the native plane, farther from the objective "
    "positive.",
)
@click.option(
    "--num-slices", type=click.IntRange(1), help="Number of planes, centred on the native plane."
)
@click.option("--um-per-slice", type=float, help="Distance of the planes in micrometres.")
@click.option(
    "--voxels",
    "--supersample",
    type=click.IntRange(1),
    help=f"Number of voxels per lenslet along each axis. Default: {VOXELS}.",
)
@click.option(
    "--binning",
    type=click.IntRange(1),
    help="Number of simulated samples per pixel along each axis, which are summed. Default: the "
    "number that the apertures of objective and lenslets require.",
)
@click.option(
    "--pixels", type=click.IntRange(1),
    help="Number of pixels per lenslet in rectified frames. Default: lenslet pitch over pixel "
    "size, rounded.",
)  # fmt: skip
@click.option(
    "--frame", type=_PATH, help="Frame to be deconvolved later; its size is checked first.",
)  # fmt: skip
@click.option(
    "--white", "--radiometry-frame", type=_PATH,
    help="White frame of later frames; its lattice is checked first.",
)  # fmt: skip
@click.option(
    "--cut", type=float, default=CUT, show_default=True,
    help="Fraction of the light of a voxel that may be cut off at the edges of a point image.",
)  # fmt: skip
@click.option(
    "--unrectified", is_flag=True,
    help="Make point images for frames that are not rectified, on pixels 1.5 times finer. Always "
    "set for hexagonal arrays and several focal lengths.",
)  # fmt: skip
@click.option(
    "--beads", type=_PATH, metavar="STACK.tif",
    help="Measure the point images of a Fourier microscope from frames of one bead, one frame per "
    "plane.",
)  # fmt: skip
@click.option("--half", is_flag=True, help="Store point images as float16, in half the memory.")
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented CAMERA.toml of a light-field microscope and exit.",
)
@click.option(
    "--fourier", is_flag=True, is_eager=True, expose_value=False, callback=fourier.print_example,
    help="Print a commented CAMERA.toml of a Fourier microscope and exit.",
)  # fmt: skip
@options.force
@options.device
def psf(camera: Path, output: Path, force: bool, selector: str | None, **sampling: Any) -> None:
    """Simulate the point images of a microscope, and write them to a file.

    CAMERA.toml is a camera file with kind = "microscope" (--example prints one) or
    "fourier_microscope", whose lenslets lie in the pupil (--fourier prints one). The names of
    LFAnalyze are accepted, too: magnification, na, medium_index, wavelength (nm),
    tubelens_focal_length (mm), ulens_pitch, ulens_focal_length and pixel_size (um), num_slices,
    um_per_slice, supersample, apodisation and cover. Plane 0 is nearest to the objective.

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
        with _sigterm_as_interrupt():
            fourier.simulate(
                camera, output, planes, sampling, cut=cut, force=force, selector=selector
            )
        return
    if sampling["beads"]:
        raise click.UsageError(
            f"--beads applies to Fourier microscopes, but {camera} is another microscope."
        )
    file = read_microscope_file(
        camera,
        binning=sampling["binning"],
        pixels=sampling["pixels"],
        rectified=not sampling["unrectified"],
    )
    for sentence in file.assumptions:
        note(sentence)
    if file.binning < file.min_binning:
        raise click.UsageError(
            f"--binning must be at least {file.min_binning} to sample the light, got "
            f"{file.binning}: leave it out, or increase it."
        )
    z = _planes_of(file, sampling, camera)
    check_output(output, force, [camera])
    if file.rectified:
        check_frames(file, sampling["frame"], sampling["white"], force)
    with _sigterm_as_interrupt():
        images = _simulate(file, z, sampling, open_device(selector), output)
    light = min(images.captured_share(plane) for plane in range(len(z)))
    click.echo(f"{output} holds {images!r} with at least {light:.2%} of the light of a voxel.")
    if "binning_error" in images.notes:
        click.echo(
            f"With {file.binning} x {file.binning} samples per pixel the relative error of an "
            f"image is {images.notes['binning_error']:.2g}, by comparison with twice as many."
        )


@microscope.command()
@click.argument("volume", metavar="VOLUME", type=_PATH)
@click.option(
    "-c", "--psf", "source", required=True, metavar="PSF.h5", type=_PATH,
    help="Point images from 'clplen microscope psf'.",
)  # fmt: skip
@click.option(
    "-o", "--output", required=True, metavar="FRAME.tif", type=_PATH, help="Output picture."
)
@click.option("--memory", type=options.Size(), help="Memory limit of matrices (512MiB, 4GB).")
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
    """Project a volume to the noise-free raw frame of the microscope.

    VOLUME is OME-TIFF, OME-Zarr or .npy of the shape (planes, rows, columns) in voxels, on the
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
            f"{source} has point images for frames that are not rectified: make point images "
            "without --unrectified, or use clplen.microscopy.FrameProjector."
        )
    v, is_fourier = images.voxels, isinstance(images, FourierPointImages)
    if any(n % v or n == 0 for n in values.shape[1:]):
        raise click.ClickException(
            f"{volume} must have a whole number of {'pixels' if is_fourier else 'lenslets'} of {v} "
            f"x {v} voxels, got {values.shape[1]} x {values.shape[2]} voxels."
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
        light = min(images.captured_share(plane) for plane in range(len(images.planes)))
        rest = (
            "beside the frame, or beyond the point images, which hold at least "
            f"{light:.2%} of a voxel's light"
        )
    text = f"{output} holds {what}, with {share:.2%} of the light of the volume"
    click.echo(f"{text}: the rest falls {rest}.")


def _planes_of(file: MicroscopeFile | FourierFile, sampling: dict[str, Any], path: Path) -> Any:
    """Return z of the planes in metres, from the options, else from the file."""
    count = sampling["num_slices"] or file.slices
    step = sampling["um_per_slice"] or file.um_per_slice
    if sampling["planes_um"] is not None:
        if sampling["num_slices"] or sampling["um_per_slice"]:
            raise click.UsageError("Give --planes-um, or --num-slices and --um-per-slice.")
        return _ascending(sampling["planes_um"] / 1e6)
    if count is None or step is None:
        raise click.UsageError(
            f"Neither the options nor {path} set the planes: give --planes-um START:STOP:N, or "
            "--num-slices and --um-per-slice."
        )
    if not 0 < step < np.inf:
        raise click.UsageError(f"--um-per-slice must be positive, got {step}.")
    return (np.arange(count) - (count - 1) / 2) * step / 1e6


def _ascending(z: Any) -> Any:
    """Return the planes in ascending order, with a note if they were descending."""
    if z[0] <= z[-1]:
        return z
    note(
        "the planes are reversed, because plane 0 is nearest to the objective: "
        f"{z[-1] * 1e6:g} to {z[0] * 1e6:g} um."
    )
    return z[::-1]


def _note_far(camera: Microscope, z: Any) -> None:
    """Warn about planes too far from the native plane to show detail, with their cost."""
    from clplen.microscopy.model.psf import lenslets_across

    far = np.abs(z) > MAX_RANGES * camera.depth_range
    if not far.any():
        return
    farthest = float(z[np.abs(z).argmax()])
    across, finest = lenslets_across(camera, farthest), 1e6 / camera.band_limit(farthest)
    note(
        f"{far.sum():,} of {options.planes(len(z))} lie more than {MAX_RANGES} light-field ranges "
        f"of {camera.depth_range * 1e6:.3g} um from the native plane: at z = {farthest * 1e6:g} um "
        f"a point covers {across} x {across} lenslets, and the resolution is {finest:.3g} um."
    )


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Handle SIGTERM as Ctrl-C, so that no partial file remains."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _simulate(
    file: MicroscopeFile,
    z: Any,
    sampling: dict[str, Any],
    device: Device,
    output: Path,
) -> PointImages:
    """Simulate the point images of a microscope file, and write them to ``output``."""
    from clplen.cameras.light_field_microscope import Microscope
    from clplen.microscopy.model.binning import binning_error
    from clplen.microscopy.model.psf import point_images

    camera = file.camera.build(device)
    assert isinstance(camera, Microscope)
    click.echo(describe_microscope(camera))
    _note_far(camera, z)
    pixels = camera.pixels_per_lenslet / file.binning
    if file.binning > 1 and file.rectified and sampling["binning"] is None:
        note(
            f"{'rectified ' * file.rectified}pixels of "
            f"{camera.lenslet_pitch / pixels * 1e6:.4g} um "
            f"{'undersample' if file.min_binning > 1 else 'integrate'} the light: it is simulated "
            f"on {file.binning} x {file.binning} samples per pixel, which are summed."
        )
    if not file.rectified:
        note(
            f"frames are not rectified: point images have {pixels:g} pixels per lenslet, frames "
            f"{file.pixels:.6g}."
        )
    elif abs(file.pixels - pixels) > 1e-6:
        note(f"a lenslet has {file.pixels:.6g} pixels: frames are rectified to {pixels:g}.")
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


def describe_microscope(camera: Any) -> Description:
    """Return the description of a microscope without the rows about a finite array."""
    description = camera.describe()
    rows = [
        replace(row, text="") if row.name == "pixel pitch" else row
        for row in description.rows
        if row.name not in _ARRAY_ROWS
    ]
    return replace(description, rows=tuple(rows))


def _check_planes(
    path: Path, values: Any, about: dict[str, Any], images: PointImages | FourierPointImages
) -> None:
    """Raise an error if the planes differ, or if voxels are negative or not finite."""
    image_z, volume_z = images.planes * 1e6, about.get("planes_um", [])
    if len(values) != len(image_z):
        raise click.ClickException(
            f"{path} has {options.planes(len(values))}, the point images have {len(image_z)}: "
            "make point images for the planes of the volume."
        )
    for number, (z, expected) in enumerate(zip(volume_z, image_z, strict=False)):
        if abs(z - expected) > 1e-6:
            raise click.ClickException(
                f"Plane {number} (from 0) of {path} lies at z = {z:g} um, but at {expected:g} um "
                "in the point images: make point images for the planes of the volume."
            )
    bad = int(np.count_nonzero(~np.isfinite(values) | (values < 0)))
    if bad:
        raise click.ClickException(f"{path} has {bad:,} voxels that are negative or not finite.")
