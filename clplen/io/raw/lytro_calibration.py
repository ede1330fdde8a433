"""White images of Lytro cameras: listed from the maker's calibrations, chosen for a picture.

A calibration is a folder or a tar archive with pairs ``MOD_0000.RAW`` and ``MOD_0000.TXT``, or a
folder with the volumes ``data.C.0``, ``data.C.1``, ... of a first-generation camera. The volumes
are containers whose tables of contents list such files (LFToolbox, Dansereau 2013-2020:
LFUtilUnpackLytroArchive.m, LFUtilProcessWhiteImages.m, LFSelectFromDatabase.m).
"""

from __future__ import annotations

import json
import os
import re
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from clplen.compute.drivers.environment import cache_dir
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.packing import Packing, packing_of, unpack
from clplen.io.formats.untrusted import Bound
from clplen.io.raw.lytro_container import listed_files, parse_json
from clplen.io.raw.lytro_metadata import LytroMetadata, lytro_metadata

VARIABLE = "CLPLEN_LYTRO"
_VOLUME = re.compile(r"data\.c\.\d+", re.IGNORECASE)
_MANIFEST = "cal_file_manifest.json"
_MAX_FILES = 20_000  # in a calibration
_MAX_JSON_BYTES = 1 << 21  # of metadata
_MAX_ZOOM_DISTANCE = 40.0  # motor steps; a white image farther away causes a warning
_CACHE_FILE = "lytro-calibrations.json"
_HINT = (
    "Give the folder or tar archive of this camera (caldata-SERIAL.tar, or the folder with "
    "data.C.0) by --calibration, or a white image by --white."
)

Source = Callable[[], bytes]


@dataclass(frozen=True)
class WhiteImage:
    """White image of a calibration."""

    name: str  # location, for messages
    metadata: LytroMetadata
    packing: Packing
    size: int  # of the stored image in bytes
    read_bytes: Source  # return the stored image

    def read(self, *, max_bytes: int | None = None) -> np.ndarray[Any, np.dtype[np.uint16]]:
        """Return the white image, uint16 of shape (ny, nx), without black-level subtraction."""
        Bound(Path(self.name), self.size, 2, max_bytes).require(
            2 * self.packing.width * self.packing.height, "the white image"
        )
        data = self.read_bytes()
        if len(data) != self.packing.stored:
            raise FormatError(
                f"{self.name}: a white image of {self.packing.width} x {self.packing.height} "
                f"pixels must have {self.packing.stored:,} bytes, got {len(data):,}: the file is "
                "truncated; copy the calibration from the camera again."
            )
        return unpack(np.frombuffer(data, np.uint8), self.packing)


@dataclass(frozen=True)
class _Member:
    """File of a calibration: name, length and content."""

    name: str
    size: int
    read_bytes: Source

    @property
    def stem(self) -> str:
        return str(PurePosixPath(self.name).with_suffix("")).lower()


def read_white_images(path: PathLike) -> list[WhiteImage]:
    """List the white images of a calibration."""
    path = Path(path)
    members = list(_members(path))
    images = {member.stem: member for member in members if member.name.lower().endswith(".raw")}
    hashes = _manifests(members, path)
    white_images = []
    for member in members:
        image = images.get(member.stem)
        if not member.name.lower().endswith(".txt") or image is None:
            continue
        what = Path(member.name)
        fields = parse_json(_text(member), what, "the metadata")
        metadata = lytro_metadata(fields)
        file_hashes = frozenset(hashes.get(PurePosixPath(member.stem).name, ()))
        white_images.append(
            WhiteImage(
                name=image.name,
                metadata=replace(metadata, references=metadata.references | file_hashes),
                packing=packing_of(fields, what, image.size),
                size=image.size,
                read_bytes=image.read_bytes,
            )
        )
    if not white_images:
        raise FormatError(
            f"{path} has no white images of a Lytro camera: give a folder, tar archive or volumes "
            "data.C.0, data.C.1, ... with files MOD_0000.RAW and MOD_0000.TXT."
        )
    return sorted(_long_exposures(white_images), key=lambda image: image.name)


def choose_white_image(
    metadata: LytroMetadata, images: list[WhiteImage], *, picture: PathLike, calibration: PathLike
) -> WhiteImage:
    """Choose the white image of a picture: equal camera, nearest zoom and focus.

    A white image that the picture refers to comes first. Otherwise candidates have the serial
    number of the camera; the nearest zoom decides, then the nearest focus.
    """
    serials = sorted({image.metadata.serial for image in images if image.metadata.serial})
    if metadata.serial is not None and serials and metadata.serial not in serials:
        raise FormatError(
            f"{picture} was taken by the camera {metadata.serial}, but {calibration} has white "
            f"images of {', '.join(serials[:4])}{' and others' if len(serials) > 4 else ''}: give "
            "the calibration of this camera."
        )
    candidates = [i for i in images if None in (metadata.serial, i.metadata.serial)
           or i.metadata.serial == metadata.serial]  # fmt: skip
    named = [image for image in candidates if image.metadata.references & metadata.references]
    if named:
        return _unique_image(named, picture, calibration)
    if len(candidates) == 1:
        return candidates[0]
    if metadata.zoom_step is None:
        raise FormatError(
            f"{picture} has no zoom and focus to choose among the {len(candidates)} white images "
            f"of {calibration}: give one of them by --white."
        )
    for name in ("zoom_step", "focus_step"):
        setting = getattr(metadata, name)
        if setting is None:
            continue
        distances = [_distance(getattr(image.metadata, name), setting) for image in candidates]
        candidates = [
            i
            for i, distance in zip(candidates, distances, strict=True)
            if distance == min(distances)
        ]
    return _unique_image(candidates, picture, calibration)


def find_calibration(metadata: LytroMetadata, path_argument: PathLike | None) -> Path | None:
    """Return the path of the calibration of a camera: argument, environment or cache."""
    variable = os.environ.get(VARIABLE)
    for location, source in ((path_argument, "The calibration"), (variable, f"${VARIABLE}")):
        if not location:
            continue
        path = Path(location)
        if not path.exists():
            raise FormatError(f"{source} {path} does not exist: give a folder or a tar archive.")
        return path
    cached_path = _cached_paths().get(metadata.serial or "")
    return Path(cached_path) if cached_path and os.path.exists(cached_path) else None


def remember_calibration(metadata: LytroMetadata, path: Path) -> None:
    """Cache the path of the calibration of a camera; do nothing without a serial number."""
    cached_paths = _cached_paths()
    location = str(path.absolute())
    if metadata.serial is None or cached_paths.get(metadata.serial) == location:
        return
    try:
        cache_dir().mkdir(parents=True, exist_ok=True)
        with replacing(cache_dir() / _CACHE_FILE) as temporary:
            temporary.write_text(json.dumps(cached_paths | {metadata.serial: location}, indent=1))
    except OSError:  # the user gives it again
        return


def calibration_advice(picture: PathLike, metadata: LytroMetadata) -> str:
    """Return the message for a picture without a known white image."""
    camera = f" of the camera {metadata.serial}" if metadata.serial else ""
    return (
        f"{picture} needs a white image{camera}: no calibration is known, and the lenslets cannot "
        f"be detected in the picture itself. {_HINT}"
    )


def _cached_paths() -> dict[str, str]:
    try:
        cache = json.loads((cache_dir() / _CACHE_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    pairs = cache.items() if isinstance(cache, dict) else ()
    return {key: value for key, value in pairs if isinstance(value, str)}


def is_far(metadata: LytroMetadata, image: WhiteImage) -> bool:
    """Return True if the chosen white image has a very different zoom."""
    zooms = metadata.zoom_step, image.metadata.zoom_step
    return None not in zooms and _distance(*zooms) > _MAX_ZOOM_DISTANCE


def _distance(value: float | None, target: float | None) -> float:
    return float("inf") if value is None or target is None else abs(value - target)


def _unique_image(images: list[WhiteImage], picture: PathLike, calibration: PathLike) -> WhiteImage:
    """Return the first of several identical white images; raise FormatError if they differ."""
    first = images[0]
    other = next((i for i in images[1:] if i.read_bytes() != first.read_bytes()), None)
    if other is None:
        return first
    raise FormatError(
        f"Two different white images of {calibration} fit {picture} equally well, {first.name} and "
        f"{other.name}: give one of them by --white."
    )


def _long_exposures(images: list[WhiteImage]) -> list[WhiteImage]:
    """Return the images of long exposure: F01 calibrations have a dark one for each setting."""
    times = [i.metadata.exposure for i in images if i.metadata.exposure is not None]
    if not times or max(times) < 2 * min(times):
        return images
    mean = sum(times) / len(times)
    return [i for i in images if i.metadata.model != "F01" or (i.metadata.exposure or mean) >= mean]


def _text(member: _Member) -> bytes:
    """Return JSON up to its last bracket: some cameras append zeros and a line."""
    if member.size > _MAX_JSON_BYTES:
        raise FormatError(
            f"{member.name} is not metadata of a frame: it has {member.size:,} bytes."
        )
    text = member.read_bytes()
    return text[: text.rfind(b"}") + 1]


def _manifests(members: list[_Member], path: Path) -> dict[str, list[str]]:
    """Return the hashes in the manifests of a calibration, by file name without suffix."""
    hashes: dict[str, list[str]] = {}
    for member in members:
        if PurePosixPath(member.name).name.lower() != _MANIFEST:
            continue
        manifest = parse_json(_text(member), path, f"the manifest {member.name}")
        files = manifest.get("calibrationFiles")
        for file in files if isinstance(files, list) else []:
            if isinstance(file, dict) and isinstance(file.get("hash"), str):
                stem = PurePosixPath(str(file.get("name", "")).replace("\\", "/")).stem.lower()
                hashes.setdefault(stem, []).append(file["hash"])
    return hashes


def _members(path: Path) -> Iterator[_Member]:
    """Yield the files of a calibration, including those in volumes and archives."""
    if path.is_file():
        yield from _volume_members(path)
        return
    files = (file for file in path.rglob("*") if file.is_file())
    for count, file in enumerate(sorted(files)):
        if count >= _MAX_FILES:
            raise FormatError(
                f"{path} has more than {_MAX_FILES:,} files: give the folder of the calibration."
            )
        if _VOLUME.fullmatch(file.name) or file.suffix.lower() == ".tar":
            yield from _volume_members(file)
        elif file.suffix.lower() in (".raw", ".txt") or file.name.lower() == _MANIFEST:
            yield _Member(file.as_posix(), file.stat().st_size, file.read_bytes)


def _volume_members(path: Path) -> Iterator[_Member]:
    if _VOLUME.fullmatch(path.name):
        for name, start, length in listed_files(path):
            yield _Member(f"{path.parent.as_posix()}/{name}", length, _reader(path, start, length))
    elif tarfile.is_tarfile(path):
        yield from _archive_members(path)
    else:
        raise FormatError(f"{path} must be a folder, a tar archive or a volume data.C.0.")


def _archive_members(path: Path) -> Iterator[_Member]:
    """Yield the files of a tar archive without unpacking it."""
    try:
        with tarfile.open(path, "r:") as archive:
            for count, member in enumerate(archive):
                if count >= _MAX_FILES:
                    raise FormatError(f"{path} has more than {_MAX_FILES:,} files.")
                if member.isreg():
                    read = _reader(path, member.offset_data, member.size)
                    yield _Member(f"{path.as_posix()}/{member.name}", member.size, read)
    except tarfile.TarError as error:
        raise FormatError(f"{path} is not a complete tar archive ({error}).") from error


def _reader(path: Path, start: int, length: int) -> Source:
    def read() -> bytes:
        with path.open("rb") as file:
            file.seek(start)
            return file.read(length)

    return read
