"""``clplen refocus``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_planes,
    disparities_of,
    note,
    note_end,
    note_nearly_black,
    planes_of,
    read,
    sharpest_plane,
)
from clplen.cli.shared.pictures import (
    PICTURES,
    Point,
    Tone,
    check_output,
    depth_map,
    pixel_of,
    read_map,
    tone,
    write,
)

if TYPE_CHECKING:
    from clplen.lightfield.depth.depth_maps import DepthMap
    from clplen.lightfield.model.light_field import LightField

Values = np.ndarray[Any, Any]

MAX_UPSAMPLE = 16  # largest factor of --upsample
MIN_CONFIDENCE = 1e-3  # below it rounding errors decide which plane is the sharpest


@click.command(cls=options.Command)
@options.source
@options.output("OUT.tif|OUT.png", "Output: TIFF of linear float32, or PNG scaled for viewing.")
@click.option(
    "--disparity",
    type=options.FINITE,
    help="Disparity of the plane in focus, in pixels per view step; larger is nearer.",
)
@click.option("--alpha", type=options.FINITE, help="Plane in focus as alpha = F/F'.")
@click.option("--at", type=Point(), help="Pixel to focus on; its depth is estimated by sharpness.")
@click.option(
    "--tilt",
    type=Point(depth=True),
    multiple=True,
    help="Pixel of a tilted plane in focus, given three times; its disparity is D, or estimated by "
    "sharpness.",
)
@click.option(
    "--all-in-focus", is_flag=True, help="Focus every pixel on the plane where it is sharpest."
)
@depth_map
@click.option(
    "--upsample",
    type=int,
    default=1,
    help=f"Number of output pixels per pixel of a view along each axis, 1 to {MAX_UPSAMPLE}. "
    "Default: 1.",
)
@options.interpolation
@options.aperture
@tone
@options.plane_range
@options.layout
@options.device
def refocus(
    source: Path,
    output: Path,
    disparity: float | None,
    alpha: float | None,
    at: Any,
    tilt: Any,
    all_in_focus: bool,
    depth_file: Path | None,
    upsample: int,
    interpolation: str,
    aperture: Any,
    limits: Any,
    curve: Any,
    disparities: Any,
    alphas: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Focus a light field on a plane, a pixel or everything.

    --at, --tilt and --all-in-focus search the planes of --disparities or --alphas for the sharpest.

    \b
    Example:
      clplen refocus flower -o near.tif --disparity -0.55
      clplen refocus flower -o here.png --at 120,88 --disparities -1:0:41
      clplen refocus flower -o tilted.tif --tilt 40,128,-0.8 --tilt 230,20,-0.5 --tilt 230,230,-0.5
      clplen refocus flower -o sharp.tif --all-in-focus --disparities -1:0:41
    """
    check_planes(disparities, alphas)
    _check_target(disparity, alpha, at, tilt, all_in_focus, depth_file)
    scaling = Tone(limits, curve)
    scaling.check(output)
    _check_words(bool(at or tilt or all_in_focus), disparities, alphas, upsample, all_in_focus)
    _check_tilt(tilt)
    if aperture is not None and (tilt or upsample != 1):
        raise click.UsageError("--aperture cannot be combined with --tilt or --upsample.")
    check_output(source, output, layout, PICTURES)
    lf = read(source, selector, layout)
    note_nearly_black(lf, aperture)
    if depth_file is not None:
        if upsample != 1 or interpolation == "fourier":
            raise click.UsageError(
                "--depth-map cannot be combined with --upsample or --interpolation fourier."
            )
        picture = lf.flatten(
            disparity=read_map(depth_file, lf), aperture=aperture, interpolation=interpolation
        ).to_numpy()
        target = f"the surface in {depth_file}"
    elif all_in_focus:
        picture, target = _sharp(lf, planes_of(lf, disparities, alphas), aperture)
    else:
        if alpha is None:
            d, target = _surface(lf, disparity, at, tilt, disparities, alphas)
            plane = {"disparity": d}
        elif np.isfinite(lf.alpha(0.0)):
            plane, target = {"alpha": alpha}, f"alpha = {alpha:g}"
        else:
            raise ValueError(
                "--alpha = F/F' needs the image distance F and the spacing of views and pixels in "
                "metres, which this light field does not store: use --disparity."
            )
        picture = _focused(lf, plane, aperture, upsample, interpolation)
    linear = layout["srgb"] or lf.linear
    description = write(output, picture, lf, srgb=linear, upsample=upsample, tone=scaling)
    click.echo(f"{output}: focused on {target}, {description}.")


def _check_target(*targets: Any) -> None:
    if sum(not (target is None or target is False or target == ()) for target in targets) != 1:
        raise click.UsageError(
            "Give one of --disparity, --alpha, --at, --tilt (three times), --all-in-focus and "
            "--depth-map."
        )


def _check_words(
    seeks: bool, disparities: Any, alphas: Any, upsample: int, all_in_focus: bool
) -> None:
    if not seeks and (disparities is not None or alphas is not None):
        raise click.UsageError(
            "--disparities and --alphas need --at, --tilt or --all-in-focus, which search these "
            "planes; for a single plane use --disparity or --alpha."
        )
    if not 1 <= upsample <= MAX_UPSAMPLE:
        raise click.UsageError(
            f"--upsample must be a whole number from 1 to {MAX_UPSAMPLE}, got {upsample}."
        )
    if all_in_focus and upsample != 1:
        raise click.UsageError("--upsample cannot be combined with --all-in-focus.")


def _check_tilt(tilt: Any) -> None:
    if tilt and len(tilt) != 3:
        raise click.UsageError(
            f"--tilt must be given three times, for three pixels, got {len(tilt)}."
        )


def _focused(
    lf: LightField, plane: dict[str, Any], aperture: Any, upsample: int, interpolation: str
) -> Values:
    from clplen.lightfield.refocusing.focal_stacks import refocus
    from clplen.lightfield.stacks import focal_stack

    if aperture is None:
        picture = refocus(lf, **plane, upsample=upsample, interpolation=interpolation)
        return picture.to_numpy()
    plurals = {"alpha": "alphas", "disparity": "disparities"}
    planes: dict[str, Any] = {plurals[name]: [value] for name, value in plane.items()}
    return focal_stack(lf, **planes, aperture=aperture, interpolation=interpolation).to_numpy()[0]


def _sharp(lf: LightField, planes: dict[str, Any], aperture: Any) -> tuple[Values, str]:
    from clplen.lightfield.focus_and_depth import all_in_focus
    from clplen.lightfield.stacks import focal_stack

    stack = focal_stack(lf, aperture=aperture, **planes)
    count = options.planes(len(stack.disparities))
    best = sharpest_plane(stack, lf)
    if isinstance(best, str):
        return all_in_focus(stack).to_numpy(), f"{count}, none of them the sharpest: {best}"
    note_end(stack.disparities, stack.disparities[best])
    return all_in_focus(stack).to_numpy(), f"the sharpest of {count}"


def _surface(
    lf: LightField, disparity: Any, at: Any, tilt: Any, disparities: Any, alphas: Any
) -> tuple[Any, str]:
    """Return the disparity or disparity map in focus, and its description."""
    from clplen.lightfield.focus_and_depth import depth_map
    from clplen.lightfield.model.rendering import plane_through

    if disparity is not None:
        return disparity, f"d = {disparity:g}"
    points = [at] if at else list(tilt)
    pixels = [pixel_of(lf, point) for point in points]
    depth, tried_disparities = None, np.array([])
    if any(len(point) == 2 for point in points):
        planes = planes_of(lf, disparities, alphas)
        depth, tried_disparities = depth_map(lf, **planes), disparities_of(lf, planes)
    depths = [
        point[2] if len(point) == 3 else _depth_at(depth, pixel, tried_disparities)
        for point, pixel in zip(points, pixels, strict=True)
    ]
    if at:
        return depths[0], f"d = {depths[0]:.4f} (at {pixels[0][0]},{pixels[0][1]})"
    plane = plane_through(np.column_stack((np.array(pixels), depths)), lf.shape[2:])
    values = ", ".join(f"{d:.4f}" for d in depths)
    return plane, f"the plane of d = {values} at the three pixels"


def _depth_at(depth: DepthMap | None, pixel: tuple[int, int], disparities: Values) -> float:
    if depth is None:
        raise ValueError("No depth map was computed.")
    d = float(depth.disparity[pixel])
    at_end = note_end(disparities, d, f"at {pixel[0]},{pixel[1]} the sharpest plane is")
    if not at_end and not depth.confidence[pixel] > MIN_CONFIDENCE:
        note(
            f"at {pixel[0]},{pixel[1]} the scene has too little texture to estimate depth, or lies "
            "beyond the planes: this pixel may be out of focus."
        )
    return d
