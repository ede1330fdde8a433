"""Views and poses for other programs: transforms.json (NeRF) and COLMAP's text files.

transforms.json of instant-ngp and nerfstudio (docs.nerf.studio, Data conventions) has poses camera
to world, with x right, y up and z back. COLMAP (colmap.github.io/format.html) has poses world to
camera, with x right, y down and z forward. In both, the centre of the first pixel is at 0.5.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array, real_array
from clplen.errors import ShapeError
from clplen.files import PathLike, filling
from clplen.io.formats.picture import write_picture
from clplen.io.formats.ply import write_ply
from clplen.lightfield.model.view_cameras import ViewCameras
from clplen.outputs import MARK

Array = np.ndarray[Any, Any]

_CORNER = 0.5  # from the corner of the first pixel to its centre
_POINTS = "points.ply"


def write_nerf(
    folder: PathLike,
    pictures: ArrayLike,
    cameras: ViewCameras,
    *,
    points: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    keep: ArrayLike | None = None,
) -> None:
    """Write views and a transforms.json for instant-ngp, nerfstudio and similar programs.

    Pictures are ``images/view_{v}_{u}.png``. The world is the camera of the centre view: x right, y
    up, z back. Principal points that differ between views are stored per frame, otherwise once.

    Parameters
    ----------
    folder : path-like
        New or empty folder.
    pictures : array_like
        Views, uint8 of shape (v, u, y, x) or (v, u, y, x, 3).
    cameras : ViewCameras
        Cameras of all views.
    points : array_like, optional
        Points (n, 3) of `ViewCameras.points`, written as points.ply in world axes for nerfstudio.
        Points that are not finite are left out.
    colours : array_like, optional
        Colours of the points (n, 3), uint8.
    keep : array_like, optional
        Mask (v, u); views that are False are left out.

    Raises
    ------
    ShapeError, ValueError, OSError
        If pictures, cameras, points and colours do not match; if pictures are not uint8; if the
        folder is not empty or not writable.

    Examples
    --------
    >>> views = np.random.default_rng(0).integers(0, 255, (3, 5, 24, 32), np.uint8)
    >>> cameras = clplen.lightfield.view_cameras(
    ...     clplen.LightField.from_array(views), baseline=1.0, focal_length=32.0, pixel_pitch=1.0)
    >>> clplen.io.write_nerf("for_nerf", views, cameras)
    >>> import json
    >>> with open("for_nerf/transforms.json") as file:
    ...     frames = json.load(file)["frames"]
    >>> frames[4]["file_path"], [row[3] for row in frames[4]["transform_matrix"]]
    ('images/view_00_04.png', [2.0, 1.0, 0.0, 1.0])
    """
    pictures = _checked_pictures(pictures, cameras)
    keep = None if keep is None else host_array(keep, "keep")
    fy, fx = cameras.focal
    height, width = cameras.size
    shared: dict[str, Any] = {
        "written_by": MARK,
        "camera_model": "OPENCV",
        "camera_angle_x": float(2 * np.arctan(width / (2 * fx))),
        "camera_angle_y": float(2 * np.arctan(height / (2 * fy))),
        "w": width,
        "h": height,
    }
    shared |= {"fl_x": fx, "fl_y": fy} | dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    has_shared_principal = bool(np.ptp(cameras.principal, axis=(0, 1)).max() == 0)
    frames = []
    for v, u, name in _selected_views(pictures, keep):
        cy, cx = (cameras.principal[v, u] + _CORNER).tolist()
        y, x = cameras.centres[v, u].tolist()
        pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0 - y], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1.0]]
        frame = {"file_path": f"images/{name}", "transform_matrix": pose}
        if has_shared_principal:
            shared |= {"cx": cx, "cy": cy}
        else:
            frame |= {"cx": cx, "cy": cy}
        frames.append(frame)
    with filling(folder) as target:
        _write_views(target, pictures, keep)
        if points is not None:
            write_ply(
                target / _POINTS,
                real_array(points, "Points", np.float64) * (1, -1, -1),
                colours,
                comment="world of the poses",
            )
            shared["ply_file_path"] = _POINTS
        text = json.dumps(shared | {"frames": frames}, indent=1)
        (target / "transforms.json").write_text(text + "\n", encoding="utf-8")


def write_colmap(
    folder: PathLike,
    pictures: ArrayLike,
    cameras: ViewCameras,
    *,
    points: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    keep: ArrayLike | None = None,
) -> None:
    """Write views and a sparse model in COLMAP's text format, for Gaussian splatting.

    Pictures are ``images/view_{v}_{u}.png``; cameras.txt, images.txt and points3D.txt are in
    ``sparse/0``. The world is the camera of the centre view: x right, y down, z forward. Cameras
    are PINHOLE: one for all views, or one per view if principal points differ.

    Parameters
    ----------
    folder : path-like
        New or empty folder.
    pictures : array_like
        Views, uint8 of shape (v, u, y, x) or (v, u, y, x, 3).
    cameras : ViewCameras
        Cameras of all views.
    points : array_like, optional
        Points (n, 3) of `ViewCameras.points`, without tracks. Points that are not finite are left
        out.
    colours : array_like, optional
        Colours of the points (n, 3), uint8; default grey.
    keep : array_like, optional
        Mask (v, u); views that are False are left out.

    Raises
    ------
    ShapeError, ValueError, OSError
        If pictures, cameras, points and colours do not match; if pictures are not uint8; if the
        folder is not empty or not writable.

    Examples
    --------
    >>> views = np.random.default_rng(0).integers(0, 255, (3, 5, 24, 32), np.uint8)
    >>> cameras = clplen.lightfield.view_cameras(
    ...     clplen.LightField.from_array(views), baseline=1.0, focal_length=32.0, pixel_pitch=1.0)
    >>> clplen.io.write_colmap("for_colmap", views, cameras)
    >>> with open("for_colmap/sparse/0/cameras.txt") as file:
    ...     file.readlines()[-1]
    '1 PINHOLE 32 24 32.0 32.0 16.0 12.0\\n'
    """
    pictures = _checked_pictures(pictures, cameras)
    keep = None if keep is None else host_array(keep, "keep")
    points, colours = _finite_points(points, colours)
    fy, fx = cameras.focal
    height, width = cameras.size
    lines = {"cameras": [f"# {MARK}: CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY"]}
    lines["images"] = [f"# {MARK}: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then no points"]
    lines["points3D"] = [f"# {MARK}: POINT3D_ID X Y Z R G B ERROR"]
    numbers: dict[tuple[float, float], int] = {}
    for image, (v, u, name) in enumerate(_selected_views(pictures, keep), 1):
        cy, cx = (cameras.principal[v, u] + _CORNER).tolist()
        if (cy, cx) not in numbers:
            number = numbers[cy, cx] = len(numbers) + 1
            lines["cameras"].append(f"{number} PINHOLE {width} {height} {fx} {fy} {cx} {cy}")
        y, x = cameras.centres[v, u].tolist()
        lines["images"].append(
            f"{image} 1 0 0 0 {0.0 - x} {0.0 - y} 0.0 {numbers[cy, cx]} {name}\n"
        )
    for number, (point, colour) in enumerate(zip(points, colours, strict=True), 1):
        coordinates = " ".join(repr(n) for n in point.tolist())
        lines["points3D"].append(f"{number} {coordinates} {' '.join(map(str, colour.tolist()))} 0")
    with filling(folder) as target:
        _write_views(target, pictures, keep)
        (target / "sparse" / "0").mkdir(parents=True)
        for name, text in lines.items():
            file = target / "sparse" / "0" / f"{name}.txt"
            file.write_text("\n".join(text) + "\n", encoding="ascii")


def _checked_pictures(pictures: ArrayLike, cameras: ViewCameras) -> Array:
    """Return uint8 pictures after a check of their shape against the cameras."""
    pictures = host_array(pictures, "The pictures of views")
    if pictures.dtype != np.uint8:
        raise ValueError(f"The pictures of views must be uint8, got {pictures.dtype}.")
    expected = (*cameras.centres.shape[:2], *cameras.size)
    if pictures.shape not in (expected, (*expected, 3)):
        raise ShapeError(
            f"pictures must have shape {expected} or {(*expected, 3)} for these cameras, got "
            f"{pictures.shape}."
        )
    return pictures


def _finite_points(points: ArrayLike | None, colours: ArrayLike | None) -> tuple[Array, Array]:
    """Return finite points (n, 3) and their colours."""
    positions = np.empty((0, 3)) if points is None else real_array(points, "Points", np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ShapeError(f"Points must have shape (n, 3), got {positions.shape}.")
    shades = (
        np.full(positions.shape, 128, np.uint8)
        if colours is None
        else host_array(colours, "Colours")
    )
    if shades.shape != positions.shape:
        raise ShapeError(
            f"Colours must have the shape {positions.shape} of the points, got {shades.shape}."
        )
    finite = np.isfinite(positions).all(1)
    return positions[finite], shades[finite]


def _selected_views(pictures: Array, keep: Array | None) -> Iterator[tuple[int, int, str]]:
    """Yield (v, u, name) of every written view."""
    for v, u in np.ndindex(*pictures.shape[:2]):
        if keep is None or keep[v, u]:
            yield v, u, f"view_{v:02d}_{u:02d}.png"


def _write_views(target: Path, pictures: Array, keep: Array | None) -> None:
    (target / "images").mkdir()
    for v, u, name in _selected_views(pictures, keep):
        write_picture(target / "images" / name, np.ascontiguousarray(pictures[v, u]))
