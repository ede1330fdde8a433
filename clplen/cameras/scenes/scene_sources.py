"""What a camera looks at."""

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
        Shape (n, 3) or (3,): (x, y, dz) in metres relative to the axis point of the focused object
        plane; dz > 0 lies farther from the lens.
    diameter : float
        Each source is a uniform coherent disc of this diameter in metres; 0 is a point.
    power : float or array_like
        Energy that leaves the main lens' aperture, one or one per source, not negative. With a
        spectrum, that of all its wavelengths together.
    spectrum : Spectrum or SpectralDistribution, optional
        Of the light of all these sources: how their power is spread over the wavelengths. None:
        that of ``coherence=`` in `expose`, else the camera's wavelength.

    Attributes
    ----------
    positions : numpy.ndarray
        float64, shape (n, 3).
    diameter : float
        In metres.
    power : numpy.ndarray
        float64, shape (n,).
    spectrum : Spectrum or None
        Of their light.

    Raises
    ------
    TypeError
        If the spectrum is none.
    ValueError
        If a position is not three finite numbers, there is none, the diameter or a power is
        negative, or there are not as many powers as positions.

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
        places = np.atleast_2d(_numbers(positions, "Positions of sources")).copy()
        if places.ndim != 2 or places.shape[1] != 3 or places.shape[0] == 0:
            raise ValueError(
                f"Positions are (x, y, dz) for each source, shape (n, 3), not {places.shape}."
            )
        if not np.isfinite(places).all():
            raise ValueError("Positions of sources are finite numbers of metres.")
        if not (is_finite(diameter) and diameter >= 0):
            raise ValueError(
                f"The diameter of sources is not negative, in metres, not {diameter!r}."
            )
        units.POINT.check(diameter, "The diameter of sources")
        powers = _numbers(power, "Powers of sources")
        if powers.ndim and powers.shape != (len(places),):
            raise ValueError(f"{len(places)} sources have {powers.shape} powers: give one or each.")
        powers = np.broadcast_to(powers, (len(places),)).copy()
        if not (np.isfinite(powers).all() and (powers >= 0).all()):
            raise ValueError("Powers of sources are finite and not negative.")
        object.__setattr__(self, "positions", places)
        object.__setattr__(self, "diameter", float(diameter))
        object.__setattr__(self, "power", powers)
        light = None if spectrum is None else as_spectrum(spectrum, "The spectrum of sources")
        object.__setattr__(self, "spectrum", light)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def spectra(self) -> tuple[Spectrum] | None:
        """The spectrum as that of a picture's channels."""
        return None if self.spectrum is None else (self.spectrum,)

    def chosen(self, which: slice | Sequence[int]) -> PointSources:
        """Some of the sources, by a slice or their indices."""
        return PointSources(
            self.positions[which],
            diameter=self.diameter,
            power=self.power[which],
            spectrum=self.spectrum,
        )


def _numbers(values: Any, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """An array of real numbers."""
    try:
        return real_array(values, what, np.float64)
    except TypeError:
        raise ValueError(f"{what} are real numbers, not {values!r}.") from None


Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PicturePlane(OneLine, HostArray):
    """A flat picture across the optical axis.

    Sample i of an axis of n samples lies at (i - n//2) width/nx from the axis: pixels are square,
    rows go along +y. Several planes make a scene as a list: their light adds up, and a plane hides
    what is behind it as far as its ``opacity`` says.

    Parameters
    ----------
    image : array_like
        Shape (ny, nx), or (ny, nx, c) with a spectrum for each of c channels; finite, not negative,
        not all 0. In emission the energy that each sample sends through the main lens' aperture (a
        picture made of points is `PointSources` at those places), of each channel by itself; in
        transmission the intensity transmittance of a slide, at most 1, without channels.
    width : float
        Of the whole picture along x in metres, nx pixels.
    z : float
        In metres from the focused object plane; > 0 lies farther from the lens.
    mode : {"emission", "transmission"}
        Self-luminous, every sample incoherent with the others, or a slide.
    spectra : Spectrum, SpectralDistribution, or sequence of them, optional
        Of the light of each channel, of unit power: how the energy of its samples is spread over
        the wavelengths. None: that of ``coherence=`` in `expose`, else the camera's wavelength.
    opacity : float or array_like, optional
        Of each sample, shape (ny, nx), or of all: the share from 0 to 1 of the light from behind
        that it stops, as of an `Occluder`. None: the picture hides nothing.

    Attributes
    ----------
    image : numpy.ndarray
        float64, shape (ny, nx) or (ny, nx, c).
    width, z : float
        In metres.
    mode : str
        "emission" or "transmission".
    spectra : tuple of Spectrum or None
        One a channel.
    occluder : Occluder or None
        What hides the light from behind.

    Raises
    ------
    ShapeError
        If the image is neither two-dimensional nor of channels with a spectrum each, or empty.
    TypeError
        If the image or a spectrum is none.
    ValueError
        For samples, a width, a z or a mode outside their range, or a slide with spectra.

    Examples
    --------
    A surface in daylight, whose reflectance each channel of an image is a share of:

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
                f"A picture is an array of real numbers, (ny, nx), not {type(image).__name__}."
            ) from error
        light = _spectra(spectra)
        if values.ndim not in (2, 3) or values.size == 0:
            raise ShapeError(
                f"A picture has shape (ny, nx), or (ny, nx, c) with spectra=, not {values.shape}."
            )
        _check_channels(values.shape, light)
        if light is not None and mode == "transmission":
            raise ValueError(
                "A slide has no spectrum of its own: give that of the light on it, "
                "coherence=Coherence(spatial, spectrum), when it is exposed."
            )
        if mode not in ("emission", "transmission"):
            raise ValueError(f"mode is 'emission' or 'transmission', not {mode!r}.")
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError("The samples of a picture are finite and not negative.")
        if not values.any():
            raise ValueError("All samples of the picture are 0: it sends no light.")
        if mode == "transmission" and values.max() > 1:
            raise ValueError(
                f"A slide transmits at most 1, not {values.max():g}: divide by its largest sample."
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
        """Whether something else lights it."""
        return self.mode == "transmission"

    @property
    def pitch(self) -> float:
        """Between samples, in metres."""
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
        """(x, y, dz) of every sample in metres, row by row, shape (ny nx, 3)."""
        y, x = np.meshgrid(self.y, self.x, indexing="ij")
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, self.z)], axis=-1)

    def points(self) -> PointSources:
        """The samples that are not 0 as point sources, of the energy of all channels together."""
        power = self.energy.ravel()
        lit = power > 0
        return PointSources(self.positions()[lit], power=power[lit])

    @property
    def energy(self) -> Vector:
        """Of each sample, all channels together, shape (ny, nx)."""
        return self.image if self.image.ndim == 2 else self.image.sum(axis=2)

    def corners(self) -> PointSources:
        """The corners of the rectangle that holds every sample that is not 0."""
        lit = self.energy > 0
        y, x = self.y[lit.any(axis=1)], self.x[lit.any(axis=0)]
        return PointSources([(a, b, self.z) for b in (y[0], y[-1]) for a in (x[0], x[-1])])

    def _occluder(self, opacity: Any) -> Occluder | None:
        if opacity is None:
            return None
        if self.is_slide:
            raise ValueError("A slide has no opacity: its samples are what it transmits.")
        values = np.full(self.image.shape[:2], opacity) if np.ndim(opacity) == 0 else opacity
        if np.shape(values) != self.image.shape[:2]:
            raise ShapeError(
                f"The opacity has shape {np.shape(values)}, and the picture "
                f"{self.image.shape[:2]}: give one number, or one for each sample."
            )
        return Occluder(values, self.width, self.z)

    def _axis(self, axis: int) -> Vector:
        n = self.image.shape[axis]
        return (np.arange(n) - n // 2) * self.pitch


def _spectra(given: Any) -> tuple[Spectrum, ...] | None:
    """Spectra of channels, checked."""
    if given is None:
        return None
    several = given if isinstance(given, list | tuple) else [given]
    return tuple(as_spectrum(one, "Each of spectra") for one in several)


def _check_channels(shape: tuple[int, ...], spectra: tuple[Spectrum, ...] | None) -> None:
    """Refuse channels that have not one spectrum each."""
    channels = shape[2] if len(shape) == 3 else 1
    if spectra is None and len(shape) == 3:
        raise ShapeError(
            f"A picture of shape {shape} has {channels} channels: give the spectrum of each, "
            "spectra=[...], or one channel of shape (ny, nx)."
        )
    if spectra is not None and len(spectra) != channels:
        raise ShapeError(
            f"A picture of shape {shape} has {channels} channel{'s' * (channels > 1)}, and "
            f"spectra= has {len(spectra)}: give one for each."
        )


Source = PointSources | PicturePlane


def as_sources(scene: Any) -> tuple[Source, ...]:
    """The sources of a scene: itself, or the members of a list or tuple that send light."""
    members = _members(scene)
    if not members:
        raise ValueError("The scene is an empty list: give PointSources or PicturePlanes.")
    for member in members:
        if not isinstance(member, PointSources | PicturePlane | Occluder):
            raise TypeError(
                "expose takes PointSources, a PicturePlane or a list of them and of Occluders, not "
                f"{type(member).__name__}."
            )
    sources = tuple(member for member in members if not isinstance(member, Occluder))
    if not sources:
        raise ValueError("The scene has Occluders only, which send no light: add PointSources.")
    return sources


def as_occluders(scene: Any) -> tuple[Occluder, ...]:
    """What hides light in a scene: its occluders, and those of its pictures."""
    members = [m.occluder if isinstance(m, PicturePlane) else m for m in _members(scene)]
    return tuple(member for member in members if isinstance(member, Occluder))


def _members(scene: Any) -> tuple[Any, ...]:
    return tuple(scene) if isinstance(scene, list | tuple) else (scene,)
