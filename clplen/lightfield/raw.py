"""Raw lenslet images: what the sensor recorded, and where the sub-images lie on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.hostarray import OnDevice
from clplen.compute.oneline import OneLine
from clplen.errors import ShapeError

if TYPE_CHECKING:
    from clplen.cameras.scenes.ground_truth import Truth
    from clplen.compute.image import Image
    from clplen.lightfield.lattice import Lattice

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
        """"standard", "focused" or "microscope"."""

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


def is_telecentric(source: Any) -> bool:
    """Whether what took a light field has its exit pupil at infinity."""
    return bool(getattr(getattr(source, "camera", None), "telecentric", False))


@dataclass(frozen=True, repr=False)
class LensletGrid(OneLine):
    """Centres of the sub-images on the sensor, in pixels; pixel centres are integers.

    Sub-image (i, k) has its centre at ``first + i row_step + k column_step``, and odd rows are
    moved by ``odd_row_shift column_step``. View (v, u) of (V, U) lies ``(v - (V - 1)/2)
    row_view_step + (u - (U - 1)/2) column_view_step`` from there.

    Attributes
    ----------
    count : tuple of int
        Sub-images, (rows, columns).
    views : tuple of int
        Pixels taken from each, (V, U).
    first, row_step, column_step : tuple of float
        (y, x) in pixels.
    odd_row_shift : float
        0 for a square lattice, 1/2 for a hexagonal one.
    row_view_step, column_view_step : tuple of float
        (y, x) in pixels; along the rows and columns of the lattice, so that a turned array obeys
        the same law as a straight one.
    columns : tuple or None
        (count, step): how many columns the views have and how far apart, in steps of
        ``column_step`` from ``first``; the rows are interpolated to them. None: those of the
        lenslets of even rows.
    exchanged : bool
        Whether rows and columns of the picture are exchanged here, and views too: L[v, u, y, x]
        is what this grid calls view (u, v) of (x, y).
    """

    count: tuple[int, int]
    views: tuple[int, int]
    first: tuple[float, float]
    row_step: tuple[float, float]
    column_step: tuple[float, float]
    odd_row_shift: float = 0.0
    row_view_step: tuple[float, float] = (1.0, 0.0)
    column_view_step: tuple[float, float] = (0.0, 1.0)
    columns: tuple[int, float] | None = None
    exchanged: bool = False

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(V, U, y, x) of the light field."""
        (V, U), (y, x) = self.views, self.count
        x = x if self.columns is None else self.columns[0]
        return (U, V, x, y) if self.exchanged else (V, U, y, x)


@dataclass(frozen=True)
class LensType:
    """One of the kinds of lenses of a multi-focus array.

    Its lenses lie at ``origin + offset + i steps[0] + k steps[1]`` for all integers i and k, with
    the origin of the array's lattice.

    Attributes
    ----------
    offset : tuple of float
        (y, x) in pixels.
    depth_range : tuple of float
        (least, greatest) virtual depth at which it is sharp.
    steps : tuple
        Two vectors (y, x) in pixels.
    """

    offset: tuple[float, float]
    depth_range: tuple[float, float]
    steps: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False, repr=False)
class RawImage(OnDevice):
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
    truth : Truth or None
        Of a synthetic scene, on the lattice of the light field that it decodes to.
    """

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
    truth: Truth | None = None

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
