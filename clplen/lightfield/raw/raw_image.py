"""Raw lenslet images: what the sensor recorded, and where the sub-images lie on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid, LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.results import Plottable, Savable

Spacing = tuple[float, float, float, float]
Transforms = tuple[tuple[int, tuple[int, int]], ...]


@dataclass(frozen=True, eq=False)
class Exposure:
    """How a raw image was simulated, and how exact it is.

    Attributes
    ----------
    route : str
        "points", one field a point, "isoplanatic", a picture from patterns at a few places,
        "snapshots", slides in partially coherent light, or "coherent", slides in a plane wave;
        several joined by " + ".
    transforms : tuple
        Fourier transforms as (how many, (ny, nx)) for each shape.
    error : float
        Measured deviation from one field a point, relative to the maximum: for a picture the
        largest over three of its samples exposed both ways, 0 for the other routes. What snapshots
        leave is in ``standard_error``.
    snapshots : int or None
        Of partially coherent light.
    standard_error : Image or None
        Of every pixel, from the scatter of the snapshots.
    relative_error : float or None
        Standard error over mean: rms over the region, divided by its mean.
    """

    route: str
    transforms: Transforms
    error: float
    snapshots: int | None = None
    standard_error: Image | None = None
    relative_error: float | None = None

    def __str__(self) -> str:
        count = sum(n for n, _ in self.transforms)
        shapes = ", ".join(f"{n} of {ny} x {nx}" for n, (ny, nx) in self.transforms)
        text = f"{self.route}: {count} Fourier transforms ({shapes})"
        if "isoplanatic" in self.route or self.snapshots is None:
            text += f", error {self.error:.2g}"
        if self.snapshots is None:
            return text
        text += f", {self.snapshots} snapshot" + "s" * (self.snapshots != 1)
        if self.relative_error is None or not self.snapshots > 1:
            return text
        return f"{text}, standard error {self.relative_error:.2g} of the mean"


class CameraModel(Protocol):
    """What the light-field tower asks of a camera; all lengths in metres."""

    @property
    def kind(self) -> str:
        """ "standard", "focused" or "microscope"."""

    @property
    def image_distance(self) -> float:
        """F, main lens to microlens array."""

    @property
    def aperture_diameter(self) -> float:
        """D, of the main lens."""

    @property
    def pixel_pitch(self) -> float:
        """Sample spacing on the sensor."""

    @property
    def wavelength(self) -> float:
        """Of the light."""

    @property
    def lenslet_pitch(self) -> float:
        """p, between neighbouring lenslets of a row."""

    @property
    def lenslet_diameter(self) -> float:
        """d, of a lenslet's aperture."""

    @property
    def lenslet_focal_length(self) -> float:
        """f_mu."""

    @property
    def lenslet_fill(self) -> str:
        """Aperture of a lenslet: "circular", a disc, or "full", the cell of the lattice."""

    @property
    def lenslet_lattice(self) -> str:
        """Lattice of the lenslets, "square" or "hexagonal"."""

    def alpha(self, dz: Any) -> Any:
        """alpha = F/F' of an object at dz from the focused plane."""

    def dz(self, alpha: Any) -> Any:
        """The inverse of `alpha`."""


class DepthTruth(Protocol):
    """Exact depth of the centre view, float32 maps of shape (y, x)."""

    @property
    def disparity(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """In pixels a view step; NaN where there is no surface."""

    @property
    def z(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Metres from the focused plane, farther positive; NaN where not known."""


def is_telecentric(source: Any) -> bool:
    """Whether what took a light field has its exit pupil at infinity."""
    return bool(getattr(getattr(source, "camera", None), "telecentric", False))


@dataclass(frozen=True, eq=False, repr=False)
class RawImage(Savable, Plottable, OnDevice):
    """A raw lenslet image with its geometry.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (ny, nx), as it lies on the sensor (not inverted); (ny, nx, 3) of a colour
        picture, which `LightField.from_raw` does not take.
    device : Device
    pixel_pitch : float
        In metres; NaN where a file does not tell.
    sub_images : LensletGrid
        Where the images of the main lens' pupil lie (chief rays).
    cells : LensletGrid
        The lenslets' own cells.
    spacing : tuple of float
        Signed (dv, du, dy, dx) in metres of the light field that it decodes to.
    camera : CameraModel or None
        The camera that took it.
    exposure : Exposure or None
        How a camera of this package simulated it.
    lattice : Lattice or None
        Of a captured image: all its lenslets, of which ``sub_images`` are a full rectangle.
    lens_types : tuple of LensType
        Of a multi-focus array; empty for lenses of one kind.
    truth : DepthTruth or None
        Of a synthetic scene, on the lattice of the light field that it decodes to.
    """

    _writer: ClassVar[str] = "write_raw"
    _figure: ClassVar[str] = "raw_image"

    data: cla.Array
    device: Device
    pixel_pitch: float
    sub_images: LensletGrid
    cells: LensletGrid
    spacing: Spacing | None = None
    camera: CameraModel | None = None
    exposure: Exposure | None = None
    lattice: Lattice | None = None
    lens_types: tuple[LensType, ...] = ()
    truth: DepthTruth | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.data.shape) not in (2, 3) or self.data.shape[2:] not in ((), (3,)):
            raise ShapeError(
                f"A raw image has shape (ny, nx) or (ny, nx, 3), not {tuple(self.data.shape)}."
            )
        if self.data.dtype != np.float32:
            raise TypeError(f"A raw image on the device is float32, not {self.data.dtype}.")

    def __repr__(self) -> str:
        count = " x ".join(map(str, self.sub_images.count))
        return f"<RawImage {self.shape} {self.data.dtype}, {count} lenslets, {self.device.name}>"

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        return (int(self.data.shape[0]), int(self.data.shape[1]))

    def to_numpy(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """The pixel values, float32, shape (ny, nx) or (ny, nx, 3)."""
        return self.device.download(self.data)
