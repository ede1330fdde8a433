"""Raw images of focused (plenoptic 2.0) cameras on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.metric import distances, write_map
from clplen.cli.shared.setting_options import Option
from clplen.settings.declaration import FOCUSED

if TYPE_CHECKING:
    from clplen.lightfield.focused.focused_depth import FocusedDepth, FocusedMaps
    from clplen.lightfield.raw.raw_image import RawImage

Values = np.ndarray[Any, Any]

_XML = (".xml", ".ray")
_LAYOUT = ("white", "dark", "grid", "step", "devignette", "max_bytes")
_ACCEPTED_INPUTS = (
    "raw images of focused cameras (raw.h5 of 'clplen simulate', a Raytrix XML, or a raw picture "
    "with --white or --grid)"
)
# The default planes span these percentiles of m over the sub-images, widened by 10 %, and at least
# 10 % of the median m to either side, so that a flat scene is bracketed, too.
_PERCENTILES = (2, 98)
_WIDENING, _MIN_HALF_RANGE = 1.1, 0.1


class Magnifications(click.ParamType):
    """Values of m = b/a from M, M,M,... or START:STOP:N."""

    name = "M|M,M,...|START:STOP:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> Values:
        text = str(value)
        if ":" in text:
            planes = options.Planes().convert(text, param, ctx)
            if (planes == 0).any():
                self.fail(
                    f"{text!r} contains m = 0, where no plane is in focus: give planes on one side "
                    "of 0, or another count.",
                    param,
                    ctx,
                )
            return planes
        try:
            numbers = np.array([float(part) for part in text.split(",")])
        except ValueError:
            numbers = np.array([np.nan])
        if not np.isfinite(numbers).all():
            self.fail(f"{text!r} is not m: give for example 0.2, 0.1,0.2 or 0.1:0.3:9.", param, ctx)
        return numbers


class Range(click.ParamType):
    """Range LEAST:GREATEST."""

    name = "LEAST:GREATEST"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float, float]:
        try:
            low, high = (float(part) for part in str(value).split(":"))
        except ValueError:
            self.fail(f"{value!r} is not LEAST:GREATEST, for example 0.1:0.3.", param, ctx)
        return low, high


def _with(*more: Any) -> Any:
    def add(command: Any) -> Any:
        for option in reversed((*more, _FOCUSED, _IMAGE)):
            command = option(command)
        return command

    return add


_FOCUSED = click.option(
    "--focused",
    cls=Option,
    group=FOCUSED,
    is_flag=True,
    help="Read INPUT as a raw image of a focused (plenoptic 2.0) camera; detected automatically "
    "for raw.h5 and a Raytrix XML.",
)
_IMAGE = click.option(
    "--image",
    cls=Option,
    group=FOCUSED,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Raw picture of a Raytrix XML. Default: the picture with the name of the XML.",
)
_VIEW = click.option(
    "--view",
    cls=Option,
    group=FOCUSED,
    type=options.FINITE,
    nargs=2,
    metavar="Y X",
    help="Viewpoint, as a pixel (y, x) from the centre of the sub-images.",
)
_PLANES = click.option(
    "--m",
    "ms",
    cls=Option,
    group=FOCUSED,
    type=Magnifications(),
    help="Planes in focus, as magnification m = b/a of the lenslets: START:STOP:N or 0.1,0.2. "
    "Default: 11 planes over the depth of the scene.",
)
picture_options = _with(
    click.option(
        "--method",
        cls=Option,
        group=FOCUSED,
        type=click.Choice(["basic", "blended", "depth"]),
        help="Rendering of a focused raw image: one patch per lenslet (basic), the mean over all "
        "lenslets that see a point (blended, the default), or blended with the depth of each "
        "pixel (depth).",
    ),
    click.option(
        "--m",
        "ms",
        cls=Option,
        group=FOCUSED,
        type=Magnifications(),
        help="Plane in focus, as magnification m = b/a of the lenslets; several planes "
        "START:STOP:N with --sweep focus. Default: the camera's focus, else the median of the "
        "scene.",
    ),
    click.option(
        "--patch",
        cls=Option,
        group=FOCUSED,
        type=options.FINITE,
        help="Width of a patch in pixels. Default: the width that follows from m.",
    ),
    _VIEW,
)
stack_options = _with(_PLANES, _VIEW)
depth_options = _with(
    click.option(
        "--m",
        "ms",
        cls=Option,
        group=FOCUSED,
        type=Range(),
        help="Search range of the magnification m = b/a of a focused raw image.",
    )
)


@dataclass(frozen=True)
class RawInput:
    """Raw image and, if given, the white image of its camera."""

    raw: RawImage
    white: Values | None

    @property
    def flat(self) -> Values | None:
        """White image averaged over its channels."""
        return self.white.mean(2) if self.white is not None and self.white.ndim == 3 else self.white


def is_focused_raw(source: Path, arguments: dict[str, Any]) -> bool:
    """Return True if INPUT is a raw image of a focused camera, by its file or by an option."""
    from clplen.io.lightfields.lightfield_files import kind_of

    if is_self_describing(source):
        return True
    names = [name for name, value in arguments.items() if value is not None and value is not False]
    if not names:
        return False
    kind = kind_of(source)
    if "white" not in kind.options:
        raise click.UsageError(
            f"--{names[0]} applies to {_ACCEPTED_INPUTS}, but {source} is {kind.name}."
        )
    return True


def is_self_describing(source: Path) -> bool:
    """Return True if a file stores the positions of the lenslets beside the raw image."""
    from clplen.io.raw.raw_files import is_raw_file

    return source.suffix.lower() in _XML or is_raw_file(source)


def refuse_options(**arguments: Any) -> None:
    """Reject options that apply to light fields only."""
    names = [name for name, value in arguments.items() if value is not None and value is not False]
    if names:
        raise click.UsageError(
            f"--{names[0].replace('_', '-')} applies to light fields, but INPUT is a raw image of "
            "a focused camera: choose its planes with --m (b/a)."
        )


def check_raw_picture(source: Path, image: Path | None, *outputs: Path) -> None:
    """Reject outputs that would overwrite the raw picture of a Raytrix XML."""
    from clplen.io.raw.raw_files import picture_of

    if source.suffix.lower() not in _XML:
        return
    picture = picture_of(source) if image is None else image
    for output in outputs:
        if output.exists() and picture.exists() and picture.samefile(output):
            raise click.UsageError(f"{output} is the raw image of {source}: choose another output.")


def read(
    source: Path, selector: str | None, layout: dict[str, Any], image: Path | None
) -> RawInput:
    """Read a raw image and its lattice; with ``--grid`` the white image only evens brightness."""
    from clplen.compute.device import Device
    from clplen.io import read_raw
    from clplen.io.lightfields.layout import Layout
    from clplen.lightfield.focused.focused_geometry import require_focused
    from clplen.lightfield.raw.demosaicing import demosaic

    Layout(**layout).require(_LAYOUT, "a raw image of a focused camera")
    white, dark, grid = (layout[name] for name in ("white", "dark", "grid"))
    device = Device.open(selector)
    if is_self_describing(source):
        if dark is not None or grid is not None:
            raise click.UsageError(
                f"--dark and --grid do not apply to {source}, which stores its lenslets: leave "
                "them out."
            )
        raw = read_raw(source, device=device, image=image)
    else:
        lattice_source = white if grid is None else None
        raw = read_raw(
            source,
            device=device,
            image=image,
            white=lattice_source,
            dark=dark,
            grid=grid,
            force=layout["force"],
        )
    raw = raw.above_black() if raw.mosaic is None else demosaic(raw)
    require_focused(raw)
    return RawInput(raw, None if layout["devignette"] is False else _white(white, dark))


def _white(white: Path | None, dark: Path | None) -> Values | None:
    from clplen.io.raw.raw_files import read_frame

    if white is None:
        return None
    values = read_frame(white)[0].astype(np.float32)
    return values if dark is None else values - read_frame(dark)[0].astype(np.float32)


def suitable_ms(raw_input: RawInput, count: int) -> Values:
    """Return planes, equidistant in m, that span the depth of the scene."""
    from clplen.lightfield.focused.focused_depth import focused_depth

    depth = focused_depth(raw_input.raw, white=raw_input.flat)
    median = depth.median  # raises an error if no sub-image is reliable
    low, high = np.percentile(depth.m[depth.confidence >= depth.sure], _PERCENTILES)
    half = max(_WIDENING * (high - low) / 2, _MIN_HALF_RANGE * abs(median))
    return np.linspace((low + high) / 2 - half, (low + high) / 2 + half, count)


def fraction(aperture: Any) -> float:
    """Return the aperture as a fraction of a sub-image's diameter."""
    if isinstance(aperture, str):
        raise click.UsageError(
            "--aperture of a focused raw image must be a fraction of a sub-image's diameter, such "
            f"as 0.5, got {aperture}."
        )
    return 1.0 if aperture is None else float(aperture)


SUFFIXES = (".h5", ".hdf5", ".tif", ".tiff", ".pfm", ".npy")
_FROM_FOCUS = " from the plane in focus, farther positive"
_POINTS = "metres: x right, y down from the axis, z from the plane in focus, farther positive"


def find_depth(
    raw_input: RawInput,
    output: Path,
    *,
    ms: tuple[float, float] | None,
    step: float | None,
    confidence: Path | None,
    metric: Path | None,
    ply: Path | None,
    title: str,
) -> None:
    """Estimate the depth, write it with a picture, and print a summary."""
    from clplen import plot
    from clplen.io import write_focused_depth
    from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
    from clplen.lightfield.focused.focused_picture import PictureGrid
    from clplen.plot.base import verbatim

    if metric is not None and raw_input.raw.camera is None:
        raise click.UsageError(
            "--metric needs the camera, which only raw.h5 of 'clplen simulate' stores: leave it "
            "out."
        )
    depth = focused_depth(raw_input.raw, ms=ms, white=raw_input.flat)
    size = depth.geometry.patch(depth.median)
    maps = focused_maps(raw_input.raw, depth, grid=PictureGrid.over(depth.geometry, size, step))
    write_focused_depth(output, depth, maps, replace=True)
    files = ""
    if confidence is not None:
        write_map(confidence, maps.confidence.astype(np.float32))
        files += f", {confidence} its confidence"
    if metric is not None:
        write_map(metric, maps.z.astype(np.float32))
        files += f", {metric} the distances in metres{_FROM_FOCUS}"
    if ply is not None:
        files += f", {ply} the points {_write_points(ply, raw_input, depth, maps)}"
    picture = output.with_suffix(".png")
    figure = plot.magnification(maps.m, maps.confidence, title=f"m = b/a of {verbatim(title)}")
    plot.save(figure, picture)
    click.echo(f"{output} holds m of every pixel, {picture} shows it{files}.")
    click.echo(_summary(depth))
    if raw_input.raw.camera is not None:
        click.echo(distances(np.where(maps.confidence > 0, maps.z, np.nan), _FROM_FOCUS))


def _summary(depth: FocusedDepth) -> str:
    """Return the number of reliable sub-images and the range of their depths as text."""
    sure = depth.confidence >= depth.sure
    low, high = depth.m[sure].min(), depth.m[sure].max()
    v = sorted((1 / low, 1 / high))
    return (
        f"{sure.sum()} of {depth.geometry.count} sub-images are reliable (confidence of at least "
        f"{depth.sure:g}): m from {low:.4f} to {high:.4f}, virtual depth 1/m from {v[0]:.3f} to "
        f"{v[1]:.3f}."
    )


def _write_points(ply: Path, raw_input: RawInput, depth: FocusedDepth, maps: FocusedMaps) -> str:
    """Write coloured points and return their unit."""
    from clplen.io.formats.glb import write_points
    from clplen.lightfield.focused.focused_rendering import render_focused

    arguments: dict[str, Any] = {"depth": depth, "white": raw_input.white, "step": maps.grid.step}
    picture = render_focused(raw_input.raw, method="depth", **arguments).to_numpy()
    points, comment, unit = _points(raw_input, maps)
    write_points(ply, points, _colours(picture), comment=comment)
    return unit


def _points(raw_input: RawInput, maps: FocusedMaps) -> tuple[Values, str, str]:
    """Return (x, y, z) of every sample, a comment for the file, and the unit."""
    # The chief ray that meets the sensor at y from the axis has the slope y/(z2 + b) and crosses
    # the centre of the main lens: an object at a distance d from the lens lies at -d y/(z2 + b).
    camera: Any = raw_input.raw.camera
    y, x = maps.grid.axes()
    if camera is None:
        coordinates = (x[None, :], y[:, None], maps.virtual_depth)
        comment, unit = "pixels of the sensor, z: virtual depth 1/m", "in pixels and virtual depth"
    else:
        from clplen.lightfield.focused.focused_geometry import FocusedGeometry

        axis = FocusedGeometry.of(raw_input.raw).axis
        before = camera.object_distance + maps.z
        slope = -raw_input.raw.pixel_pitch / (camera.array_distance + camera.sensor_distance)
        coordinates = (
            (x[None, :] - axis[1]) * slope * before,
            (y[:, None] - axis[0]) * slope * before,
            maps.z,
        )
        comment, unit = _POINTS, "in metres"
    points = np.stack(np.broadcast_arrays(*coordinates), -1).reshape(-1, 3)
    return points, comment, unit


def _colours(picture: Values) -> Values:
    """Return colours as uint8, shape (n, 3), scaled to the largest value."""
    top = max(float(picture.max()), 1e-30)
    grey = picture.reshape(*picture.shape[:2], -1)
    three = grey if grey.shape[2] == 3 else np.repeat(grey, 3, axis=2)
    return np.asarray(np.rint(255 * np.clip(three / top, 0, 1)), np.uint8).reshape(-1, 3)
