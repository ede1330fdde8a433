"""White images of Lytro cameras: found in what the makers' programs keep, chosen for a picture.

A calibration is a folder or a tar archive with pairs ``MOD_0000.RAW`` and ``MOD_0000.TXT``, or a
folder with the volumes ``data.C.0``, ``data.C.1``, ... of a first-generation camera, containers
whose tables of contents name the same files (LFToolbox, Dansereau 2013-2020:
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
_MOST = 20_000  # files of a calibration
_TEXT = 1 << 21  # bytes of metadata
_ZOOM = 40.0  # steps of the zoom's motor: a white image farther away is said
_REMEMBERED = "lytro-calibrations.json"
_HINT = (
    "Give --calibration, the folder or tar archive of this camera (caldata-SERIAL.tar, or the "
    "folder with data.C.0), or --white, a white image."
)

Source = Callable[[], bytes]


@dataclass(frozen=True)
class WhiteImage:
    """A white image of a calibration."""

    name: str  # where it lies, for messages
    metadata: LytroMetadata
    packing: Packing
    size: int  # bytes of the stored image
    read_bytes: Source  # () -> bytes, the stored image

    def read(self, *, max_bytes: int | None = None) -> np.ndarray[Any, np.dtype[np.uint16]]:
        """The white image, uint16, shape (ny, nx), no level subtracted."""
        Bound(Path(self.name), self.size, 2, max_bytes).require(
            2 * self.packing.width * self.packing.height, "the white image"
        )
        data = self.read_bytes()
        if len(data) != self.packing.stored:
            raise FormatError(
                f"{self.name}: a white image of {self.packing.width} x {self.packing.height} "
                f"pixels takes {self.packing.stored:,} bytes, but {len(data):,} are there: it is "
                "cut off; copy the calibration from the camera again."
            )
        return unpack(np.frombuffer(data, np.uint8), self.packing)


@dataclass(frozen=True)
class _Member:
    """A file of a calibration: its name, length and content."""

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
    found = []
    for member in members:
        image = images.get(member.stem)
        if not member.name.lower().endswith(".txt") or image is None:
            continue
        what = Path(member.name)
        described = parse_json(_text(member), what, "the metadata")
        metadata = lytro_metadata(described)
        own = frozenset(hashes.get(PurePosixPath(member.stem).name, ()))
        found.append(
            WhiteImage(
                name=image.name,
                metadata=replace(metadata, references=metadata.references | own),
                packing=packing_of(described, what, image.size),
                size=image.size,
                read_bytes=image.read_bytes,
            )
        )
    if not found:
        raise FormatError(
            f"{path} holds no white images of a Lytro camera (MOD_0000.RAW with MOD_0000.TXT, in a "
            "folder, a tar archive or the volumes data.C.0, data.C.1, ...)."
        )
    return sorted(_bright(found), key=lambda image: image.name)


def choose_white_image(
    metadata: LytroMetadata, images: list[WhiteImage], *, picture: PathLike, calibration: PathLike
) -> WhiteImage:
    """Choose the white image of a picture: of the same camera, zoom and focus.

    One that the picture itself refers to is taken; else of those with the same serial number the
    one nearest in zoom, and of these nearest in focus.
    """
    serials = sorted({image.metadata.serial for image in images if image.metadata.serial})
    if metadata.serial is not None and serials and metadata.serial not in serials:
        raise FormatError(
            f"{picture} is of the camera {metadata.serial}, and {calibration} holds white images "
            f"of {', '.join(serials[:4])}{' and others' if len(serials) > 4 else ''}: give the "
            "calibration of this camera."
        )
    own = [i for i in images if None in (metadata.serial, i.metadata.serial)
           or i.metadata.serial == metadata.serial]  # fmt: skip
    named = [image for image in own if image.metadata.references & metadata.references]
    if named:
        return _only(named, picture, calibration)
    if len(own) == 1:
        return own[0]
    if metadata.zoom_step is None:
        raise FormatError(
            f"{picture} does not tell its zoom and focus, so that none of the {len(own)} white "
            f"images of {calibration} can be chosen: give --white, one of them."
        )
    for name in ("zoom_step", "focus_step"):
        wanted = getattr(metadata, name)
        if wanted is None:
            continue
        apart = [_apart(getattr(image.metadata, name), wanted) for image in own]
        own = [i for i, off in zip(own, apart, strict=True) if off == min(apart)]
    return _only(own, picture, calibration)


def find_calibration(metadata: LytroMetadata, given: PathLike | None) -> Path | None:
    """Where the calibration of a camera lies."""
    variable = os.environ.get(VARIABLE)
    for place, words in ((given, "The calibration"), (variable, f"${VARIABLE}")):
        if not place:
            continue
        path = Path(place)
        if not path.exists():
            raise FormatError(f"{words} {path} is not there: give a folder or a tar archive.")
        return path
    known = _remembered().get(metadata.serial or "")
    return Path(known) if known and os.path.exists(known) else None


def remember_calibration(metadata: LytroMetadata, path: Path) -> None:
    """Keep where the calibration of a camera lies; without a serial or a cache nothing is kept."""
    known = _remembered()
    place = str(path.absolute())
    if metadata.serial is None or known.get(metadata.serial) == place:
        return
    try:
        cache_dir().mkdir(parents=True, exist_ok=True)
        with replacing(cache_dir() / _REMEMBERED) as temporary:
            temporary.write_text(json.dumps(known | {metadata.serial: place}, indent=1))
    except OSError:  # it is asked for again
        return


def no_calibration(picture: PathLike, metadata: LytroMetadata) -> str:
    """What to do where no white image is known, in words."""
    of = f" of the camera {metadata.serial}" if metadata.serial else ""
    return (
        f"{picture} needs a white image{of}: no calibration is known, and its lenslets cannot be "
        f"found on the scene itself. {_HINT}"
    )


def _remembered() -> dict[str, str]:
    try:
        found = json.loads((cache_dir() / _REMEMBERED).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    pairs = found.items() if isinstance(found, dict) else ()
    return {key: value for key, value in pairs if isinstance(value, str)}


def is_far(metadata: LytroMetadata, image: WhiteImage) -> bool:
    """Whether the chosen white image was taken at quite another zoom."""
    zooms = metadata.zoom_step, image.metadata.zoom_step
    return None not in zooms and _apart(*zooms) > _ZOOM


def _apart(value: float | None, wanted: float | None) -> float:
    return float("inf") if value is None or wanted is None else abs(value - wanted)


def _only(images: list[WhiteImage], picture: PathLike, calibration: PathLike) -> WhiteImage:
    """The one of several that are the same; those that differ are refused."""
    first = images[0]
    other = next((i for i in images[1:] if i.read_bytes() != first.read_bytes()), None)
    if other is None:
        return first
    raise FormatError(
        f"Two white images of {calibration} fit {picture} alike, {first.name} and {other.name}, "
        "and differ: give one of them by --white."
    )


def _bright(images: list[WhiteImage]) -> list[WhiteImage]:
    """Those that are not dark: a first-generation camera has one of short exposure for each."""
    times = [i.metadata.exposure for i in images if i.metadata.exposure is not None]
    if not times or max(times) < 2 * min(times):
        return images
    mean = sum(times) / len(times)
    return [i for i in images if i.metadata.model != "F01" or (i.metadata.exposure or mean) >= mean]


def _text(member: _Member) -> bytes:
    """JSON less what follows its last bracket: some cameras end it with zeros and a line."""
    if member.size > _TEXT:
        raise FormatError(f"{member.name} has {member.size:,} bytes: it is no metadata of a frame.")
    text = member.read_bytes()
    return text[: text.rfind(b"}") + 1]


def _manifests(members: list[_Member], path: Path) -> dict[str, list[str]]:
    """Hashes of the manifests of a calibration, by the names (without suffix) of their files."""
    found: dict[str, list[str]] = {}
    for member in members:
        if PurePosixPath(member.name).name.lower() != _MANIFEST:
            continue
        manifest = parse_json(_text(member), path, f"the manifest {member.name}")
        files = manifest.get("calibrationFiles")
        for file in files if isinstance(files, list) else []:
            if isinstance(file, dict) and isinstance(file.get("hash"), str):
                stem = PurePosixPath(str(file.get("name", "")).replace("\\", "/")).stem.lower()
                found.setdefault(stem, []).append(file["hash"])
    return found


def _members(path: Path) -> Iterator[_Member]:
    """The files of a calibration, those of volumes and archives by what they hold."""
    if path.is_file():
        yield from _of_file(path)
        return
    files = (file for file in path.rglob("*") if file.is_file())
    for count, file in enumerate(sorted(files)):
        if count >= _MOST:
            raise FormatError(
                f"{path} holds more than {_MOST:,} files: give the folder of the calibration."
            )
        if _VOLUME.fullmatch(file.name) or file.suffix.lower() == ".tar":
            yield from _of_file(file)
        elif file.suffix.lower() in (".raw", ".txt") or file.name.lower() == _MANIFEST:
            yield _Member(file.as_posix(), file.stat().st_size, file.read_bytes)


def _of_file(path: Path) -> Iterator[_Member]:
    if _VOLUME.fullmatch(path.name):
        for name, start, length in listed_files(path):
            yield _Member(f"{path.parent.as_posix()}/{name}", length, _part(path, start, length))
    elif tarfile.is_tarfile(path):
        yield from _of_archive(path)
    else:
        raise FormatError(f"{path} is neither a folder, a tar archive nor a volume data.C.0.")


def _of_archive(path: Path) -> Iterator[_Member]:
    """The files of a tar archive, which is not unpacked."""
    try:
        with tarfile.open(path, "r:") as archive:
            for count, member in enumerate(archive):
                if count >= _MOST:
                    raise FormatError(f"{path} holds more than {_MOST:,} files.")
                if member.isreg():
                    read = _part(path, member.offset_data, member.size)
                    yield _Member(f"{path.as_posix()}/{member.name}", member.size, read)
    except tarfile.TarError as error:
        raise FormatError(f"{path} is no tar archive that is whole ({error}).") from error


def _part(path: Path, start: int, length: int) -> Source:
    def read() -> bytes:
        with path.open("rb") as file:
            file.seek(start)
            return file.read(length)

    return read
