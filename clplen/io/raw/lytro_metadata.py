"""Metadata of a Lytro raw image: levels, colour, lens, lenslets, serial number.

Names follow the JSON of both generations (LFToolbox, Dansereau 2013-2020: LFReadLFP.m,
LFLytroDecodeImage.m, LFGatherCamInfo.m). All values are optional: a missing or invalid value is
None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.raw.raw_image import tiled

_CORNERS = ("r", "gr", "gb", "b")
_MAX_GAIN = 100.0  # plausible white balance and colour matrix


@dataclass(frozen=True)
class LytroMetadata:
    """Metadata of a Lytro frame."""

    model: str | None = None  # F01 or ILLUM (B01)
    serial: str | None = None  # serial number of the camera
    # Positions of the zoom and focus motors; they select the white image.
    zoom_step: float | None = None
    focus_step: float | None = None
    exposure: float | None = None  # exposure time in seconds
    black: dict[str, float] | None = None  # levels of r, gr, gb, b in digital numbers
    white: dict[str, float] | None = None  # levels of r, gr, gb, b in digital numbers
    # Factors of red, green and blue relative to green.
    white_balance: tuple[float, float, float] | None = None
    # float64, shape (3, 3): linear sRGB = matrix @ camera RGB, white balanced.
    colour_matrix: np.ndarray[Any, np.dtype[np.float64]] | None = None
    lens_pitch: float | None = None  # in metres
    pixel_pitch: float | None = None  # in metres
    rotation: float | None = None  # of the lenslet array in radians
    lattice: str | None = None  # "hexagonal", or None if not stated
    # Names (sha1) of the calibration files that the camera refers to.
    references: frozenset[str] = frozenset()

    @property
    def pitch(self) -> float | None:
        """Distance of neighbouring lenslets in pixels, or None."""
        if self.lens_pitch is None or self.pixel_pitch is None:
            return None
        pitch = self.lens_pitch / self.pixel_pitch
        return pitch if 3 <= pitch <= 200 else None

    def black_frame(
        self, shape: tuple[int, int], bayer: str | None
    ) -> np.ndarray[Any, np.dtype[np.float32]] | None:
        """Return the black level of every pixel, float32, or None if not stated."""
        if self.black is None:
            return None
        tile = np.array(_levels_of(self.black, bayer), np.float32).reshape(2, 2)
        return np.ascontiguousarray(tiled(tile, shape))

    @property
    def range(self) -> float | None:
        """White level minus black level of green, or None if not stated."""
        if self.black is None or self.white is None:
            return None
        span = self.white["gr"] - self.black["gr"]
        return span if span > 0 else None


def lytro_metadata(*parts: dict[str, Any]) -> LytroMetadata:
    """Return the metadata of a frame from the JSON objects that hold them."""
    holders = [holder for part in parts for holder in _holders(part)]

    def first(*paths: str) -> Any:
        for path in paths:
            for holder in holders:
                value = _at(holder, path)
                if value is not None:
                    return value
        return None

    formats = ("image.pixelFormat", "image.rawDetails.pixelFormat")
    lens = "devices.lens."
    return LytroMetadata(
        model=_text(first("camera.model")),
        serial=_text(first("camera.serialNumber")),
        zoom_step=_number(first(lens + "zoomStep")),
        focus_step=_number(first(lens + "focusStep")),
        exposure=_number(
            first("devices.shutter.frameExposureDuration", "devices.shutter.pixelExposureDuration")
        ),
        black=_levels(first(*(f"{name}.black" for name in formats))),
        white=_levels(first(*(f"{name}.white" for name in formats))),
        white_balance=_balance(
            first("algorithms.awb.computed.gain", "image.color.whiteBalanceGain")
        ),
        colour_matrix=_matrix(first("image.color.ccm", "image.color.ccmRgbToSrgbArray")),
        lens_pitch=_positive(first("devices.mla.lensPitch")),
        pixel_pitch=_positive(first("devices.sensor.pixelPitch")),
        rotation=_number(first("devices.mla.rotation")),
        lattice="hexagonal" if str(first("devices.mla.tiling")).startswith("hex") else None,
        references=frozenset(name for part in parts for name in _references(part)),
    )


def _holders(part: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the objects that may hold metadata: the object itself and its first frame."""
    yield part
    for keys in (("master", "picture", "frameArray"), ("picture", "frameArray"), ("frames",)):
        entry: Any = part
        for key in keys:
            entry = entry.get(key) if isinstance(entry, dict) else None
        if isinstance(entry, list) and entry and isinstance(entry[0], dict):
            frame = entry[0].get("frame")
            for name in ("metadata", "privateMetadata"):
                if isinstance(frame, dict) and isinstance(frame.get(name), dict):
                    yield frame[name]


def _at(holder: dict[str, Any], path: str) -> Any:
    value: Any = holder
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and 0 < len(value) <= 64 else None


def _number(value: Any) -> float | None:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if plain and abs(value) < 1e9 else None  # rejects NaN and infinity


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _levels(value: Any) -> dict[str, float] | None:
    numbers = {name: _number(_at(value, name)) for name in _CORNERS} if value is not None else {}
    levels = {name: level for name, level in numbers.items() if level is not None and level >= 0}
    return levels if len(levels) == len(_CORNERS) else None


def _balance(value: Any) -> tuple[float, float, float] | None:
    """Return the gains of red and blue relative to the mean of the two greens."""
    gains = _levels(value)
    if gains is None:
        return None
    green = (gains["gr"] + gains["gb"]) / 2
    if not all(0 < gain <= _MAX_GAIN for gain in (green, gains["r"], gains["b"])):
        return None
    return gains["r"] / green, 1.0, gains["b"] / green


def _matrix(value: Any) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Return the colour matrix from its rows, scaled to row sums of 1 so that white is kept."""
    numbers = [_number(n) for n in value] if isinstance(value, list) else []
    if len(numbers) != 9 or any(n is None or abs(n) > _MAX_GAIN for n in numbers):
        return None
    matrix = np.array(numbers, np.float64).reshape(3, 3)
    sums = matrix.sum(axis=1)
    if not (sums > 0.1).all() or abs(np.linalg.det(matrix)) < 1e-3:
        return None
    return np.asarray(matrix / sums[:, None])


def _levels_of(levels: dict[str, float], bayer: str | None) -> list[float]:
    """Return the levels of a Bayer tile; the green next to red has the level ``gr``."""
    if bayer is None:
        return [math.fsum(levels.values()) / len(levels)] * 4
    beside_red = {"RGGB": 1, "GRBG": 0, "GBRG": 3, "BGGR": 2}[bayer]
    names = [("gr" if n == beside_red else "gb") if c == "G" else c.lower()
             for n, c in enumerate(bayer)]  # fmt: skip
    return [levels[name] for name in names]


def _references(part: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the calibration files that a frame refers to.

    First-generation files list derivations; Illum files name a geometry correction.
    """
    for path in ("picture.derivationArray", "master.picture.derivationArray"):
        derivations = _at(part, path)
        yield from (name for name in derivations or [] if isinstance(name, str))
    frames = part.get("frames")
    if isinstance(frames, list) and frames and isinstance(frames[0], dict):
        name = _at(frames[0], "frame.geometryCorrectionRef")
        if isinstance(name, str):
            yield name
