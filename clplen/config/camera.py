"""The tables ``[camera]``, ``[camera.microlenses]`` and ``[sensor]`` of a camera file."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.plenoptic1 import Plenoptic1
from clplen.compute.device import Device
from clplen.config.tables import (
    Count,
    Finite,
    NotNegative,
    Positive,
    Seed,
    Switch,
    Table,
    divided,
    of,
    twice,
)
from clplen.lightfield.sensor import Sensor
from clplen.wave.lenslets import MicrolensArray


class MicrolensTable(Table):
    """``[camera.microlenses]``."""

    pitch_um: Positive
    focal_length_mm: Positive
    count: Annotated[
        tuple[Count, Count], of(2, "one number or [rows, columns]"), BeforeValidator(twice)
    ]
    lattice: Literal["square", "hexagonal"] = "square"
    fill: Literal["circular", "full"] = "circular"
    diameter_um: Positive | None = None
    offset_um: Annotated[tuple[Finite, Finite], of(2, "two numbers, [y, x]")] = (0.0, 0.0)
    rotation_deg: Finite = 0.0

    def build(self) -> MicrolensArray:
        """The array, in SI units."""
        return MicrolensArray(
            self.pitch_um / 1e6,
            self.focal_length_mm / 1e3,
            count=self.count,
            lattice=self.lattice,
            fill=self.fill,
            diameter=divided(self.diameter_um, 1e6),
            offset=(self.offset_um[0] / 1e6, self.offset_um[1] / 1e6),
            rotation=math.radians(self.rotation_deg),
        )


class CameraTable(Table):
    """``[camera]``."""

    focal_length_mm: Positive
    wavelength_nm: Positive
    pixels_per_lenslet: Positive
    microlenses: MicrolensTable
    object_distance_mm: Positive | None = None
    image_distance_mm: Positive | None = None
    aperture_diameter_mm: Positive | None = None
    field_lens: Switch = False

    def build(self, device: Device) -> Plenoptic1:
        """The camera, in SI units, on a device."""
        return PlenopticCamera.type1(
            focal_length=self.focal_length_mm / 1e3,
            mla=self.microlenses.build(),
            wavelength=self.wavelength_nm / 1e9,
            pixels_per_lenslet=self.pixels_per_lenslet,
            device=device,
            object_distance=divided(self.object_distance_mm, 1e3),
            image_distance=divided(self.image_distance_mm, 1e3),
            aperture_diameter=divided(self.aperture_diameter_mm, 1e3),
            field_lens=self.field_lens,
        )


class SensorTable(Table):
    """``[sensor]``."""

    exposure_electrons: Positive | None = None
    shot_noise: Switch = False
    read_noise_electrons: NotNegative = 0.0
    bit_depth: Annotated[int, Field(ge=1, le=24, strict=True)] | None = None
    full_well_electrons: Positive | None = None
    seed: Seed = 0

    def build(self) -> Sensor:
        """The sensor."""
        return Sensor(
            exposure=self.exposure_electrons,
            shot_noise=self.shot_noise,
            read_noise=self.read_noise_electrons,
            bit_depth=self.bit_depth,
            full_well=self.full_well_electrons,
            seed=self.seed,
        )
