"""Point images in HDF5: every plane a dataset of chunks, with all parameters and a digest."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from clplen.files import PathLike
from clplen.microscopy.model.image_datasets import (
    check_memory,
    digest_of,
    opened,
    parameters_in,
    planes_in,
    require_digest,
    require_parameters,
    write_planes,
)
from clplen.microscopy.model.images import PointImages

FORMAT = "clplen point images 1"
OF_CELLS = "clplen point images 3"  # with cells of several lenslets, which readers of 1 do not know
# Bytes of a file over those of its images; from .79 and .46 on were measured.
DENSEST = {"float32": 0.7, "float16": 0.4}


def write_point_images(path: PathLike, images: PointImages) -> None:
    """Write point images; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        HDF5 file; one that is there is replaced.
    images : PointImages
        As `clplen.microscopy.point_images` gives them.

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
    attributes = {
        "format": FORMAT if images.cell.lenslets == (1, 1) else OF_CELLS,
        "digest": digest(images),
    }
    if images.notes:
        attributes["notes"] = json.dumps(images.notes)
    write_planes(
        path,
        images.stored,
        parameters=images.parameters,
        attributes=attributes,
        arrays={"scales": images.scales},
        chunk_axes=1,
    )


def read_point_images(path: PathLike) -> PointImages:
    """Read point images.

    Parameters
    ----------
    path : path-like
        HDF5 file that `write_point_images` wrote.

    Returns
    -------
    PointImages
        As they were written.

    Raises
    ------
    FormatError
        If the file holds no point images, was changed since it was written, or holds more than
        there is memory for.
    FileNotFoundError
        If there is none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    place = Path(path)
    with opened(place, (FORMAT, OF_CELLS), f"point images ({FORMAT!r})") as file:
        of_planes = planes_in(file)
        remedy = "for fewer planes, of less depth or with store='float16'"
        check_memory(place, [*of_planes, file["scales"]], remedy)
        parameters = json.loads(file.attrs["parameters"])
        notes = _numbers(json.loads(file.attrs.get("notes", "{}")))
        for name in {"planes", "lenslet_focal_lengths"} & parameters.keys():
            parameters[name] = tuple(parameters[name])
        images = PointImages(
            parameters,
            np.array(parameters["planes"]),
            int(parameters["voxels_per_lenslet"]),
            int(parameters["pixels_per_lenslet"]),
            tuple(one[()] for one in of_planes),
            file["scales"][()],
            notes,
        )
        written = file.attrs["digest"]
    require_digest(place, digest(images), written)
    return images


def read_parameters(path: PathLike) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """What a file's point images depend on, and their shapes, without reading them."""
    return parameters_in(path, (FORMAT, OF_CELLS))


def _numbers(notes: Any) -> dict[str, float]:
    """Notes as numbers from 0 on, by name."""
    found = {str(name): float(one) for name, one in dict(notes).items()}
    if not all(0 <= one < math.inf for one in found.values()):
        raise ValueError(f"notes are {notes!r}")
    return found


def read_matching(path: PathLike, parameters: dict[str, Any]) -> PointImages | None:
    """Point images of a file, None if there is no file."""
    if not Path(path).is_file():
        return None
    images = read_point_images(path)
    require_parameters(path, images.parameters, parameters)
    return images


def digest(images: PointImages) -> str:
    """SHA-256 of the parameters and all numbers."""
    return digest_of(images.parameters, (images.scales, *images.stored))
