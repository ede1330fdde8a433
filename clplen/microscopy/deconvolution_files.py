"""Files of a deconvolution: point images of either microscope, raw frames, and volumes."""

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
    """Point images of a file, of either microscope; a parameter file is told from it."""
    if Path(path).suffix.lower() == ".toml":
        raise FormatError(
            f"{path} has the parameters of a microscope, not its point images: make them by "
            f"'clplen microscope psf {path} -o PSF.h5'."
        )
    return read_point_images(path)


def refuse_volume(path: PathLike) -> None:
    """Refuse a volume where a raw frame is expected."""
    if is_volume(path):
        raise FormatError(f"{path} is a volume, as clplen writes them: give raw frames.")


def read_picture(path: PathLike, frame: int | None = None) -> Values:
    """A frame of one channel, of a file or of its ``frame``."""
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
    found: DeconvolutionResult,
    images: AnyImages,
    *,
    more: dict[str, Any],
    replace: bool = False,
) -> None:
    """Write a volume with what is known of it."""
    write_volume(
        path,
        found.volume,
        planes=images.planes,
        voxel=images.sides,
        description={
            "voxel_um": [round(side * 1e6, 9) for side in images.sides],
            "values": "energy of a voxel, photons (counts over the gain) of the frame",
            "residuals": [float(one) for one in found.residuals],
            "degenerate_um": [round(z * 1e6, 9) for z in found.degenerate],
            **more,
        },
        durable=True,
        replace=replace,
    )
