"""Camera files of Fourier light-field microscopes: ``kind = "fourier_microscope"``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clplen.cameras import FourierMicroscope, LensletLayout, PlenopticCamera
from clplen.compute.device import Device
from clplen.config.camera import MicrolensTable
from clplen.config.kinds import FOURIER, kind_of, require_fourier
from clplen.config.microscope import (
    INDEX,
    PIXEL,
    STEP,
    TUBE_LENS,
    WAVELENGTH,
    ObjectiveTable,
    Range,
)
from clplen.config.tables import (
    Count,
    Finite,
    Positive,
    Table,
    listed,
    of,
    read_toml,
    validated,
)
from clplen.files import PathLike

RELAY = Range(5, 2000, "mm")
STOP = Range(0.05, 200, "mm")
DISTANCE = Range(0.1, 2000, "mm")


class LensletsTable(Table):
    """``[camera.lenslets]``: lenslets at arbitrary positions."""

    positions_mm: Annotated[
        list[Annotated[tuple[Finite, Finite], of(2, "two numbers, [y, x]")]], Field(min_length=1)
    ]
    focal_length_mm: Annotated[list[Positive], Field(min_length=1), BeforeValidator(listed)]
    diameter_um: Positive
    fill: Literal["circular", "square", "hexagonal"] = "circular"
    rotation_deg: Finite = 0.0

    def build(self) -> LensletLayout:
        """Return the lenslets in SI units."""
        return LensletLayout(**self.in_si() | {"positions": np.array(self.positions_mm) / 1e3})


class FourierTable(ObjectiveTable):
    """``[camera]``: a Fourier microscope."""

    kind: Literal["fourier_microscope"]
    medium_index: Annotated[Positive, AfterValidator(INDEX.check)] = 1.0
    wavelength_nm: Annotated[Positive, AfterValidator(WAVELENGTH.check)]
    tube_lens_mm: Annotated[Positive, AfterValidator(TUBE_LENS.check)] = 200.0
    relay_mm: Annotated[Positive, AfterValidator(RELAY.check)]
    field_stop_mm: Annotated[Positive, AfterValidator(STOP.check)] | None = None
    sensor_distance_mm: Annotated[Positive, AfterValidator(DISTANCE.check)] | None = None
    pixel_um: Annotated[Positive, AfterValidator(PIXEL.check)]
    sensor: Annotated[tuple[Count, Count], of(2, "[rows, columns]")] | None = None
    microlenses: MicrolensTable | None = None
    lenslets: LensletsTable | None = None

    @model_validator(mode="after")
    def _lenslets_once(self) -> FourierTable:
        if (self.microlenses is None) == (self.lenslets is None):
            count = "neither" if self.lenslets is None else "both"
            raise ValueError(f"needs either microlenses or lenslets, has {count}")
        return self

    def build(self, device: Device) -> FourierMicroscope:
        """Return the camera in SI units on a device."""
        lenslets = self.microlenses or self.lenslets
        assert lenslets is not None
        arguments = self.in_si("kind", "pixel_um", "sensor", "microlenses", "lenslets")
        arguments |= {"cover": self.cover.build() if self.cover else None, "shape": self.sensor}
        pitch = self.pixel_um / 1e6
        return PlenopticCamera.fourier_microscope(
            mla=lenslets.build(), pixel_pitch=pitch, device=device, **arguments
        )


class VolumeTable(Table):
    """``[volume]``: planes and voxels."""

    num_slices: Count | None = None
    um_per_slice: Annotated[Positive, AfterValidator(STEP.check)] | None = None
    voxels_per_pixel: Count = 1


class FourierCameraFile(Table):
    """Content of a camera file of a Fourier microscope, as tables."""

    camera: FourierTable
    volume: VolumeTable = VolumeTable()


@dataclass(frozen=True)
class FourierFile:
    """Camera and volume of a Fourier microscope; ``voxels`` per pixel along an axis."""

    camera: FourierTable
    slices: int | None
    um_per_slice: float | None
    voxels: int


def is_fourier_file(path: PathLike) -> bool:
    """Return True if a TOML file has ``kind = "fourier_microscope"`` in ``[camera]``."""
    return kind_of(_content(Path(path))) == FOURIER


def read_fourier_file(path: PathLike) -> FourierFile:
    """Read the parameters of a Fourier microscope."""
    path = Path(path)
    content = _content(path)
    require_fourier(content, path)
    file = validated(FourierCameraFile, content, path)
    volume = file.volume
    return FourierFile(file.camera, volume.num_slices, volume.um_per_slice, volume.voxels_per_pixel)


def _content(path: Path) -> dict[str, Any]:
    return read_toml(path, f"camera file {path}; 'clplen microscope psf --example' prints one")


EXAMPLE = """\
# A Fourier light-field microscope: lenslets on the conjugate pupil of an objective.
# clplen microscope psf flfm.toml -o psf.h5
# Keys that begin with # show their defaults.

[camera]
kind = "fourier_microscope"
magnification = 20.0            # magnification of objective and tube lens
na = 0.5                        # numerical aperture
medium_index = 1.33             # refractive index around the specimen: air 1, water 1.33, oil 1.52
wavelength_nm = 525.0           # wavelength of the fluorescence in vacuum
# tube_lens_mm = 200.0          # focal length of the tube lens, for the printed lengths only
relay_mm = 100.0                # focal length of the lens that images the pupil onto the lenslets
# field_stop_mm = 3.333         # diameter on the native image; default: sub-images touch
# sensor_distance_mm = 30.0     # lenslets to sensor; default: focal length of the lenslets
pixel_um = 8.0                  # pixel size on the sensor
# sensor = [625, 625]           # rows and columns of pixels; default: all sub-images with light
# apodisation = 0.5             # exponent of cos(theta) over the pupil
# cover = { thickness_um = 150 }  # cover glass, if it differs from that of the objective's design

[camera.microlenses]            # lenslets on a lattice
pitch_um = 1000.0
focal_length_mm = 30.0
count = 5                       # number of rows and columns, or [rows, columns]
# lattice = "square"            # or "hexagonal"
# fill = "circular"             # or "full"

# [camera.lenslets]             # instead: lenslets at arbitrary positions
# positions_mm = [[0, 0], [0, 1.5], [1.3, -0.75], [-1.3, -0.75]]  # y and x from the axis
# focal_length_mm = 30.0        # or a list such as [30, 31, 31, 31], with sensor_distance_mm
# diameter_um = 1400

[volume]                        # options: --num-slices and --um-per-slice, or --planes-um
num_slices = 21
um_per_slice = 4.0              # z from -40 to 40 um, farther from the objective positive
# voxels_per_pixel = 1          # number of voxels per pixel along an axis; option --voxels
"""
