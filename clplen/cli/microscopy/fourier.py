"""Fourier microscopes in ``clplen microscope`` and ``clplen info``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared.console import check_output, note, open_device, progress_bar, update_bar

if TYPE_CHECKING:
    from clplen.cameras import FourierMicroscope
    from clplen.compute.device import Device

UNSUPPORTED_OPTIONS = ("binning", "half")  # for microscopes with lenslets on the native image only


def print_example(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    """Print a commented camera file, and exit."""
    if is_set:
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
    """Compute or measure the point images of a camera file, and write them to ``output``."""
    from clplen.config.fourier_microscope import read_fourier_file
    from clplen.microscopy.fourier.fourier_psf import CUT, fourier_point_images

    for name in UNSUPPORTED_OPTIONS:
        if sampling[name]:
            raise click.UsageError(
                f"--{name} applies to microscopes with lenslets on the native image, but {path} is "
                "a Fourier microscope: leave it out."
            )
    check_output(output, force, [path, *filter(None, [sampling["beads"]])])
    file = read_fourier_file(path)
    camera = file.camera.build(open_device(selector))
    click.echo(camera.describe())
    deep = abs(z).max()
    if 2 * deep > 2 * camera.depth_of_field:
        note(
            f"planes reach {deep * 1e6:.4g} um from the focal plane, but sub-images are sharp "
            f"only within {camera.depth_of_field / 2e-6:.3g} um of it."
        )
    if sampling["beads"]:
        _measure(camera, sampling["beads"], z, output)
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
    light = min(images.captured_share(plane) for plane in range(len(z)))
    click.echo(
        f"{output} holds {images!r}; they contain {light:.2%} of the light of the pupil, the rest "
        "falls between lenslets or beyond the point images (--cut)."
    )


def _measure(camera: FourierMicroscope, path: Path, z: Any, output: Path) -> None:
    """Measure point images on frames of a bead, and write them to ``output``."""
    from clplen.files import naming
    from clplen.io.formats.tiff import frames_in
    from clplen.microscopy.deconvolution_files import read_picture
    from clplen.microscopy.fourier.bead_stack import measure_point_images
    from clplen.microscopy.model.point_image_files import write_point_images

    count = frames_in(path)
    if count != len(z):
        raise click.ClickException(
            f"{path} must have a frame for each of the {len(z)} planes, got {count} frames."
        )
    stack = np.stack([read_picture(path, number if count > 1 else None) for number in range(count)])
    with naming(str(path)):
        if stack.shape[1:] == camera.grid.shape:
            stack = _repaired(camera, stack, z)
        measurement = measure_point_images(camera, stack, z)
    write_point_images(output, measurement.images)
    y, x = measurement.positions.mean(axis=0) * 1e6
    click.echo(
        f"{output} holds {measurement.images!r}, measured. The given z exceed the z of the bead by "
        f"{measurement.offset * 1e6:+.3g} um; the bead lies {y:+.3g} um down and {x:+.3g} um right "
        "of the axis. Sub-images deviate from the ray model by "
        f"{measurement.error:.3g} pixels (rms)."
    )


def _repaired(camera: FourierMicroscope, stack: Any, z: Any) -> Any:
    """Replace hot pixels, which are sharper than any light of the microscope."""
    from clplen.microscopy.fourier.fourier_psf import fourier_point_images
    from clplen.microscopy.frames.outliers import without_hot_pixels
    from clplen.microscopy.frames.sharpness import chosen_planes, sharpness

    subset = np.asarray(z)[chosen_planes(len(z))]
    frames, hot = without_hot_pixels(stack, sharpness(fourier_point_images(camera, subset)))
    if hot:
        note(
            f"{hot:,} hot pixels in {len(stack)} frames are replaced by the median of their "
            "neighbours."
        )
    return frames


Rows = list[tuple[str, str]]


def info_of_parameters(source: Path, device: Device) -> tuple[Rows, dict[str, Any]]:
    """Return the quantities derived from a file of a Fourier microscope, for ``clplen info``."""
    from clplen.config.fourier_microscope import read_fourier_file

    file, kind = read_fourier_file(source), "parameters of a Fourier light-field microscope"
    description = file.camera.build(device).describe()
    counts = {"slices": file.slices, "um_per_slice": file.um_per_slice, "voxels": file.voxels}
    rows = [("File", f"{source}, {kind}"), ("Camera", description.title)]
    rows += [("", line) for line in str(description).splitlines()[1:]]
    rows += [(name.replace("_", " ").capitalize(), f"{value:g}") for name, value in counts.items()
             if value is not None]  # fmt: skip
    lengths = {row.name: row.value for row in description.rows}
    return rows, {"file": source, "kind": kind, "camera": lengths, **counts}


def point_images(source: Path) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """Read the parameters and shapes of Fourier point images; return None for other files."""
    from clplen.microscopy.model.point_image_files import read_parameters

    content = read_parameters(source) if source.suffix.lower() in (".h5", ".hdf5") else None
    return content if content is not None and "voxels_per_pixel" in content[0] else None


def info_of_point_images(
    source: Path, parameters: dict[str, Any], shapes: list[tuple[int, ...]]
) -> tuple[Rows, dict[str, Any]]:
    """Return the rows and data of Fourier point images, for ``clplen info``."""
    kind = "point images of a Fourier light-field microscope"
    planes = ", ".join(f"{z * 1e6:g}" for z in parameters["planes"])
    scale = parameters["magnification"] * parameters["sensor_distance"] / parameters["relay"]
    b, count = parameters["voxels_per_pixel"], len(parameters["lenslet_positions"])
    side = parameters["pixel_pitch"] / scale / b
    ny, nx = parameters["sensor"]
    rows = [
        ("File", f"{source}, {kind}, {parameters['source']}"),
        ("Objective", f"{parameters['magnification']:g}x/{parameters['na']:g} in index "
            f"{parameters['medium_index']:g}, {parameters['wavelength'] * 1e9:g} nm"),
        ("Relay", f"{parameters['relay'] * 1e3:g} mm, field stop "
            f"{parameters['field_stop'] * 1e3:.4g} mm"),
        ("Lenslets", f"{count}, {shapes[0][1]} with light, {parameters['lenslet_fill']}, "
            f"{parameters['lenslet_diameter'] * 1e6:g} um"),
        ("Sensor", f"{ny} x {nx} pixels of {parameters['pixel_pitch'] * 1e6:g} um"),
        ("Voxels", f"{b} x {b} per pixel, {side * 1e6:.4g} um apart"),
        ("Planes", f"{len(shapes)}, z = {planes} um; farther from the objective positive"),
        ("Images", f"of {', '.join(str(shape[2]) for shape in shapes)} pixels across"),
    ]  # fmt: skip
    return rows, {"file": source, "kind": kind, **parameters, "shapes": shapes}
