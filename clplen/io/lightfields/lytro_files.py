"""Pictures of Lytro cameras as light fields: raw image, white image, levels and colours.

The camera's metadata tell black and white level, white balance and colour matrix; the white image
is the one of a calibration that was taken with the same camera, zoom and focus.
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

    Black and white level, white balance and colour matrix are those of the metadata: samples are
    linear sRGB in which 1 is the sensor's white level.
    """
    path = Path(path)
    frame, bayer, metadata = read_lytro_frame(path, max_bytes=layout.max_bytes)
    capture = _capture(frame, bayer, metadata)
    said = []
    if layout.white is None and layout.grid is None:
        chosen = _chosen(path, metadata, layout)
        if chosen is not None:
            capture = _with_white(capture, chosen, frame, path, layout)
            layout = replace(layout, white=chosen.name)
            said = [_said(metadata, chosen)]
    layout = replace(layout, calibration=None, lattice=layout.lattice or metadata.lattice)
    try:
        lf, took = decode_frame(
            frame, path, device=device, layout=layout, progress=progress, capture=capture
        )
    except (FormatError, ShapeError) as error:
        if layout.white is not None or layout.grid is not None:
            raise
        raise FormatError(calibration_advice(path, metadata)) from error
    return lf, ", ".join([took, *said])


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


def _chosen(path: Path, metadata: LytroMetadata, layout: Layout) -> WhiteImage | None:
    """The white image of the calibration that is known; None where none is."""
    place = find_calibration(metadata, layout.calibration)
    if place is None:
        return None
    found = choose_white_image(metadata, read_white_images(place), picture=path, calibration=place)
    if layout.calibration is not None:
        remember_calibration(metadata, place)
    return found


def _with_white(
    capture: Capture, chosen: WhiteImage, frame: Frame, path: Path, layout: Layout
) -> Capture:
    white = chosen.read(max_bytes=layout.max_bytes)
    shape = (int(white.shape[0]), int(white.shape[1]))
    if shape != frame.shape:
        raise FormatError(
            f"{chosen.name} has shape {shape} and {path} has {frame.shape}: the white image is of "
            "another camera; give the calibration of this one."
        )
    black = chosen.metadata.black_frame(shape, chosen.packing.bayer)
    return replace(capture, white=white, white_black=black)


def _said(metadata: LytroMetadata, chosen: WhiteImage) -> str:
    """Which white image was chosen, and how near it is."""
    own, theirs = metadata, chosen.metadata
    if None in (own.zoom_step, theirs.zoom_step, own.focus_step, theirs.focus_step):
        return "the only white image of this camera"
    text = (
        f"taken at zoom {theirs.zoom_step:g} and focus {theirs.focus_step:g} (the picture: "
        f"{own.zoom_step:g} and {own.focus_step:g})"
    )
    return text + (", which is another zoom" if is_far(metadata, chosen) else "")
