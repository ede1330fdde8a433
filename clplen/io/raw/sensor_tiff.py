"""Sensor frames as TIFF with the tags of TIFF/EP and DNG: filters, black and white level.

The picture is ordinary grey TIFF of 16 bits, readable by any program. The reader also accepts the
PhotometricInterpretation of raw converters (32803). CFARepeatPatternDim (33421) and CFAPattern
(33422) are defined in ISO 12234-2 (TIFF/EP), BlackLevelRepeatDim (50713), BlackLevel (50714),
WhiteLevel (50717) and AsShotNeutral (50728) in Adobe's Digital Negative specification 1.7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.checks import fits_float64
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats import tiff
from clplen.lightfield.raw.raw_image import Levels, RawImage, tiled
from clplen.outputs import MARK

Tile = tuple[tuple[str, ...], ...]
Frame = np.ndarray[Any, Any]

FILTERS = "RGBCMYW"  # red, green, blue, cyan, magenta, yellow, white; indices of CFAPattern
_REPEAT, _PATTERN = 33421, 33422
_BLACK_REPEAT, _BLACK, _WHITE, _NEUTRAL = 50713, 50714, 50717, 50728
_MAX_BITS = 16
_MAX_VALUES = 4096  # filters in a tile, numbers in a tag
_SHORT, _BYTE, _RATIONAL = 3, 1, 5
_DENOMINATOR = 10000  # of rational numbers


@dataclass(frozen=True)
class SensorTags:
    """Sensor properties in the tags of a TIFF."""

    mosaic: Tile | None  # colour filters, row by row from pixel (0, 0)
    black: Frame  # black levels of a tile, float64, shape (rows, columns)
    white: float | None  # digital number of a saturated pixel
    # Relative signals of white through red, green and blue.
    neutral: tuple[float, float, float] | None

    def black_frame(self, shape: tuple[int, int]) -> Frame | None:
        """Return the black level of every pixel, float32, or None if all are 0."""
        if not self.black.any():
            return None
        return np.asarray(tiled(self.black, shape), np.float32)

    @property
    def bayer(self) -> str | Tile | None:
        """Mosaic as for `decode_raw`: a string for Bayer patterns; None for other colours."""
        if self.mosaic is None or {name for row in self.mosaic for name in row} != set("RGB"):
            return None
        letters = "".join(name for row in self.mosaic for name in row)
        is_bayer_size = len(self.mosaic) == 2 == len(self.mosaic[0])
        return (
            letters
            if is_bayer_size and letters in ("RGGB", "GRBG", "GBRG", "BGGR")
            else self.mosaic
        )

    def balance(self) -> tuple[float, float, float] | None:
        """Return the factors of red, green and blue that make white grey; green has 1."""
        if self.neutral is None:
            return None
        red, green, blue = self.neutral
        return (green / red, 1.0, green / blue)

    def levels(self, dtype: Any) -> Levels | None:
        """Return the levels, or None if black levels differ or white is unknown."""
        if self.white is None or np.ptp(self.black) > 0:
            return None
        bits = max(1, math.ceil(math.log2(self.white + 1)))
        return Levels(
            float(self.black.flat[0]), self.white, min(bits, 8 * np.dtype(dtype).itemsize)
        )


def write_sensor_tiff(
    path: PathLike,
    raw: RawImage,
    *,
    white_balance: Sequence[float] | None = None,
    durable: bool = False,
) -> None:
    """Write a raw image of digital numbers as TIFF of 16 bits with mosaic tags."""
    if raw.levels is None or raw.levels.bit_depth > _MAX_BITS or len(raw.data.shape) != 2:
        raise ValueError(
            "TIFF needs the digital numbers of a sensor, up to 16 bits: expose with "
            "sensor=Sensor(exposure=..., full_well=..., bit_depth=...), or write .h5, which stores "
            "any values."
        )
    tags: list[tuple[int, int, int, Any, bool]] = []
    if raw.mosaic is not None:
        names = [name for row in raw.mosaic for name in row]
        unknown = [name for name in names if name not in FILTERS or len(name) != 1]
        if unknown:
            raise ValueError(
                f"The TIFF tag CFAPattern has no number for the filter {unknown[0]!r}, only for "
                f"{', '.join(FILTERS)}: write .h5, which stores any names."
            )
        pattern = bytes(FILTERS.index(name) for name in names)
        tags.append((_REPEAT, _SHORT, 2, (len(raw.mosaic), len(raw.mosaic[0])), True))
        tags.append((_PATTERN, _BYTE, len(pattern), pattern, True))
    tags.append((_BLACK_REPEAT, _SHORT, 2, (1, 1), True))
    tags.append(
        (_BLACK, _RATIONAL, 1, (round(raw.levels.black * _DENOMINATOR), _DENOMINATOR), True)
    )
    tags.append((_WHITE, _SHORT, 1, round(raw.levels.white), True))
    if white_balance is not None:
        tags.append((_NEUTRAL, _RATIONAL, 3, _neutral(white_balance), True))
    pitch = raw.pixel_pitch
    resolution = (0.01 / pitch, 0.01 / pitch) if fits_float64(pitch) else None
    with replacing(path, durable=durable) as temporary:
        tifffile.imwrite(
            temporary,
            raw.to_numpy().astype(np.uint16),
            photometric="minisblack",
            metadata=None,
            software=MARK,
            resolution=resolution,
            resolutionunit="CENTIMETER" if resolution else None,
            extratags=tags,
        )


def _neutral(factors: Any) -> tuple[int, ...]:
    values = np.asarray(factors, np.float64)
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(
            f"white_balance must be three factors above 0, of red, green and blue, got {factors!r}."
        )
    relative = values.min() / values
    return tuple(int(n) for value in relative for n in (max(1, round(value * 1e8)), 10**8))


def sensor_tags(path: Path) -> SensorTags | None:
    """Return the sensor tags of a TIFF, or None for files without them."""
    if path.suffix.lower() not in tiff.SUFFIXES:
        return None
    try:
        with tiff.open_tiff(path) as file:
            tags = file.pages.first.tags
            values = {
                code: _values(tags[code], path)
                for code in (_REPEAT, _PATTERN, _BLACK_REPEAT, _BLACK, _WHITE, _NEUTRAL)
                if code in tags
            }
    except FormatError:
        raise
    except Exception:  # reading the picture reports the reason
        return None
    if not {_PATTERN, _BLACK, _WHITE} & values.keys():
        return None
    white = values.get(_WHITE)
    neutral = values.get(_NEUTRAL)
    if neutral is not None and (len(neutral) != 3 or not min(neutral) > 0):
        neutral = None  # camera with other colours
    return SensorTags(
        _mosaic(values, path),
        _black(values, path),
        None if white is None else float(white[0]),
        None if neutral is None else (neutral[0], neutral[1], neutral[2]),
    )


def _values(tag: Any, path: Path) -> list[float]:
    """Return the numbers of a tag; divide rational numbers."""
    if tag.count > _MAX_VALUES:
        raise FormatError(
            f"{path}: the tag {tag.code} declares {tag.count:,} values: the file is damaged."
        )
    value = tag.value
    numbers = list(value) if isinstance(value, bytes | tuple | list) else [value]
    if tag.dtype in (5, 10):
        numbers = [
            n / d if d else math.nan for n, d in zip(numbers[::2], numbers[1::2], strict=True)
        ]
    if not numbers or not all(isinstance(n, int | float) and fits_float64(n) for n in numbers):
        raise FormatError(
            f"{path}: the tag {tag.code} must hold numbers, got {value!r}"[:200] + "."
        )
    return [float(n) for n in numbers]


def _shape(values: dict[int, list[float]], code: int, path: Path) -> tuple[int, int]:
    rows, columns = (
        values.get(code, [1.0, 1.0])[:2] if len(values.get(code, [0, 0])) == 2 else (0, 0)
    )
    if not (1 <= rows <= _MAX_VALUES and 1 <= columns <= _MAX_VALUES):
        raise FormatError(f"{path}: the tag {code} must be rows and columns, got {values[code]}.")
    return int(rows), int(columns)


def _mosaic(values: dict[int, list[float]], path: Path) -> Tile | None:
    if _PATTERN not in values:
        return None
    rows, columns = _shape({_REPEAT: [2.0, 2.0], **values}, _REPEAT, path)
    numbers = values[_PATTERN]
    if len(numbers) != rows * columns or not all(0 <= n < len(FILTERS) for n in numbers):
        raise FormatError(
            f"{path}: the tag CFAPattern must hold the colours of {rows} x {columns} filters, got "
            f"{numbers[:9]}."
        )
    names = [FILTERS[int(n)] for n in numbers]
    return tuple(tuple(names[y * columns : (y + 1) * columns]) for y in range(rows))


def _black(values: dict[int, list[float]], path: Path) -> Frame:
    rows, columns = _shape({_BLACK_REPEAT: [1.0, 1.0], **values}, _BLACK_REPEAT, path)
    numbers = values.get(_BLACK, [0.0])
    if len(numbers) != rows * columns:
        raise FormatError(
            f"{path}: the tag BlackLevel must hold {rows} x {columns} numbers, got {len(numbers)}."
        )
    return np.array(numbers).reshape(rows, columns)
