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
_SUCH = (
    "raw images of focused cameras: raw.h5 of 'clplen simulate', a Raytrix XML, or a raw picture "
    "with --white or --grid"
)
_SPREAD = (2, 98)  # per cent of the sub-images that default planes hold
_WIDER, _LEAST = 1.1, 0.1  # of their half range, and of their middle


class Magnifications(click.ParamType):
    """m = b/a: one number, several, or START:STOP:N."""

    name = "M|M,M,...|START:STOP:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> Values:
        text = str(value)
        if ":" in text:
            planes = options.Planes().convert(text, param, ctx)
            if (planes == 0).any():
                self.fail(
                    f"{text!r} passes m = 0, where nothing is in focus: give planes on one side "
                    "of 0, or a count that leaves it out.",
                    param,
                    ctx,
                )
            return planes
        try:
            numbers = np.array([float(part) for part in text.split(",")])
        except ValueError:
            numbers = np.array([np.nan])
        if not np.isfinite(numbers).all():
            self.fail(f"{text!r} is not m: give 0.2, 0.1,0.2 or 0.1:0.3:9.", param, ctx)
        return numbers


class Range(click.ParamType):
    """LEAST:GREATEST."""

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
    help="INPUT is a raw image of a focused (plenoptic 2.0) camera; raw.h5 and a Raytrix XML tell "
    "by themselves.",
)
_IMAGE = click.option(
    "--image",
    cls=Option,
    group=FOCUSED,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Picture that belongs to a Raytrix XML; default: the one of the same name.",
)
_VIEW = click.option(
    "--view",
    cls=Option,
    group=FOCUSED,
    type=options.FINITE,
    nargs=2,
    metavar="Y X",
    help="Pixel in the sub-images, which is another place on the main lens.",
)
_PLANES = click.option(
    "--m",
    "ms",
    cls=Option,
    group=FOCUSED,
    type=Magnifications(),
    help="Planes in focus by m = b/a, START:STOP:N or 0.1,0.2; default: 11 that suit it.",
)
picture_words = _with(
    click.option(
        "--method",
        cls=Option,
        group=FOCUSED,
        type=click.Choice(["basic", "blended", "depth"]),
        help="One patch a lenslet, the mean of all that see a point "
        "(default), or that with the m of each place.",
    ),
    click.option(
        "--m",
        "ms",
        cls=Option,
        group=FOCUSED,
        type=Magnifications(),
        help="Plane in focus by m = b/a; default: the camera's, else the "
        "median. With --sweep focus several, START:STOP:N.",
    ),
    click.option(
        "--patch",
        cls=Option,
        group=FOCUSED,
        type=options.FINITE,
        help="Pixels across a patch; default: those that m has.",
    ),
    _VIEW,
)
stack_words = _with(_PLANES, _VIEW)
depth_words = _with(
    click.option(
        "--m",
        "ms",
        cls=Option,
        group=FOCUSED,
        type=Range(),
        help="Range of m = b/a to search.",
    )
)


@dataclass(frozen=True)
class Opened:
    """A raw image and the white image of its camera, where one is given."""

    raw: RawImage
    white: Values | None

    @property
    def flat(self) -> Values | None:
        """The white image, of one channel."""
        return self.white.mean(2) if self.white is not None and self.white.ndim == 3 else self.white


def is_meant(source: Path, words: dict[str, Any]) -> bool:
    """Return whether INPUT is a raw image of a focused camera, by itself or by an option."""
    from clplen.io.lightfields.lightfield_files import kind_of

    if tells(source):
        return True
    given = [name for name, value in words.items() if value is not None and value is not False]
    if not given:
        return False
    kind = kind_of(source)
    if "white" not in kind.options:
        raise click.UsageError(f"--{given[0]} is for {_SUCH}; {source} is {kind.name}.")
    return True


def tells(source: Path) -> bool:
    """Whether a file says by itself that it is a raw image, and where its lenslets are."""
    from clplen.io.raw.raw_files import is_raw_file

    return source.suffix.lower() in _XML or is_raw_file(source)


def refuse(**words: Any) -> None:
    """Refuse words that are for light fields."""
    given = [name for name, value in words.items() if value is not None and value is not False]
    if given:
        raise click.UsageError(
            f"--{given[0].replace('_', '-')} is for light fields; this is a raw image of a focused "
            "camera, whose planes are given by --m, b/a."
        )


def check_kept(source: Path, image: Path | None, *outputs: Path) -> None:
    """Refuse outputs that would replace the picture that belongs to a Raytrix XML."""
    from clplen.io.raw.raw_files import picture_of

    if source.suffix.lower() not in _XML:
        return
    picture = picture_of(source) if image is None else image
    for output in outputs:
        if output.exists() and picture.exists() and picture.samefile(output):
            raise click.UsageError(
                f"{output} is the raw image of {source}: name an output elsewhere."
            )


def read(source: Path, selector: str | None, layout: dict[str, Any], image: Path | None) -> Opened:
    """The raw image with its lattice; with ``--grid`` the white image only evens it."""
    from clplen.compute.device import Device
    from clplen.io import read_raw
    from clplen.io.lightfields.layout import Layout
    from clplen.lightfield.focused.focused_geometry import require_focused
    from clplen.lightfield.raw.demosaicing import demosaic

    Layout(**layout).require(_LAYOUT, "a raw image of a focused camera")
    white, dark, grid = (layout[name] for name in ("white", "dark", "grid"))
    device = Device.open(selector)
    if tells(source):
        if dark is not None or grid is not None:
            raise click.UsageError(
                f"--dark and --grid do not apply to {source}, which tells its lenses: leave out."
            )
        raw = read_raw(source, device=device, image=image)
    else:
        found_on = white if grid is None else None
        raw = read_raw(
            source,
            device=device,
            image=image,
            white=found_on,
            dark=dark,
            grid=grid,
            force=layout["force"],
        )
    raw = raw.above_black() if raw.mosaic is None else demosaic(raw)
    require_focused(raw)
    return Opened(raw, None if layout["devignette"] is False else _white(white, dark))


def _white(white: Path | None, dark: Path | None) -> Values | None:
    from clplen.io.raw.raw_files import read_frame

    if white is None:
        return None
    values = read_frame(white)[0].astype(np.float32)
    return values if dark is None else values - read_frame(dark)[0].astype(np.float32)


def suitable_ms(opened: Opened, count: int) -> Values:
    """Planes that hold what the sub-images show, equidistant in m."""
    from clplen.lightfield.focused.focused_depth import focused_depth

    depth = focused_depth(opened.raw, white=opened.flat)
    median = depth.median  # says so where nothing is sure
    low, high = np.percentile(depth.m[depth.confidence >= depth.sure], _SPREAD)
    half = max(_WIDER * (high - low) / 2, _LEAST * abs(median))
    return np.linspace((low + high) / 2 - half, (low + high) / 2 + half, count)


def fraction(aperture: Any) -> float:
    """The share of a sub-image's diameter."""
    if isinstance(aperture, str):
        raise click.UsageError(
            "--aperture of a focused raw image is a share of a sub-image's diameter, such as 0.5, "
            f"not {aperture}."
        )
    return 1.0 if aperture is None else float(aperture)


SUFFIXES = (".h5", ".hdf5", ".tif", ".tiff", ".pfm", ".npy")
_FROM_FOCUS = " from the plane in focus, farther positive"
_POINTS = "metres: x right, y down from the axis, z from the plane in focus, farther positive"


def find_depth(
    opened: Opened,
    output: Path,
    *,
    ms: tuple[float, float] | None,
    step: float | None,
    confidence: Path | None,
    metric: Path | None,
    ply: Path | None,
    title: str,
) -> None:
    """Find the depth, write it with a picture beside, and say what was found."""
    from clplen import plot
    from clplen.io import write_focused_depth
    from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
    from clplen.lightfield.focused.focused_picture import PictureGrid
    from clplen.plot.base import verbatim

    if metric is not None and opened.raw.camera is None:
        raise click.UsageError(
            "--metric needs the camera, which only raw.h5 of 'clplen simulate' tells: leave it out."
        )
    found = focused_depth(opened.raw, ms=ms, white=opened.flat)
    size = found.geometry.patch(found.median)
    maps = focused_maps(opened.raw, found, grid=PictureGrid.over(found.geometry, size, step))
    write_focused_depth(output, found, maps, replace=True)
    files = ""
    if confidence is not None:
        write_map(confidence, maps.confidence.astype(np.float32))
        files += f", {confidence} its confidence"
    if metric is not None:
        write_map(metric, maps.z.astype(np.float32))
        files += f", {metric} the distances in metres{_FROM_FOCUS}"
    if ply is not None:
        files += f", {ply} the points {_write_points(ply, opened, found, maps)}"
    picture = output.with_suffix(".png")
    figure = plot.magnification(maps.m, maps.confidence, title=f"m = b/a of {verbatim(title)}")
    plot.save(figure, picture)
    click.echo(f"{output} holds m on the picture, {picture} shows it{files}.")
    click.echo(_summary(found))
    if opened.raw.camera is not None:
        click.echo(distances(np.where(maps.confidence > 0, maps.z, np.nan), _FROM_FOCUS))


def _summary(found: FocusedDepth) -> str:
    """How many sub-images are sure, and the range of what they show."""
    sure = found.confidence >= found.sure
    low, high = found.m[sure].min(), found.m[sure].max()
    v = sorted((1 / low, 1 / high))
    return (
        f"{sure.sum()} of {found.geometry.count} sub-images are sure (confidence from "
        f"{found.sure:g}), m from {low:.4f} to {high:.4f}, virtual depth 1/m from {v[0]:.3f} to "
        f"{v[1]:.3f}."
    )


def _write_points(ply: Path, opened: Opened, found: FocusedDepth, maps: FocusedMaps) -> str:
    """Points with their colours; what their unit is."""
    from clplen.io.formats.glb import write_points
    from clplen.lightfield.focused.focused_rendering import render_focused

    words: dict[str, Any] = {"depth": found, "white": opened.white, "step": maps.grid.step}
    picture = render_focused(opened.raw, method="depth", **words).to_numpy()
    points, comment, unit = _points(opened, maps)
    write_points(ply, points, _colours(picture), comment=comment)
    return unit


def _points(opened: Opened, maps: FocusedMaps) -> tuple[Values, str, str]:
    """(x, y, z) of every sample, what they are, and their unit.

    The chief ray that meets the sensor at y from the axis has the slope y/(z2 + b) and passes the
    main lens in its middle, so that its object at a distance d before it lies at -d y/(z2 + b).
    """
    camera: Any = opened.raw.camera
    y, x = maps.grid.axes()
    if camera is None:
        places = (x[None, :], y[:, None], maps.virtual_depth)
        comment, unit = "pixels of the sensor, z: virtual depth 1/m", "in pixels and virtual depth"
    else:
        from clplen.lightfield.focused.focused_geometry import FocusedGeometry

        axis = FocusedGeometry.of(opened.raw).axis
        before = camera.object_distance + maps.z
        slope = -opened.raw.pixel_pitch / (camera.array_distance + camera.sensor_distance)
        places = (
            (x[None, :] - axis[1]) * slope * before,
            (y[:, None] - axis[0]) * slope * before,
            maps.z,
        )
        comment, unit = _POINTS, "in metres"
    points = np.stack(np.broadcast_arrays(*places), -1).reshape(-1, 3)
    return points, comment, unit


def _colours(picture: Values) -> Values:
    """uint8 colours, shape (n, 3), by the largest value."""
    top = max(float(picture.max()), 1e-30)
    grey = picture.reshape(*picture.shape[:2], -1)
    three = grey if grey.shape[2] == 3 else np.repeat(grey, 3, axis=2)
    return np.asarray(np.rint(255 * np.clip(three / top, 0, 1)), np.uint8).reshape(-1, 3)
