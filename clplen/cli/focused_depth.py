"""``clplen depth`` of a raw image of a focused camera: m of every sub-image, and on the picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.focused import Opened, Values
from clplen.cli.metres import distances, write_map

if TYPE_CHECKING:
    from clplen.lightfield.focused_depth import FocusedDepth
    from clplen.lightfield.focused_maps import FocusedMaps

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
    from clplen.lightfield.focused_depth import focused_depth
    from clplen.lightfield.focused_maps import focused_maps
    from clplen.lightfield.focused_picture import PictureGrid

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
    figure = plot.magnification(maps.m, maps.confidence, title=f"m = b/a of {title}")
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
    from clplen.io import write_ply
    from clplen.lightfield.focused import render_focused

    words: dict[str, Any] = {"depth": found, "white": opened.white, "step": maps.grid.step}
    picture = render_focused(opened.raw, method="depth", **words).to_numpy()
    points, comment, unit = _points(opened, maps)
    write_ply(ply, points, _colours(picture), comment=comment)
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
        from clplen.lightfield.focused_geometry import FocusedGeometry

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
