"""Focal stacks, depth maps and pictures as files that other programs read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

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

    Of OME-TIFF ``tifffile.imread`` gives it back as (n, y, x) or (n, y, x, c), a single plane as
    (y, x[, c]). The OME axes are ZYX or ZYXS; the image's OME description is JSON with the
    ``disparities`` and ``alphas`` of the planes (null where unknown) and, with a camera, their
    ``dz_m``. From 4 GB on it is a BigTIFF. OME-Zarr (version 0.4) has the axes z, y, x or
    c, z, y, x, the same description as attribute "clplen", and a pyramid; planes are not
    equidistant in general, so that the scale of z is 1 without unit.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``; ``.zarr``, a folder.
    stack : FocalStack or Tiles
        A stack on a device, or one that comes in parts and is larger than memory: one block and a
        few megabytes are held.
    progress : bool
        Whether to show a bar on standard error.
    durable : bool
        Whether to wait until the disk has it (fsync) before it takes its name.
    replace : bool
        Whether an OME-Zarr of another shape may be there, and goes; a TIFF, or an OME-Zarr of the
        same shape, is always replaced.

    Raises
    ------
    ValueError, ShapeError, FormatError, FileExistsError, OSError
        If the suffix is another one; if parts do not make up the stack; if it is ``.zarr`` and the
        package zarr is not installed; if there is an OME-Zarr of another shape that is not to be
        replaced, or another folder; if it cannot be written.

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
        _shown(blocks, stack.shape) if progress else blocks,
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
        ``.tif`` or ``.tiff``; ``.zarr``, a folder.
    device : Device or str, optional
        Default ``Device.open()``.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    FocalStack
        Of its ``spacing`` the file keeps the size of a pixel (dy, dx), the rest is NaN; it keeps
        no camera, weights or positions.

    Raises
    ------
    FormatError
        If it is missing, damaged, of another kind, or does not say the disparity of each plane.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> clplen.io.write_stack("stack.tif", stack)
    >>> found = clplen.io.read_stack("stack.tif")
    >>> found.disparities.tolist(), bool((found.to_numpy() == stack.to_numpy()).all())
    ([-0.5, 0.0, 0.5, 1.0], True)
    """
    device = as_device(device)
    with open_series(path, what="a focal stack", max_bytes=max_bytes) as series:
        count = series.shape[0]
        known = [_vector(series.about.get(name), count) for name in ("disparities", "alphas")]
        if known[0] is None:
            raise FormatError(
                f"{path} does not say the disparities of its {count} planes: it is no focal stack "
                "of write_stack."
            )
        data = device.empty(series.shape, np.float32)
        with device.on_host(data) as host:
            series.read(host)
    return FocalStack(
        data,
        device,
        known[0],
        np.full(count, np.nan) if known[1] is None else known[1],
        None if series.pixel is None else (math.nan, math.nan, *series.pixel),
    )


def _vector(values: Any, count: int) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Numbers of a description, NaN for null; None if there are not as many."""
    if not isinstance(values, list | tuple) or len(values) != count:
        return None
    if not all(value is None or isinstance(value, int | float) for value in values):
        return None
    return float64_array([math.nan if value is None else value for value in values])


def planes_of(stack: FocalStack | FocusedStack) -> Iterator[Block]:
    """The pictures of a stack on a device, one after the other."""
    rows, columns = (slice(0, n) for n in stack.shape[1:3])
    for i in range(stack.shape[0]):
        picture = stack.device.download(stack.data[i])
        yield slice(i, i + 1), rows, columns, picture[None]


def _shown(blocks: Iterable[Block], shape: tuple[int, ...]) -> Iterator[Block]:
    """Blocks as they are, with a bar."""
    total = int(np.prod(shape[:3], dtype=np.int64))
    with tqdm(total=total, desc="writing", unit="px", unit_scale=True) as bar:
        for block in blocks:
            yield block
            bar.update(int(np.prod(block[3].shape[:3], dtype=np.int64)))


def _description(stack: FocalStack | Tiles) -> dict[str, Any]:
    """What is said about the planes."""
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
    """Write the disparity of a depth map, in pixels per view step, nearer larger.

    Parameters
    ----------
    path : path-like
        ``.pfm``, or ``.tif`` for one float32 page; ``.ome.tif`` for OME-TIFF, ``.zarr`` for
        OME-Zarr (a folder), with the channels disparity, confidence and, where known, alpha and z
        (metres).
    depth : DepthMap or array_like
        Its maps, or an array of disparities, have the shape (y, x); stored as float32.
    spacing : tuple of float, optional
        That of the light field, signed (dv, du, dy, dx) in metres; kept by OME-TIFF and OME-Zarr.
    durable, replace : bool
        As in `write_stack`.

    Raises
    ------
    ValueError, FormatError, FileExistsError, OSError
        As `write_stack`.

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
        maps = _known(depth)
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
        raise ValueError(
            f"Disparities are written as .pfm, .tif or .zarr, not as {path}."
        )


def _known(depth: DepthMap) -> dict[str, np.ndarray[Any, Any]]:
    """The maps that hold something."""
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
        OME-TIFF (``.ome.tif``) or OME-Zarr (``.zarr``) of `write_depth`, with all maps that they
        hold; of other files disparity alone, as `read_disparity` takes it.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    DepthMap
        Maps that the file does not hold are NaN.

    Raises
    ------
    FormatError
        If it is missing, damaged, or holds no disparity.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> clplen.io.write_depth("depth.ome.tif", depth)
    >>> found = clplen.io.read_depth("depth.ome.tif")
    >>> found.disparity.shape, bool((found.confidence == depth.confidence).all())
    ((32, 32), True)
    """
    if is_ome(path):
        with open_series(path, what="a depth map", max_bytes=max_bytes) as series:
            names = [name for name in _CHANNELS if name in series.about]
            if "confidence" not in names or len(names) != series.shape[0]:
                raise FormatError(
                    f"{path} does not name its maps: it is no depth map of write_depth."
                )
            known = dict(zip(names, series.read(np.empty(series.shape, np.float32)), strict=True))
    else:
        known = {"disparity": read_disparity(path, max_bytes=max_bytes)}
    unknown = np.full_like(known["disparity"], np.nan)
    return DepthMap(**{name: known.get(name, unknown) for name in _CHANNELS})


def write_image(
    path: PathLike,
    image: Image | ArrayLike,
    *,
    spacing: Spacing | None = None,
    description: str = "",
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write one linear picture, such as all-in-focus, with the size of its pixels.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``, OME-TIFF; ``.zarr``, OME-Zarr (a folder).
    image : Image or array_like
        Shape (y, x) or (y, x, c); stored as float32.
    spacing : tuple of float, optional
        That of the light field, signed (dv, du, dy, dx) in metres.
    description : str, optional
        What the values are.
    durable, replace : bool
        As in `write_stack`.

    Raises
    ------
    ValueError, FormatError, FileExistsError, OSError
        As `write_stack`; if the shape is another one.

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
        raise ValueError(f"A picture has shape (y, x) or (y, x, c), not {values.shape}.")
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
    """Read one linear picture of `write_image`.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``; ``.zarr``, a folder.
    device : Device or str, optional
        Default ``Device.open()``.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    Image
        Shape (y, x) or (y, x, c), float32.

    Raises
    ------
    FormatError
        If it is missing, damaged, of another kind, or holds several pictures.

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
        raise FormatError(f"{path} holds {len(values)} pictures, not one: read_stack takes it.")
    device = as_device(device)
    return Image(device.upload(np.ascontiguousarray(values[0], np.float32)), device)
