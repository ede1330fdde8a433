"""Pictures, stacks and depth of focused cameras in files for other programs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.hdf5_safety import require_internal
from clplen.io.formats import npy, pfm, tiff
from clplen.io.formats.npy import write_npy
from clplen.io.formats.pfm import write_pfm
from clplen.io.formats.picture import write_picture
from clplen.io.results.stack_files import numbers, planes_of
from clplen.io.store import hdf5_files
from clplen.io.store.hdf5_files import create_hdf5
from clplen.io.store.picture_blocks import as_block
from clplen.io.store.picture_series import describe_series, is_ome, write_series
from clplen.lightfield.focused.focused_depth import FocusedDepth, FocusedMaps
from clplen.lightfield.focused.focused_picture import FocusedImage, FocusedStack, PictureGrid
from clplen.lightfield.raw.raw_image import Spacing

_M = "b/a, magnification of the lenslets; > 0: they see an image before the array"
_MAP = f"m, {_M}"
_BY = "of a focused camera (plenoptic 2.0)"
_DZ = "metres from the focused plane, farther is positive"
_ALPHA = "F/F', F main lens to its image of the focused plane, F' to that of the plane"
_GRID = "sample (i, k) is the chief ray that meets the sensor at first_px + step_px (i, k)"
_CHANNELS = {
    "m": _M,
    "virtual_depth": "1/m = a/b",
    "z": _DZ,
    "confidence": "0 to 1; 0 where m is filled from its neighbours",
}
_LENSLETS = {
    "centre": "(y, x) of each sub-image, in pixels of the sensor",
    "m": _M,
    "virtual_depth": "1/m = a/b",
    "z": _DZ,
    "confidence": "0 to 1",
    "uncertainty": "standard deviation of m",
    "type": "kind of lens; -1: no lenslet",
}


def write_focused(
    path: PathLike,
    image: FocusedImage | FocusedStack,
    *,
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write a rendered picture or focal stack of a focused camera as linear float32.

    The OME description is JSON. A picture has ``m``; a stack has ``ms``, ``alphas`` and ``dz_m`` of
    the planes (null where unknown). Both have the patch in pixels and the sample positions on the
    sensor. The pixel size of a picture refers to the main lens' image plane of ``m``; a stack has
    none.

    Parameters
    ----------
    path : path-like
        ``.tif`` for OME-TIFF or ``.zarr`` for OME-Zarr; axes YX or ZYX, with S for colours.
    image : FocusedImage or FocusedStack
        Picture of `render_focused`, or stack of `focused_stack`.
    durable, replace : bool
        Options as in `clplen.io.write_stack`.

    Raises
    ------
    ValueError, FormatError, OSError
        If the suffix is unknown; if ``.zarr`` is given without the package zarr; if the file
        cannot be written.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9), m=0.25,
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> picture = clplen.render_focused(raw)
    >>> clplen.io.write_focused("picture.tif", picture)
    >>> clplen.io.read_image("picture.tif").shape == picture.shape
    True
    """
    is_stack = isinstance(image, FocusedStack)
    shape = image.shape if is_stack else (1, *image.shape)
    axes = ("ZYX" if is_stack else "YX") + ("S" if len(shape) == 4 else "")
    write_series(
        path,
        planes_of(image) if isinstance(image, FocusedStack) else as_block(image.to_numpy()[None]),
        "Pictures of a focused camera are",
        shape=shape,
        axes=axes,
        description=_description(image) | _grid_description(image.grid),
        spacing=None if isinstance(image, FocusedStack) else _spacing(image.pitch),
        durable=durable,
        replace=replace,
    )


def _description(image: FocusedImage | FocusedStack) -> dict[str, Any]:
    """Return the description of the planes."""
    description: dict[str, Any] = {"lenslet_pitch_px": image.geometry.pitch, "magnification": _M}
    if isinstance(image, FocusedStack):
        patches = [image.geometry.patch(float(m)) for m in image.ms]
        description |= {"ms": numbers(image.ms), "patches_px": patches}
        return description | {
            "alphas": numbers(image.alphas),
            "alpha": _ALPHA,
            "dz_m": numbers(image.zs),
            "dz": _DZ,
        }
    return description | {"m": image.m, "patch_px": abs(image.ratio) * image.geometry.pitch}


def _grid_description(grid: PictureGrid) -> dict[str, Any]:
    return {"first_px": list(grid.first), "step_px": grid.step, "grid": _GRID}


def _spacing(pitch: float) -> Spacing | None:
    """Return the signed spacing (dv, du, dy, dx) of a picture; the view steps are NaN."""
    return (math.nan, math.nan, pitch, pitch) if math.isfinite(pitch) else None


def write_focused_depth(
    path: PathLike,
    depth: FocusedDepth,
    maps: FocusedMaps,
    *,
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write the depth estimated from a focused camera.

    Parameters
    ----------
    path : path-like
        ``.h5``: group ``lenslets`` with centre, m, virtual_depth, z, confidence, uncertainty and
        type of every sub-image, and group ``picture`` with the maps m, virtual_depth, z and
        confidence. ``.ome.tif`` or ``.zarr``: these maps as channels. ``.pfm``, ``.npy`` or
        ``.tif``: the map of m alone, float32. z is written only if known.
    depth : FocusedDepth
        Depth of every sub-image, from `focused_depth`.
    maps : FocusedMaps
        Maps of this depth on a picture, from `focused_maps`.
    durable, replace : bool
        Options as in `clplen.io.write_stack`.

    Raises
    ------
    ValueError, FormatError, OSError
        If the suffix is unknown; if ``.zarr`` is given without the package zarr; if the file
        cannot be written.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9), m=0.25,
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> depth = clplen.lightfield.focused_depth(raw)
    >>> maps = clplen.lightfield.focused_maps(raw, depth)
    >>> clplen.io.write_focused_depth("m.npy", depth, maps)
    >>> clplen.io.read_npy("m.npy").shape == maps.m.shape
    True
    """
    path = Path(path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes[-1:] in ([suffix] for suffix in hdf5_files.SUFFIXES):
        _write_hdf5(path, depth, maps, durable)
    elif is_ome(path):
        channels = {
            name: np.asarray(v, np.float32) for name, v in _named_maps(maps, _CHANNELS).items()
        }
        values = np.stack(list(channels.values()))
        write_series(
            path,
            as_block(values),
            "Depth of a focused camera is",
            shape=values.shape,
            axes="CYX",
            description={name: _CHANNELS[name] for name in channels} | _grid_description(maps.grid),
            spacing=None,
            channels=tuple(channels),
            durable=durable,
            replace=replace,
        )
    else:
        _write_map(path, np.asarray(maps.m, np.float32), durable)


def describe_focused(path: PathLike) -> tuple[str, dict[str, Any]] | None:
    """Return kind and properties of a file of this module, or None for other files."""
    path = Path(path)
    if not path.is_file():
        return None
    if path.suffix.lower() in hdf5_files.SUFFIXES:
        return _describe_hdf5(path) if h5py.is_hdf5(path) else None
    return _describe_tiff(path) if path.suffix.lower() in tiff.SUFFIXES else None


def _describe_hdf5(path: Path) -> tuple[str, dict[str, Any]] | None:
    try:
        with h5py.File(path) as file:
            require_internal(file, path)
            m = file.get("lenslets/m")
            if m is None or "picture/m" not in file or m.attrs.get("meaning") != _M:
                return None
            shapes = {"lenslets": m.shape, "shape": file["picture/m"].shape}
    except (FormatError, OSError, RuntimeError, ValueError, AttributeError, KeyError):
        return None
    return f"depth {_BY}", shapes


def _describe_tiff(path: Path) -> tuple[str, dict[str, Any]] | None:
    try:
        with tiff.open_tiff(path) as file:
            first, count = file.pages.first, len(file.pages)
            about, shape = first.description, tuple(first.shape)
        if about == _MAP:
            return f"a map of m = b/a {_BY}", {"shape": shape}
        description = describe_series(path)
        properties: dict[str, Any] = {"shape": (count, *shape) if count > 1 else shape}
        if description.get("m") == _M:
            return f"depth {_BY}", properties
        if description.get("magnification") != _M:
            return None
        properties["m"] = [float(m) for m in description.get("ms", [description.get("m")])]
    except Exception:  # tifffile raises any exception on damaged files
        return None
    return f"{'a focal stack' if 'ms' in description else 'a picture'} {_BY}", properties


def _write_map(path: Path, values: np.ndarray[Any, Any], durable: bool) -> None:
    suffix = path.suffix.lower()
    if suffix in npy.SUFFIXES:
        write_npy(path, values, durable=durable)
    elif suffix in pfm.SUFFIXES:
        write_pfm(path, values, durable=durable)
    elif suffix in tiff.SUFFIXES:
        write_picture(path, values, description=_MAP, durable=durable)
    else:
        raise ValueError(
            "path must end in .h5, .tif, .zarr, .pfm or .npy for depth of a focused camera, got "
            f"{path}."
        )


def _named_maps(source: Any, names: dict[str, str]) -> dict[str, np.ndarray[Any, Any]]:
    """Return the maps of an object by name, without z if it is unknown."""
    maps = {name: np.asarray(getattr(source, name)) for name in names}
    if not np.isfinite(maps["z"]).any():
        del maps["z"]
    return maps


def _write_hdf5(path: Path, depth: FocusedDepth, maps: FocusedMaps, durable: bool) -> None:
    geometry = depth.geometry
    lenslet_texts = {
        name: text for name, text in _LENSLETS.items() if name not in ("centre", "type")
    }
    lenslets: dict[str, np.ndarray[Any, Any]] = {"centre": geometry.centres, "type": geometry.kinds}
    lenslets |= _named_maps(depth, lenslet_texts)
    with create_hdf5(path, durable=durable) as file:
        _write_datasets(file.create_group("lenslets"), lenslets, _LENSLETS)
        picture = file.create_group("picture")
        _write_datasets(picture, _named_maps(maps, _CHANNELS), _CHANNELS)
        picture.attrs.update(_grid_description(maps.grid))


def _write_datasets(
    group: h5py.Group, arrays: dict[str, np.ndarray[Any, Any]], texts: dict[str, str]
) -> None:
    for name, values in arrays.items():
        stored = values.astype(np.float32) if values.dtype.kind == "f" else values
        group.create_dataset(name, data=stored).attrs["meaning"] = texts[name]
