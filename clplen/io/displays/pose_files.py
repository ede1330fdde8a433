"""Views with their poses for other programs: transforms.json (NeRF) and COLMAP's text files.

transforms.json as instant-ngp and nerfstudio read it (docs.nerf.studio, Data conventions): poses
camera to world, cameras with x right, y up and z back. COLMAP (colmap.github.io/format.html): poses
world to camera, x right, y down, z ahead. Both count pixels from the corner of the first one, whose
centre lies at 0.5.
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
    """Write views and a transforms.json for instant-ngp, nerfstudio and programs like these.

    Pictures are ``images/view_{v}_{u}.png``. The world is the centre view's camera: x right, y up,
    z back. Principal points that shift from view to view stand with each frame, others on top.

    Parameters
    ----------
    folder : path-like
        New or empty.
    pictures : array_like
        uint8, shape (v, u, y, x) or (v, u, y, x, 3).
    cameras : ViewCameras
        Of all views.
    points : array_like, optional
        Shape (n, 3), as `ViewCameras.points` gives them; written as points.ply, in the world's
        axes, where nerfstudio looks for them. Those that are not finite are left out.
    colours : array_like, optional
        Of the points: shape (n, 3), uint8.
    keep : array_like, optional
        Shape (v, u); views where it is False are left out.

    Raises
    ------
    ShapeError, ValueError, OSError
        If pictures, cameras, points and colours do not fit together; if pictures are not uint8; if
        the folder holds something, or cannot be written.

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
    pictures = _checked(pictures, cameras)
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
    alike = bool(np.ptp(cameras.principal, axis=(0, 1)).max() == 0)
    frames = []
    for v, u, name in _kept(pictures, keep):
        cy, cx = (cameras.principal[v, u] + _CORNER).tolist()
        y, x = cameras.centres[v, u].tolist()
        pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0 - y], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1.0]]
        frame = {"file_path": f"images/{name}", "transform_matrix": pose}
        if alike:
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
    """Write views and a sparse model in COLMAP's text format, as Gaussian splatting takes it.

    Pictures are ``images/view_{v}_{u}.png``; cameras.txt, images.txt and points3D.txt stand in
    ``sparse/0``. The world is the centre view's camera: x right, y down, z ahead. Cameras are
    PINHOLE: one for all views, or one a view where principal points shift.

    Parameters
    ----------
    folder : path-like
        New or empty.
    pictures : array_like
        uint8, shape (v, u, y, x) or (v, u, y, x, 3).
    cameras : ViewCameras
        Of all views.
    points : array_like, optional
        Shape (n, 3), as `ViewCameras.points` gives them; without tracks. Those that are not finite
        are left out.
    colours : array_like, optional
        Of the points: shape (n, 3), uint8; default grey.
    keep : array_like, optional
        Shape (v, u); views where it is False are left out.

    Raises
    ------
    ShapeError, ValueError, OSError
        If pictures, cameras, points and colours do not fit together; if pictures are not uint8; if
        the folder holds something, or cannot be written.

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
    pictures = _checked(pictures, cameras)
    keep = None if keep is None else host_array(keep, "keep")
    points, colours = _known(points, colours)
    fy, fx = cameras.focal
    height, width = cameras.size
    lines = {"cameras": [f"# {MARK}: CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY"]}
    lines["images"] = [f"# {MARK}: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then no points"]
    lines["points3D"] = [f"# {MARK}: POINT3D_ID X Y Z R G B ERROR"]
    numbers: dict[tuple[float, float], int] = {}
    for image, (v, u, name) in enumerate(_kept(pictures, keep), 1):
        cy, cx = (cameras.principal[v, u] + _CORNER).tolist()
        if (cy, cx) not in numbers:
            number = numbers[cy, cx] = len(numbers) + 1
            lines["cameras"].append(f"{number} PINHOLE {width} {height} {fx} {fy} {cx} {cy}")
        y, x = cameras.centres[v, u].tolist()
        lines["images"].append(
            f"{image} 1 0 0 0 {0.0 - x} {0.0 - y} 0.0 {numbers[cy, cx]} {name}\n"
        )
    for number, (point, colour) in enumerate(zip(points, colours, strict=True), 1):
        place = " ".join(repr(n) for n in point.tolist())
        lines["points3D"].append(f"{number} {place} {' '.join(map(str, colour.tolist()))} 0")
    with filling(folder) as target:
        _write_views(target, pictures, keep)
        (target / "sparse" / "0").mkdir(parents=True)
        for name, text in lines.items():
            file = target / "sparse" / "0" / f"{name}.txt"
            file.write_text("\n".join(text) + "\n", encoding="ascii")


def _checked(pictures: ArrayLike, cameras: ViewCameras) -> Array:
    """Pictures, one a camera, in 8 bits."""
    pictures = host_array(pictures, "The pictures of views")
    if pictures.dtype != np.uint8:
        raise ValueError(f"The pictures of views are uint8, not {pictures.dtype}.")
    wanted = (*cameras.centres.shape[:2], *cameras.size)
    if pictures.shape not in (wanted, (*wanted, 3)):
        raise ShapeError(
            f"These cameras see pictures of shape {wanted} or {(*wanted, 3)}, not {pictures.shape}."
        )
    return pictures


def _known(points: ArrayLike | None, colours: ArrayLike | None) -> tuple[Array, Array]:
    """Finite points (n, 3) and their colours."""
    places = np.empty((0, 3)) if points is None else real_array(points, "Points", np.float64)
    if places.ndim != 2 or places.shape[1] != 3:
        raise ShapeError(f"Points have shape (n, 3), not {places.shape}.")
    shades = (
        np.full(places.shape, 128, np.uint8) if colours is None else host_array(colours, "Colours")
    )
    if shades.shape != places.shape:
        raise ShapeError(f"Colours have shape {places.shape} as the points, not {shades.shape}.")
    finite = np.isfinite(places).all(1)
    return places[finite], shades[finite]


def _kept(pictures: Array, keep: Array | None) -> Iterator[tuple[int, int, str]]:
    """(v, u, name) of every view that is written."""
    for v, u in np.ndindex(*pictures.shape[:2]):
        if keep is None or keep[v, u]:
            yield v, u, f"view_{v:02d}_{u:02d}.png"


def _write_views(target: Path, pictures: Array, keep: Array | None) -> None:
    (target / "images").mkdir()
    for v, u, name in _kept(pictures, keep):
        write_picture(target / "images" / name, np.ascontiguousarray(pictures[v, u]))
