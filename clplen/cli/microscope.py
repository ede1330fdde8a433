"""``clplen microscope``: point images, projection and the group of commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli import options
from clplen.cli.common import bar_of, check_suffix, opened, reach
from clplen.cli.messages import note

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.config.microscope import MicroscopeFile
    from clplen.microscopy.images import PointImages

_PATH = click.Path(path_type=Path)
VOXELS = 5
CUT = 2e-3
_OF_THE_ARRAY = ("lenslets", "field of view")  # point images are those of an endless one


@click.group()
def microscope() -> None:
    """Light-field microscopes: point images (psf), frames (project), volumes (deconvolve)."""


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
    help="Parts of a pixel along an axis, added up, that light is simulated on; default: the "
    "fewest that sample it.",
)
@click.option(
    "--cut", type=float, default=CUT, show_default=True,
    help="Share of a voxel's light that may be left out.",
)  # fmt: skip
@click.option("--half", is_flag=True, help="Keep point images as float16: half of the memory.")
@options.device
def psf(camera: Path, output: Path, selector: str | None, **sampling: Any) -> None:
    """Simulate the point images of a microscope, and keep them in a file.

    CAMERA.toml is a camera file with kind = "microscope", or has the names of LFAnalyze:
    magnification, na, medium_index, wavelength (nm), tubelens_focal_length (mm), ulens_pitch,
    ulens_focal_length and pixel_size (um), num_slices, um_per_slice, supersample.

    \b
    Example:
      clplen microscope psf guv.toml -o psf.h5 --planes-um -20:20:41 --voxels 5
      clplen microscope deconvolve guv.tif -c psf.h5 --white white.tif -o volume.ome.tif
    """
    from clplen.config.microscope import read_microscope_file
    from clplen.io import check_writable

    check_suffix(output, (".h5", ".hdf5"))
    file = read_microscope_file(camera, binning=sampling["binning"])
    z = _planes_of(file, sampling, camera)
    check_writable(output)
    images = _simulated(file, z, sampling, opened(selector), output)
    kept = min(images.kept(plane) for plane in range(len(z)))
    click.echo(f"{output} holds {images!r}; at least {kept:.2%} of the light of a voxel is kept.")


@microscope.command()
@click.argument("volume", metavar="VOLUME", type=_PATH)
@click.option("-c", "--psf", "source", required=True, metavar="PSF.h5", type=_PATH)
@click.option("-o", "--output", required=True, metavar="FRAME.tif", type=_PATH)
@click.option("--memory", type=options.Size(), help="Bytes for matrices (512MiB, 4GB).")
@options.device
def project(
    volume: Path, source: Path, output: Path, memory: int | None, selector: str | None
) -> None:
    """Project a volume to the raw frame that the microscope would take, without noise.

    VOLUME is OME-TIFF, OME-Zarr or .npy, shape (planes, rows of voxels, columns of voxels), on the
    planes of the point images.

    \b
    Example:
      clplen microscope project volume.ome.tif -c psf.h5 -o frame.tif
    """
    from clplen.batch.volumes import read_psf
    from clplen.io import check_writable, write_picture
    from clplen.io.volume import read_volume
    from clplen.microscopy.projector import Projector

    check_suffix(output, (".tif", ".tiff"))
    values, about = read_volume(volume)
    images = read_psf(source)
    _check_volume(volume, values, about, images)
    if check_writable(output).exists() and volume.exists() and output.samefile(volume):
        raise click.UsageError(f"{output} is the volume that is read: name an output elsewhere.")
    v = images.voxels
    shape = (values.shape[1] // v, values.shape[2] // v)
    projector = Projector(images, shape, device=opened(selector), memory=memory)
    frame = projector.forward(values)
    write_picture(output, frame)
    rows, columns = shape
    click.echo(
        f"{output} holds {rows} x {columns} lenslets of {images.pixels} x {images.pixels} pixels, "
        f"with {frame.sum(dtype=float) / max(values.sum(dtype=float), 1e-300):.2%} of the light."
    )


def _planes_of(file: MicroscopeFile, sampling: dict[str, Any], path: Path) -> Any:
    """z of the planes in metres, of the options, else of the file."""
    count = sampling["num_slices"] or file.slices
    step = sampling["um_per_slice"] or file.um_per_slice
    if sampling["planes_um"] is not None:
        if sampling["num_slices"] or sampling["um_per_slice"]:
            raise click.UsageError("Give --planes-um, or --num-slices and --um-per-slice.")
        return sampling["planes_um"] / 1e6
    if count is None or step is None:
        raise click.UsageError(
            f"Neither the options nor {path} tell the planes: give --planes-um START:STOP:N, or "
            "--num-slices and --um-per-slice."
        )
    if not 0 < step < np.inf:
        raise click.UsageError(f"--um-per-slice is a positive number of micrometres, not {step}.")
    return (np.arange(count) - (count - 1) / 2) * step / 1e6


def _simulated(
    file: MicroscopeFile,
    z: Any,
    sampling: dict[str, Any],
    device: Device,
    output: Path,
) -> PointImages:
    """The point images of a file's microscope, kept in ``output``."""
    from clplen.cameras.microscope import Microscope
    from clplen.microscopy.psf import point_images

    camera = file.camera.build(device)
    assert isinstance(camera, Microscope)
    known = camera.describe()
    click.echo(replace(known, rows=tuple(r for r in known.rows if r.name not in _OF_THE_ARRAY)))
    pixels = camera.pixels_per_lenslet / file.binning
    if file.binning > 1 and sampling["binning"] is None:
        note(
            f"Pixels of {camera.lenslet_pitch / pixels * 1e6:.4g} um do not sample the light: "
            f"it is simulated on {file.binning} x {file.binning} parts of each, which are added up."
        )
    if abs(file.pixels - pixels) > 1e-6:
        note(f"A lenslet has {file.pixels:.6g} pixels: frames are rectified to {pixels:g}.")
    with bar_of(len(z), "plane") as bar:
        return point_images(
            camera,
            z,
            voxels_per_lenslet=sampling["voxels"] or file.voxels or VOXELS,
            binning=file.binning,
            cut=sampling["cut"],
            store="float16" if sampling["half"] else "float32",
            path=output,
            progress=lambda done, total: reach(bar, done, total),
        )


def _check_volume(path: Path, values: Any, about: dict[str, Any], images: PointImages) -> None:
    """Refuse a volume on other planes, or not of whole lenslets."""
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
    v = images.voxels
    if any(n % v or n == 0 for n in values.shape[1:]):
        raise click.ClickException(
            f"{path} has {values.shape[1]} x {values.shape[2]} voxels, no whole number of lenslets "
            f"of {v} x {v}."
        )
    bad = int(np.count_nonzero(~np.isfinite(values) | (values < 0)))
    if bad:
        raise click.ClickException(f"{path} has {bad:,} voxels that are negative or not finite.")
