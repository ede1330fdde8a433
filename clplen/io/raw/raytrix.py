"""The XML in which Raytrix cameras keep their calibration, and where it tells that the lenses lie.

The calibration counts y upwards, the offset in pixels from the centre of the image, ((h - 1)/2,
(w - 1)/2), and base vectors in lens diameters; the rotation turns them counter-clockwise
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

_LARGEST = 10000  # pixels a lens, and lens diameters
_NEAR = 0.05  # lens diameters: how far a lens of a type may lie from the lattice
_SQUARE = 0.1  # cosine up to which base vectors are at right angles
_HEXAGON = 0.06  # relative differences among neighbours of a hexagonal lattice
_LONGEST = 1 << 20  # bytes
_RANGE = ("min", "max")


@dataclass(frozen=True)
class Distortion:
    """What the file says of the main lens' distortion; kept, not applied.

    Attributes
    ----------
    kind, function : str
        Such as "radial" and "Brown".
    parameters : tuple of float
        The numbers of that function, in the order of the file.
    offset : tuple of float
        (x, y) in pixels.

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
    """One of the kinds of lenses of a multi-focus array, as in the file.

    Attributes
    ----------
    offset : tuple of float
        (x, y) of one of its lenses, in lens diameters, y upwards.
    depth_range : tuple of float
        (least, greatest) virtual depth.

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
    """A calibration as in the file: x before y, and y upwards.

    Attributes
    ----------
    offset : tuple of float
        (x, y) of a lens' centre, in pixels from the centre of the image.
    diameter : float
        Lens pitch in pixels.
    lens_base_x, lens_base_y : tuple of float
        Base vectors of the lattice, in lens diameters.
    rotation : float
        Of the base vectors, counter-clockwise, in radians.
    lens_border : float
        Pixels at the rim of a lens that are not used.
    tcp : float or None
        Virtual depth of the total covering plane.
    sub_grid_base : tuple of float or None
        (width, height) in lens diameters of the rectangle that repeats the types of the lenses.
    distortion : Distortion or None
        Of the main lens; None where the file has none.
    lens_types : tuple of FocusType
        By their id.

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
        found = {name: getattr(self, name) for name in names}
        check_finite(**{name: value for name, value in found.items() if value is not None})
        if not 1 <= self.diameter <= _LARGEST:
            raise ValueError(
                f"The diameter of a lens is 1 to {_LARGEST} pixels, not {self.diameter}."
            )
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        if not max(map(abs, (ax, ay, bx, by))) <= _LARGEST or not abs(ax * by - ay * bx) > 1e-3:
            raise ValueError(
                f"The base vectors {self.lens_base_x} and {self.lens_base_y} span no lattice."
            )

    def origin(self, shape: tuple[int, int]) -> Vector:
        """(y, x) in pixels, y downwards, of a lens' centre in an image of a shape (ny, nx)."""
        check_finite(shape=shape)
        return (shape[0] - 1) / 2 - self.offset[1], (shape[1] - 1) / 2 + self.offset[0]

    def on_sensor(self, vector: Vector) -> Vector:
        """(y, x) in pixels, y downwards, of (x, y) in lens diameters, rotation included."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        x, y = vector
        return -self.diameter * (s * x + c * y), self.diameter * (c * x - s * y)

    def lattice(self, shape: tuple[int, int]) -> Lattice:
        """All lenses of an image of a shape (ny, nx).

        Raises
        ------
        ValueError
            If they lie neither on a square nor on a hexagonal lattice.
        """
        kind, row, column = lattice_vectors(
            self.on_sensor(self.lens_base_x), self.on_sensor(self.lens_base_y)
        )
        verdict = "from a calibration of Raytrix"
        return Lattice(kind, self.origin(shape), row, column, shape, verdict=verdict)

    def types(self) -> tuple[LensType, ...]:
        """The kinds of lenses on the sensor.

        Lenses of one kind lie on a lattice of their own: that of the rectangle ``sub_grid_base``,
        with a second lens in its middle where it holds two of each kind.

        Raises
        ------
        ValueError
            If the rectangle does not hold one or two lenses of each kind.
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
        """Two vectors between lenses of one kind."""
        width, height = (abs(side) for side in rectangle)
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        each = width * height / abs(ax * by - ay * bx) / len(self.lens_types)
        for count, row in ((1, (0.0, height)), (2, (width / 2, height / 2))):
            if abs(each - count) < _NEAR and self._is_lens(row) and self._is_lens((width, 0)):
                return row, (width, 0.0)
        raise ValueError(
            f"The rectangle of {width:g} x {height:g} lenses, after which the kinds of lenses are "
            f"said to repeat, holds {each:.2f} of each of {len(self.lens_types)} kinds, not one "
            "or two on the lattice."
        )

    def _is_lens(self, place: Vector) -> bool:
        base = np.array([self.lens_base_x, self.lens_base_y]).T
        found = np.linalg.solve(base, np.array(place))
        return bool(np.all(np.abs(found - np.round(found)) < _NEAR))


def lattice_vectors(first: Vector, second: Vector) -> tuple[str, Vector, Vector]:
    """Return kind, row and column of `Lattice` for any two base vectors (y, x)."""
    a, b = short = reduced_basis(np.array([first, second]))
    cosine = float(a @ b / math.sqrt(a @ a * (b @ b)))
    kind = "square" if abs(cosine) < _SQUARE else "hexagonal"
    lengths = [math.hypot(*vector) for vector in (a, b, b - a if cosine > 0 else a + b)]
    if kind == "hexagonal" and max(lengths) > (1 + _HEXAGON) * min(lengths):
        angle = math.degrees(math.acos(abs(cosine)))
        raise ValueError(
            f"The base vectors enclose {angle:.1f} degrees with lengths of {lengths[0]:.4g} and "
            f"{lengths[1]:.4g} px: the lattice is neither square nor hexagonal."
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
        ``.xml``, of version 1, in UTF-8 or UTF-16.

    Returns
    -------
    RaytrixCalibration
        The numbers of the file, in its own units and directions.

    Raises
    ------
    FormatError
        If it is missing, no such XML, or lacks a number.

    Examples
    --------
    >>> calibration = clplen.io.RaytrixCalibration(
    ...     offset=(0.5, -1.25), diameter=23.0,
    ...     lens_base_x=(1.0, 0.0), lens_base_y=(0.5, 0.8660254))
    >>> clplen.io.write_raytrix("camera.xml", calibration)
    >>> found = clplen.io.read_raytrix("camera.xml")
    >>> found == calibration, found.diameter, found.lattice((120, 150)).kind
    (True, 23.0, 'hexagonal')
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
        if not fits_float64(value):
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
        The numbers of the file; what is None is left out.

    Raises
    ------
    ValueError, OSError
        If the suffix is another one; if it cannot be written.

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
        raise ValueError(f"A Raytrix calibration is written as .xml, not as {path}.")
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
