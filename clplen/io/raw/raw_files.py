"""Raw sensor frames of any kind of file, with the lattice of their lenslets or their camera.

Simulated ones are HDF5: the dataset ``raw`` (y, x) or (y, x, c), float32, as it lies on the sensor,
with the attributes ``pixel_pitch`` and ``wavelength`` in metres, ``levels`` (black, white, bits) of
digital numbers, and the group ``camera`` of `clplen.io.store.attributes`.
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
    LYTRO_DESCRIBED,
    RAYTRIX_SUFFIXES,
    require_room,
)
from clplen.io.raw.lattice_cache import kept_lattice
from clplen.io.raw.lytro_container import read_container
from clplen.io.raw.raytrix import read_raytrix
from clplen.io.raw.sensor_tiff import SensorTags, sensor_tags, write_sensor_tiff
from clplen.io.store import hdf5_files
from clplen.io.store.attributes import CAMERA, RAW, SAMPLES, of_camera
from clplen.io.store.hdf5_files import (
    HDF5Container,
    attributes_of,
    created,
    dataset_of,
    opened,
    read_array,
)
from clplen.io.store.opd_arrays import read_stored_camera, write_camera
from clplen.lightfield.calibration.lattice_trust import lattice_of_white
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import Levels, RawImage

Frame = np.ndarray[Any, Any]
Bayer = str | tuple[tuple[str, ...], ...]  # filters as `decode_raw` takes them
LEVELS = "levels"
DECODING_BYTES = 24  # a pixel: measured peak with white image and dark frame, without views


def write_raw(
    path: PathLike,
    raw: RawImage,
    *,
    durable: bool = False,
    white_balance: Sequence[float] | None = None,
) -> None:
    """Write a raw image: with the camera that took it, or as a captured frame is stored.

    Parameters
    ----------
    path : path-like
        ``.h5`` or ``.hdf5``: `read_raw` gives image and camera back. ``.tif`` or ``.tiff``: the
        whole numbers of a `Sensor`, 16 bits, with colour filters, black and white level in the tags
        of TIFF/EP and DNG; as for a captured frame, a white image or a lattice tells the lenslets.
    raw : RawImage
        Of a `PlenopticCamera`. How it was exposed and a scene's truth are not kept.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.
    white_balance : sequence of float, optional
        Of TIFF: factors of red, green and blue that make white grey (AsShotNeutral), by which
        `read_lightfield` multiplies.

    Raises
    ------
    ValueError, OSError
        If the suffix is another one, or the raw image has no camera of this package (HDF5), no
        levels or more than 16 bits (TIFF); if the file cannot be written.

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
        raise ValueError("white_balance= is kept by TIFF only: give it to decode_raw later.")
    if Path(path).suffix.lower() not in hdf5_files.SUFFIXES:
        raise ValueError(
            f"A raw image is written as .h5, with its camera, or as .tif, not as {path}."
        )
    camera: Any = raw.camera
    if of_camera(camera) is None:
        raise ValueError(
            "This raw image was taken by no camera of this package: keep its picture by "
            "write_picture and its lattice by Lattice.save."
        )
    with created(path, durable=durable) as file:
        container = HDF5Container(file, path)
        known: dict[str, Any] = {"pixel_pitch": float(raw.pixel_pitch)}
        known["wavelength"] = float(camera.wavelength)
        if raw.levels is not None:
            known[LEVELS] = [raw.levels.black, raw.levels.white, raw.levels.bit_depth]
        container.write(RAW, raw.to_numpy(), **known)
        write_camera(container, camera)


def is_raw(file: h5py.File) -> bool:
    """Whether an open file is one of `write_raw`."""
    held = isinstance(file.get(RAW), h5py.Dataset) and isinstance(file.get(CAMERA), h5py.Group)
    return held and SAMPLES not in file


def is_raw_file(path: PathLike) -> bool:
    """Return whether a file is one of `write_raw` in HDF5; False too where there is none."""
    path = Path(path)
    if (
        path.suffix.lower() not in hdf5_files.SUFFIXES
        or not path.is_file()
        or not h5py.is_hdf5(path)
    ):
        return False
    with opened(path) as file:
        return is_raw(file)


def read_raw_file(
    path: PathLike, *, device: DeviceLike | None = None, max_bytes: int | None = None
) -> RawImage:
    """Read what `write_raw` wrote."""
    path = Path(path)
    device = as_device(device)
    with opened(path) as file:
        dataset = dataset_of(file, RAW, path)
        camera = read_stored_camera(HDF5Container(file, path), device, max_bytes)
        if camera is None:
            raise FormatError(f"{path} does not tell which camera took its raw image.")
        _require_sensor(dataset, camera.grid.shape, path)
        data = np.ascontiguousarray(read_array(dataset, path, max_bytes), np.float32)
        levels = _levels(attributes_of(dataset, [LEVELS], path).get(LEVELS), path)
    raw = camera.raw_image(device.upload(data))
    return replace(raw, levels=levels, mosaic=raw.mosaic if data.ndim == 2 else None)


def _levels(found: Any, path: Path) -> Levels | None:
    """Levels as a file has them."""
    if found is None:
        return None
    numbers = isinstance(found, tuple) and all(isinstance(n, int | float) for n in found)
    if not numbers or len(found) != 3 or not 0 <= found[0] < found[1] <= 2 ** found[2] - 1 <= 2**24:
        raise FormatError(
            f"{path}: {LEVELS} are the black one, the white one and bits, not {str(found)[:60]}."
        )
    return Levels(float(found[0]), float(found[1]), int(found[2]))


def _require_sensor(dataset: h5py.Dataset, shape: tuple[int, int], path: Path) -> None:
    fits = tuple(dataset.shape[:2]) == shape and dataset.shape[2:] in ((), (3,))
    if not fits or dataset.dtype.kind not in "uif":
        raise FormatError(
            f"{path}: the dataset {RAW!r} of shape {dataset.shape} holds {dataset.dtype}, not real "
            f"numbers on the sensor of its camera, {shape}."
        )


def read_frame(
    path: PathLike, *, frame: int | None = None, max_bytes: int | None = None
) -> tuple[Frame, Bayer | None]:
    """Read one frame as it lies on the sensor.

    Parameters
    ----------
    path : path-like
        A picture, a Lytro container, or a raw image with its JSON beside it.
    frame : int, optional
        Which frame of a TIFF that holds several, from 0, in the file's own order (of OME-TIFF
        usually time, channel, plane, the last running fastest); the log says where it lies.
    max_bytes : int, optional
        Largest allocation that a file may ask for; default half of the free memory.

    Returns
    -------
    numpy.ndarray, str or tuple or None
        Shape (ny, nx), or (ny, nx, 3) of a colour picture, with the file's own dtype, no level
        subtracted; and the colour filters, such as "GRBG", or the rows of another tile, where the
        file tells them.

    Raises
    ------
    FormatError
        If it is missing, damaged or of another kind, or holds several frames and ``frame`` is not
        one of them.

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
        raise FormatError(f"frame= counts the frames of a TIFF, {path} holds one only.")
    with path.open("rb") as file:
        lytro = file.read(8) == LYTRO
    if lytro or path.suffix.lower() in (*LYTRO_DESCRIBED, ".txt"):
        return read_container(path, max_bytes=max_bytes)
    if path.suffix.lower() not in picture.SUFFIXES:
        raise FormatError(
            f"{path} is no raw frame: give a picture ({', '.join(picture.SUFFIXES)}), a Lytro "
            "container, or a .raw file with its .json beside it."
        )
    return read_picture(path, max_bytes=max_bytes), None


def read_beside(
    source: PathLike, what: str, frame: Frame, path: Path, *, max_bytes: int | None = None
) -> tuple[Frame, Bayer | None]:
    """A picture of the shape of a frame to which it belongs, and its colour filters."""
    found, bayer = read_frame(source, max_bytes=max_bytes)
    if found.shape != frame.shape:
        raise FormatError(
            f"The {what} {source} has shape {found.shape} and {path} has {frame.shape}: it is of "
            f"another camera or another crop; give the {what} of this one."
        )
    return found, bayer


def require_decoding(pixels: int, path: Path, max_bytes: int | None) -> None:
    """Refuse a frame whose lattice or views would take more memory than is allowed."""
    what = f"finding the lenslets among {pixels:,} pixels"
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
    """Read a raw lenslet image with the lattice of its lenslets, without decoding it.

    Parameters
    ----------
    path : path-like
        The XML calibration of a Raytrix camera, whose lenses it tells; a file of `write_raw`, with
        its camera; or a picture, a Lytro container or a raw image with its JSON, with ``white`` or
        ``grid``.
    image : path-like, optional
        The picture that belongs to an XML; default the one of the same name beside it.
    device : Device or str, optional
        Default ``Device.open()``.
    white : path-like, optional
        White image of the same camera, on which the lenslets are found (`estimate_lattice`). The
        raw image is not divided by it.
    dark : path-like, optional
        Dark frame, subtracted from the image and from the white one.
    grid : path-like, optional
        Lenslet lattice: JSON of `Lattice.save`, or a Raytrix XML, which tells its lens types too.
    frame : int, optional
        Which frame of a TIFF that holds several, as for `read_frame`.
    force : bool
        Whether to go on, with a `SamplingWarning`, where the lattice of the white image is not to
        be trusted, or the frame shows another one.

    Returns
    -------
    RawImage
        Of float32, with the file's own values and `lattice`; ``sub_images`` and ``cells`` are its
        lenslets of which a whole sub-image lies on the picture. The pixel pitch is NaN. Of a file
        of `write_raw`, what was written.

    Raises
    ------
    FormatError, ValueError, ShapeError
        If a file is missing, damaged or of another kind, nothing tells where the lenslets lie, the
        white image is none or of another camera, or an XML has no lens types; if both white and
        grid are given, or words that do not apply to an XML or HDF5; if not one lenslet lies on the
        picture.

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
    beside = any(one is not None for one in (white, dark, grid))
    if beside and path.suffix.lower() in (*RAYTRIX_SUFFIXES, *hdf5_files.SUFFIXES):
        words = f"{argument('white')}, {argument('dark')} and {argument('grid')}"
        raise ValueError(f"{path} tells the lenses: {words} do not apply.")
    if path.suffix.lower() in hdf5_files.SUFFIXES:
        if image is not None or frame is not None:
            words = f"{argument('image')} and {argument('frame')}"
            raise ValueError(f"{path} holds one raw image: {words} do not apply.")
        return read_raw_file(path, device=device)
    if path.suffix.lower() in RAYTRIX_SUFFIXES:
        values, _ = read_frame(picture_of(path) if image is None else image, frame=frame)
        levels, mosaic = None, None
        lattice, types = _calibrated(path, _shape(values))
    else:
        if image is not None:
            word = argument("image")
            raise ValueError(f"{word} belongs to an XML, {path} is an image itself.")
        values, _ = read_frame(path, frame=frame)
        black = None
        if dark is not None:
            black = read_beside(dark, "dark frame", values, path)[0].astype(np.float32)
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
    """A frame less its dark one, or less black levels that differ; its levels and mosaic."""
    if tags is None:
        return values if dark is None else values.astype(np.float32) - dark, None, None
    levels = tags.levels(values.dtype)
    if dark is not None:
        return values.astype(np.float32) - dark, None, tags.mosaic
    black = None if levels is not None else tags.black_frame(_shape(values))
    return values if black is None else values.astype(np.float32) - black, levels, tags.mosaic


def read_lattice(path: PathLike, shape: tuple[int, int]) -> Lattice:
    """Read the lattice of the lenslets of a picture, from JSON or from a Raytrix XML.

    Parameters
    ----------
    path : path-like
        JSON of `Lattice.save`, or the ``.xml`` of a Raytrix camera.
    shape : tuple of int
        (ny, nx) of the picture.

    Returns
    -------
    Lattice
        In pixels, with ``shape`` as given.

    Raises
    ------
    FormatError
        If the file is damaged, of another kind, or tells another shape.

    Examples
    --------
    >>> found = clplen.lightfield.Lattice(
    ...     "square", origin=(7.0, 7.0), row=(15.0, 0.0), column=(0.0, 15.0))
    >>> found.save("lattice.json")
    >>> lattice = clplen.io.read_lattice("lattice.json", (120, 150))
    >>> lattice.kind, lattice.pitch, lattice.shape
    ('square', (15.0, 15.0), (120, 150))
    """
    path = Path(path)
    if path.suffix.lower() in RAYTRIX_SUFFIXES:
        calibration = read_raytrix(path)
        with _refusing(path):
            return calibration.lattice(shape)
    lattice = Lattice.load(path)
    if lattice.shape not in (None, shape):
        raise FormatError(
            f"{path} is the lattice of a picture of shape {lattice.shape}, not of {shape}: it "
            "belongs to another camera."
        )
    return replace(lattice, shape=shape)


def _calibrated(path: Path, shape: tuple[int, int]) -> tuple[Lattice, tuple[LensType, ...]]:
    """The lenses of a Raytrix XML and their kinds."""
    calibration = read_raytrix(path)
    if not calibration.lens_types:
        raise FormatError(
            f"{path} has no <lens_type>, which tells the depths at which a kind of lens is sharp: "
            "add one for each kind, one in all if the lenses are alike."
        )
    with _refusing(path):
        return calibration.lattice(shape), calibration.types()


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """A value in a file that makes no lattice, as what is wrong with the file."""
    try:
        yield
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error


def picture_of(path: Path) -> Path:
    """The picture of the same name beside a Raytrix XML."""
    for suffix in picture.SUFFIXES:
        for name in (path.with_suffix(suffix), path.with_suffix(suffix.upper())):
            if name.is_file():
                return name
    raise FormatError(
        f"There is no picture {path.stem} beside {path} ({', '.join(picture.SUFFIXES)}): "
        f"give {argument('image')}."
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
            f"Give {argument('white')}, to find the lenslets, or {argument('grid')}, where they "
            "are; not both."
        )
    if grid is not None:
        return read_lattice(grid, _shape(frame))
    if white is None:
        raise FormatError(
            f"Nothing tells where the lenslets of {path} lie: give {argument('white')}, a white "
            f"image of the same camera, or {argument('grid')}, a lattice saved before."
        )
    require_decoding(frame.size, path, None)
    flat, bayer = read_beside(white, "white image", frame, path)
    flat = flat.astype(np.float32)
    black = None if dark is None else _grey(dark)
    return lattice_of_white(
        _grey(flat), white, frame=_grey(frame), path=path, dark=black, bayer=bayer, force=force,
        error=FormatError, estimate=kept_lattice,
    )  # fmt: skip


def _grey(frame: Frame) -> Frame:
    return frame.mean(2) if frame.ndim == 3 else frame


def _shape(frame: Frame) -> tuple[int, int]:
    return frame.shape[0], frame.shape[1]
