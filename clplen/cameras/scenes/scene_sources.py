"""Sources of light before a camera: points and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from clplen import units
from clplen.cameras.scenes.occluders import Occluder, check_plane
from clplen.checks import is_finite, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.reprs import OneLine
from clplen.wave.spectrum.spectral_distribution import SpectralDistribution, as_spectrum
from clplen.wave.spectrum.spectrum import Spectrum

Light = Spectrum | SpectralDistribution


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PointSources(OneLine):
    """Mutually incoherent point-like sources.

    Parameters
    ----------
    positions : array_like
        Positions (x, y, dz) in metres relative to the axis point of the focused object plane, shape
        (n, 3) or (3,); dz > 0 is farther from the lens.
    diameter : float
        Diameter of each source as a uniform coherent disc, in metres; 0 is a point.
    power : float or array_like
        Energy that leaves the main lens' aperture, >= 0: one value, or a value for each source.
        With a spectrum, it is the sum over all wavelengths.
    spectrum : Spectrum or SpectralDistribution, optional
        Distribution of the power over the wavelengths, for all sources. None: the spectrum of
        ``coherence=`` in `expose`, else the camera's wavelength.

    Attributes
    ----------
    positions : numpy.ndarray
        Positions in metres, float64, shape (n, 3).
    diameter : float
        Diameter in metres.
    power : numpy.ndarray
        Energies, float64, shape (n,).
    spectrum : Spectrum or None
        Spectrum of the light.

    Raises
    ------
    TypeError
        If the spectrum has another type.
    ValueError
        If a position is not three finite numbers, there are no positions, the diameter or a power
        is negative, or the numbers of powers and positions differ.

    Examples
    --------
    >>> points = clplen.PointSources([(0, 0, 0), (20e-6, 0, 1e-3)], power=[1.0, 0.5])
    >>> len(points), points.positions.shape, points.power.tolist()
    (2, (2, 3), [1.0, 0.5])
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> camera.expose(points)
    <RawImage (55, 55) float32, 11 x 11 lenslets, ...>
    """

    positions: np.ndarray[Any, np.dtype[np.float64]]
    diameter: float
    power: np.ndarray[Any, np.dtype[np.float64]]
    spectrum: Spectrum | None

    def __init__(
        self,
        positions: Sequence[Sequence[float]] | np.ndarray[Any, Any],
        *,
        diameter: float = 0.0,
        power: float | Sequence[float] | np.ndarray[Any, Any] = 1.0,
        spectrum: Light | None = None,
    ) -> None:
        points = np.atleast_2d(_numbers(positions, "Positions of sources")).copy()
        if points.ndim != 2 or points.shape[1] != 3 or points.shape[0] == 0:
            raise ValueError(
                f"positions must be (x, y, dz) of each source, shape (n, 3), got {points.shape}."
            )
        if not np.isfinite(points).all():
            raise ValueError("positions must be finite numbers of metres.")
        if not (is_finite(diameter) and diameter >= 0):
            raise ValueError(f"diameter must be >= 0, in metres, got {diameter!r}.")
        units.POINT.check(diameter, "The diameter of sources")
        powers = _numbers(power, "Powers of sources")
        if powers.ndim and powers.shape != (len(points),):
            raise ValueError(f"power must be one value or {len(points)}, got shape {powers.shape}.")
        powers = np.broadcast_to(powers, (len(points),)).copy()
        if not (np.isfinite(powers).all() and (powers >= 0).all()):
            raise ValueError("power must be finite and >= 0.")
        object.__setattr__(self, "positions", points)
        object.__setattr__(self, "diameter", float(diameter))
        object.__setattr__(self, "power", powers)
        light = None if spectrum is None else as_spectrum(spectrum, "The spectrum of sources")
        object.__setattr__(self, "spectrum", light)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def spectra(self) -> tuple[Spectrum] | None:
        """Spectra of the channels, as of a picture with one channel."""
        return None if self.spectrum is None else (self.spectrum,)

    def chosen(self, which: slice | Sequence[int]) -> PointSources:
        """Return a selection of the sources, by a slice or indices."""
        return PointSources(
            self.positions[which],
            diameter=self.diameter,
            power=self.power[which],
            spectrum=self.spectrum,
        )


def _numbers(values: Any, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return an array of real numbers."""
    try:
        return real_array(values, what, np.float64)
    except TypeError:
        raise ValueError(f"{what} must be real numbers, got {values!r}.") from None


Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PicturePlane(OneLine, HostArray):
    """Flat picture across the optical axis.

    Sample i of an axis of n samples lies at (i - n//2) width/nx from the axis: pixels are square,
    rows go along +y. A list of planes is a scene: their light adds up, and a plane attenuates the
    light from behind it by its ``opacity``.

    Parameters
    ----------
    image : array_like
        Picture of shape (ny, nx), or (ny, nx, c) with a spectrum for each of c channels; finite, >=
        0, not all 0. In emission, samples are energies through the main lens' aperture for each
        channel, as of `PointSources` at their positions. In transmission, samples are the intensity
        transmittance of a slide, at most 1, without channels.
    width : float
        Width of the whole picture along x in metres, nx pixels.
    z : float
        Distance from the focused object plane in metres; > 0 is farther from the lens.
    mode : {"emission", "transmission"}
        "emission": self-luminous, all samples mutually incoherent. "transmission": a slide.
    spectra : Spectrum, SpectralDistribution, or sequence of them, optional
        Spectrum of each channel of unit power, the distribution of its energy over the wavelengths.
        None: the spectrum of ``coherence=`` in `expose`, else the camera's wavelength.
    opacity : float or array_like, optional
        Fraction from 0 to 1 of the light from behind that is blocked, as of an `Occluder`: one
        value, or shape (ny, nx). None: 0.
        that it stops, as of an `Occluder`. None: the picture hides nothing.

    Attributes
    ----------
    image : numpy.ndarray
        Samples, float64, shape (ny, nx) or (ny, nx, c).
    width, z : float
        Width and distance in metres.
    mode : str
        "emission" or "transmission".
    spectra : tuple of Spectrum or None
        Spectrum of each channel.
    occluder : Occluder or None
        Screen of the picture's opacity.

    Raises
    ------
    ShapeError
        If the image is empty, or neither two-dimensional nor of channels with a spectrum each.
    TypeError
        If the image or a spectrum has another type.
    ValueError
        If samples, the width, z or the mode are outside their range, or a slide has spectra.

    Examples
    --------
    Surface in daylight; the channels of the image are fractions of its reflectance:

    >>> curve, bands = clplen.wave.SpectralDistribution, np.array([450e-9, 550e-9, 650e-9])
    >>> daylight = curve.illuminant("D65")
    >>> light = [daylight * curve(bands, share) for share in np.eye(3)]  # blue, green, red
    >>> energies = np.ones((16, 24, 3)) * [one.integral / daylight.integral for one in light]
    >>> plane = clplen.PicturePlane(energies, 4e-3, spectra=light)
    >>> plane.image.shape, len(plane.spectra)
    ((16, 24, 3), 3)
    """

    _samples: ClassVar[str] = "image"

    image: Vector
    width: float
    z: float
    mode: str
    spectra: tuple[Spectrum, ...] | None
    occluder: Occluder | None

    def __init__(
        self,
        image: Any,
        width: float,
        z: float = 0.0,
        *,
        mode: Literal["emission", "transmission"] = "emission",
        spectra: Light | Sequence[Light] | None = None,
        opacity: Any = None,
    ) -> None:
        try:
            values = np.array(real_array(image, "A picture", np.float64))
        except TypeError as error:
            raise TypeError(
                f"image must be an array of real numbers, (ny, nx), got {type(image).__name__}."
            ) from error
        light = _spectra(spectra)
        if values.ndim not in (2, 3) or values.size == 0:
            raise ShapeError(
                f"image must have shape (ny, nx), or (ny, nx, c) with spectra=, got {values.shape}."
            )
        _check_channels(values.shape, light)
        if light is not None and mode == "transmission":
            raise ValueError(
                "spectra must be None for a slide: give the spectrum of the light on it, "
                "coherence=Coherence(spatial, spectrum), to expose()."
            )
        if mode not in ("emission", "transmission"):
            raise ValueError(f"mode must be 'emission' or 'transmission', got {mode!r}.")
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError("image must be finite and >= 0.")
        if not values.any():
            raise ValueError("image must have a sample above 0: this picture sends no light.")
        if mode == "transmission" and values.max() > 1:
            raise ValueError(
                f"A slide must transmit at most 1, got {values.max():g}: divide by its largest "
                "sample."
            )
        check_plane("a picture", width, z)
        object.__setattr__(self, "image", values)
        object.__setattr__(self, "width", float(width))
        object.__setattr__(self, "z", float(z))
        object.__setattr__(self, "mode", mode)
        object.__setattr__(self, "spectra", light)
        object.__setattr__(self, "occluder", self._occluder(opacity))

    @property
    def is_slide(self) -> bool:
        """True for a slide, which needs illumination."""
        return self.mode == "transmission"

    @property
    def pitch(self) -> float:
        """Distance of neighbouring samples in metres."""
        return self.width / self.image.shape[1]

    @property
    def y(self) -> Vector:
        """Coordinates of the rows in metres, shape (ny,)."""
        return self._axis(0)

    @property
    def x(self) -> Vector:
        """Coordinates of the columns in metres, shape (nx,)."""
        return self._axis(1)

    def positions(self) -> Vector:
        """Return (x, y, dz) of every sample in metres, row by row, shape (ny nx, 3)."""
        y, x = np.meshgrid(self.y, self.x, indexing="ij")
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, self.z)], axis=-1)

    def points(self) -> PointSources:
        """Return samples above 0 as point sources, with the energy of all channels."""
        power = self.energy.ravel()
        lit = power > 0
        return PointSources(self.positions()[lit], power=power[lit])

    @property
    def energy(self) -> Vector:
        """Energy of each sample, summed over channels, shape (ny, nx)."""
        return self.image if self.image.ndim == 2 else self.image.sum(axis=2)

    def corners(self) -> PointSources:
        """Return the corners of the rectangle that contains every sample above 0."""
        lit = self.energy > 0
        y, x = self.y[lit.any(axis=1)], self.x[lit.any(axis=0)]
        return PointSources([(a, b, self.z) for b in (y[0], y[-1]) for a in (x[0], x[-1])])

    def _occluder(self, opacity: Any) -> Occluder | None:
        if opacity is None:
            return None
        if self.is_slide:
            raise ValueError("opacity must be None for a slide: its samples are the transmittance.")
        values = np.full(self.image.shape[:2], opacity) if np.ndim(opacity) == 0 else opacity
        if np.shape(values) != self.image.shape[:2]:
            raise ShapeError(
                f"opacity must be one number or have the picture's shape {self.image.shape[:2]}, "
                f"got {np.shape(values)}."
            )
        return Occluder(values, self.width, self.z)

    def _axis(self, axis: int) -> Vector:
        n = self.image.shape[axis]
        return (np.arange(n) - n // 2) * self.pitch


def _spectra(spectra: Any) -> tuple[Spectrum, ...] | None:
    """Return checked spectra of channels."""
    if spectra is None:
        return None
    several = spectra if isinstance(spectra, list | tuple) else [spectra]
    return tuple(as_spectrum(spectrum, "Each of spectra") for spectrum in several)


def _check_channels(shape: tuple[int, ...], spectra: tuple[Spectrum, ...] | None) -> None:
    """Raise unless every channel has one spectrum."""
    channels = shape[2] if len(shape) == 3 else 1
    if spectra is None and len(shape) == 3:
        raise ShapeError(
            f"A picture of shape {shape} has {channels} channels: give a spectrum for each, "
            "spectra=[...], or one channel of shape (ny, nx)."
        )
    if spectra is not None and len(spectra) != channels:
        raise ShapeError(
            f"spectra must have {channels} element{'s' * (channels > 1)} for a picture of shape "
            f"{shape}, got {len(spectra)}."
        )


Source = PointSources | PicturePlane


def as_sources(scene: Any) -> tuple[Source, ...]:
    """Return the sources of a scene: itself, or the members of a list that send light."""
    members = _members(scene)
    if not members:
        raise ValueError("scene must not be an empty list: use PointSources or PicturePlanes.")
    for member in members:
        if not isinstance(member, PointSources | PicturePlane | Occluder):
            raise TypeError(
                "scene must be PointSources, a PicturePlane or a list of them and of Occluders, "
                f"got {type(member).__name__}."
            )
    sources = tuple(member for member in members if not isinstance(member, Occluder))
    if not sources:
        raise ValueError("scene must contain a source, got Occluders only: add PointSources.")
    return sources


def as_occluders(scene: Any) -> tuple[Occluder, ...]:
    """Return the occluders of a scene, and those of its pictures."""
    members = [m.occluder if isinstance(m, PicturePlane) else m for m in _members(scene)]
    return tuple(member for member in members if isinstance(member, Occluder))


def _members(scene: Any) -> tuple[Any, ...]:
    return tuple(scene) if isinstance(scene, list | tuple) else (scene,)
