"""Pictures of Lytro cameras as light fields: raw image, white image, levels and colours.

Metadata of the camera contain black and white level, white balance and colour matrix. The white
image comes from a calibration of the same camera, zoom and focus.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike
from clplen.io.lightfields.layout import Layout
from clplen.io.lightfields.lenslet_frames import Capture, decode_frame
from clplen.io.raw.lytro_calibration import (
    WhiteImage,
    calibration_advice,
    choose_white_image,
    find_calibration,
    is_far,
    read_white_images,
    remember_calibration,
)
from clplen.io.raw.lytro_container import read_lytro_frame
from clplen.io.raw.lytro_metadata import LytroMetadata
from clplen.lightfield.model.light_field import LightField

Frame = np.ndarray[Any, Any]


def read_lytro(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read the raw image of a Lytro camera and decode it.

    Metadata supply black and white level, white balance and colour matrix. Samples are linear sRGB;
    1 is the white level of the sensor.
    """
    path = Path(path)
    frame, bayer, metadata = read_lytro_frame(path, max_bytes=layout.max_bytes)
    capture = _capture(frame, bayer, metadata)
    notes = []
    if layout.white is None and layout.grid is None:
        white_image = _white_image(path, metadata, layout)
        if white_image is not None:
            capture = _with_white(capture, white_image, frame, path, layout)
            layout = replace(layout, white=white_image.name)
            notes = [_describe_choice(metadata, white_image)]
    layout = replace(layout, calibration=None, lattice=layout.lattice or metadata.lattice)
    try:
        lf, summary = decode_frame(
            frame, path, device=device, layout=layout, progress=progress, capture=capture
        )
    except (FormatError, ShapeError) as error:
        if layout.white is not None or layout.grid is not None:
            raise
        raise FormatError(calibration_advice(path, metadata)) from error
    return lf, ", ".join([summary, *notes])


def _capture(frame: Frame, bayer: str | None, metadata: LytroMetadata) -> Capture:
    shape = (int(frame.shape[0]), int(frame.shape[1]))
    return Capture(
        bayer=bayer,
        black=metadata.black_frame(shape, bayer),
        balance=metadata.white_balance,
        matrix=metadata.colour_matrix,
        span=metadata.range,
        pitch=metadata.pitch,
        pixel_pitch=metadata.pixel_pitch,
    )


def _white_image(path: Path, metadata: LytroMetadata, layout: Layout) -> WhiteImage | None:
    """Return the white image of the known calibration, or None."""
    location = find_calibration(metadata, layout.calibration)
    if location is None:
        return None
    white_image = choose_white_image(
        metadata, read_white_images(location), picture=path, calibration=location
    )
    if layout.calibration is not None:
        remember_calibration(metadata, location)
    return white_image


def _with_white(
    capture: Capture, white_image: WhiteImage, frame: Frame, path: Path, layout: Layout
) -> Capture:
    white = white_image.read(max_bytes=layout.max_bytes)
    shape = (int(white.shape[0]), int(white.shape[1]))
    if shape != frame.shape:
        raise FormatError(
            f"The white image {white_image.name} must have the shape {frame.shape} of {path}, got "
            f"{shape}: give the calibration of this camera."
        )
    black = white_image.metadata.black_frame(shape, white_image.packing.bayer)
    return replace(capture, white=white, white_black=black)


def _describe_choice(metadata: LytroMetadata, white_image: WhiteImage) -> str:
    """Describe the chosen white image and its zoom and focus."""
    picture, white = metadata, white_image.metadata
    if None in (picture.zoom_step, white.zoom_step, picture.focus_step, white.focus_step):
        return "the only white image of this camera"
    text = (
        f"taken at zoom {white.zoom_step:g} and focus {white.focus_step:g} (picture: "
        f"{picture.zoom_step:g} and {picture.focus_step:g})"
    )
    return text + (", a different zoom" if is_far(metadata, white_image) else "")
