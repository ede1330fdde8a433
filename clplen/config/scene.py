"""The tables ``[scene]`` and ``[[scene.pictures]]`` of a camera file."""

from __future__ import annotations

import logging
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources
from clplen.config.tables import (
    File,
    Finite,
    NotNegative,
    Positive,
    Switch,
    Table,
    listed,
    of,
    rename_key,
    value_of,
)
from clplen.io import read_picture
from clplen.units import metres

GREY = (0.2126, 0.7152, 0.0722)  # R, G, B: luminance (Rec. ITU-R BT.709)
OF_POINTS = ("diameter_um", "power")

Values = np.ndarray[Any, Any]
logger = logging.getLogger(__name__)


class PictureTable(Table):
    """``[[scene.pictures]]``."""

    file: File
    width_mm: Positive
    z_mm: Finite = 0.0
    mode: Literal["emission", "transmission"] = "emission"
    srgb: Switch = False

    @model_validator(mode="before")
    @classmethod
    def _take_old_key(cls, content: Any) -> Any:
        return rename_key(content, "dz_mm", "z_mm")

    def build(self) -> PicturePlane:
        """The picture in grey and linear light, in SI units."""
        stored = read_picture(self.file)
        try:
            plane = PicturePlane(
                _grey(_linear(stored, self.srgb)),
                self.width_mm / 1e3,
                self.z_mm / 1e3,
                mode=self.mode,
            )
        except ValueError as error:
            raise ValueError(f"{self.file}: {error}") from error
        weights = " + ".join(f"{w:g} {c}" for w, c in zip(GREY, "RGB", strict=True))
        logger.info(
            "read %s: %d x %d samples (y x x) of %s, %s, mode %s",
            self.file,
            *plane.image.shape,
            metres(plane.pitch),
            "grey" if stored.ndim == 2 else f"colours as {weights}",
            self.mode,
        )
        return plane


Point = Annotated[tuple[Finite, Finite, Finite], of(3, "three numbers, [x, y, z]")]


class SceneTable(Table):
    """``[scene]``."""

    points_mm: Annotated[list[Point], Field(min_length=1)] | None = None
    diameter_um: NotNegative = 0.0
    power: Annotated[list[Finite], BeforeValidator(listed)] = Field(default=[1.0])
    pictures: list[PictureTable] = Field(default=[])

    @model_validator(mode="after")
    def _not_empty(self) -> SceneTable:
        if self.points_mm is not None:
            return self
        stray = [key for key in OF_POINTS if key in self.model_fields_set]
        if stray:
            raise ValueError(f"has {stray[0]}, which belongs to points_mm, and there are none")
        if not self.pictures:
            raise ValueError("is empty: give points_mm, or tables [[scene.pictures]], or both")
        return self

    def slides(self) -> list[int]:
        """Which pictures are slides, counted from 0."""
        return [i for i, one in enumerate(self.pictures) if one.mode == "transmission"]

    def build(self) -> list[PointSources | PicturePlane]:
        """The point sources, if any, and the pictures, in SI units.

        Raises
        ------
        FormatError
            If a picture cannot be read or its values are out of range; naming its key.
        """
        parts: list[PointSources | PicturePlane] = []
        if self.points_mm is not None:
            positions = [tuple(value / 1e3 for value in point) for point in self.points_mm]
            power = self.power if len(self.power) > 1 else self.power[0]
            parts.append(PointSources(positions, diameter=self.diameter_um / 1e6, power=power))
        for i, picture in enumerate(self.pictures):
            with value_of(f"scene.pictures.{i}.file"):
                parts.append(picture.build())
        return parts


def _linear(values: Values, srgb: bool) -> Values:
    """Stored values as linear light, float64.

    Whole numbers are divided by the largest of their type, or by 1 if there are only 0 and 1, a
    picture of one bit; floats stay. sRGB is decoded by IEC 61966-2-1 (1999), eqs 5 and 6.
    """
    if srgb and values.dtype != np.uint8:
        raise ValueError(f"srgb = true decodes 8-bit values, not {values.dtype}: leave it out.")
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    full = 1 if values.max() <= 1 else np.iinfo(values.dtype).max
    share = values / full
    if not srgb:
        return share
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _grey(values: Values) -> Values:
    """Luminance of linear colours, rounded to no more than the brightest of the three."""
    if values.ndim == 2:
        return values
    return np.minimum(values @ np.array(GREY), values.max(axis=2))
