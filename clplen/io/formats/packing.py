"""Packing of raw pixels in bytes: Lytro's 10 and 12 bits, and whole bytes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError

Bytes = np.ndarray[Any, np.dtype[np.uint8]]
Frame = np.ndarray[Any, np.dtype[np.uint16]]

_MAX_SIDE = 1 << 16  # pixels
# Pixels and bytes of a group, by bits and byte order.
_GROUPS = {
    (8, "little"): (1, 1),
    (8, "big"): (1, 1),
    (10, "little"): (4, 5),
    (12, "big"): (2, 3),
    (16, "little"): (1, 2),
    (16, "big"): (1, 2),
}
_BAND = 1 << 18  # groups of pixels unpacked at a time
_BAYER = {"r": "RGGB", "gr": "GRBG", "gb": "GBRG", "b": "BGGR"}  # by the upper left pixel
_TILE = "r,gr:gb,b"


@dataclass(frozen=True)
class Packing:
    """Packing of the pixels of a raw image."""

    width: int
    height: int
    bits: int  # 8, 10, 12 or 16
    order: str  # "big" or "little"
    bayer: str | None = None  # colour filters, such as "BGGR"

    @property
    def stored(self) -> int:
        """Size of the stored image in bytes."""
        pixels, size = _GROUPS[self.bits, self.order]
        return -(-self.width * self.height // pixels) * size


F01 = Packing(3280, 3280, 12, "big", "BGGR")
ILLUM = Packing(7728, 5368, 10, "little", "GRBG")


def packing_of(metadata: dict[str, Any], path: Path, length: int) -> Packing:
    """Return the packing stated in metadata, or that of the Lytro camera with this file size."""
    image = _image(metadata)
    camera_packing = next((item for item in (F01, ILLUM) if item.stored == length), None)
    if not image:
        if camera_packing is None:
            raise FormatError(
                f"{path}: the size of the raw image is unknown, and no Lytro camera has images of "
                f"{length:,} bytes: add a JSON file of equal name with image.width, image.height "
                "and image.pixelPacking (bitsPerPixel, endianness)."
            )
        return camera_packing
    details = {**_dict(image.get("rawDetails")), **image}
    packed = _dict(details.get("pixelPacking"))
    width, height = (_count(image, name, path) for name in ("width", "height"))
    bits, order = packed.get("bitsPerPixel"), packed.get("endianness")
    if not packed and camera_packing is not None:
        bits, order = camera_packing.bits, camera_packing.order
    if not isinstance(bits, int) or not isinstance(order, str) or (bits, order) not in _GROUPS:
        raise FormatError(
            f"{path}: pixels must have 8, 10 (little), 12 (big) or 16 bits, got {bits!r:.40} bits "
            f"in the byte order {order!r:.40}."
        )
    bayer = _bayer(_dict(details.get("mosaic")), path) or (
        camera_packing.bayer if camera_packing else None
    )
    return Packing(width, height, bits, order, bayer)


def _image(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return the description of the image in metadata or in a table of contents."""
    for holder in (metadata, _dict(metadata.get("master"))):
        image = _dict(holder.get("image"))
        frames = _dict(holder.get("picture")).get("frameArray") or holder.get("frames")
        if not image and isinstance(frames, list) and frames:
            frame = _dict(_dict(frames[0]).get("frame"))
            image = _dict(_dict(frame.get("metadata")).get("image"))
        if image:
            return image
    return {}


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _count(image: dict[str, Any], name: str, path: Path) -> int:
    value = image.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= _MAX_SIDE:
        raise FormatError(
            f"{path}: image.{name} of the metadata must be 1 to {_MAX_SIDE} pixels, got "
            f"{value!r:.40}."
        )
    return value


def _bayer(mosaic: dict[str, Any], path: Path) -> str | None:
    if not mosaic:
        return None
    tile, corner = mosaic.get("tile", _TILE), mosaic.get("upperLeftPixel")
    if tile != _TILE or not isinstance(corner, str) or corner not in _BAYER:
        raise FormatError(
            f"{path}: the colour filters must be {_TILE!r} with r, gr, gb or b at the upper left, "
            f"got {tile!r:.40} with {corner!r:.40}."
        )
    return _BAYER[corner]


def unpack(data: Bytes, packing: Packing) -> Frame:
    """Unpack the pixels of a raw image.

    Lytro F01: two pixels of 12 bits in three bytes, most significant bits first. Lytro Illum: four
    pixels of 10 bits in five bytes, the upper eight bits of each pixel and a fifth byte with the
    lower two bits, the first pixel lowest.
    """
    pixels, size = _GROUPS[packing.bits, packing.order]
    groups = data.reshape(-1, size)
    out = np.empty((len(groups), pixels), np.uint16)
    for start in range(0, len(groups), _BAND):
        _unpack_band(groups[start : start + _BAND], packing, out[start : start + _BAND])
    return out.reshape(-1)[: packing.width * packing.height].reshape(packing.height, packing.width)


def _unpack_band(groups: Bytes, packing: Packing, out: Frame) -> None:
    """Unpack groups (n, bytes) into pixels (n, pixels)."""
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
