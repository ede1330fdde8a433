"""``clplen refocus``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_planes,
    note,
    note_end,
    note_nearly_black,
    planes_of,
    read,
    sharpest_of,
    tried_disparities,
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

_MOST = 16  # of --upsample
_SURE = 1e-3  # of a confidence: below it there is nothing to tell depth by


@click.command(cls=options.Command)
@options.source
@options.output("OUT.tif|OUT.png", "TIFF holds linear float32; PNG is scaled, to look at.")
@click.option(
    "--disparity", type=options.FINITE, help="Plane in focus, pixels a view step, nearer larger."
)
@click.option("--alpha", type=options.FINITE, help="Plane in focus, alpha = F/F'.")
@click.option(
    "--at", type=Point(), help="Focus on this pixel, whose depth is estimated by sharpness."
)
@click.option(
    "--tilt",
    type=Point(depth=True),
    multiple=True,
    help="Given three times, focus on the plane through three pixels, of disparity D or as "
    "estimated by sharpness.",
)
@click.option(
    "--all-in-focus", is_flag=True, help="Focus every pixel on the plane where it is sharp."
)
@depth_map
@click.option(
    "--upsample", type=int, default=1, help="Number of pixels along each axis for one of the views."
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
    """Focus a light field on a plane, a pixel, a tilted plane, or everything.

    The planes of --disparities or --alphas are those among which --at, --tilt and --all-in-focus
    look for what is sharp.

    \b
    Example:
      clplen refocus flower -o near.tif --disparity -0.55
      clplen refocus flower -o here.png --at 120,88 --disparities -1:0:41
      clplen refocus flower -o tilted.tif --tilt 40,128,-0.8 --tilt 230,20,-0.5 --tilt 230,230,-0.5
      clplen refocus flower -o sharp.tif --all-in-focus --disparities -1:0:41
    """
    check_planes(disparities, alphas)
    _check_target(disparity, alpha, at, tilt, all_in_focus, depth_file)
    shown = Tone(limits, curve)
    shown.check(output)
    _check_words(bool(at or tilt or all_in_focus), disparities, alphas, upsample, all_in_focus)
    _check_tilt(tilt)
    if aperture is not None and (tilt or upsample != 1):
        raise click.UsageError("--aperture goes neither with --tilt nor with --upsample.")
    check_output(source, output, layout, PICTURES)
    lf = read(source, selector, layout)
    note_nearly_black(lf, aperture)
    if depth_file is not None:
        if upsample != 1 or interpolation == "fourier":
            raise click.UsageError("--depth-map goes neither with --upsample nor with fourier.")
        picture = lf.flatten(
            disparity=read_map(depth_file, lf), aperture=aperture, interpolation=interpolation
        ).to_numpy()
        where = f"the surface in {depth_file}"
    elif all_in_focus:
        picture, where = _sharp(lf, planes_of(lf, disparities, alphas), aperture)
    else:
        if alpha is None:
            d, where = _surface(lf, disparity, at, tilt, disparities, alphas)
            plane = {"disparity": d}
        elif np.isfinite(lf.alpha(0.0)):
            plane, where = {"alpha": alpha}, f"alpha = {alpha:g}"
        else:
            raise ValueError(
                "--alpha = F/F' needs F (a microscope has none) and the spacing of views and "
                "pixels in metres, which this light field does not have: use --disparity."
            )
        picture = _focused(lf, plane, aperture, upsample, interpolation)
    linear = layout["srgb"] or lf.linear
    said = write(output, picture, lf, srgb=linear, upsample=upsample, tone=shown)
    click.echo(f"{output}: focused on {where}, {said}.")


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
            "--disparities and --alphas are the planes that --at, --tilt and --all-in-focus look "
            "through; for one plane use --disparity or --alpha."
        )
    if not 1 <= upsample <= _MOST:
        raise click.UsageError(f"--upsample is a whole number from 1 to {_MOST}, not {upsample}.")
    if all_in_focus and upsample != 1:
        raise click.UsageError("--upsample goes with one plane, not with --all-in-focus.")


def _check_tilt(tilt: Any) -> None:
    if tilt and len(tilt) != 3:
        raise click.UsageError(f"--tilt is given three times, for three pixels, not {len(tilt)}.")


def _focused(
    lf: LightField, plane: dict[str, Any], aperture: Any, upsample: int, interpolation: str
) -> Values:
    from clplen.lightfield.refocusing.focal_stacks import refocus
    from clplen.lightfield.stacks import focal_stack

    if aperture is None:
        picture = refocus(lf, **plane, upsample=upsample, interpolation=interpolation)
        return picture.to_numpy()
    many = {"alpha": "alphas", "disparity": "disparities"}
    planes: dict[str, Any] = {many[name]: [value] for name, value in plane.items()}
    return focal_stack(lf, **planes, aperture=aperture, interpolation=interpolation).to_numpy()[0]


def _sharp(lf: LightField, planes: dict[str, Any], aperture: Any) -> tuple[Values, str]:
    from clplen.lightfield.focus_and_depth import all_in_focus
    from clplen.lightfield.stacks import focal_stack

    stack = focal_stack(lf, aperture=aperture, **planes)
    count = options.planes(len(stack.disparities))
    best = sharpest_of(stack, lf)
    if isinstance(best, str):
        return all_in_focus(stack).to_numpy(), f"of {count}, none the sharpest: {best}"
    note_end(stack.disparities, stack.disparities[best])
    return all_in_focus(stack).to_numpy(), f"the sharpest of {count}"


def _surface(
    lf: LightField, disparity: Any, at: Any, tilt: Any, disparities: Any, alphas: Any
) -> tuple[Any, str]:
    """(disparity or map, what it is in words)."""
    from clplen.lightfield.focus_and_depth import depth_map
    from clplen.lightfield.model.rendering import plane_through

    if disparity is not None:
        return disparity, f"d = {disparity:g}"
    points = [at] if at else list(tilt)
    pixels = [pixel_of(lf, point) for point in points]
    found, tried = None, np.array([])
    if any(len(point) == 2 for point in points):
        planes = planes_of(lf, disparities, alphas)
        found, tried = depth_map(lf, **planes), tried_disparities(lf, planes)
    depths = [
        point[2] if len(point) == 3 else _depth_at(found, pixel, tried)
        for point, pixel in zip(points, pixels, strict=True)
    ]
    if at:
        return depths[0], f"d = {depths[0]:.4f} (at {pixels[0][0]},{pixels[0][1]})"
    plane = plane_through(np.column_stack((np.array(pixels), depths)), lf.shape[2:])
    words = ", ".join(f"{d:.4f}" for d in depths)
    return plane, f"the plane of d = {words} at the three pixels"


def _depth_at(found: DepthMap | None, pixel: tuple[int, int], tried: Values) -> float:
    if found is None:
        raise ValueError("No depth was looked for.")
    d = float(found.disparity[pixel])
    at_end = note_end(tried, d, f"at {pixel[0]},{pixel[1]} the sharpest plane is")
    if not at_end and not found.confidence[pixel] > _SURE:
        note(
            f"At {pixel[0]},{pixel[1]} there is hardly any texture to tell depth by, or it lies "
            "beyond the planes: the picture may be out of focus there."
        )
    return d
