"""How the pixels of a raw image lie in bytes: Lytro's 10 and 12 bits, and whole bytes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError

Bytes = np.ndarray[Any, np.dtype[np.uint8]]
Frame = np.ndarray[Any, np.dtype[np.uint16]]

_LARGEST = 1 << 16  # pixels a side
# Bits and byte order: pixels and bytes of a group.
_GROUPS = {
    (8, "little"): (1, 1),
    (8, "big"): (1, 1),
    (10, "little"): (4, 5),
    (12, "big"): (2, 3),
    (16, "little"): (1, 2),
    (16, "big"): (1, 2),
}
_BAND = 1 << 18  # groups of pixels that are unpacked at a time
_BAYER = {"r": "RGGB", "gr": "GRBG", "gb": "GBRG", "b": "BGGR"}  # by the pixel at the upper left
_TILE = "r,gr:gb,b"


@dataclass(frozen=True)
class Packing:
    """The pixels of a raw image in bytes."""

    width: int
    height: int
    bits: int  # 8, 10, 12 or 16
    order: str  # "big" or "little"
    bayer: str | None = None  # colour filters, such as "BGGR"

    @property
    def stored(self) -> int:
        """Bytes that the image takes."""
        pixels, size = _GROUPS[self.bits, self.order]
        return -(-self.width * self.height // pixels) * size


F01 = Packing(3280, 3280, 12, "big", "BGGR")
ILLUM = Packing(7728, 5368, 10, "little", "GRBG")


def packing_of(metadata: dict[str, Any], path: Path, length: int) -> Packing:
    """The packing that metadata tell, or that of the Lytro camera whose images are as long."""
    image = _image(metadata)
    known = next((camera for camera in (F01, ILLUM) if camera.stored == length), None)
    if not image:
        if known is None:
            raise FormatError(
                f"{path}: nothing tells the size of the raw image, and its {length:,} bytes are "
                "those of no Lytro camera: put its JSON beside it, with image.width, image.height "
                "and image.pixelPacking (bitsPerPixel, endianness)."
            )
        return known
    details = {**_dict(image.get("rawDetails")), **image}
    packed = _dict(details.get("pixelPacking"))
    width, height = (_count(image, name, path) for name in ("width", "height"))
    bits, order = packed.get("bitsPerPixel"), packed.get("endianness")
    if not packed and known is not None:
        bits, order = known.bits, known.order
    if not isinstance(bits, int) or not isinstance(order, str) or (bits, order) not in _GROUPS:
        raise FormatError(
            f"{path}: the raw image has pixels of {bits!r:.40} bits in the byte order "
            f"{order!r:.40}; known are 8, 10 (little), 12 (big) and 16."
        )
    bayer = _bayer(_dict(details.get("mosaic")), path) or (known.bayer if known else None)
    return Packing(width, height, bits, order, bayer)


def _image(metadata: dict[str, Any]) -> dict[str, Any]:
    """What metadata say of the image: at their top, or where a table of contents holds them."""
    for holder in (metadata, _dict(metadata.get("master"))):
        found = _dict(holder.get("image"))
        frames = _dict(holder.get("picture")).get("frameArray") or holder.get("frames")
        if not found and isinstance(frames, list) and frames:
            frame = _dict(_dict(frames[0]).get("frame"))
            found = _dict(_dict(frame.get("metadata")).get("image"))
        if found:
            return found
    return {}


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _count(image: dict[str, Any], name: str, path: Path) -> int:
    value = image.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= _LARGEST:
        raise FormatError(
            f"{path}: image.{name} of the metadata is {value!r:.40}, not a count of pixels from 1 "
            f"to {_LARGEST}."
        )
    return value


def _bayer(mosaic: dict[str, Any], path: Path) -> str | None:
    if not mosaic:
        return None
    tile, corner = mosaic.get("tile", _TILE), mosaic.get("upperLeftPixel")
    if tile != _TILE or not isinstance(corner, str) or corner not in _BAYER:
        raise FormatError(
            f"{path}: the colour filters are {tile!r:.40} with {corner!r:.40} at the upper left; "
            f"known is {_TILE!r} with r, gr, gb or b."
        )
    return _BAYER[corner]


def unpack(data: Bytes, packing: Packing) -> Frame:
    """The pixels of a raw image.

    Two pixels of 12 bits lie in three bytes, most significant bits first (Lytro F01). Four of 10
    bits lie in five: the upper eight bits of each, and a fifth byte with the lower two, those of
    the first pixel lowest (Lytro Illum).
    """
    pixels, size = _GROUPS[packing.bits, packing.order]
    groups = data.reshape(-1, size)
    out = np.empty((len(groups), pixels), np.uint16)
    for start in range(0, len(groups), _BAND):
        _unpack_band(groups[start : start + _BAND], packing, out[start : start + _BAND])
    return out.reshape(-1)[: packing.width * packing.height].reshape(packing.height, packing.width)


def _unpack_band(groups: Bytes, packing: Packing, out: Frame) -> None:
    """Unpack groups (n, bytes) of pixels into (n, pixels)."""
    if packing.bits == 12:
        out[:, 0] = groups[:, 1] >> 4
        out[:, 0] |= groups[:, 0].astype(np.uint16) << 4
        out[:, 1] = groups[:, 2]
        out[:, 1] |= (groups[:, 1] & 15).astype(np.uint16) << 8
    elif packing.bits == 10:
        for i in range(4):
            out[:, i] = groups[:, i]
            out[:, i] <<= 2
            out[:, i] |= (groups[:, 4] >> 2 * i) & 3
    elif packing.bits == 16:
        low, high = (0, 1) if packing.order == "little" else (1, 0)
        out[:, 0] = groups[:, high]
        out[:, 0] <<= 8
        out[:, 0] |= groups[:, low]
    else:
        out[:, 0] = groups[:, 0]
