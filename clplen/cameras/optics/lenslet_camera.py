"""Base class of cameras with lenslets: lengths of array and sensor, and their checks."""

from __future__ import annotations

import math
from typing import Literal

from clplen import units
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.checks import is_finite
from clplen.compute.device import Device, as_device
from clplen.errors import SamplingError
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.units import metres
from clplen.wave.elements.lenslets import SMALLEST_PITCH, MicrolensArray
from clplen.wave.field.field import Grid

Kind = Literal["standard", "focused", "microscope"]

MIN_LENSLET_WAVELENGTHS = 2.0  # minimum width of a lenslet in wavelengths
PITCH_TOLERANCE = 1e-6  # maximum relative difference of pixels_per_lenslet and the pixels' pitch
_LENGTHS = {
    "focal_length": units.CAMERA_FOCAL_LENGTH,
    "image_distance": units.CAMERA_FOCAL_LENGTH,
    "aperture_diameter": units.CAMERA_DIAMETER,
    "tube_lens": units.TUBE_LENS,
    "relay": units.CAMERA_FOCAL_LENGTH,
    "sensor_distance": units.CAMERA_FOCAL_LENGTH,
    "field_stop": units.IMAGE_PLACE,
    "pixel_pitch": units.PIXEL_PITCH,
}  # the object distance is unlimited, and wavelengths are checked separately


class LensletCamera:
    """Camera with an array of lenslets before its sensor; `Plenoptic1` documents its fields."""

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
        """Numbers of lenslets and pixels as a short text."""
        (rows, columns), (ny, nx) = self.mla.count, self.grid.shape
        lenslets = f"{rows} x {columns} lenslets of {metres(self.mla.pitch)}"
        return f"{lenslets}, {ny} x {nx} pixels"

    @property
    def lenslet_pitch(self) -> float:
        """Pitch p of the lenslets in metres."""
        return self.mla.pitch

    @property
    def lenslet_diameter(self) -> float:
        """Diameter d of a lenslet in metres."""
        return self.mla.diameter

    @property
    def lenslet_focal_length(self) -> float:
        """Focal length f_mu in metres; the first of several kinds of lenslets."""
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
        """Variance of a point's image along an axis by the pixel, in square pixels."""
        return 0.0 if self.pixels is None else self.pixels.fill_factor / 12


def sensor_grid(
    mla: MicrolensArray, pixels_per_lenslet: float, pixels: PixelArray | None = None
) -> Grid:
    """Return the sensor behind an array: by default the pixels that cover it, about the axis."""
    if not (is_finite(pixels_per_lenslet) and pixels_per_lenslet >= SMALLEST_PITCH):
        is_number = is_finite(pixels_per_lenslet)
        number = f"{pixels_per_lenslet:g}" if is_number else repr(pixels_per_lenslet)
        raise SamplingError(
            f"pixels_per_lenslet must be at least {SMALLEST_PITCH}, got {number}: use pixels of "
            f"{mla.pitch / SMALLEST_PITCH:g} m or less."
        )
    pitch = mla.pitch / pixels_per_lenslet
    ny, nx = (math.ceil(length / pitch - 1e-6) for length in mla.extent)
    down, right = (0.0, 0.0) if pixels is None else pixels.offset
    if pixels is not None and pixels.shape is not None:
        ny, nx = pixels.shape
    for axis, (n, offset, lenslets) in enumerate(
        zip((ny, nx), (down, right), mla.offset, strict=True)
    ):
        distance, limit = abs(offset - lenslets), (n * pitch + mla.extent[axis]) / 2
        if distance >= limit and mla.rotation == 0:
            raise ValueError(
                f"Offsets from the axis separate array and sensor by {distance:g} m along "
                f"{'yx'[axis]}, so that no lenslet has pixels: use less than {limit:g} m."
            )
    origin = (
        down + (pitch / 2 if ny % 2 == 0 else 0.0),
        right + (pitch / 2 if nx % 2 == 0 else 0.0),
    )
    return Grid((ny, nx), pitch, origin=origin)


def views(camera: LensletCamera) -> int:
    """Return the number of views across: the pixels of a lenslet, rounded."""
    return max(1, round(camera.pixels_per_lenslet))


def independent_views(
    diameter: float, focal_length: float, wavelength: float, pixels: float
) -> float:
    """Return the number of views across that stay independent after diffraction.

    It is d^2/(lam f_mu), the width of a sub-image d over that of a diffraction spot, lam f_mu/d,
    at most the number of pixels of a lenslet.
    """
    return min(pixels, diameter**2 / (wavelength * focal_length))


def lenslet_grid(camera: LensletCamera, magnification: float) -> LensletGrid:
    """Return lenslet centres in pixels, projected by ``magnification`` about the axis."""
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


def check_lenslets(mla: MicrolensArray, wavelength: float) -> None:
    """Raise if ``mla`` is no array, or its lenslets are too narrow for the wavelength."""
    if not isinstance(mla, MicrolensArray):
        raise TypeError(f"mla must be a MicrolensArray, got {mla!r}.")
    width = mla.pitch if mla.gap == "clear" else mla.diameter
    if width < MIN_LENSLET_WAVELENGTHS * wavelength:
        raise ValueError(
            f"Lenslets must be at least {MIN_LENSLET_WAVELENGTHS:g} wavelengths wide, got "
            f"{width:g} m for {wavelength:g} m: use wavelengths below "
            f"{width / MIN_LENSLET_WAVELENGTHS:g} m. Lengths are in metres."
        )


def lenslet_pixels(mla: MicrolensArray, number: float | None, pixels: PixelArray | None) -> float:
    """Return the pixels a lenslet, from their number or their pitch."""
    if pixels is not None and not isinstance(pixels, PixelArray):
        raise TypeError(f"pixels must be a PixelArray, such as PixelArray(), got {pixels!r}.")
    pitch = None if pixels is None else pixels.pitch
    if number is None and pitch is None:
        raise ValueError(
            "Pixels must have a size: give pixels_per_lenslet, or pixels=PixelArray(pitch=...)."
        )
    if number is not None and not (is_finite(number) and number > 0):
        raise SamplingError(f"pixels_per_lenslet must be a number >= 2, got {number!r}.")
    if pitch is None:
        assert number is not None
        return number
    across = mla.pitch / pitch
    if number is not None and abs(number - across) > PITCH_TOLERANCE * across:
        raise ValueError(
            f"pixels_per_lenslet = {number!r} contradicts the pixel pitch of {pitch:g} m, with "
            f"{across:.6g} pixels for a lenslet of {mla.pitch:g} m: give only one of the two."
        )
    return across


def require_lengths(**lengths: float | None) -> None:
    """Raise for lengths that are not positive and finite, or not in metres; None is allowed."""
    for name, value in lengths.items():
        if value is not None and not (is_finite(value) and value > 0):
            raise ValueError(f"{name} must be > 0, in metres, got {value!r}.")
        if value is not None and name in _LENGTHS:
            _LENGTHS[name].check(value, name)
