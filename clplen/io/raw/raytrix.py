"""The XML in which Raytrix cameras keep their calibration."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.sax.saxutils import escape, quoteattr

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.lightfields.layout import Layout
from clplen.io.raw.raytrix_calibration import Distortion, FocusType, RaytrixCalibration, Vector

_LONGEST = 1 << 20  # bytes
_RANGE = ("min", "max")


def read(path: PathLike, *, device: Device, layout: Layout, progress: bool = False) -> NoReturn:
    """Refuse: a focused raw image becomes no light field by slicing.

    Raises
    ------
    FormatError
        Always.
    """
    path = Path(path)
    if path.suffix.lower() == ".ray":
        raise FormatError(_proprietary(path))
    read_raytrix(path)
    raise FormatError(
        f"{path} is the calibration of a focused (plenoptic 2.0) raw image, whose views are "
        "rendered, not sliced: clplen.io.read_raw(path) gives the raw image with its lenses."
    )


def read_raytrix(path: PathLike) -> RaytrixCalibration:
    """Read the XML calibration of a Raytrix camera.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    RaytrixCalibration

    Raises
    ------
    FormatError
        If it is missing, no such XML, or lacks a number.
    """
    path = Path(path)
    if path.suffix.lower() == ".ray":
        raise FormatError(_proprietary(path))
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    root = _root(path)
    focus = [_focus_type(_Element(path, element)) for element in root.all("lens_type")]
    if sorted(number for number, _ in focus) != list(range(len(focus))):
        raise FormatError(
            f"{path}: the lens types have the ids {[number for number, _ in focus][:9]}, not 0, "
            "1, ... each once."
        )
    try:
        return RaytrixCalibration(
            offset=root.pair("offset", "pix"),
            diameter=root.number("diameter", "pix"),
            lens_base_x=root.pair("lens_base_x", "lens"),
            lens_base_y=root.pair("lens_base_y", "lens"),
            rotation=root.number("rotation", "rad") if root.has("rotation") else 0.0,
            lens_border=root.number("lens_border", "pix") if root.has("lens_border") else 0.0,
            tcp=root.number("tcp", "virtual_depth") if root.has("tcp") else None,
            sub_grid_base=root.pair("sub_grid_base", "lens") if root.has("sub_grid_base") else None,
            distortion=_distortion(root.one("distortion")) if root.has("distortion") else None,
            lens_types=tuple(found for _, found in sorted(focus, key=lambda pair: pair[0])),
        )
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error


def _proprietary(path: Path) -> str:
    return (
        f"{path} is in the maker's own closed format: let the camera's software save the "
        "processed image as .png or .tif and the calibration as .xml, and give the .xml."
    )


@dataclass(frozen=True)
class _Element:
    """An element of the XML, whose numbers are asked for by name."""

    path: Path
    element: ET.Element

    def has(self, name: str) -> bool:
        return self.element.find(name) is not None

    def all(self, name: str) -> list[ET.Element]:
        return self.element.findall(name)

    def one(self, name: str) -> _Element:
        found = self.all(name)
        if len(found) != 1:
            raise FormatError(
                f"{self.path}: <{self.element.tag}> has {len(found)} elements <{name}>, not one."
            )
        return _Element(self.path, found[0])

    def number(self, name: str, units: str | None = None) -> float:
        found = self.one(name)
        found.require_units(units)
        return found.value(found.element.text or "")

    def pair(self, name: str, units: str | None, parts: tuple[str, str] = ("x", "y")) -> Vector:
        found = self.one(name)
        found.require_units(units)
        return found.number(parts[0]), found.number(parts[1])

    def value(self, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise FormatError(
                f"{self.path}: <{self.element.tag}> holds {text[:40]!r}, not a finite number."
            )
        return value

    def require_units(self, units: str | None) -> None:
        found = self.element.get("units", units)
        if found != units:
            raise FormatError(
                f"{self.path}: <{self.element.tag}> is in {str(found)[:40]!r}, expected {units!r}."
            )


def _root(path: Path) -> _Element:
    with path.open("rb") as file:
        data = file.read(_LONGEST + 1)
    if len(data) > _LONGEST:
        raise FormatError(f"{path} is longer than {_LONGEST:,} bytes: it is no calibration.")
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is no XML: it is neither UTF-8 nor UTF-16.") from error
    if re.search(r"<!(?!--)", text):
        raise FormatError(
            f"{path} declares a document type or entities, which a calibration does not need and "
            "which could claim any amount of memory: remove them."
        )
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise FormatError(f"{path} is no XML ({error}).") from error
    if root.tag != "RayCalibData":
        raise FormatError(f"{path} holds <{root.tag[:40]}>, not <RayCalibData>.")
    version = root.get("version", "1.0")
    if version.split(".")[0] != "1":
        raise FormatError(f"{path} is a calibration of version {version[:20]!r}, not 1.0.")
    return _Element(path, root)


def _focus_type(found: _Element) -> tuple[int, FocusType]:
    number = found.element.get("id", "")
    if not re.fullmatch(r"\d{1,4}", number):
        raise FormatError(f"{found.path}: a <lens_type> has the id {number[:40]!r}, no number.")
    offset = found.pair("offset", "lens")
    return int(number), FocusType(offset, found.pair("depth_range", "virtual_depth", _RANGE))


def _distortion(found: _Element) -> Distortion:
    function = found.one("function").element.text or ""
    text = found.one("parameter").element.text or ""
    values = tuple(found.value(part) for part in text.split(";") if part.strip())
    offset = found.pair("offset", "pix") if found.has("offset") else (0.0, 0.0)
    return Distortion(found.element.get("type", ""), function.strip(), values, offset)


def write_raytrix(path: PathLike, calibration: RaytrixCalibration) -> None:
    """Write a calibration as the XML that `read_raytrix` reads.

    Parameters
    ----------
    path : path-like
        ``.xml``.
    calibration : RaytrixCalibration

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If it cannot be written.
    """
    if Path(path).suffix.lower() != ".xml":
        raise ValueError(f"A Raytrix calibration is written as .xml, not as {Path(path).name}.")
    given = calibration
    lines = [
        _pair("offset", "pix", given.offset),
        _number("diameter", "pix", given.diameter),
        _number("rotation", "rad", given.rotation),
        _number("lens_border", "pix", given.lens_border),
        *([] if given.tcp is None else [_number("tcp", "virtual_depth", given.tcp)]),
        _pair("lens_base_x", "lens", given.lens_base_x),
        _pair("lens_base_y", "lens", given.lens_base_y),
        *(
            []
            if given.sub_grid_base is None
            else [_pair("sub_grid_base", "lens", given.sub_grid_base)]
        ),
        *([] if given.distortion is None else [_distortion_text(given.distortion)]),
        *(_type_text(number, found) for number, found in enumerate(given.lens_types)),
    ]
    body = "".join(f"  {line}\n" for line in lines)
    with replacing(path) as temporary:
        temporary.write_text(
            f'<?xml version="1.0"?>\n<RayCalibData version="1.0">\n{body}</RayCalibData>\n', "utf-8"
        )


def _number(name: str, units: str, value: float) -> str:
    return f'<{name} units="{units}">{float(value)!r}</{name}>'


def _pair(name: str, units: str, values: Vector, parts: tuple[str, str] = ("x", "y")) -> str:
    inner = "".join(
        f"<{part}>{float(value)!r}</{part}>" for part, value in zip(parts, values, strict=True)
    )
    return f'<{name} units="{units}">{inner}</{name}>'


def _type_text(number: int, found: FocusType) -> str:
    inner = _pair("offset", "lens", found.offset)
    inner += _pair("depth_range", "virtual_depth", found.depth_range, _RANGE)
    return f'<lens_type id="{number}">{inner}</lens_type>'


def _distortion_text(found: Distortion) -> str:
    values = ";".join(repr(float(value)) for value in found.parameters)
    return (
        f"<distortion type={quoteattr(found.kind)}><function>{escape(found.function)}</function>"
        f'<parameter count="{len(found.parameters)}">{values}</parameter>'
        f"{_pair('offset', 'pix', found.offset)}</distortion>"
    )
