"""What every camera with an array of lenslets has: its array's lengths, its sensor, its table."""

from __future__ import annotations

import html
import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal

from clplen.cameras.optics.pixel_array import PixelArray
from clplen.checks import is_finite
from clplen.compute.device import Device, as_device
from clplen.errors import SamplingError
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.elements.lenslets import SMALLEST_PITCH, MicrolensArray
from clplen.wave.field.field import Grid

Kind = Literal["standard", "focused", "microscope"]


class LensletCamera:
    """A camera with an array of lenslets before its sensor.

    Attributes
    ----------
    mla : MicrolensArray
    pixels_per_lenslet : float
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor.
    device : Device
    """

    mla: MicrolensArray
    pixels_per_lenslet: float
    pixel_pitch: float
    grid: Grid
    device: Device
    pixels: PixelArray | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    @property
    def _sensor(self) -> str:
        """Lenslets and pixels in a few words, for a representation."""
        (rows, columns), (ny, nx) = self.mla.count, self.grid.shape
        lenslets = f"{rows} x {columns} lenslets of {metres(self.mla.pitch)}"
        return f"{lenslets}, {ny} x {nx} pixels"

    @property
    def lenslet_pitch(self) -> float:
        """p in metres."""
        return self.mla.pitch

    @property
    def lenslet_diameter(self) -> float:
        """d in metres."""
        return self.mla.diameter

    @property
    def lenslet_focal_length(self) -> float:
        """f_mu in metres; of several kinds of lenslets the first."""
        return self.mla.focal_length

    @property
    def lenslet_fill(self) -> str:
        """Aperture of a lenslet: "circular", a disc, or "full", the cell of the lattice."""
        return self.mla.fill

    @property
    def lenslet_lattice(self) -> str:
        """Lattice of the lenslets, "square" or "hexagonal"."""
        return self.mla.lattice

    @property
    def spot_variance(self) -> float:
        """Along one axis, in square pixels, of a point's image without diffraction: of a pixel."""
        return 0.0 if self.pixels is None else self.pixels.fill_factor / 12


def sensor_grid(
    mla: MicrolensArray, pixels_per_lenslet: float, pixels: PixelArray | None = None
) -> Grid:
    """The sensor behind an array: as many pixels as cover it, the axis in its middle."""
    if not (is_finite(pixels_per_lenslet) and pixels_per_lenslet >= SMALLEST_PITCH):
        known = is_finite(pixels_per_lenslet)
        number = f"{pixels_per_lenslet:g}" if known else repr(pixels_per_lenslet)
        raise SamplingError(
            f"A lenslet has {number} pixels; at least {SMALLEST_PITCH} are needed: "
            f"pixels of {mla.pitch / SMALLEST_PITCH:g} m or less would do."
        )
    pitch = mla.pitch / pixels_per_lenslet
    ny, nx = (math.ceil(length / pitch - 1e-6) for length in mla.extent)
    down, right = (0.0, 0.0) if pixels is None else pixels.offset
    if pixels is not None and pixels.shape is not None:
        ny, nx = pixels.shape
    for axis, (n, offset, lenslets) in enumerate(
        zip((ny, nx), (down, right), mla.offset, strict=True)
    ):
        apart, most = abs(offset - lenslets), (n * pitch + mla.extent[axis]) / 2
        if apart >= most and mla.rotation == 0:
            raise ValueError(
                f"Array and sensor lie {apart:g} m beside each other along {'yx'[axis]}, by their "
                f"offsets from the axis, so that no lenslet has pixels: less than {most:g} m "
                "would do."
            )
    origin = (
        down + (pitch / 2 if ny % 2 == 0 else 0.0),
        right + (pitch / 2 if nx % 2 == 0 else 0.0),
    )
    return Grid((ny, nx), pitch, origin=origin)


def views(camera: LensletCamera) -> int:
    """Views across: the pixels of a lenslet, rounded."""
    return max(1, round(camera.pixels_per_lenslet))


def lenslet_grid(camera: LensletCamera, magnification: float) -> LensletGrid:
    """Centres of the lenslets, projected by ``magnification`` from the axis, in pixels."""
    mla, n = camera.mla, views(camera)
    first = mla.centres()[0, 0]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    scale = magnification / camera.pixel_pitch
    ny, nx = camera.grid.shape
    oy, ox = camera.grid.origin
    return LensletGrid(
        count=mla.count,
        views=(n, n),
        first=(
            first[0] * scale - oy / camera.pixel_pitch + ny // 2,
            first[1] * scale - ox / camera.pixel_pitch + nx // 2,
        ),
        row_step=(mla.row_pitch * cos * scale, -mla.row_pitch * sin * scale),
        column_step=(mla.pitch * sin * scale, mla.pitch * cos * scale),
        row_view_step=(cos, -sin),
        column_view_step=(sin, cos),
        odd_row_shift=0.5 if mla.lattice == "hexagonal" else 0.0,
    )


@dataclass(frozen=True)
class Row:
    """One derived parameter: its name, value in SI units, unit and what it means."""

    name: str
    value: float
    unit: str
    text: str


@dataclass(frozen=True, repr=False)
class Description(OneLine):
    """Derived parameters of a camera; prints as a table.

    Attributes
    ----------
    title : str
        Kind of the camera.
    rows : tuple of Row
        One for each parameter: its name, value in SI units, unit and what it means.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> print(camera.describe())
    Plenoptic 1.0 camera
      focal length                 120 mm    main lens
      object distance              240 mm    focused plane to main lens
    ...
    >>> camera.describe()["views"]
    15
    """

    title: str
    rows: tuple[Row, ...]

    def __getitem__(self, name: str) -> float:
        """Value of a parameter in SI units."""
        for row in self.rows:
            if row.name == name:
                return row.value
        raise KeyError(f"no parameter {name!r}; there are {', '.join(r.name for r in self.rows)}")

    def __str__(self) -> str:
        width = max(len(row.name) for row in self.rows)
        lines = [self.title]
        for row in self.rows:
            value, unit = _readable(row.value, row.unit)
            lines.append(f"  {row.name:<{width}}  {value:>10} {unit:<4}  {row.text}".rstrip())
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """The table as a notebook shows it."""
        rows = [(row.name, *_readable(row.value, row.unit), row.text) for row in self.rows]
        cells = "".join(
            f"<tr>{''.join(f'<td>{html.escape(text)}</td>' for text in row)}</tr>" for row in rows
        )
        return f"<table><caption>{html.escape(self.title)}</caption>{cells}</table>"


class Described:
    """Base of cameras that tell their derived parameters, in a notebook as a table."""

    @abstractmethod
    def describe(self) -> Description:
        """Derived parameters; see `Description`."""

    def _repr_html_(self) -> str:
        return self.describe()._repr_html_()


def _readable(value: float, unit: str) -> tuple[str, str]:
    """Metres as m, mm, um or nm; anything else as it is."""
    if unit != "m" or value == 0:
        return f"{value:.6g}", unit
    for factor, name in ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")):
        if abs(value) >= factor:
            return f"{value / factor:.6g}", name
    return f"{value * 1e9:.6g}", "nm"
