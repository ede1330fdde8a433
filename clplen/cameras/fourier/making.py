"""A Fourier light-field microscope from its parameters: what is checked, and what follows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen import units
from clplen.cameras.fourier.fourier_microscope import FourierMicroscope
from clplen.cameras.fourier.fourier_optics import LIT
from clplen.cameras.fourier.lenslet_layout import LensletLayout
from clplen.cameras.optics.objective import CoverGlass
from clplen.checks import is_finite, is_integer
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import SamplingError, ShapeError
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid
from clplen.wave.spectrum.spectrum_tables import check_wavelength

LEAST = 8  # pixels of a sub-image
MOST = 2**28  # pixels of a sensor


def make(
    *,
    magnification: float,
    na: float,
    mla: MicrolensArray | LensletLayout,
    wavelength: float,
    relay: float,
    pixel_pitch: float,
    shape: tuple[int, int] | None,
    field_stop: float | None,
    sensor_distance: float | None,
    medium_index: float,
    tube_lens: float,
    cover: CoverGlass | None,
    apodisation: float,
    device: DeviceLike | None,
) -> FourierMicroscope:
    """What `PlenopticCamera.fourier_microscope` makes of its arguments."""
    device = as_device(device)
    if not isinstance(mla, MicrolensArray | LensletLayout):
        raise TypeError(
            "mla is a MicrolensArray or a LensletLayout, as LensletLayout([(0, 0)], 30e-3, "
            f"diameter=1e-3), not of type {type(mla).__name__}."
        )
    layout = LensletLayout.of(mla) if isinstance(mla, MicrolensArray) else mla
    for name, value, length in (
        ("relay", relay, units.CAMERA_FOCAL_LENGTH),
        ("pixel_pitch", pixel_pitch, units.PIXEL_PITCH),
        ("tube_lens", tube_lens, units.TUBE_LENS),
        ("field_stop", field_stop, units.IMAGE_PLACE),
        ("sensor_distance", sensor_distance, units.CAMERA_FOCAL_LENGTH),
        ("wavelength", wavelength, units.WAVELENGTH),
    ):
        if value is None:
            continue
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")
        length.check(value, name)
    check_wavelength(wavelength)
    _check_objective(magnification, na, medium_index, apodisation, cover)
    focal = np.unique(layout.focal_lengths)
    if sensor_distance is None and len(focal) > 1:
        raise ValueError(
            f"Lenslets of {len(focal)} focal lengths share one sensor: give sensor_distance, from "
            f"the array to it, such as {focal.mean():g}."
        )
    s = float(focal[0]) if sensor_distance is None else float(sensor_distance)
    stop = layout.diameter * relay / s if field_stop is None else float(field_stop)
    pixels = stop * s / relay / pixel_pitch
    if pixels < LEAST:
        raise SamplingError(
            f"A sub-image has {pixels:.3g} pixels (field_stop s/(f_FL pixel_pitch)), at least "
            f"{LEAST} are needed: give smaller pixels, or a wider field stop."
        )
    camera = FourierMicroscope(
        magnification=float(magnification),
        na=float(na),
        medium_index=float(medium_index),
        tube_lens=float(tube_lens),
        relay=float(relay),
        lenslets=layout,
        sensor_distance=s,
        field_stop=stop,
        wavelength=float(wavelength),
        pixel_pitch=float(pixel_pitch),
        grid=Grid((1, 1), float(pixel_pitch)),
        device=device,
        cover=cover,
        apodisation=float(apodisation),
    )
    if not (camera.lit >= LIT).any():
        raise ValueError(
            f"No lenslet lies in the pupil, which is {camera.pupil_diameter:g} m wide about the "
            "axis (2 NA f_FL/M): lengths are in metres."
        )
    object.__setattr__(camera, "grid", _sensor(camera, shape))
    return camera


def _check_objective(
    magnification: Any, na: Any, index: Any, apodisation: Any, cover: CoverGlass | None
) -> None:
    """Refuse an objective that cannot be."""
    if not (is_finite(magnification) and magnification >= 1):
        raise ValueError(f"The magnification is a finite number from 1 on, not {magnification!r}.")
    if not (is_finite(index) and index >= 1):
        raise ValueError(f"medium_index is a finite number from 1 (air) on, not {index!r}.")
    if not (is_finite(na) and 0 < na < index):
        raise ValueError(
            f"NA = n sin(theta) lies between 0 and the index of the medium, {index!r}, not at "
            f"{na!r}: give medium_index (water 1.33, oil 1.52) or another NA."
        )
    if not (is_finite(apodisation) and -1 <= apodisation <= 1):
        raise ValueError(
            f"apodisation is the power of cos(theta) over the pupil, from -1 to 1, not "
            f"{apodisation!r}."
        )
    if cover is not None and not isinstance(cover, CoverGlass):
        raise TypeError(f"cover is a CoverGlass, as CoverGlass(150e-6), not {cover!r}.")
    if cover is not None and na >= min(cover.index, cover.designed_index):
        raise ValueError(
            f"NA {na!r} does not pass a cover glass of index "
            f"{min(cover.index, cover.designed_index)!r}."
        )


def _sensor(camera: FourierMicroscope, shape: tuple[int, int] | None) -> Grid:
    """The sensor about the axis: as given, or as large as the sub-images with light."""
    pitch = camera.pixel_pitch
    if shape is None:
        farthest = np.abs(camera.lenslets.positions[camera.lit >= LIT]).max(axis=0)
        sides = 2 * farthest + max(camera.sub_image, camera.lenslets.diameter)
        shape = (math.ceil(sides[0] / pitch - 1e-6), math.ceil(sides[1] / pitch - 1e-6))
    elif np.shape(shape) != (2,) or any(not is_integer(n) or n < 1 for n in shape):
        raise ShapeError(f"shape is (ny, nx) pixels of the sensor, not {shape!r}.")
    ny, nx = int(shape[0]), int(shape[1])
    if ny * nx > MOST:
        raise ValueError(f"The sensor has {ny} x {nx} pixels, at most {MOST:,}: are lengths right?")
    return Grid(
        (ny, nx),
        pitch,
        origin=(pitch / 2 if ny % 2 == 0 else 0.0, pitch / 2 if nx % 2 == 0 else 0.0),
    )
