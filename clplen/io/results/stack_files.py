"""Focal stacks, depth maps and pictures in files for other programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import float64_array, host_array
from clplen.compute.arrays import Image
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats import tiff
from clplen.io.formats.pfm import write_pfm
from clplen.io.formats.picture import write_picture
from clplen.io.results.disparity_maps import read_disparity
from clplen.io.store.picture_blocks import Block, Tiles, as_block
from clplen.io.store.picture_series import is_ome, open_series, write_series
from clplen.lightfield.depth.depth_maps import DepthMap, as_depth_map
from clplen.lightfield.focused.focused_picture import FocusedStack
from clplen.lightfield.model.alpha_law import depth_at
from clplen.lightfield.raw.raw_image import Spacing, is_telecentric
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.progress import progress_bar

_DISPARITY = "pixels per view step, nearer is larger"
_ALPHA = "F/F', F main lens to microlens array, F' main lens to the plane"
_DZ = "metres from the focused plane, farther is positive"
_CHANNELS = {
    "disparity": _DISPARITY,
    "confidence": "0 to 1",
    "alpha": _ALPHA,
    "z": _DZ,
}


def write_stack(
    path: PathLike,
    stack: FocalStack | Tiles,
    *,
    progress: bool = False,
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write a focal stack as linear float32 pictures, OME-TIFF or OME-Zarr.

    ``tifffile.imread`` reads the OME-TIFF as (n, y, x) or (n, y, x, c), a single plane as (y, x[,
    c]). The OME axes are ZYX or ZYXS. The OME description is JSON with the ``disparities`` and
    ``alphas`` of the planes (null where unknown) and, with a camera, their ``dz_m``. Files above 4
    GB are BigTIFF. OME-Zarr (version 0.4) has the axes z, y, x or c, z, y, x, a pyramid and the
    same description in the attribute "clplen". Its z scale is 1 without unit, because planes are
    not equidistant in general.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff`` for OME-TIFF; ``.zarr`` for OME-Zarr (a folder).
    stack : FocalStack or Tiles
        Stack on a device, or a stack in parts that is larger than memory. Memory use is one block
        and a few megabytes.
    progress : bool
        True to show a progress bar on standard error.
    durable : bool
        True to wait until the file is on disk (fsync) before it is renamed.
    replace : bool
        True to replace an OME-Zarr of another shape. A TIFF, or an OME-Zarr of equal shape, is
        always replaced.

    Raises
    ------
    ValueError, ShapeError, FormatError, FileExistsError, OSError
        If the suffix is unknown; if the parts do not cover the stack; if ``.zarr`` is given without
        the package zarr; if an OME-Zarr of another shape exists and ``replace`` is False, or
        another folder exists; if the file cannot be written.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> clplen.io.write_stack("stack.tif", stack)
    >>> clplen.io.read_stack("stack.tif").shape
    (4, 32, 32)
    """
    blocks: Iterable[Block] = planes_of(stack) if isinstance(stack, FocalStack) else stack
    write_series(
        path,
        _with_progress(blocks, stack.shape) if progress else blocks,
        "A focal stack is",
        shape=stack.shape,
        axes="ZYXS" if len(stack.shape) == 4 else "ZYX",
        description=_description(stack),
        spacing=stack.spacing,
        durable=durable,
        replace=replace,
    )


def read_stack(
    path: PathLike, *, device: DeviceLike | None = None, max_bytes: int | None = None
) -> FocalStack:
    """Read a focal stack of `write_stack`.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff`` for OME-TIFF; ``.zarr`` for OME-Zarr (a folder).
    device : Device or str, optional
        Compute device; default ``Device.open()``.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    FocalStack
        Focal stack whose ``spacing`` has the pixel size (dy, dx) and NaN for views. Camera, weights
        and positions are not stored.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind, or lacks the disparities of its planes.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> clplen.io.write_stack("stack.tif", stack)
    >>> stored = clplen.io.read_stack("stack.tif")
    >>> stored.disparities.tolist(), bool((stored.to_numpy() == stack.to_numpy()).all())
    ([-0.5, 0.0, 0.5, 1.0], True)
    """
    device = as_device(device)
    with open_series(path, what="a focal stack", max_bytes=max_bytes) as series:
        count = series.shape[0]
        vectors = [_vector(series.about.get(name), count) for name in ("disparities", "alphas")]
        if vectors[0] is None:
            raise FormatError(
                f"{path} has no disparities for its {count} planes: give a focal stack of "
                "write_stack."
            )
        data = device.empty(series.shape, np.float32)
        with device.on_host(data) as host:
            series.read(host)
    return FocalStack(
        data,
        device,
        vectors[0],
        np.full(count, np.nan) if vectors[1] is None else vectors[1],
        None if series.pixel is None else (math.nan, math.nan, *series.pixel),
    )


def _vector(values: Any, count: int) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Return the numbers of a description, NaN for null; None if the count is wrong."""
    if not isinstance(values, list | tuple) or len(values) != count:
        return None
    if not all(value is None or isinstance(value, int | float) for value in values):
        return None
    return float64_array([math.nan if value is None else value for value in values])


def planes_of(stack: FocalStack | FocusedStack) -> Iterator[Block]:
    """Yield the pictures of a stack on a device, plane by plane."""
    rows, columns = (slice(0, n) for n in stack.shape[1:3])
    for i in range(stack.shape[0]):
        picture = stack.device.download(stack.data[i])
        yield slice(i, i + 1), rows, columns, picture[None]


def _with_progress(blocks: Iterable[Block], shape: tuple[int, ...]) -> Iterator[Block]:
    """Yield blocks unchanged and update a progress bar."""
    total = int(np.prod(shape[:3], dtype=np.int64))
    with progress_bar(total=total, desc="writing", unit="px", unit_scale=True) as bar:
        for block in blocks:
            yield block
            bar.update(int(np.prod(block[3].shape[:3], dtype=np.int64)))


def _description(stack: FocalStack | Tiles) -> dict[str, Any]:
    """Return the description of the planes."""
    description = {
        "disparities": numbers(stack.disparities),
        "alphas": numbers(stack.alphas),
        "disparity": _DISPARITY,
        "alpha": _ALPHA,
    }
    if stack.camera is not None:
        far = is_telecentric(stack)
        z = depth_at(stack, stack.disparities) if far else stack.camera.dz(stack.alphas)
        description["dz_m"] = numbers(z)
        description["dz"] = _DZ
    return description


def numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def write_depth(
    path: PathLike,
    depth: DepthMap | ArrayLike,
    *,
    spacing: Spacing | None = None,
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write the disparity of a depth map, in pixels per view step, larger when nearer.

    Parameters
    ----------
    path : path-like
        ``.pfm``, or ``.tif`` for a single float32 page. ``.ome.tif`` for OME-TIFF, ``.zarr`` for
        OME-Zarr (a folder), with the channels disparity, confidence and, if known, alpha and z
        (metres).
    depth : DepthMap or array_like
        Depth map, or array of disparities, of shape (y, x); stored as float32.
    spacing : tuple of float, optional
        Spacing of the light field, signed (dv, du, dy, dx) in metres; stored in OME-TIFF and
        OME-Zarr.
    durable, replace : bool
        Options as in `write_stack`.

    Raises
    ------
    ValueError, FormatError, FileExistsError, OSError
        Errors of `write_stack`.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> clplen.io.write_depth("depth.ome.tif", depth)
    >>> clplen.io.write_depth("disparity.pfm", depth)
    >>> clplen.io.read_disparity("disparity.pfm").shape
    (32, 32)
    """
    depth = as_depth_map(depth)
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if suffixes[-1:] == [".pfm"]:
        write_pfm(path, depth.disparity, durable=durable)
    elif is_ome(path):
        maps = _known_maps(depth)
        values = np.stack(list(maps.values()))
        write_series(
            path,
            as_block(values),
            "Disparities are",
            shape=values.shape,
            axes="CYX",
            description={name: _CHANNELS[name] for name in maps},
            spacing=spacing,
            channels=tuple(maps),
            durable=durable,
            replace=replace,
        )
    elif suffixes[-1:] in ([suffix] for suffix in tiff.SUFFIXES):
        disparity = depth.disparity.astype(np.float32, copy=False)
        write_picture(path, disparity, description=f"disparity, {_DISPARITY}", durable=durable)
    else:
        raise ValueError(f"path must end in .pfm, .tif or .zarr for disparities, got {path}.")


def _known_maps(depth: DepthMap) -> dict[str, np.ndarray[Any, Any]]:
    """Return disparity, confidence and the other maps that are not all NaN."""
    maps = {name: np.asarray(getattr(depth, name), np.float32) for name in _CHANNELS}
    return {
        name: values
        for name, values in maps.items()
        if name in ("disparity", "confidence") or not np.isnan(values).all()
    }


def read_depth(path: PathLike, *, max_bytes: int | None = None) -> DepthMap:
    """Read a depth map of `write_depth`.

    Parameters
    ----------
    path : path-like
        OME-TIFF (``.ome.tif``) or OME-Zarr (``.zarr``) of `write_depth`, with all its maps; other
        files contain disparity alone, as for `read_disparity`.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    DepthMap
        Depth map; maps that the file does not contain are NaN.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or has no disparity.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> clplen.io.write_depth("depth.ome.tif", depth)
    >>> stored = clplen.io.read_depth("depth.ome.tif")
    >>> stored.disparity.shape, bool((stored.confidence == depth.confidence).all())
    ((32, 32), True)
    """
    if is_ome(path):
        with open_series(path, what="a depth map", max_bytes=max_bytes) as series:
            names = [name for name in _CHANNELS if name in series.about]
            if "confidence" not in names or len(names) != series.shape[0]:
                raise FormatError(
                    f"{path} has no names for its maps: give a depth map of write_depth."
                )
            maps = dict(zip(names, series.read(np.empty(series.shape, np.float32)), strict=True))
    else:
        maps = {"disparity": read_disparity(path, max_bytes=max_bytes)}
    empty = np.full_like(maps["disparity"], np.nan)
    return DepthMap(**{name: maps.get(name, empty) for name in _CHANNELS})


def write_image(
    path: PathLike,
    image: Image | ArrayLike,
    *,
    spacing: Spacing | None = None,
    description: str = "",
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write a linear picture, such as an all-in-focus image, with its pixel size.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff`` for OME-TIFF; ``.zarr`` for OME-Zarr (a folder).
    image : Image or array_like
        Picture of shape (y, x) or (y, x, c); stored as float32.
    spacing : tuple of float, optional
        Spacing of the light field, signed (dv, du, dy, dx) in metres.
    description : str, optional
        Meaning of the values.
    durable, replace : bool
        Options as in `write_stack`.

    Raises
    ------
    ValueError, FormatError, FileExistsError, OSError
        Errors of `write_stack`; if the shape is invalid.

    Examples
    --------
    >>> picture = np.random.default_rng(1).random((24, 32), np.float32)
    >>> spacing = (1e-3, 1e-3, 5e-6, 5e-6)  # of the light field, in metres
    >>> clplen.io.write_image("picture.tif", picture, spacing=spacing, description="all in focus")
    >>> bool((clplen.io.read_image("picture.tif").to_numpy() == picture).all())
    True
    """
    values = np.asarray(host_array(image, "A picture"), np.float32)
    if values.ndim not in (2, 3):
        raise ValueError(f"A picture must have shape (y, x) or (y, x, c), got {values.shape}.")
    write_series(
        path,
        as_block(values[None]),
        "A picture is",
        shape=(1, *values.shape),
        axes="YXS" if values.ndim == 3 else "YX",
        description={"values": description} if description else {},
        spacing=spacing,
        durable=durable,
        replace=replace,
    )


def read_image(
    path: PathLike, *, device: DeviceLike | None = None, max_bytes: int | None = None
) -> Image:
    """Read a linear picture of `write_image`.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff`` for OME-TIFF; ``.zarr`` for OME-Zarr (a folder).
    device : Device or str, optional
        Compute device; default ``Device.open()``.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    Image
        Picture of shape (y, x) or (y, x, c), float32.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind, or has several pictures.

    Examples
    --------
    >>> clplen.io.write_image("picture.tif", np.full((24, 32, 3), 0.5, np.float32))
    >>> image = clplen.io.read_image("picture.tif")
    >>> image.shape, float(image.to_numpy().mean())
    ((24, 32, 3), 0.5)
    """
    with open_series(path, what="a picture", max_bytes=max_bytes) as series:
        values = series.read()
    if series.axes == "cyx":
        values = np.moveaxis(values, 0, -1)[None]
    if len(values) != 1:
        raise FormatError(f"{path} must have one picture, got {len(values)}: use read_stack.")
    device = as_device(device)
    return Image(device.upload(np.ascontiguousarray(values[0], np.float32)), device)
