"""Lytro files built byte by byte, and calibrations with white images."""

from __future__ import annotations

import hashlib
import json
import tarfile
from pathlib import Path

import numpy as np

START = b"\x89LFP\x0d\x0a\x1a\x0a\x00\x00\x00\x01" + bytes(4)
Section = tuple[bytes, bytes, bytes]  # type, name, data


def content(data: bytes) -> Section:
    return b"C", b"sha1-" + hashlib.sha1(data).hexdigest().encode(), data


def contents_of(sections: list[Section]) -> bytes:
    """A container as the format says, each section padded to 16 bytes."""
    out = START
    for letter, name, data in sections:
        head = b"\x89LF" + letter + b"\x0d\x0a\x1a\x0a" + bytes(4) + len(data).to_bytes(4, "big")
        out += head + name + bytes(35) + data
        out += bytes(-len(out) % 16)
    return out


def packed12(frame: np.ndarray) -> bytes:
    """All bits in a row, the most significant first."""
    return np.packbits(frame.ravel()[:, None] >> np.arange(11, -1, -1) & 1).tobytes()


def packed10(frame: np.ndarray) -> bytes:
    """Four upper bytes, then the lower two bits of the four, the first pixel's lowest."""
    four = frame.reshape(-1, 4)
    low = ((four & 3) << np.arange(0, 8, 2)).sum(1)
    return np.column_stack([four >> 2, low]).astype(np.uint8).tobytes()


def f01(frame: np.ndarray) -> tuple[bytes, dict]:
    height, width = frame.shape
    details = {
        "pixelPacking": {"endianness": "big", "bitsPerPixel": 12},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "b"},
    }
    image = {"width": width, "height": height, "rawDetails": details}
    return packed12(frame), {"camera": {"model": "F01"}, "image": image}


def illum(frame: np.ndarray) -> tuple[bytes, dict]:
    height, width = frame.shape
    image = {
        "width": width,
        "height": height,
        "pixelPacking": {"endianness": "little", "bitsPerPixel": 10},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "gr"},
    }
    return packed10(frame), {"camera": {"model": "ILLUM"}, "image": image}


def a_container(
    path: Path, raw: bytes, metadata: dict, *, newer: bool, private: dict | None = None
) -> Path:
    """The frame of a camera; ``private`` holds its serial number."""
    parts = (raw, json.dumps(metadata).encode(), json.dumps(private or {}).encode())
    sections = [content(part) for part in parts]
    keys = ("imageRef", "metadataRef", "privateMetadataRef")
    frame = {key: name.decode() for key, (_, name, _) in zip(keys, sections, strict=True)}
    frames = [{"frame": frame}]
    table = {"frames": frames} if newer else {"picture": {"frameArray": frames}}
    head = (b"M", *content(json.dumps(table).encode())[1:])
    order = [*sections, head] if newer else [head, *sections]
    path.write_bytes(contents_of(order))
    return path


def described(
    metadata: dict,
    *,
    serial: str = "",
    zoom: int = 0,
    focus: int = 0,
    black: int = 0,
    white: int = 1023,
    exposure: float = 0.01,
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0),
    matrix: list[float] | None = None,
) -> dict:
    """Metadata with what a camera writes of lens, levels and colours."""
    levels = {
        "black": dict.fromkeys(("r", "gr", "gb", "b"), black),
        "white": dict.fromkeys(("r", "gr", "gb", "b"), white),
    }
    red, green, blue = gains
    balance = {"r": red, "gr": green, "gb": green, "b": blue}
    color = {"whiteBalanceGain": balance, "ccm": matrix or [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    image = metadata["image"] | {"pixelFormat": levels, "color": color}
    devices = {
        "lens": {"zoomStep": zoom, "focusStep": focus},
        "shutter": {"frameExposureDuration": exposure},
        "mla": {"lensPitch": 14e-6, "tiling": "hexUniformRowMajor", "rotation": 0.002},
        "sensor": {"pixelPitch": 1.4e-6},
    }
    camera = metadata["camera"] | ({"serialNumber": serial} if serial else {})
    return {"camera": camera, "image": image, "devices": devices}


def modulation(metadata: dict) -> bytes:
    """The text beside a white image, with what cameras put behind it."""
    frame = {"metadata": metadata, "privateMetadata": {"camera": metadata["camera"]}}
    table = {"master": {"picture": {"frameArray": [{"frame": frame}]}}}
    return json.dumps(table).encode() + b"\0\n"


def write_folder(place: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(data)
    return place


def write_archive(path: Path, files: dict[str, bytes]) -> Path:
    """As of an Illum: ``unitdata/`` in a tar archive."""
    folder = write_folder(path.with_suffix(""), files)
    with tarfile.open(path, "w") as archive:
        for name in files:
            archive.add(folder / name, arcname=f"unitdata/{name}")
    for name in files:
        (folder / name).unlink()
    return path


def write_volumes(place: Path, files: dict[str, bytes]) -> Path:
    """As of a first-generation camera: data.C.0, data.C.1, ..."""
    place.mkdir(parents=True, exist_ok=True)
    items = list(files.items())
    for number in range(3):
        part = items[number::3]
        sections = [content(data) for _, data in part]
        listed = [
            {"name": f"C:\\T1CALIB\\{name}", "dataRef": section[1].decode()}
            for (name, _), section in zip(part, sections, strict=True)
        ]
        head = (b"M", *content(json.dumps({"files": listed}).encode())[1:])
        (place / f"data.C.{number}").write_bytes(contents_of([head, *sections]))
    return place
