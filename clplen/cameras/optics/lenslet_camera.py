"""Cameras with an array of lenslets: lengths of the array, the sensor, checks of both."""

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

NARROWEST = 2.0  # wavelengths across a lenslet
PITCH_TOLERANCE = 1e-6  # relative, between pixels a lenslet and their pitch
_LENGTHS = {
    "focal_length": units.CAMERA_FOCAL_LENGTH,
    "image_distance": units.CAMERA_FOCAL_LENGTH,
    "aperture_diameter": units.CAMERA_DIAMETER,
    "tube_lens": units.TUBE_LENS,
    "relay": units.CAMERA_FOCAL_LENGTH,
    "sensor_distance": units.CAMERA_FOCAL_LENGTH,
    "field_stop": units.IMAGE_PLACE,
    "pixel_pitch": units.PIXEL_PITCH,
}  # an object may be anywhere, and wavelengths have a check of their own


class LensletCamera:
    """A camera with an array of lenslets before its sensor; `Plenoptic1` documents its fields."""

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


def independent_views(
    diameter: float, focal_length: float, wavelength: float, pixels: float
) -> float:
    """Views across that diffraction by a lenslet leaves independent, at most its pixels.

    d^2/(lam f_mu), the width of a sub-image d over that of a spot of diffraction, lam f_mu/d.
    """
    return min(pixels, diameter**2 / (wavelength * focal_length))


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


def check_lenslets(mla: MicrolensArray, wavelength: float) -> None:
    """Refuse what is no array, or one whose lenslets are too narrow for the wavelength."""
    if not isinstance(mla, MicrolensArray):
        raise TypeError(f"mla is a MicrolensArray, not {mla!r}.")
    width = mla.pitch if mla.gap == "clear" else mla.diameter
    if width < NARROWEST * wavelength:
        raise ValueError(
            f"Lenslets of {width:g} m are no lenses for a wavelength of {wavelength:g} m: "
            f"lengths are in metres; wavelengths below {width / NARROWEST:g} m would do."
        )


def lenslet_pixels(mla: MicrolensArray, given: float | None, pixels: PixelArray | None) -> float:
    """Pixels a lenslet, from their number or their pitch."""
    if pixels is not None and not isinstance(pixels, PixelArray):
        raise TypeError(f"pixels is a PixelArray, as PixelArray(), not {pixels!r}.")
    pitch = None if pixels is None else pixels.pitch
    if given is None and pitch is None:
        raise ValueError(
            "The pixels have no size: give pixels_per_lenslet, or pixels=PixelArray(pitch=...)."
        )
    if given is not None and not (is_finite(given) and given > 0):
        raise SamplingError(f"pixels_per_lenslet is a number, at least 2, not {given!r}.")
    if pitch is None:
        assert given is not None
        return given
    across = mla.pitch / pitch
    if given is not None and abs(given - across) > PITCH_TOLERANCE * across:
        raise ValueError(
            f"pixels_per_lenslet = {given!r} contradicts the pixels' pitch of {pitch:g} m, of "
            f"which a lenslet of {mla.pitch:g} m has {across:.6g}: give one of the two."
        )
    return across


def require_lengths(**given: float | None) -> None:
    """Refuse lengths that are not positive and finite, or no metres; None is left out."""
    for name, value in given.items():
        if value is not None and not (is_finite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")
        if value is not None and name in _LENGTHS:
            _LENGTHS[name].check(value, name)
