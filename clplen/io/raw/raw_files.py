"""Read and write raw sensor frames with their lenslet lattice or camera.

Simulated frames are HDF5: the float32 dataset ``raw`` (y, x) or (y, x, c), in sensor order, and the
group ``camera`` of `clplen.io.store.attributes`. Its attributes are ``pixel_pitch`` and
``wavelength`` in metres and the ``levels`` (black, white, bits) of digital numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.device import DeviceLike, as_device
from clplen.errors import FormatError, argument
from clplen.files import PathLike, naming
from clplen.io.formats import picture, tiff
from clplen.io.formats.picture import read_picture, without_alpha
from clplen.io.formats.tiff import read_tiff_frame
from clplen.io.formats.untrusted import (
    LYTRO,
    LYTRO_SUFFIXES,
    RAYTRIX_SUFFIXES,
    require_room,
)
from clplen.io.raw.lattice_cache import cached_lattice
from clplen.io.raw.lytro_container import read_container
from clplen.io.raw.raytrix import read_raytrix
from clplen.io.raw.sensor_tiff import SensorTags, sensor_tags, write_sensor_tiff
from clplen.io.store import hdf5_files
from clplen.io.store.attributes import CAMERA, RAW, SAMPLES, camera_attributes
from clplen.io.store.hdf5_files import (
    HDF5Container,
    attributes_of,
    create_hdf5,
    dataset_of,
    open_hdf5,
    read_array,
)
from clplen.io.store.opd_arrays import read_stored_camera, write_camera
from clplen.lightfield.calibration.lattice_trust import lattice_of_white
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import Levels, RawImage

Frame = np.ndarray[Any, Any]
Bayer = str | tuple[tuple[str, ...], ...]  # colour filters, as for `decode_raw`
LEVELS = "levels"
DECODING_BYTES = 24  # per pixel; measured peak with white image and dark frame, without views


def write_raw(
    path: PathLike,
    raw: RawImage,
    *,
    durable: bool = False,
    white_balance: Sequence[float] | None = None,
) -> None:
    """Write a raw image: with its camera (HDF5), or like a captured frame (TIFF).

    Parameters
    ----------
    path : path-like
        Output file. ``.h5`` or ``.hdf5`` stores the camera too, for `read_raw`. ``.tif`` or
        ``.tiff`` stores the digital numbers of a `Sensor` in 16 bits, with colour filters, black
        and white level in the tags of TIFF/EP and DNG. Reading it needs a white image or a lattice,
        as for a captured frame.
    raw : RawImage
        Raw image of a `PlenopticCamera`. Its exposure settings and scene truth are not stored.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.
    white_balance : sequence of float, optional
        Factors of red, green and blue that make white grey, stored in the tag AsShotNeutral of
        TIFF. `read_lightfield` applies them.

    Raises
    ------
    ValueError, OSError
        If the suffix is unknown; if the raw image has no camera of this package (HDF5), no levels
        or more than 16 bits (TIFF); if the file cannot be written.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=clplen.MicrolensArray(100e-6, 1e-3, count=11),
    ...     wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> clplen.write_raw("point.h5", raw)
    >>> clplen.read_raw("point.h5").camera.kind
    'standard'
    """
    if Path(path).suffix.lower() in tiff.SUFFIXES:
        write_sensor_tiff(path, raw, white_balance=white_balance, durable=durable)
        return
    if white_balance is not None:
        raise ValueError("white_balance= requires TIFF: pass it to decode_raw later instead.")
    if Path(path).suffix.lower() not in hdf5_files.SUFFIXES:
        raise ValueError(
            f"path must end in .h5 (with the camera) or .tif for a raw image, got {path}."
        )
    camera: Any = raw.camera
    if camera_attributes(camera) is None:
        raise ValueError(
            "This raw image has no camera of this package: save its picture with write_picture and "
            "its lattice with Lattice.save."
        )
    with create_hdf5(path, durable=durable) as file:
        container = HDF5Container(file, path)
        attributes: dict[str, Any] = {"pixel_pitch": float(raw.pixel_pitch)}
        attributes["wavelength"] = float(camera.wavelength)
        if raw.levels is not None:
            attributes[LEVELS] = [raw.levels.black, raw.levels.white, raw.levels.bit_depth]
        container.write(RAW, raw.to_numpy(), **attributes)
        write_camera(container, camera)


def is_raw(file: h5py.File) -> bool:
    """Return True for an open file of `write_raw`."""
    has_members = isinstance(file.get(RAW), h5py.Dataset) and isinstance(
        file.get(CAMERA), h5py.Group
    )
    return has_members and SAMPLES not in file


def is_raw_file(path: PathLike) -> bool:
    """Return True for an HDF5 file of `write_raw`, False for other or missing files."""
    path = Path(path)
    if (
        path.suffix.lower() not in hdf5_files.SUFFIXES
        or not path.is_file()
        or not h5py.is_hdf5(path)
    ):
        return False
    with open_hdf5(path) as file:
        return is_raw(file)


def read_raw_file(
    path: PathLike, *, device: DeviceLike | None = None, max_bytes: int | None = None
) -> RawImage:
    """Read a raw image of `write_raw` from HDF5."""
    path = Path(path)
    device = as_device(device)
    with open_hdf5(path) as file:
        dataset = dataset_of(file, RAW, path)
        camera = read_stored_camera(HDF5Container(file, path), device, max_bytes)
        if camera is None:
            raise FormatError(f"{path} does not describe the camera of its raw image.")
        _require_sensor(dataset, camera.grid.shape, path)
        data = np.ascontiguousarray(read_array(dataset, path, max_bytes), np.float32)
        levels = _levels(attributes_of(dataset, [LEVELS], path).get(LEVELS), path)
    raw = camera.raw_image(device.upload(data))
    return replace(raw, levels=levels, mosaic=raw.mosaic if data.ndim == 2 else None)


def _levels(values: Any, path: Path) -> Levels | None:
    """Return the validated levels of a file."""
    if values is None:
        return None
    numbers = isinstance(values, tuple) and all(isinstance(n, int | float) for n in values)
    if (
        not numbers
        or len(values) != 3
        or not 0 <= values[0] < values[1] <= 2 ** values[2] - 1 <= 2**24
    ):
        raise FormatError(f"{path}: {LEVELS} must be (black, white, bits), got {str(values)[:60]}.")
    return Levels(float(values[0]), float(values[1]), int(values[2]))


def _require_sensor(dataset: h5py.Dataset, shape: tuple[int, int], path: Path) -> None:
    fits = tuple(dataset.shape[:2]) == shape and dataset.shape[2:] in ((), (3,))
    if not fits or dataset.dtype.kind not in "uif":
        raise FormatError(
            f"{path}: the dataset {RAW!r} must hold real numbers on the sensor of its camera, "
            f"{shape}, got {dataset.dtype} of shape {dataset.shape}."
        )


def read_frame(
    path: PathLike, *, frame: int | None = None, max_bytes: int | None = None
) -> tuple[Frame, Bayer | None]:
    """Read a sensor frame.

    Parameters
    ----------
    path : path-like
        Picture, Lytro container, or raw image with a JSON file of equal name.
    frame : int, optional
        Index of the frame in a TIFF with several frames, from 0, in file order. OME-TIFF usually
        orders time, channel, plane, the last running fastest; the log reports the position.
    max_bytes : int, optional
        Largest allocation that a file may cause; default half of the free memory.

    Returns
    -------
    numpy.ndarray, str or tuple or None
        Frame of shape (ny, nx), or (ny, nx, 3) for a colour picture, in the dtype of the file and
        without black-level subtraction; and the colour filters, such as "GRBG" or the rows of
        another tile, if the file states them.

    Raises
    ------
    FormatError
        If the file is missing, damaged or of another kind, or if ``frame`` is not one of its
        several frames.

    Examples
    --------
    >>> clplen.io.write_picture("frame.tif", np.full((24, 32), 1023, np.uint16))
    >>> values, filters = clplen.io.read_frame("frame.tif")
    >>> values.shape, values.dtype.name, filters is None
    ((24, 32), 'uint16', True)
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    if path.suffix.lower() in tiff.SUFFIXES:
        values = without_alpha(read_tiff_frame(path, frame=frame, max_bytes=max_bytes), path)
        tags = sensor_tags(path)
        return values, None if tags is None or values.ndim != 2 else tags.bayer
    if frame is not None:
        raise FormatError(f"frame= requires a TIFF with several frames; {path} has one frame.")
    with path.open("rb") as file:
        lytro = file.read(8) == LYTRO
    if lytro or path.suffix.lower() in (*LYTRO_SUFFIXES, ".txt"):
        return read_container(path, max_bytes=max_bytes)
    if path.suffix.lower() not in picture.SUFFIXES:
        raise FormatError(
            f"{path} is not a raw frame: give a picture ({', '.join(picture.SUFFIXES)}), a Lytro "
            "container, or a .raw file with a .json file of equal name."
        )
    return read_picture(path, max_bytes=max_bytes), None


def read_companion(
    source: PathLike, what: str, frame: Frame, path: Path, *, max_bytes: int | None = None
) -> tuple[Frame, Bayer | None]:
    """Read a picture that must have the shape of a frame, and its colour filters."""
    companion, bayer = read_frame(source, max_bytes=max_bytes)
    if companion.shape != frame.shape:
        raise FormatError(
            f"The {what} {source} must have the shape {frame.shape} of {path}, got "
            f"{companion.shape}: give the {what} of this camera and crop."
        )
    return companion, bayer


def require_decoding(pixels: int, path: Path, max_bytes: int | None) -> None:
    """Raise FormatError for a frame whose decoding would exceed the allowed memory."""
    what = f"detecting the lenslets among {pixels:,} pixels"
    require_room(DECODING_BYTES * pixels, path=path, what=what, max_bytes=max_bytes)


def read_raw(
    path: PathLike,
    *,
    image: PathLike | None = None,
    device: DeviceLike | None = None,
    white: PathLike | None = None,
    dark: PathLike | None = None,
    grid: PathLike | None = None,
    frame: int | None = None,
    force: bool = False,
) -> RawImage:
    """Read a raw lenslet image with its lenslet lattice, without decoding it.

    Parameters
    ----------
    path : path-like
        XML calibration of a Raytrix camera; file of `write_raw`; or picture, Lytro container or raw
        image with JSON, together with ``white`` or ``grid``.
    image : path-like, optional
        Picture that belongs to an XML; default the picture of equal name in its folder.
    device : Device or str, optional
        Compute device; default ``Device.open()``.
    white : path-like, optional
        White image of the same camera, in which the lenslets are detected (`estimate_lattice`). The
        raw image is not divided by it.
    dark : path-like, optional
        Dark frame, subtracted from the image and the white image.
    grid : path-like, optional
        Lenslet lattice: JSON of `Lattice.save`, or a Raytrix XML with lens types.
    frame : int, optional
        Index of the frame in a TIFF with several frames, as for `read_frame`.
    force : bool
        True to continue with a `SamplingWarning` if the lattice of the white image is unreliable or
        differs from that of the frame.

    Returns
    -------
    RawImage
        Raw image of float32 with the values of the file and its `lattice`. ``sub_images`` and
        ``cells`` are the lenslets whose whole sub-image is in the picture. The pixel pitch is NaN.
        A file of `write_raw` is restored as written.

    Raises
    ------
    FormatError, ValueError, ShapeError
        If a file is missing, damaged or of another kind; if the lenslets are unknown, the white
        image is unsuitable or an XML has no lens types; if both white and grid are given, or
        arguments that do not apply to XML or HDF5; if no lenslet is in the picture.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=clplen.MicrolensArray(100e-6, 1e-3, count=11),
    ...     wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> clplen.write_raw("point.h5", raw)
    >>> again = clplen.read_raw("point.h5")
    >>> again.shape, again.sub_images.count, bool((again.to_numpy() == raw.to_numpy()).all())
    ((55, 55), (11, 11), True)
    """
    path = Path(path)
    types: tuple[LensType, ...] = ()
    has_companion = any(source is not None for source in (white, dark, grid))
    if has_companion and path.suffix.lower() in (*RAYTRIX_SUFFIXES, *hdf5_files.SUFFIXES):
        names = f"{argument('white')}, {argument('dark')} and {argument('grid')}"
        raise ValueError(f"{names} do not apply to {path}, a file that describes its lenses.")
    if path.suffix.lower() in hdf5_files.SUFFIXES:
        if image is not None or frame is not None:
            names = f"{argument('image')} and {argument('frame')}"
            raise ValueError(f"{names} do not apply to {path}, a file with one raw image.")
        return read_raw_file(path, device=device)
    if path.suffix.lower() in RAYTRIX_SUFFIXES:
        values, _ = read_frame(picture_of(path) if image is None else image, frame=frame)
        levels, mosaic = None, None
        lattice, types = _calibrated(path, _shape(values))
    else:
        if image is not None:
            name = argument("image")
            raise ValueError(f"{name} requires an XML calibration; {path} is an image itself.")
        values, _ = read_frame(path, frame=frame)
        black = None
        if dark is not None:
            black = read_companion(dark, "dark frame", values, path)[0].astype(np.float32)
        tags = sensor_tags(path) if values.ndim == 2 else None
        lattice = _lattice(path, values, white, black, grid, force)
        if grid is not None and Path(grid).suffix.lower() in RAYTRIX_SUFFIXES:
            types = _calibrated(Path(grid), _shape(values))[1]
        values, levels, mosaic = _without_dark(values, black, tags)
    device = as_device(device)
    with naming(path):
        grid_of_all = lattice.grid(lattice.views())
    return RawImage(
        device.upload(np.ascontiguousarray(values, np.float32)),
        device,
        math.nan,
        grid_of_all,
        grid_of_all,
        lattice=lattice,
        lens_types=types,
        mosaic=mosaic,
        levels=levels,
    )


def _without_dark(
    values: Frame, dark: Frame | None, tags: SensorTags | None
) -> tuple[Frame, Levels | None, tuple[tuple[str, ...], ...] | None]:
    """Subtract the dark frame or varying black levels; return the frame, levels and mosaic."""
    if tags is None:
        return values if dark is None else values.astype(np.float32) - dark, None, None
    levels = tags.levels(values.dtype)
    if dark is not None:
        return values.astype(np.float32) - dark, None, tags.mosaic
    black = None if levels is not None else tags.black_frame(_shape(values))
    return values if black is None else values.astype(np.float32) - black, levels, tags.mosaic


def read_lattice(path: PathLike, shape: tuple[int, int]) -> Lattice:
    """Read the lenslet lattice of a picture, from JSON or from a Raytrix XML.

    Parameters
    ----------
    path : path-like
        JSON file of `Lattice.save`, or ``.xml`` file of a Raytrix camera.
    shape : tuple of int
        Shape (ny, nx) of the picture.

    Returns
    -------
    Lattice
        Lattice in pixels, with the given ``shape``.

    Raises
    ------
    FormatError
        If the file is damaged, of another kind, or has another shape.

    Examples
    --------
    >>> square = clplen.lightfield.Lattice(
    ...     "square", origin=(7.0, 7.0), row=(15.0, 0.0), column=(0.0, 15.0))
    >>> square.save("lattice.json")
    >>> lattice = clplen.io.read_lattice("lattice.json", (120, 150))
    >>> lattice.kind, lattice.pitch, lattice.shape
    ('square', (15.0, 15.0), (120, 150))
    """
    path = Path(path)
    if path.suffix.lower() in RAYTRIX_SUFFIXES:
        calibration = read_raytrix(path)
        with _format_errors(path):
            return calibration.lattice(shape)
    lattice = Lattice.load(path)
    if lattice.shape not in (None, shape):
        raise FormatError(
            f"{path} must be the lattice of a picture of shape {shape}, got {lattice.shape}: it "
            "belongs to another camera."
        )
    return replace(lattice, shape=shape)


def _calibrated(path: Path, shape: tuple[int, int]) -> tuple[Lattice, tuple[LensType, ...]]:
    """Return the lattice and the lens types of a Raytrix XML."""
    calibration = read_raytrix(path)
    if not calibration.lens_types:
        raise FormatError(
            f"{path} has no <lens_type> with the depth range of a kind of lens: add an element for "
            "each kind, or one element if all lenses are alike."
        )
    with _format_errors(path):
        return calibration.lattice(shape), calibration.types()


@contextmanager
def _format_errors(path: Path) -> Iterator[None]:
    """Turn the ValueError of an invalid lattice into a FormatError of the file."""
    try:
        yield
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error


def picture_of(path: Path) -> Path:
    """Return the picture of equal name in the folder of a Raytrix XML."""
    for suffix in picture.SUFFIXES:
        for name in (path.with_suffix(suffix), path.with_suffix(suffix.upper())):
            if name.is_file():
                return name
    raise FormatError(
        f"The folder of {path} has no picture {path.stem} ({', '.join(picture.SUFFIXES)}): give "
        f"{argument('image')}."
    )


def _lattice(
    path: Path,
    frame: Frame,
    white: PathLike | None,
    dark: Frame | None,
    grid: PathLike | None,
    force: bool,
) -> Lattice:
    if white is not None and grid is not None:
        raise ValueError(
            f"Give either {argument('white')}, to detect the lenslets, or {argument('grid')}, "
            "their lattice, but not both."
        )
    if grid is not None:
        return read_lattice(grid, _shape(frame))
    if white is None:
        raise FormatError(
            f"The lenslets of {path} are unknown: give {argument('white')}, a white image of the "
            f"same camera, or {argument('grid')}, a saved lattice."
        )
    require_decoding(frame.size, path, None)
    flat, bayer = read_companion(white, "white image", frame, path)
    flat = flat.astype(np.float32)
    black = None if dark is None else _grey(dark)
    return lattice_of_white(
        _grey(flat), white, frame=_grey(frame), path=path, dark=black, bayer=bayer, force=force,
        error=FormatError, estimate=cached_lattice,
    )  # fmt: skip


def _grey(frame: Frame) -> Frame:
    return frame.mean(2) if frame.ndim == 3 else frame


def _shape(frame: Frame) -> tuple[int, int]:
    return frame.shape[0], frame.shape[1]
