"""XML calibration of Raytrix cameras, and the lens lattice that it describes.

In the calibration y points upwards. The offset is in pixels from the centre of the image,
((h - 1)/2, (w - 1)/2), base vectors are in lens diameters and the rotation is counter-clockwise
(Palmieri, PlenopticToolbox2.0: plenopticIO/imgIO.py, lens_grid.py).
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from clplen.checks import check_finite, fits_float64
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.lightfield.calibration.lattice_fit import lattice_steps
from clplen.lightfield.calibration.reciprocal import reduced_basis
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice

Vector = tuple[float, float]
Array = np.ndarray[Any, np.dtype[np.float64]]

_MAX_SIZE = 10000  # of a lens in pixels, of a base vector in lens diameters
_MAX_DEVIATION = 0.05  # lens diameters between a lens of a type and the lattice
_MAX_SQUARE_COSINE = 0.1  # of the angle between base vectors of a square lattice
_MAX_HEXAGON_SPREAD = 0.06  # relative difference of neighbour distances in a hexagonal lattice
_MAX_FILE_BYTES = 1 << 20
_RANGE = ("min", "max")


@dataclass(frozen=True)
class Distortion:
    """Distortion of the main lens as stored in the file; it is not applied.

    Attributes
    ----------
    kind, function : str
        Type and model, such as "radial" and "Brown".
    parameters : tuple of float
        Parameters of the function, in file order.
    offset : tuple of float
        Centre (x, y) in pixels.

    Examples
    --------
    >>> bent = clplen.io.Distortion("radial", "Brown", (-0.00145, 0.000735), offset=(0.0, 0.0))
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.0, 0.0), diameter=23.0, lens_base_x=(1.0, 0.0), lens_base_y=(0.0, 1.0),
    ...     distortion=bent)
    >>> clplen.io.write_raytrix("camera.xml", calibration)
    >>> clplen.io.read_raytrix("camera.xml").distortion.parameters
    (-0.00145, 0.000735)
    """

    kind: str
    function: str
    parameters: tuple[float, ...]
    offset: Vector

    def __post_init__(self) -> None:
        check_finite(parameters=self.parameters, offset=self.offset)


@dataclass(frozen=True)
class FocusType:
    """Lens type of a multi-focus array, as stored in the file.

    Attributes
    ----------
    offset : tuple of float
        Centre (x, y) of a lens of this type, in lens diameters, y upwards.
    depth_range : tuple of float
        Smallest and largest virtual depth.

    Examples
    --------
    >>> far = clplen.io.FocusType(offset=(0.0, 0.0), depth_range=(3.8, 100.0))
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.0, 0.0), diameter=23.0, lens_base_x=(1.0, 0.0), lens_base_y=(0.0, 1.0),
    ...     lens_types=(far,))
    >>> [kind.depth_range for kind in calibration.types()]
    [(3.8, 100.0)]
    """

    offset: Vector
    depth_range: Vector

    def __post_init__(self) -> None:
        check_finite(offset=self.offset, depth_range=self.depth_range)


@dataclass(frozen=True)
class RaytrixCalibration:
    """Calibration of a Raytrix camera as stored in the file: x before y, y upwards.

    Attributes
    ----------
    offset : tuple of float
        Centre (x, y) of a lens, in pixels from the centre of the image.
    diameter : float
        Lens pitch in pixels.
    lens_base_x, lens_base_y : tuple of float
        Base vectors of the lattice, in lens diameters.
    rotation : float
        Counter-clockwise rotation of the base vectors in radians.
    lens_border : float
        Unused rim of a lens in pixels.
    tcp : float or None
        Virtual depth of the total covering plane.
    sub_grid_base : tuple of float or None
        Size (width, height) of the unit cell of the lens types, in lens diameters.
    distortion : Distortion or None
        Distortion of the main lens, or None if the file has none.
    lens_types : tuple of FocusType
        Lens types in the order of their ids.

    Examples
    --------
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.5, -1.25), diameter=23.0,
    ...     lens_base_x=(1.0, 0.0), lens_base_y=(0.5, 0.8660254))
    >>> lattice = calibration.lattice((120, 150))
    >>> lattice.kind, f"{lattice.neighbour:.2f} pixels from lens to lens"
    ('hexagonal', '23.00 pixels from lens to lens')
    >>> calibration.origin((120, 150))  # y, x of a lens, in pixels
    (60.75, 75.0)
    """

    offset: Vector
    diameter: float
    lens_base_x: Vector
    lens_base_y: Vector
    rotation: float = 0.0
    lens_border: float = 0.0
    tcp: float | None = None
    sub_grid_base: Vector | None = None
    distortion: Distortion | None = None
    lens_types: tuple[FocusType, ...] = ()

    def __post_init__(self) -> None:
        names = ("offset", "rotation", "lens_border", "tcp", "sub_grid_base")
        values = {name: getattr(self, name) for name in names}
        check_finite(**{name: value for name, value in values.items() if value is not None})
        if not 1 <= self.diameter <= _MAX_SIZE:
            raise ValueError(f"diameter must be 1 to {_MAX_SIZE} pixels, got {self.diameter}.")
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        if not max(map(abs, (ax, ay, bx, by))) <= _MAX_SIZE or not abs(ax * by - ay * bx) > 1e-3:
            raise ValueError(
                f"lens_base_x and lens_base_y must span a lattice, got {self.lens_base_x} and "
                f"{self.lens_base_y}."
            )

    def origin(self, shape: tuple[int, int]) -> Vector:
        """Return the centre (y, x) of a lens in pixels, y downwards, in an image (ny, nx)."""
        check_finite(shape=shape)
        return (shape[0] - 1) / 2 - self.offset[1], (shape[1] - 1) / 2 + self.offset[0]

    def on_sensor(self, vector: Vector) -> Vector:
        """Convert (x, y) in lens diameters to (y, x) in pixels, y downwards, with rotation."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        x, y = vector
        return -self.diameter * (s * x + c * y), self.diameter * (c * x - s * y)

    def lattice(self, shape: tuple[int, int]) -> Lattice:
        """Return the lattice of all lenses of an image of shape (ny, nx).

        Raises
        ------
        ValueError
            If the lattice is neither square nor hexagonal.
        """
        kind, row, column = lattice_vectors(
            self.on_sensor(self.lens_base_x), self.on_sensor(self.lens_base_y)
        )
        verdict = "from a calibration of Raytrix"
        return Lattice(kind, self.origin(shape), row, column, shape, verdict=verdict)

    def types(self) -> tuple[LensType, ...]:
        """Return the lens types on the sensor.

        Lenses of a type form a lattice whose unit cell is the rectangle ``sub_grid_base``, with a
        second lens in its centre if the rectangle contains two lenses of each type.

        Raises
        ------
        ValueError
            If the rectangle does not contain one or two lenses of each type.
        """
        if len(self.lens_types) < 2 or self.sub_grid_base is None:
            base: tuple[Vector, ...] = (self.lens_base_y, self.lens_base_x)
        else:
            base = self._sub_lattice(self.sub_grid_base)
        steps = (self.on_sensor(base[0]), self.on_sensor(base[1]))
        return tuple(
            LensType(self.on_sensor(t.offset), t.depth_range, steps) for t in self.lens_types
        )

    def _sub_lattice(self, rectangle: Vector) -> tuple[Vector, Vector]:
        """Return two vectors between lenses of a type."""
        width, height = (abs(side) for side in rectangle)
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        lenses_per_type = width * height / abs(ax * by - ay * bx) / len(self.lens_types)
        for count, row in ((1, (0.0, height)), (2, (width / 2, height / 2))):
            if (
                abs(lenses_per_type - count) < _MAX_DEVIATION
                and self._is_lens(row)
                and self._is_lens((width, 0))
            ):
                return row, (width, 0.0)
        raise ValueError(
            f"sub_grid_base of {width:g} x {height:g} lenses must contain one or two lenses of "
            f"each of {len(self.lens_types)} types, got {lenses_per_type:.2f}."
        )

    def _is_lens(self, position: Vector) -> bool:
        base = np.array([self.lens_base_x, self.lens_base_y]).T
        coordinates = np.linalg.solve(base, np.array(position))
        return bool(np.all(np.abs(coordinates - np.round(coordinates)) < _MAX_DEVIATION))


def lattice_vectors(first: Vector, second: Vector) -> tuple[str, Vector, Vector]:
    """Return kind, row and column of `Lattice` for any two base vectors (y, x)."""
    a, b = short = reduced_basis(np.array([first, second]))
    cosine = float(a @ b / math.sqrt(a @ a * (b @ b)))
    kind = "square" if abs(cosine) < _MAX_SQUARE_COSINE else "hexagonal"
    lengths = [math.hypot(*vector) for vector in (a, b, b - a if cosine > 0 else a + b)]
    if kind == "hexagonal" and max(lengths) > (1 + _MAX_HEXAGON_SPREAD) * min(lengths):
        angle = math.degrees(math.acos(abs(cosine)))
        raise ValueError(
            f"The lattice must be square or hexagonal, got base vectors of {lengths[0]:.4g} and "
            f"{lengths[1]:.4g} px at {angle:.1f} degrees."
        )
    row, column = lattice_steps(short, kind)
    return kind, _vector(row), _vector(column)


def _vector(vector: Array) -> Vector:
    return float(vector[0]), float(vector[1])


def read_raytrix(path: PathLike) -> RaytrixCalibration:
    """Read the XML calibration of a Raytrix camera.

    Parameters
    ----------
    path : path-like
        ``.xml`` file of version 1, in UTF-8 or UTF-16.

    Returns
    -------
    RaytrixCalibration
        Calibration in the units and directions of the file.

    Raises
    ------
    FormatError
        If the file is missing, another kind of XML, or incomplete.

    Examples
    --------
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.5, -1.25), diameter=23.0,
    ...     lens_base_x=(1.0, 0.0), lens_base_y=(0.5, 0.8660254))
    >>> clplen.io.write_raytrix("camera.xml", calibration)
    >>> stored = clplen.io.read_raytrix("camera.xml")
    >>> stored == calibration, stored.diameter, stored.lattice((120, 150)).kind
    (True, 23.0, 'hexagonal')
    """
    path = Path(path)
    if path.suffix.lower() == ".ray":
        raise FormatError(_proprietary(path))
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    root = _root(path)
    focus = [_focus_type(_Element(path, element)) for element in root.children("lens_type")]
    if sorted(number for number, _ in focus) != list(range(len(focus))):
        raise FormatError(
            f"{path}: the ids of the lens types must be 0, 1, ..., each once, got "
            f"{[number for number, _ in focus][:9]}."
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
            distortion=_distortion(root.child("distortion")) if root.has("distortion") else None,
            lens_types=tuple(lens_type for _, lens_type in sorted(focus, key=lambda pair: pair[0])),
        )
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error


def _proprietary(path: Path) -> str:
    return (
        f"{path} has the maker's proprietary format: with the software of the camera, save the "
        "processed image as .png or .tif and the calibration as .xml, then give the .xml."
    )


@dataclass(frozen=True)
class _Element:
    """Element of the XML with access to its numbers by name."""

    path: Path
    element: ET.Element

    def has(self, name: str) -> bool:
        return self.element.find(name) is not None

    def children(self, name: str) -> list[ET.Element]:
        return self.element.findall(name)

    def child(self, name: str) -> _Element:
        children = self.children(name)
        if len(children) != 1:
            raise FormatError(
                f"{self.path}: <{self.element.tag}> must have one element <{name}>, got "
                f"{len(children)}."
            )
        return _Element(self.path, children[0])

    def number(self, name: str, units: str | None = None) -> float:
        child = self.child(name)
        child.require_units(units)
        return child.value(child.element.text or "")

    def pair(self, name: str, units: str | None, parts: tuple[str, str] = ("x", "y")) -> Vector:
        child = self.child(name)
        child.require_units(units)
        return child.number(parts[0]), child.number(parts[1])

    def value(self, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not fits_float64(value):
            raise FormatError(
                f"{self.path}: <{self.element.tag}> must be a finite number, got {text[:40]!r}."
            )
        return value

    def require_units(self, units: str | None) -> None:
        unit = self.element.get("units", units)
        if unit != units:
            raise FormatError(
                f"{self.path}: <{self.element.tag}> must be in {units!r}, got {str(unit)[:40]!r}."
            )


def _root(path: Path) -> _Element:
    with path.open("rb") as file:
        data = file.read(_MAX_FILE_BYTES + 1)
    if len(data) > _MAX_FILE_BYTES:
        raise FormatError(
            f"{path} is not a calibration: it is longer than {_MAX_FILE_BYTES:,} bytes."
        )
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not XML: it is neither UTF-8 nor UTF-16.") from error
    if re.search(r"<!(?!--)", text):
        raise FormatError(
            f"{path} declares a document type or entities, which could expand without limit: "
            "remove them."
        )
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise FormatError(f"{path} is not valid XML ({error}).") from error
    if root.tag != "RayCalibData":
        raise FormatError(f"{path} must have the root <RayCalibData>, got <{root.tag[:40]}>.")
    version = root.get("version", "1.0")
    if version.split(".")[0] != "1":
        raise FormatError(f"{path} must be a calibration of version 1.0, got {version[:20]!r}.")
    return _Element(path, root)


def _focus_type(element: _Element) -> tuple[int, FocusType]:
    number = element.element.get("id", "")
    if not re.fullmatch(r"\d{1,4}", number):
        raise FormatError(
            f"{element.path}: the id of a <lens_type> must be a number, got {number[:40]!r}."
        )
    offset = element.pair("offset", "lens")
    return int(number), FocusType(offset, element.pair("depth_range", "virtual_depth", _RANGE))


def _distortion(element: _Element) -> Distortion:
    function = element.child("function").element.text or ""
    text = element.child("parameter").element.text or ""
    values = tuple(element.value(part) for part in text.split(";") if part.strip())
    offset = element.pair("offset", "pix") if element.has("offset") else (0.0, 0.0)
    return Distortion(element.element.get("type", ""), function.strip(), values, offset)


def write_raytrix(path: PathLike, calibration: RaytrixCalibration) -> None:
    """Write a calibration as the XML that `read_raytrix` reads.

    Parameters
    ----------
    path : path-like
        ``.xml`` file.
    calibration : RaytrixCalibration
        Calibration to write; attributes that are None are left out.

    Raises
    ------
    ValueError, OSError
        If the suffix is not ``.xml``; if the file cannot be written.

    Examples
    --------
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.5, -1.25), diameter=23.0,
    ...     lens_base_x=(1.0, 0.0), lens_base_y=(0.5, 0.8660254))
    >>> clplen.io.write_raytrix("camera.xml", calibration)
    >>> with open("camera.xml", encoding="utf-8") as file:
    ...     print(file.read())
    <?xml version="1.0"?>
    <RayCalibData version="1.0">
      <offset units="pix"><x>0.5</x><y>-1.25</y></offset>
      <diameter units="pix">23.0</diameter>
    ...
    """
    if Path(path).suffix.lower() != ".xml":
        raise ValueError(f"path must end in .xml for a Raytrix calibration, got {path}.")
    lines = [
        _pair("offset", "pix", calibration.offset),
        _number("diameter", "pix", calibration.diameter),
        _number("rotation", "rad", calibration.rotation),
        _number("lens_border", "pix", calibration.lens_border),
        *([] if calibration.tcp is None else [_number("tcp", "virtual_depth", calibration.tcp)]),
        _pair("lens_base_x", "lens", calibration.lens_base_x),
        _pair("lens_base_y", "lens", calibration.lens_base_y),
        *(
            []
            if calibration.sub_grid_base is None
            else [_pair("sub_grid_base", "lens", calibration.sub_grid_base)]
        ),
        *([] if calibration.distortion is None else [_distortion_text(calibration.distortion)]),
        *(_type_text(number, lens_type) for number, lens_type in enumerate(calibration.lens_types)),
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


def _type_text(number: int, lens_type: FocusType) -> str:
    inner = _pair("offset", "lens", lens_type.offset)
    inner += _pair("depth_range", "virtual_depth", lens_type.depth_range, _RANGE)
    return f'<lens_type id="{number}">{inner}</lens_type>'


def _distortion_text(distortion: Distortion) -> str:
    values = ";".join(repr(float(value)) for value in distortion.parameters)
    return (
        f"<distortion type={quoteattr(distortion.kind)}>"
        f"<function>{escape(distortion.function)}</function>"
        f'<parameter count="{len(distortion.parameters)}">{values}</parameter>'
        f"{_pair('offset', 'pix', distortion.offset)}</distortion>"
    )
