"""What files of point images share: a dataset for each plane, parameters and a digest, in HDF5."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.memory import free_memory
from clplen.errors import FormatError
from clplen.files import PathLike, check_space, replacing
from clplen.hdf5_safety import require_heaps, require_own
from clplen.outputs import MARK

Values = np.ndarray[Any, Any]
Parameters = dict[str, Any]

_DEFLATE = 1032  # largest ratio of gzip
_SLACK = 1 << 20  # bytes that any file may ask for
_DAMAGED = (
    OSError,
    ArithmeticError,
    AttributeError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
)


def write_planes(
    path: PathLike,
    planes: Sequence[Values],
    *,
    parameters: Parameters,
    attributes: Mapping[str, Any],
    arrays: Mapping[str, Values],
    chunk_axes: int,
) -> None:
    """Write planes of point images with what belongs to them; the file appears whole or not at all.

    It is made in memory first: HDF5 ends the whole program where a disk is full.
    """
    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        file.attrs["software"] = MARK
        file.attrs["parameters"] = json.dumps(parameters)
        for name, value in attributes.items():
            file.attrs[name] = value
        for name, values in arrays.items():
            file[name] = values
        for number, values in enumerate(planes):
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


@contextmanager
def opened(path: Path, formats: Collection[str], what: str) -> Iterator[h5py.File]:
    """A file of point images; what is damaged is refused in one sentence."""
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        require_heaps(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") not in formats:
                raise FormatError(f"{path} holds no {what}.")
            require_own(file, path)
            yield file
    except _DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"{path} is no whole file of point images: it was cut short, damaged or is another "
            "file; make it again."
        ) from error


def has_format(path: PathLike, formats: Collection[str]) -> bool:
    """Whether a file says that it is of one of these formats."""
    if not Path(path).is_file():
        return False
    try:
        require_heaps(Path(path))
        with h5py.File(path, "r") as file:
            return file.attrs.get("format") in formats
    except (OSError, FormatError, RuntimeError, ValueError):
        return False


def planes_in(file: h5py.File) -> list[h5py.Dataset]:
    """Datasets of the planes, in order."""
    return [file["planes"][name] for name in sorted(file["planes"])]


def check_memory(path: Path, datasets: Sequence[h5py.Dataset], remedy: str) -> None:
    """Refuse more samples than the file can hold, or the memory."""
    chunks = [math.prod(one.chunks or ()) * one.dtype.itemsize for one in datasets]
    nbytes = sum(one.nbytes for one in datasets)
    if max(nbytes, *chunks) > path.stat().st_size * _DEFLATE + _SLACK:
        raise ValueError(f"{nbytes:,} bytes are declared")
    free = free_memory()
    if nbytes > free:
        raise FormatError(
            f"The point images in {path} need {nbytes:,} bytes, and {free:,} are free: make them "
            f"{remedy}."
        )


def require_digest(path: Path, found: str, written: Any) -> None:
    """Refuse numbers that are not those that were written."""
    if found != written:
        raise FormatError(f"The point images in {path} are not those that were written: damaged.")


def parameters_in(
    path: PathLike, formats: Collection[str]
) -> tuple[Parameters, list[tuple[int, ...]]] | None:
    """What a file's point images depend on, and their shapes, without reading them."""
    try:
        with opened(Path(path), formats, "point images") as file:
            return json.loads(file.attrs["parameters"]), [one.shape for one in planes_in(file)]
    except (OSError, FormatError):
        return None


def require_parameters(path: PathLike, there: Parameters, wanted: Parameters) -> None:
    """Refuse point images that were made with other parameters."""
    for name, value in wanted.items():
        if there.get(name) != value:
            raise ValueError(
                f"The point images in {path} were made with "
                f"{_difference(name, there.get(name), value)}: "
                "give another path, or remove the file to have them made anew."
            )


def _difference(name: str, there: Any, wanted: Any) -> str:
    """What is there, and what is wanted; of planes their number, or the first that differs."""
    if name == "planes" and there is not None:
        if len(there) != len(wanted):
            return f"{len(there)} planes, not {len(wanted)}"
        pairs = enumerate(zip(there, wanted, strict=True))
        number, (there, wanted) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        name = f"planes[{number}]"
    if isinstance(wanted, list | tuple) and len(wanted) > 2:
        return f"other {name}"
    return f"{name} = {there!r}, not {wanted!r}"


def digest_of(parameters: Parameters, arrays: Iterable[Values]) -> str:
    """SHA-256 of parameters and arrays, with their shapes."""
    total = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    for values in arrays:
        total.update(str(values.shape).encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
