"""Point images of a Fourier light-field microscope in HDF5, with all parameters and a digest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from clplen.files import PathLike
from clplen.microscopy.fourier.fourier_images import FourierPointImages
from clplen.microscopy.model.image_datasets import (
    check_memory,
    digest_of,
    has_format,
    opened,
    parameters_in,
    planes_in,
    require_digest,
    require_parameters,
    write_planes,
)

FORMAT = "clplen Fourier point images 1"


def write_fourier_point_images(path: PathLike, images: FourierPointImages) -> None:
    """Write point images of a Fourier microscope; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        HDF5 file; one that is there is replaced.
    images : FourierPointImages
        As `fourier_point_images` or `measure_point_images` give them.

    Raises
    ------
    OSError
        If the file cannot be written, with the bytes it takes and those that the disk has free.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_fourier_point_images("images.h5", images)
    >>> clplen.microscopy.read_fourier_point_images("images.h5").planes.tolist()
    [0.0, 2e-05]
    """
    write_planes(
        path,
        images.stored,
        parameters=images.parameters,
        attributes={
            "format": FORMAT,
            "digest": digest(images),
            "side": images.side,
            "radius": images.radius,
            "shape": images.shape,
        },
        arrays={"centres": images.centres, "corners": images.corners},
        chunk_axes=2,
    )


def read_fourier_point_images(path: PathLike) -> FourierPointImages:
    """Read point images of a Fourier microscope.

    Parameters
    ----------
    path : path-like
        HDF5 file that `write_fourier_point_images` wrote.

    Returns
    -------
    FourierPointImages
        As they were written.

    Raises
    ------
    FormatError
        If the file holds none, was changed since it was written, or holds more than there is
        memory for.
    FileNotFoundError
        If there is none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_fourier_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_fourier_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    place = Path(path)
    with opened(place, (FORMAT,), "point images of a Fourier microscope") as file:
        of_planes = planes_in(file)
        check_memory(
            place,
            [*of_planes, file["centres"], file["corners"]],
            "for fewer planes, or with a larger cut",
        )
        parameters = json.loads(file.attrs["parameters"])
        images = FourierPointImages(
            parameters,
            np.array(parameters["planes"], np.float64),
            int(parameters["voxels_per_pixel"]),
            float(file.attrs["side"]),
            (int(file.attrs["shape"][0]), int(file.attrs["shape"][1])),
            file["centres"][()],
            float(file.attrs["radius"]),
            tuple(one[()] for one in of_planes),
            file["corners"][()],
        )
        written = file.attrs["digest"]
        _check_shapes(images)
    require_digest(place, digest(images), written)
    return images


def _check_shapes(images: FourierPointImages) -> None:
    """Refuse arrays that do not belong together."""
    planes, lenslets, b = len(images.planes), len(images.centres), images.voxels
    fits = images.centres.shape == (lenslets, 2) and lenslets > 0 and b > 0
    fits = fits and images.corners.shape == (planes, lenslets, 2) and len(images.stored) == planes
    fits = fits and all(
        one.ndim == 4 and one.shape[:2] == (b * b, lenslets) and one.shape[2] == one.shape[3]
        for one in images.stored
    )
    if not (fits and min(images.shape) > 0 and images.side > 0 and images.radius > 0):
        raise ValueError("arrays do not fit each other")


def is_fourier(path: PathLike) -> bool:
    """Whether a file says that it holds point images of a Fourier microscope."""
    return has_format(path, (FORMAT,))


def read_fourier_parameters(path: PathLike) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """What a file's point images depend on, and their shapes, without reading them."""
    return parameters_in(path, (FORMAT,))


def read_matching(path: PathLike, parameters: dict[str, Any]) -> FourierPointImages | None:
    """Point images of a file, None if there is no file."""
    if not Path(path).is_file():
        return None
    images = read_fourier_point_images(path)
    require_parameters(path, images.parameters, parameters)
    return images


def digest(images: FourierPointImages) -> str:
    """SHA-256 of the parameters and all numbers."""
    numbers = np.array([images.side, images.radius, *images.shape], np.float64)
    arrays = (numbers, images.centres, images.corners, *images.stored)
    return digest_of(images.parameters, arrays)
