"""Files of a deconvolution: point images of both kinds of microscope, raw frames and volumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.tiff import SUFFIXES
from clplen.io.raw.raw_files import read_frame
from clplen.io.results.volume_files import is_volume, write_volume
from clplen.microscopy.model.point_image_files import AnyImages, read_point_images
from clplen.microscopy.reconstruction.deconvolution import DeconvolutionResult

Values = np.ndarray[Any, Any]


def read_psf(path: PathLike) -> AnyImages:
    """Read the point images of a microscope or a Fourier microscope; reject a parameter file."""
    if Path(path).suffix.lower() == ".toml":
        raise FormatError(
            f"{path} contains the parameters of a microscope, not its point images: simulate them "
            f"by 'clplen microscope psf {path} -o PSF.h5'."
        )
    return read_point_images(path)


def refuse_volume(path: PathLike) -> None:
    """Raise FormatError if the file is a volume instead of a raw frame."""
    if is_volume(path):
        raise FormatError(f"{path} is a volume written by clplen: give raw frames.")


def read_picture(path: PathLike, frame: int | None = None) -> Values:
    """Read a single-channel frame from a file, or frame number ``frame`` of a stack."""
    refuse_volume(path)
    picture, _ = read_frame(path, frame=frame)
    if picture.ndim != 2:
        text = f"{path} has shape {picture.shape}; a raw frame has one channel."
        if Path(path).suffix.lower() in SUFFIXES:
            text += (
                f" If it is a series of {picture.shape[2]} frames, write it with "
                "photometric='minisblack'."
            )
        raise FormatError(text)
    return picture


def write_result(
    path: PathLike,
    result: DeconvolutionResult,
    images: AnyImages,
    *,
    more: dict[str, Any],
    replace: bool = False,
) -> None:
    """Write a volume with its planes, voxel size, residuals and the entries of ``more``."""
    write_volume(
        path,
        result.volume,
        planes=images.planes,
        voxel=images.sides,
        description={
            "voxel_um": [round(side * 1e6, 9) for side in images.sides],
            "values": "energy of a voxel, photons (counts over the gain) of the frame",
            "residuals": [float(residual) for residual in result.residuals],
            "degenerate_um": [round(z * 1e6, 9) for z in result.degenerate],
            **more,
        },
        durable=True,
        replace=replace,
    )
