"""What a Lytro camera writes beside its raw image: levels, colour, lens, lenslets, serial number.

The names are those of the JSON of both generations (LFToolbox, Dansereau 2013-2020: LFReadLFP.m,
LFLytroDecodeImage.m, LFGatherCamInfo.m). A value that is absent or no number is None: each can be
done without.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.raw.raw_image import tiled

_CORNERS = ("r", "gr", "gb", "b")
_LARGEST_GAIN = 100.0


@dataclass(frozen=True)
class LytroMetadata:
    """The metadata of a Lytro frame."""

    model: str | None = None  # F01 or ILLUM (B01)
    serial: str | None = None  # of the camera
    # Positions of the lens' two motors, by which a white image is chosen.
    zoom_step: float | None = None
    focus_step: float | None = None
    exposure: float | None = None  # exposure time in seconds
    black: dict[str, float] | None = None  # levels of the colours r, gr, gb, b in digital numbers
    white: dict[str, float] | None = None  # levels of the colours r, gr, gb, b in digital numbers
    # Factors of red, green and blue, green 1.
    white_balance: tuple[float, float, float] | None = None
    # float64, shape (3, 3): linear sRGB = matrix @ camera RGB, white balanced.
    colour_matrix: np.ndarray[Any, np.dtype[np.float64]] | None = None
    lens_pitch: float | None = None  # in metres
    pixel_pitch: float | None = None  # in metres
    rotation: float | None = None  # of the array of lenslets, radians
    lattice: str | None = None  # "hexagonal", where the metadata tell so
    # Names (sha1) of the calibration that the camera itself refers to.
    references: frozenset[str] = frozenset()

    @property
    def pitch(self) -> float | None:
        """Distance of neighbouring lenslets in pixels."""
        if self.lens_pitch is None or self.pixel_pitch is None:
            return None
        pitch = self.lens_pitch / self.pixel_pitch
        return pitch if 3 <= pitch <= 200 else None

    def black_frame(
        self, shape: tuple[int, int], bayer: str | None
    ) -> np.ndarray[Any, np.dtype[np.float32]] | None:
        """The black level of every pixel, float32; None where the metadata tell none."""
        if self.black is None:
            return None
        tile = np.array(_levels_of(self.black, bayer), np.float32).reshape(2, 2)
        return np.ascontiguousarray(tiled(tile, shape))

    @property
    def range(self) -> float | None:
        """White level less black level, of green; None where the metadata tell none."""
        if self.black is None or self.white is None:
            return None
        span = self.white["gr"] - self.black["gr"]
        return span if span > 0 else None


def lytro_metadata(*parts: dict[str, Any]) -> LytroMetadata:
    """The metadata of a frame, from the objects that hold them."""
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
    """The objects that may hold metadata: the part itself, and the frame of a calibration file."""
    yield part
    for keys in (("master", "picture", "frameArray"), ("picture", "frameArray"), ("frames",)):
        found: Any = part
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        if isinstance(found, list) and found and isinstance(found[0], dict):
            frame = found[0].get("frame")
            for name in ("metadata", "privateMetadata"):
                if isinstance(frame, dict) and isinstance(frame.get(name), dict):
                    yield frame[name]


def _at(holder: dict[str, Any], path: str) -> Any:
    found: Any = holder
    for key in path.split("."):
        found = found.get(key) if isinstance(found, dict) else None
    return found


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and 0 < len(value) <= 64 else None


def _number(value: Any) -> float | None:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if plain and abs(value) < 1e9 else None  # NaN and infinity are not


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _levels(value: Any) -> dict[str, float] | None:
    found = {name: _number(_at(value, name)) for name in _CORNERS} if value is not None else {}
    levels = {name: level for name, level in found.items() if level is not None and level >= 0}
    return levels if len(levels) == len(_CORNERS) else None


def _balance(value: Any) -> tuple[float, float, float] | None:
    """Red and blue over green: the mean of the two greens has 1."""
    gains = _levels(value)
    if gains is None:
        return None
    green = (gains["gr"] + gains["gb"]) / 2
    if not all(0 < gain <= _LARGEST_GAIN for gain in (green, gains["r"], gains["b"])):
        return None
    return gains["r"] / green, 1.0, gains["b"] / green


def _matrix(value: Any) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Row by row; its rows add to 1, so that white stays white."""
    numbers = [_number(n) for n in value] if isinstance(value, list) else []
    if len(numbers) != 9 or any(n is None or abs(n) > _LARGEST_GAIN for n in numbers):
        return None
    matrix = np.array(numbers, np.float64).reshape(3, 3)
    sums = matrix.sum(axis=1)
    if not (sums > 0.1).all() or abs(np.linalg.det(matrix)) < 1e-3:
        return None
    return np.asarray(matrix / sums[:, None])


def _levels_of(levels: dict[str, float], bayer: str | None) -> list[float]:
    """Levels of the four pixels of a tile; two greens are told by the red beside one of them."""
    if bayer is None:
        return [math.fsum(levels.values()) / len(levels)] * 4
    beside_red = {"RGGB": 1, "GRBG": 0, "GBRG": 3, "BGGR": 2}[bayer]
    names = [("gr" if n == beside_red else "gb") if c == "G" else c.lower()
             for n, c in enumerate(bayer)]  # fmt: skip
    return [levels[name] for name in names]


def _references(part: dict[str, Any]) -> Iterator[str]:
    """Names of the calibration: of a first-generation file its derivations, of an Illum one its
    geometry correction."""
    for path in ("picture.derivationArray", "master.picture.derivationArray"):
        found = _at(part, path)
        yield from (name for name in found or [] if isinstance(name, str))
    frames = part.get("frames")
    if isinstance(frames, list) and frames and isinstance(frames[0], dict):
        name = _at(frames[0], "frame.geometryCorrectionRef")
        if isinstance(name, str):
            yield name
