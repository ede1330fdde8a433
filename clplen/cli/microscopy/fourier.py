"""What ``clplen microscope`` does for Fourier microscopes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared.console import check_output, note, open_device, progress_bar, update_bar

if TYPE_CHECKING:
    from clplen.cameras import FourierMicroscope
    from clplen.compute.device import Device

OF_ANOTHER = ("binning", "half")  # options of microscopes with lenslets on the native image


def print_example(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print a commented camera file, and stop."""
    if wanted:
        from clplen.config.fourier_microscope import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        ctx.exit()


def simulate(
    path: Path,
    output: Path,
    z: Any,
    sampling: dict[str, Any],
    *,
    cut: float | None,
    force: bool,
    selector: str | None,
) -> None:
    """Point images of a camera file, kept in ``output``."""
    from clplen.config.fourier_microscope import read_fourier_file
    from clplen.microscopy.fourier.fourier_psf import CUT, fourier_point_images

    for name in OF_ANOTHER:
        if sampling[name]:
            raise click.UsageError(
                f"--{name} is of microscopes with lenslets on the native image; {path} is of a "
                "Fourier microscope, whose pixels integrate and whose images are small."
            )
    check_output(output, force, [path, *filter(None, [sampling["beads"]])])
    file = read_fourier_file(path)
    camera = file.camera.build(open_device(selector))
    click.echo(camera.describe())
    deep = abs(z).max()
    if 2 * deep > 2 * camera.depth_of_field:
        note(
            f"planes reach {deep * 1e6:.4g} um from the focal plane, and sub-images are sharp "
            f"within {camera.depth_of_field / 2e-6:.3g} um of it."
        )
    if sampling["beads"]:
        _measured(camera, sampling["beads"], z, output)
        return
    with progress_bar(len(z), "plane") as bar:
        images = fourier_point_images(
            camera,
            z,
            voxels_per_pixel=sampling["voxels"] or file.voxels,
            cut=CUT if cut is None else cut,
            path=output,
            progress=lambda done, total: update_bar(bar, done, total),
        )
    kept = min(images.captured_share(plane) for plane in range(len(z)))
    click.echo(
        f"{output} holds {images!r}; they keep {kept:.2%} of the light of the pupil, the rest "
        "falls between lenslets, and up to the cut beyond their images."
    )


def _measured(camera: FourierMicroscope, path: Path, z: Any, output: Path) -> None:
    """Measured point images, kept in ``output``."""
    from clplen.files import naming
    from clplen.io.formats.tiff import frames_in
    from clplen.microscopy.deconvolution_files import read_picture
    from clplen.microscopy.fourier.bead_stack import measure_point_images
    from clplen.microscopy.model.point_image_files import write_point_images

    count = frames_in(path)
    if count != len(z):
        raise click.ClickException(f"{path} has {count} frames, and there are {len(z)} planes.")
    stack = np.stack([read_picture(path, number if count > 1 else None) for number in range(count)])
    with naming(str(path)):
        if stack.shape[1:] == camera.grid.shape:
            stack = _repaired(camera, stack, z)
        found = measure_point_images(camera, stack, z)
    write_point_images(output, found.images)
    y, x = found.positions.mean(axis=0) * 1e6
    click.echo(
        f"{output} holds {found.images!r}, measured; the z given lie {found.offset * 1e6:+.3g} um "
        f"beyond those of the bead, which is {y:+.3g} um down and {x:+.3g} um right of the axis; "
        f"sub-images lie where rays put them within {found.error:.3g} pixels (rms)."
    )


def _repaired(camera: FourierMicroscope, stack: Any, z: Any) -> Any:
    """The stack without pixels that stand out more than light of the parameters does."""
    from clplen.microscopy.fourier.fourier_psf import fourier_point_images
    from clplen.microscopy.frames.outliers import without_hot_pixels
    from clplen.microscopy.frames.sharpness import chosen_planes, sharpness

    some = np.asarray(z)[chosen_planes(len(z))]
    frames, hot = without_hot_pixels(stack, sharpness(fourier_point_images(camera, some)))
    if hot:
        note(f"{hot:,} hot pixels in {len(stack)} frames are replaced by the median around them.")
    return frames


Rows = list[tuple[str, str]]


def info_of_parameters(source: Path, device: Device) -> tuple[Rows, dict[str, Any]]:
    """What follows from a camera file of a Fourier microscope, for ``clplen info``."""
    from clplen.config.fourier_microscope import read_fourier_file

    file, kind = read_fourier_file(source), "parameters of a Fourier light-field microscope"
    known = file.camera.build(device).describe()
    asked = {"slices": file.slices, "um_per_slice": file.um_per_slice, "voxels": file.voxels}
    rows = [("File", f"{source}, {kind}"), ("Camera", known.title)]
    rows += [("", line) for line in str(known).splitlines()[1:]]
    rows += [(name.replace("_", " ").capitalize(), f"{value:g}") for name, value in asked.items()
             if value is not None]  # fmt: skip
    lengths = {row.name: row.value for row in known.rows}
    return rows, {"file": source, "kind": kind, "camera": lengths, **asked}


def point_images(source: Path) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """Return what a file's Fourier point images were made with; None if it is something else."""
    from clplen.microscopy.model.point_image_files import read_parameters

    known = read_parameters(source) if source.suffix.lower() in (".h5", ".hdf5") else None
    return known if known is not None and "voxels_per_pixel" in known[0] else None


def info_of_point_images(
    source: Path, known: dict[str, Any], shapes: list[tuple[int, ...]]
) -> tuple[Rows, dict[str, Any]]:
    """Of point images of a Fourier microscope, for ``clplen info``."""
    kind = "point images of a Fourier light-field microscope"
    planes = ", ".join(f"{z * 1e6:g}" for z in known["planes"])
    scale = known["magnification"] * known["sensor_distance"] / known["relay"]
    b, count = known["voxels_per_pixel"], len(known["lenslet_positions"])
    side = known["pixel_pitch"] / scale / b
    ny, nx = known["sensor"]
    rows = [
        ("File", f"{source}, {kind}, {known['source']}"),
        ("Objective", f"{known['magnification']:g}x/{known['na']:g} in index "
            f"{known['medium_index']:g}, {known['wavelength'] * 1e9:g} nm"),
        ("Relay", f"{known['relay'] * 1e3:g} mm, field stop {known['field_stop'] * 1e3:.4g} mm"),
        ("Lenslets", f"{count}, {shapes[0][1]} with light, {known['lenslet_fill']}, "
            f"{known['lenslet_diameter'] * 1e6:g} um"),
        ("Sensor", f"{ny} x {nx} pixels of {known['pixel_pitch'] * 1e6:g} um"),
        ("Voxels", f"{b} x {b} a pixel, {side * 1e6:.4g} um apart"),
        ("Planes", f"{len(shapes)}, z = {planes} um; farther from the objective positive"),
        ("Images", f"of {', '.join(str(shape[2]) for shape in shapes)} pixels across"),
    ]  # fmt: skip
    return rows, {"file": source, "kind": kind, **known, "shapes": shapes}
