"""Raw lenslet images: what the sensor records, its noise, and where sub-images lie on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_finite, is_integer
from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid, LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.results import Plottable, Savable

Spacing = tuple[float, float, float, float]
Transforms = tuple[tuple[int, tuple[int, int]], ...]
LARGEST_PRNU = 0.3
_PATTERN = (0, 1288)  # of seeds: the pixels' sensitivities, apart from every frame's noise


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
    wavelengths : int or None
        By which sources with a spectrum, and all before colour filters, were exposed: the most
        that a source took.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=5, fill="full")
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.03, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=15
    ... )
    >>> camera.expose(clplen.PointSources((0, 0, 0))).exposure.route
    'local'
    """

    route: str
    transforms: Transforms
    error: float
    snapshots: int | None = None
    standard_error: Image | None = None
    relative_error: float | None = None
    wavelengths: int | None = None

    def __str__(self) -> str:
        count = sum(n for n, _ in self.transforms)
        shapes = ", ".join(f"{n} of {ny} x {nx}" for n, (ny, nx) in self.transforms)
        text = f"{self.route}: {count} Fourier transforms ({shapes})"
        if "isoplanatic" in self.route or self.snapshots is None:
            text += f", error {self.error:.2g}"
        if self.wavelengths is not None:
            text += f", {self.wavelengths} wavelength" + "s" * (self.wavelengths != 1)
        if self.snapshots is None:
            return text
        text += f", {self.snapshots} snapshot" + "s" * (self.snapshots != 1)
        if self.relative_error is None or not self.snapshots > 1:
            return text
        return f"{text}, standard error {self.relative_error:.2g} of the mean"


class CameraModel(Protocol):
    """What the light-field tower asks of a camera; all lengths in metres.
    """

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


def tiled(tile: Any, shape: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Return a tile, such as one of colour filters, repeated over a sensor of a shape (ny, nx)."""
    (down, across), (ny, nx) = np.shape(tile), shape
    return np.tile(tile, (-(-ny // down), -(-nx // across)))[:ny, :nx]


def is_telecentric(source: Any) -> bool:
    """Whether what took a light field has its exit pupil at infinity."""
    return bool(getattr(getattr(source, "camera", None), "telecentric", False))


@dataclass(frozen=True)
class Levels:
    """What the digital numbers of a sensor mean.

    Attributes
    ----------
    black : float
        Number of a pixel without light.
    white : float
        Number of a saturated pixel.
    bit_depth : int
        Of the converter: numbers go from 0 to 2^bit_depth - 1.

    Examples
    --------
    >>> levels = clplen.lightfield.Levels(64.0, 1023.0, 10)
    >>> levels.white - levels.black
    959.0
    """

    black: float
    white: float
    bit_depth: int


@dataclass(frozen=True, eq=False, repr=False)
class RawImage(Savable, Plottable, OnDevice):
    """A raw lenslet image with its geometry.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (ny, nx), as it lies on the sensor (not inverted); (ny, nx, 3) of a colour
        picture, which `LightField.from_raw` does not take.
    device : Device
        The device that holds them.
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
    mosaic : tuple of tuple of str or None
        Names of the colour filters over the pixels, row by row, which repeat from pixel (0, 0) on.
    levels : Levels or None
        What the numbers of a sensor with ``bit_depth`` mean.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> raw.shape, raw.sub_images.count, f"{raw.pixel_pitch * 1e6:.0f} um"
    ((55, 55), (11, 11), '20 um')
    >>> clplen.LightField.from_raw(raw).shape
    (5, 5, 11, 11)
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
    mosaic: tuple[tuple[str, ...], ...] | None = None
    levels: Levels | None = None

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

    def above_black(self) -> RawImage:
        """The raw image less its black level; itself where there is none."""
        if self.levels is None or self.levels.black == 0:
            return self
        lit = self.device.upload(self.to_numpy() - np.float32(self.levels.black))
        return replace(self, data=lit, levels=None)

    def to_numpy(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """The pixel values, float32, shape (ny, nx) or (ny, nx, 3)."""
        return self.device.download(self.data)


Gains = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Sensor:
    """A photon-counting model; everything is off by default.

    Parameters
    ----------
    exposure : float, optional
        Photo-electrons for one unit of the raw image: of energy (a source of power 1), or, behind
        colour filters, of signal. None leaves these units and switches everything else off.
    shot_noise : bool
        Poisson noise of the electrons, those of the dark current too.
    read_noise : float
        Standard deviation in electrons a pixel.
    full_well : float, optional
        Electrons at which a pixel saturates.
    bit_depth : int, optional
        Bits of the converter: whole numbers from 0 to 2^bit_depth - 1. ``full_well`` is then
        needed: it gives ``white_level``.
    seed : int
        The same seed and image give the same noise; images of two devices differ by rounding, and
        with it a few of the pixels' photons.
    prnu : float
        Photo response non-uniformity: standard deviation of the pixels' sensitivities, relative to
        their mean, 0 to .3; normally distributed, and the same in all frames of a seed.
    dark_current : float
        Electrons a pixel and second; it needs ``exposure_time``.
    exposure_time : float
        In seconds. It makes dark current only: the light's electrons are those of ``exposure``.
    black_level : float
        Number of a pixel without electrons; it needs ``bit_depth``. Read noise goes below it.
    white_level : float, optional
        Number of a pixel at its full well with a gain of 1; default 2^bit_depth - 1.
    gain : float or mapping of str to float
        Amplification between pixel and converter, one for all or one for each colour filter. A
        gain of 2 reaches ``white_level`` at half the full well.
    frame : int
        Number of the frame: others of the same seed have the same ``prnu`` and other noise.

    Raises
    ------
    ValueError
        For a value outside its range, or noise and bits asked for without an exposure.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=clplen.MicrolensArray(100e-6, 1e-3, count=11),
    ...     wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> sensor = clplen.Sensor(exposure=1e5, shot_noise=True, full_well=2e4, bit_depth=10)
    >>> taken = sensor.record(raw)
    >>> taken.levels
    Levels(black=0.0, white=1023.0, bit_depth=10)
    >>> bool((taken.to_numpy() % 1 == 0).all())  # whole numbers
    True
    """

    exposure: float | None = None
    shot_noise: bool = False
    read_noise: float = 0.0
    full_well: float | None = None
    bit_depth: int | None = None
    seed: int = 0
    _: KW_ONLY
    prnu: float = 0.0
    dark_current: float = 0.0
    exposure_time: float = 0.0
    black_level: float = 0.0
    white_level: float | None = None
    gain: float | Mapping[str, float] | Gains = 1.0
    frame: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", _gains(self.gain))
        self._check_electrons()
        self._check_numbers()

    def _check_electrons(self) -> None:
        for name in ("exposure", "full_well"):
            value = getattr(self, name)
            if value is not None and not (is_finite(value) and value > 0):
                raise ValueError(f"{name} is a positive number of electrons, not {value!r}.")
        for name, unit in (
            ("read_noise", "electrons"),
            ("dark_current", "electrons a pixel and second"),
            ("exposure_time", "seconds"),
        ):
            value = getattr(self, name)
            if not (is_finite(value) and value >= 0):
                raise ValueError(f"{name} is not negative, in {unit}, not {value!r}.")
        if not (is_finite(self.prnu) and 0 <= self.prnu <= LARGEST_PRNU):
            raise ValueError(
                f"prnu is a share of the sensitivity, 0 to {LARGEST_PRNU:g}, not {self.prnu!r}: "
                "1 % is .01."
            )
        if self.dark_current and not self.exposure_time:
            raise ValueError("dark_current needs exposure_time, in seconds.")
        for name in ("seed", "frame"):
            value = getattr(self, name)
            if not is_integer(value) or value < 0:
                raise ValueError(f"{name} is a whole number, not negative, not {value!r}.")
        wants = (
            self.shot_noise or self.read_noise or self.full_well or self.bit_depth or self.prnu
            or self.dark_current
        )  # fmt: skip
        if wants and self.exposure is None:
            raise ValueError("Noise, saturation and bits need exposure, electrons a unit energy.")

    def _check_numbers(self) -> None:
        bits = self.bit_depth
        if bits is not None and not (is_integer(bits) and 1 <= bits <= 24):
            raise ValueError(f"bit_depth is a whole number between 1 and 24, not {bits!r}.")
        if bits is not None and self.full_well is None:
            raise ValueError("bit_depth needs full_well, the electrons of the largest number.")
        if bits is None:
            for name, default in (("black_level", 0.0), ("white_level", None), ("gain", 1.0)):
                if getattr(self, name) != default:
                    raise ValueError(f"{name} is of digital numbers: give bit_depth too.")
            return
        top = 2 ** int(bits) - 1
        white = top if self.white_level is None else self.white_level
        if not (is_finite(self.black_level) and is_finite(white)) or not (
            0 <= self.black_level < white <= top
        ):
            raise ValueError(
                f"Levels of {bits} bits are 0 <= black_level < white_level <= {top}, not "
                f"{self.black_level!r} and {white!r}."
            )

    def record(self, raw: RawImage) -> RawImage:
        """The raw image as this sensor delivers it.

        Photo-electrons times the pixel's own sensitivity, plus dark current, as Poisson numbers,
        plus read noise, cut off at the full well; times the gain, on the levels of the converter
        (EMVA 1288, release 4.0, section 2).

        Parameters
        ----------
        raw : RawImage
            In units of energy, or of signal behind colour filters.

        Returns
        -------
        RawImage
            float32: electrons, or with ``bit_depth`` whole numbers from 0 to 2^bit_depth - 1, with
            their ``levels``.

        Raises
        ------
        ValueError
            If there are gains for filters, and the raw image has others or none.
        """
        if self.exposure is None:
            return raw
        gain = self._gain(raw)
        electrons = np.maximum(raw.to_numpy().astype(np.float64), 0) * self.exposure
        if self.prnu:
            pattern = np.random.default_rng([self.seed, *_PATTERN]).normal(size=electrons.shape)
            electrons *= np.maximum(1 + self.prnu * pattern, 0)
        electrons += self.dark_current * self.exposure_time
        random = np.random.default_rng(self.seed if not self.frame else [self.seed, self.frame])
        if self.shot_noise:
            electrons = random.poisson(electrons).astype(np.float64)
        if self.read_noise:
            electrons = electrons + random.normal(0, self.read_noise, electrons.shape)
        if self.full_well is not None:
            electrons = np.minimum(electrons, self.full_well)
        levels = None
        if self.bit_depth is not None and self.full_well is not None:
            top = 2 ** int(self.bit_depth) - 1
            white = float(top if self.white_level is None else self.white_level)
            per_electron = gain * ((white - self.black_level) / self.full_well)
            electrons = np.clip(np.rint(self.black_level + electrons * per_electron), 0, top)
            levels = Levels(float(self.black_level), white, int(self.bit_depth))
        data = raw.device.upload(electrons.astype(np.float32))
        return replace(raw, data=data, levels=levels)

    def _gain(self, raw: RawImage) -> Any:
        """The gain of every pixel."""
        if isinstance(self.gain, float):
            return self.gain
        gains, names = dict(self.gain), {name for row in raw.mosaic or () for name in row}
        if names != set(gains):
            found = ", ".join(sorted(names)) or "none"
            raise ValueError(
                f"gain is of the colour filters {', '.join(sorted(gains))}, and the raw image has "
                f"{found}: give one number, or a gain for each of its filters."
            )
        assert raw.mosaic is not None
        tile = np.array([[gains[name] for name in row] for row in raw.mosaic])
        return tiled(tile, raw.shape)


def _gains(gain: Any) -> float | Gains:
    """One gain or one for each colour filter, checked."""
    pairs = gain if isinstance(gain, tuple) else None
    if isinstance(gain, Mapping):
        pairs = tuple(gain.items())
    for value in [gain] if pairs is None else [value for _, value in pairs] or [None]:
        if not (is_finite(value) and value > 0):
            raise ValueError(
                "gain is a number above 0, or one for each colour filter, such as {'R': 2.0, "
                f"'G': 1.0, 'B': 1.5}}, not {gain!r}."
            )
    if pairs is None:
        return float(gain)
    return tuple((str(name), float(value)) for name, value in pairs)


def merged(transforms: Iterable[tuple[int, tuple[int, int]]]) -> Transforms:
    """Return one entry for each shape of transforms."""
    counts: dict[tuple[int, int], int] = {}
    for n, shape in transforms:
        counts[shape] = counts.get(shape, 0) + n
    return tuple((n, shape) for shape, n in counts.items())
