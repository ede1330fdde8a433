"""Point images of both kinds of microscope in HDF5: a dataset a plane, parameters and a digest."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.memory import free_memory
from clplen.errors import FormatError
from clplen.files import PathLike, check_space, check_writable, replacing
from clplen.hdf5_safety import require_heaps, require_internal
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.images import PointImages
from clplen.outputs import MARK

AnyImages = PointImages | FourierPointImages
Parameters = dict[str, Any]

FORMAT = "clplen point images 1"
OF_CELLS = "clplen point images 3"  # with cells of several lenslets, which readers of 1 do not know
FOURIER = "clplen Fourier point images 1"
# Bytes of a file over those of its images; from .79 and .46 on were measured.
DENSEST = {"float32": 0.7, "float16": 0.4}

_DEFLATE = 1032  # largest ratio of gzip
_SLACK = 1 << 20  # bytes that any file may ask for
_DAMAGED = (
    OSError, ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError,
)  # fmt: skip


def write_point_images(path: PathLike, images: AnyImages) -> None:
    """Write point images; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        HDF5 file; one that is there is replaced.
    images : PointImages or FourierPointImages
        Point images of a microscope or of a Fourier microscope.

    Raises
    ------
    OSError
        If the file cannot be written, with the bytes it takes and those that the disk has free.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> clplen.microscopy.read_point_images("images.h5").planes.tolist()
    [0.0, 5e-05]
    """
    attributes: dict[str, Any] = {"digest": digest(images)}
    if isinstance(images, FourierPointImages):
        attributes |= {"format": FOURIER, "side": images.side, "radius": images.radius}
        attributes["shape"] = images.shape
        arrays, chunk_axes = {"centres": images.centres, "corners": images.corners}, 2
    else:
        attributes["format"] = FORMAT if images.cell.lenslets == (1, 1) else OF_CELLS
        if images.notes:
            attributes["notes"] = json.dumps(images.notes)
        arrays, chunk_axes = {"scales": images.scales}, 1
    made = io.BytesIO()  # HDF5 ends the whole program where a disk is full
    with h5py.File(made, "w") as file:
        file.attrs["software"] = MARK
        file.attrs["parameters"] = json.dumps(images.parameters)
        for name, value in attributes.items():
            file.attrs[name] = value
        for name, values in arrays.items():
            file[name] = values
        for number, values in enumerate(images.stored):
            file.create_dataset(
                f"planes/{number:04d}",
                data=values,
                chunks=(1,) * chunk_axes + values.shape[chunk_axes:],
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
    check_space(path, made.getbuffer().nbytes)
    with replacing(path) as temporary:
        temporary.write_bytes(made.getbuffer())


def read_point_images(path: PathLike) -> AnyImages:
    """Read point images.

    Parameters
    ----------
    path : path-like
        HDF5 file that `write_point_images` wrote.

    Returns
    -------
    PointImages or FourierPointImages
        Point images as they were written.

    Raises
    ------
    FormatError
        If the file holds no point images, was changed since it was written, or holds more than
        there is memory for.
    FileNotFoundError
        If there is none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    place = Path(path)
    with _opened(place) as file:
        is_fourier = file.attrs["format"] == FOURIER
        planes = _planes_in(file)
        beside = [file[name] for name in (("centres", "corners") if is_fourier else ("scales",))]
        _check_memory(place, [*planes, *beside])
        read = _read_fourier if is_fourier else _read_images
        images = read(file, json.loads(file.attrs["parameters"]), tuple(one[()] for one in planes))
        written = file.attrs["digest"]
    if digest(images) != written:
        raise FormatError(f"The point images in {place} are not those that were written: damaged.")
    return images


def _read_images(
    file: h5py.File, parameters: Parameters, stored: tuple[np.ndarray[Any, Any], ...]
) -> PointImages:
    notes = {
        str(name): float(one)
        for name, one in dict(json.loads(file.attrs.get("notes", "{}"))).items()
    }
    if not all(0 <= one < math.inf for one in notes.values()):
        raise ValueError(f"notes are {notes!r}")
    for name in {"planes", "lenslet_focal_lengths"} & parameters.keys():
        parameters[name] = tuple(parameters[name])
    return PointImages(
        parameters,
        np.array(parameters["planes"]),
        int(parameters["voxels_per_lenslet"]),
        int(parameters["pixels_per_lenslet"]),
        stored,
        file["scales"][()],
        notes,
    )


def _read_fourier(
    file: h5py.File, parameters: Parameters, stored: tuple[np.ndarray[Any, Any], ...]
) -> FourierPointImages:
    images = FourierPointImages(
        parameters,
        np.array(parameters["planes"], np.float64),
        int(parameters["voxels_per_pixel"]),
        float(file.attrs["side"]),
        (int(file.attrs["shape"][0]), int(file.attrs["shape"][1])),
        file["centres"][()],
        float(file.attrs["radius"]),
        stored,
        file["corners"][()],
    )
    planes, lenslets, b = len(images.planes), len(images.centres), images.voxels
    fits = images.centres.shape == (lenslets, 2) and lenslets > 0 and b > 0
    fits = fits and images.corners.shape == (planes, lenslets, 2) and len(stored) == planes
    fits = fits and all(
        one.ndim == 4 and one.shape[:2] == (b * b, lenslets) and one.shape[2] == one.shape[3]
        for one in stored
    )
    if not (fits and min(images.shape) > 0 and images.side > 0 and images.radius > 0):
        raise ValueError("arrays do not fit each other")
    return images


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file of point images; refuse a damaged one in one sentence."""
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        require_heaps(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") not in (FORMAT, OF_CELLS, FOURIER):
                raise FormatError(f"{path} holds no point images.")
            require_internal(file, path)
            yield file
    except _DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"{path} is no whole file of point images: it was cut short, damaged or is another "
            "file; make it again."
        ) from error


def _planes_in(file: h5py.File) -> list[h5py.Dataset]:
    """Return the datasets of the planes, in order."""
    return [file["planes"][name] for name in sorted(file["planes"])]


def _check_memory(path: Path, datasets: Sequence[h5py.Dataset]) -> None:
    """Refuse more samples than the file can hold, or the memory."""
    chunks = [math.prod(one.chunks or ()) * one.dtype.itemsize for one in datasets]
    nbytes = sum(one.nbytes for one in datasets)
    if max(nbytes, *chunks) > path.stat().st_size * _DEFLATE + _SLACK:
        raise ValueError(f"{nbytes:,} bytes are declared")
    free = free_memory()
    if nbytes > free:
        raise FormatError(
            f"The point images in {path} need {nbytes:,} bytes, and {free:,} are free: make them "
            "for fewer planes, with a larger cut or with store='float16'."
        )


def read_parameters(path: PathLike) -> tuple[Parameters, list[tuple[int, ...]]] | None:
    """Return what a file's point images depend on, and their shapes, without reading them."""
    try:
        with _opened(Path(path)) as file:
            return json.loads(file.attrs["parameters"]), [one.shape for one in _planes_in(file)]
    except (OSError, FormatError):
        return None


def read_matching(path: PathLike | None, parameters: Parameters) -> AnyImages | None:
    """Return the point images of a file; refuse other parameters.

    None without a file; raise OSError where none can be written.
    """
    if path is None:
        return None
    if not Path(path).is_file():
        check_writable(path)
        return None
    images = read_point_images(path)
    for name, value in parameters.items():
        there = images.parameters.get(name)
        if there != value:
            raise ValueError(
                f"The point images in {path} were made with {_difference(name, there, value)}: "
                "give another path, or remove the file to have them made anew."
            )
    return images


def _difference(name: str, there: Any, wanted: Any) -> str:
    """Name what is there, and what is wanted; of planes their number, or the first that differs."""
    if name == "planes" and there is not None:
        if len(there) != len(wanted):
            return f"{len(there)} planes, not {len(wanted)}"
        pairs = enumerate(zip(there, wanted, strict=True))
        number, (there, wanted) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        name = f"planes[{number}]"
    if isinstance(wanted, list | tuple) and len(wanted) > 2:
        return f"other {name}"
    return f"{name} = {there!r}, not {wanted!r}"


def digest(images: AnyImages) -> str:
    """Return the SHA-256 of the parameters and all numbers, with their shapes."""
    if isinstance(images, FourierPointImages):
        numbers = np.array([images.side, images.radius, *images.shape], np.float64)
        beside = [numbers, images.centres, images.corners]
    else:
        beside = [images.scales]
    total = hashlib.sha256(json.dumps(images.parameters, sort_keys=True).encode())
    for values in (*beside, *images.stored):
        total.update(str(values.shape).encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
