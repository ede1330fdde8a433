"""Raw lenslet images: what the sensor records, its noise, and where sub-images lie on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
        "points", one field a point as large as the sensor, "local", a window of its own for each
        point, "isoplanatic", a picture from patterns at a few places,
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


@dataclass(frozen=True)
class Sensor:
    """A photon-counting model; everything is off by default.

    Parameters
    ----------
    exposure : float, optional
        Photo-electrons for one unit of energy (a source of power 1); None leaves energy units and
        switches everything else off.
    shot_noise : bool
        Poisson noise of the photo-electrons.
    read_noise : float
        Standard deviation in electrons a pixel.
    full_well : float, optional
        Electrons at which a pixel saturates.
    bit_depth : int, optional
        Round to 2^bit_depth - 1 equal steps up to ``full_well``, which is then needed.
    seed : int
        The same seed and image give the same noise; images of two devices differ by rounding, and
        with it a few of the pixels' photons.

    Raises
    ------
    ValueError
        For a value outside its range, or noise and bits asked for without an exposure.
    """

    exposure: float | None = None
    shot_noise: bool = False
    read_noise: float = 0.0
    full_well: float | None = None
    bit_depth: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("exposure", "full_well"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is a positive number of electrons, not {value!r}.")
        if not (math.isfinite(self.read_noise) and self.read_noise >= 0):
            raise ValueError(f"read_noise is not negative, in electrons, not {self.read_noise!r}.")
        if self.bit_depth is not None and (
            int(self.bit_depth) != self.bit_depth or not 1 <= self.bit_depth <= 24
        ):
            raise ValueError(
                f"bit_depth is a whole number between 1 and 24, not {self.bit_depth!r}."
            )
        if int(self.seed) != self.seed or self.seed < 0:
            raise ValueError(f"seed is a whole number, not negative, not {self.seed!r}.")
        if self.bit_depth is not None and self.full_well is None:
            raise ValueError("bit_depth needs full_well, the electrons of the largest number.")
        wants = self.shot_noise or self.read_noise or self.full_well or self.bit_depth
        if wants and self.exposure is None:
            raise ValueError("Noise, saturation and bits need exposure, electrons a unit energy.")

    def record(self, raw: RawImage) -> RawImage:
        """The raw image as this sensor delivers it.

        Parameters
        ----------
        raw : RawImage
            In units of energy.

        Returns
        -------
        RawImage
            float32: electrons, or with ``bit_depth`` whole numbers from 0 to 2^bit_depth - 1.
        """
        if self.exposure is None:
            return raw
        electrons = np.maximum(raw.to_numpy().astype(np.float64), 0) * self.exposure
        random = np.random.default_rng(self.seed)
        if self.shot_noise:
            electrons = random.poisson(electrons).astype(np.float64)
        if self.read_noise:
            electrons = electrons + random.normal(0, self.read_noise, electrons.shape)
        if self.full_well is not None:
            electrons = np.minimum(electrons, self.full_well)
        if self.bit_depth is not None and self.full_well is not None:
            top = 2**self.bit_depth - 1
            electrons = np.clip(np.rint(electrons * (top / self.full_well)), 0, top)
        return replace(raw, data=raw.device.upload(electrons.astype(np.float32)))
