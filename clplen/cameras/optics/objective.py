"""Fields of points that an aplanatic objective and its tube lens image onto the native plane.

The image side is telecentric (4f). A point at (x0, y0, z) from the axis point of the native plane
in the medium has on the magnified native plane the field

    U(x) = int P(f) exp(2 pi i f (x - M x0)) df,   M abs(f) <= NA/lam,
    P(f) = cos^e exp(2 pi i z (sqrt((n/lam)^2 - (M f)^2) - n/lam)),   sin = lam M abs(f)/n,

the Debye integral over spatial frequencies (Gu 2000, "Advanced Optical Imaging Theory", chapter 6).
As df is sin cos dtheta, its weight over angles is cos^(e + 1) sin: e = 1/2 by default, and e = -1/2
is the cos^(1/2) sin of a lens that obeys the sine condition. z > 0 lies farther from the objective.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.checks import check_finite, check_positive, is_finite, real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.compute.fft.lines import smooth_length
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import average_of
from clplen.wave.field.transmission import phasor

Vector = np.ndarray[Any, Any]

APODISATION = 0.5  # default exponent of cos(theta): the Debye integral over frequencies
MAX_GLASS_THICKNESS = 0.01  # maximum thickness of a cover glass in metres
BLUR_RAYS = 257  # rays of a pupil whose outermost on the array gives the blur
MAX_DISTANCE = 0.1  # maximum distance in metres; no objective has an image from farther away


@dataclass(frozen=True)
class CoverGlass:
    """Cover glass that differs from the design of the objective.

    With s = n sin(theta) its path differs by

        W = t sqrt(g^2 - s^2) - t0 sqrt(g0^2 - s^2) - n (t/g - t0/g0) sqrt(n^2 - s^2)

    (Gibson and Lanni 1991, eq. 3). The last term is a refocusing that keeps the paraxial focus in
    place. To lowest order it is t (g^2 - n^2) s^4/(8 g^3 n^2) for a surplus t.

    Parameters
    ----------
    thickness : float
        Thickness t of the glass in metres, up to 0.01; 0 for none.
    index : float
        Refractive index g of the glass, from 1 to 5.
    designed_thickness : float
        Thickness t0 of the glass that the objective corrects, in metres, up to 0.01.
    designed_index : float
        Refractive index g0 of the glass that the objective corrects, from 1 to 5.

    Raises
    ------
    ValueError
        If a thickness is outside 0 to 0.01 m, or an index outside 1 to 5.

    Examples
    --------
    >>> thin = clplen.cameras.CoverGlass(150e-6)  # 20 um less than the objective's design
    >>> sines = np.array([0.0, 0.5, 0.9])  # n sin(theta), in air
    >>> np.round(thin.path(sines, 1.0) * 1e9).tolist()  # in nanometres
    [0.0, -71.0, -1520.0]
    """

    thickness: float
    index: float = 1.5255
    designed_thickness: float = 170e-6
    designed_index: float = 1.5255

    def __post_init__(self) -> None:
        for length in (self.thickness, self.designed_thickness):
            if not (is_finite(length) and 0 <= length <= MAX_GLASS_THICKNESS):
                raise ValueError(
                    f"A cover glass must be 0 to {MAX_GLASS_THICKNESS} m thick, got {length!r}: "
                    "150 um are 150e-6."
                )
        for index in (self.index, self.designed_index):
            if not (is_finite(index) and 1 <= index < 5):
                raise ValueError(f"The index of a cover glass must be 1 to 5, got {index!r}.")

    def path(self, s: Vector, n: float) -> Vector:
        """Compute W in metres, 0 on the axis.

        Parameters
        ----------
        s : numpy.ndarray
            n sin(theta), below all indices.
        n : float
            Refractive index of the medium that refocuses.

        Returns
        -------
        numpy.ndarray
        """
        layers = self._layers(n)
        s = real_array(s, "s", np.float64)
        check_finite(s=s)
        # sqrt(g^2 - s^2) - g without cancellation
        return sum((-t * s**2 / (np.sqrt(g * g - s**2) + g) for t, g in layers), np.zeros_like(s))

    def slope(self, s: Vector, n: float) -> Vector:
        """Compute -dW/ds in metres: sum t s/sqrt(g^2 - s^2) over the layers.

        Parameters
        ----------
        s : numpy.ndarray
            n sin(theta), below all indices.
        n : float
            Refractive index of the medium that refocuses.

        Returns
        -------
        numpy.ndarray
        """
        return sum((t * s / np.sqrt(g * g - s**2) for t, g in self._layers(n)), np.zeros_like(s))

    def _layers(self, n: float) -> tuple[tuple[float, float], ...]:
        """Return thickness and index: glass, design (negative), refocusing medium."""
        check_positive(n=n)
        moved = self.thickness / self.index - self.designed_thickness / self.designed_index
        return (
            (self.thickness, self.index),
            (-self.designed_thickness, self.designed_index),
            (-n * moved, n),
        )


@dataclass(frozen=True)
class Objective:
    """Objective with its tube lens.

    Attributes
    ----------
    magnification : float
        Magnification M > 0; the image is not inverted.
    na : float
        Numerical aperture, below the index.
    medium_index : float
        Refractive index n of the medium.
    wavelength : float
        Wavelength in vacuum, in metres.
    cover : CoverGlass or None
        Cover glass that differs from the design; None for the designed glass.
    apodisation : float
        Exponent e of the amplitude cos^e over the pupil.
    aberration : PupilAberration or None
        Aberrations of the pupil; None for a perfect pupil.

    Examples
    --------
    >>> objective = clplen.cameras.Objective(20, 0.5, 1.0, 525e-9)
    >>> f"{objective.blur(10e-6) * 1e6:.1f} um"  # of a point 10 um out of focus, on the array
    '115.5 um'
    >>> f"{objective.cutoff / 1e3:.1f} cycles/mm"
    '47.6 cycles/mm'
    """

    magnification: float
    na: float
    medium_index: float
    wavelength: float
    cover: CoverGlass | None = None
    apodisation: float = APODISATION
    aberration: PupilAberration | None = None

    def __post_init__(self) -> None:
        check_finite(na=self.na)
        names = ("magnification", "medium_index", "wavelength")
        check_positive(**{name: getattr(self, name) for name in names})

    @property
    def cutoff(self) -> float:
        """Highest frequency on the image side in cycles a metre, NA/(M lam)."""
        return self.na / (self.magnification * self.wavelength)

    def blur(self, z: Any) -> Any:
        """Return the largest distance of the rays of points from X on the array, in metres.

        Without a cover glass it is that of the rim, M abs(z) tan(theta). An aberration adds at most
        M/NA dW/drho of its steepest slope.

        Parameters
        ----------
        z : float or array_like
            Distance from the native plane in metres, farther positive.

        Returns
        -------
        float or numpy.ndarray
        """
        rays = np.array([self.na]) if self.cover is None else np.linspace(0, self.na, BLUR_RAYS)
        reach = np.abs(self.landing(rays, np.asarray(z)[..., None])).max(axis=-1)
        if self.aberration is not None:
            reach = reach + self.magnification / self.na * self.aberration.steepest
        return reach

    def landing(self, s: Vector, z: Any) -> Vector:
        """Return the position of a ray on the array from X, by the slope of the pupil's phase.

        M (z tan(theta) - dW/ds), W of the cover glass: M z tan(theta) without a cover glass.

        Parameters
        ----------
        s : numpy.ndarray
            n sin(theta).
        z : float or numpy.ndarray
            Distance from the native plane in metres, farther positive.

        Returns
        -------
        numpy.ndarray
            Position in metres, on the ray's side of the pupil for positive z.
        """
        check_finite(z=z)
        shift = z * s / np.sqrt(self.medium_index * self.medium_index - s**2)
        if self.cover is not None:
            shift = shift + self.cover.slope(s, self.medium_index)
        return np.asarray(self.magnification * shift)

    def pupil(self, grid: Grid, z: float, *, diameter: float = 0.0) -> Vector:
        """Compute P on the frequencies of a grid, scaled to the energy sum abs(U)^2 = 1.

        The rim is hard: a rim softened over a frequency sample departs more from the Debye
        integral. A uniform coherent disc multiplies P by 2 J1(v)/v, v = pi M f diameter (Goodman
        2005, eq. 2-35).

        Parameters
        ----------
        grid : Grid
            Grid of the image side.
        z : float
            Distance from the native plane in metres, farther positive.
        diameter : float
            Diameter of the source in metres.

        Returns
        -------
        numpy.ndarray
            complex128, shape of the grid, frequencies in FFT order.
        """
        fy, fx = grid.fy, grid.fx
        rows, columns = np.abs(fy) <= self.cutoff, np.abs(fx) <= self.cutoff
        values = self.amplitude(fy[rows], fx[columns], z, diameter=diameter)
        values *= np.sqrt(math.prod(grid.shape) / (np.abs(values) ** 2).sum())
        out = np.zeros(grid.shape, complex)
        out[np.ix_(rows, columns)] = values
        return out

    def amplitude(self, fy: Vector, fx: Vector, z: float, *, diameter: float = 0.0) -> Vector:
        """Compute P at any frequencies, 1 in the middle; 0 beyond the cut-off, with a hard rim.

        Parameters
        ----------
        fy, fx : numpy.ndarray
            Frequencies of the image side in cycles a metre, shapes (ny,) and (nx,).
        z : float
            Distance from the native plane in metres, farther positive.
        diameter : float
            Diameter of the source in metres.

        Returns
        -------
        numpy.ndarray
            complex128, shape (ny, nx).
        """
        f = np.hypot(fy[:, None], fx)
        longest = self.medium_index / self.wavelength
        sine2 = np.minimum((self.magnification * f / longest) ** 2, 1)
        cosine = np.sqrt(1 - sine2)
        turns = -z * longest * sine2 / (1 + cosine)
        inside = f <= self.cutoff
        if self.cover is not None:
            s = self.medium_index * np.sqrt(sine2) * inside
            turns += self.cover.path(s, self.medium_index) / self.wavelength
        if self.aberration is not None:
            theta = np.arctan2(fy[:, None], fx)
            turns += self.aberration.path(f / self.cutoff, theta) / self.wavelength
        values = np.where(inside, cosine, 1.0) ** self.apodisation * inside * phasor(turns)
        return np.asarray(values * _disc(np.pi * self.magnification * f * diameter))

    def fields(
        self,
        sources: PointSources,
        grid: Grid,
        device: DeviceLike | None = None,
        *,
        factor: Vector | None = None,
    ) -> Field:
        """Compute fields of points on the native plane, each of energy sum abs(U)^2 = 1.

        Parameters
        ----------
        sources : PointSources
            Points before the objective.
        grid : Grid
            Grid on the magnified native plane; the periodic window must hold the blur.
        device : Device or str, optional
            Device of the computation; default ``Device.open()``.
        factor : numpy.ndarray, optional
            Complex factor of all pupils, shape of the grid, such as the derivative of a phase.

        Returns
        -------
        Field
            Fields, shape (n, ny, nx).
        """
        device = as_device(device)
        out = self.spectra(sources, grid, device, factor=factor)
        device.fft.inverse(out, device)
        return Field(out, grid, self.wavelength, device)

    def spectra(
        self,
        sources: PointSources,
        grid: Grid,
        device: DeviceLike | None = None,
        *,
        factor: Vector | None = None,
    ) -> cla.Array:
        """Compute the transforms of `fields`: pupils shifted to the positions of points.

        Parameters
        ----------
        sources : PointSources
        grid : Grid
            Grid on the magnified native plane.
        device : Device or str, optional
            Device of the computation; default ``Device.open()``.
        factor : numpy.ndarray, optional
            Complex factor of all pupils, see `fields`.

        Returns
        -------
        pyopencl.array.Array
            Spectra, complex, shape (n, ny, nx), frequencies in FFT order.
        """
        device = as_device(device)
        planes, plane = np.unique(sources.positions[:, 2], return_inverse=True)
        pupils = np.stack([self.pupil(grid, z, diameter=sources.diameter) for z in planes])
        if factor is not None:
            pupils = pupils * factor
        ty, tx = (
            phasor(f * (axis[0] - self.magnification * sources.positions[:, k : k + 1]))
            for f, axis, k in ((grid.fy, grid.y, 1), (grid.fx, grid.x, 0))
        )
        return shift_pupils(pupils, plane, (ty, tx), device)


def shift_pupils(
    pupils: Vector, plane: Vector, turns: tuple[Vector, Vector], device: Device
) -> cla.Array:
    """Multiply the pupil of each point's plane by the phases along y and x of its position."""
    shape = (plane.size, *pupils.shape[1:])
    out = device.empty(shape, device.complex)
    ty, tx = (device.upload(phases.astype(device.complex)) for phases in turns)
    device.launch_rows(
        device.kernel("objective.cl", "point_spectra", **device.wave_defines()),
        shape,
        out,
        device.upload(pupils.astype(device.complex)),
        device.upload(plane.ravel().astype(np.int32)),
        ty,
        tx,
        *(np.int32(n) for n in shape[1:]),
    )
    return out


def _disc(v: Vector) -> Vector:
    """Compute 2 J1(v)/v."""
    if not v.any():
        return np.ones_like(v)
    from scipy import special

    safe = np.where(v > 0, v, 1.0)
    return np.where(v > 0, 2 * special.j1(safe) / safe, 1.0)


def check_objective(
    magnification: Any, na: Any, index: Any, apodisation: Any, cover: CoverGlass | None
) -> None:
    """Raise for impossible parameters of an objective."""
    if not (is_finite(magnification) and magnification >= 1):
        raise ValueError(f"magnification must be a finite number >= 1, got {magnification!r}.")
    if not (is_finite(index) and index >= 1):
        raise ValueError(f"medium_index must be a finite number >= 1 (air), got {index!r}.")
    if not (is_finite(na) and 0 < na < index):
        raise ValueError(
            f"na = n sin(theta) must be between 0 and the medium's index of {index!r}, got "
            f"{na!r}: use another medium_index (water 1.33, oil 1.52) or another NA."
        )
    if not (is_finite(apodisation) and -1 <= apodisation <= 1):
        raise ValueError(
            f"apodisation, the exponent of cos(theta), must be -1 to 1, got {apodisation!r}."
        )
    if cover is not None and not isinstance(cover, CoverGlass):
        raise TypeError(f"cover must be a CoverGlass, such as CoverGlass(150e-6), got {cover!r}.")
    if cover is not None and na >= min(cover.index, cover.designed_index):
        raise ValueError(
            f"na must be below the index of the cover glass, "
            f"{min(cover.index, cover.designed_index)!r}, got {na!r}."
        )


def check_positions(positions: Any) -> None:
    """Raise for positions about the native plane beyond any objective, or not in metres."""
    values = real_array(positions, "places", np.float64)
    beyond = values[np.abs(values) > MAX_DISTANCE]
    if beyond.size:
        raise ValueError(
            f"Positions must be within {MAX_DISTANCE:g} m of the native plane and the axis, got "
            f"{beyond[0]:g} m. They are in metres: did you mean {beyond[0]:g}e-6?"
        )


def fluorescent_points(scene: Any, projector: str) -> list[PointSources]:
    """Return the points of a scene before an objective; the error names ``projector``."""
    parts = [scene] if isinstance(scene, PointSources) else list(scene)
    if not parts or not all(isinstance(part, PointSources) for part in parts):
        kinds = ", ".join(sorted({type(part).__name__ for part in parts})) or "nothing"
        raise TypeError(
            f"A microscope exposes PointSources or a list of them, got {kinds}: use points, or "
            f"project a volume ({projector})."
        )
    return parts


def fluorescent_lines(
    coherence: Coherence | None, wavelength: float
) -> Sequence[tuple[float, float]]:
    """Return wavelengths of fluorescence and their fractions of the energy."""
    if coherence is None:
        return [(wavelength, 1.0)]
    average_of(coherence)
    if coherence.spatial is not None:
        raise ValueError(
            "A spatial model of coherence does not apply to fluorescent points, which are "
            "incoherent: leave it out, Coherence(None, spectrum)."
        )
    return coherence.lines(wavelength)


def fast_length(n: int, min_length: float) -> int:
    """Return the next fast transform length from ``least`` on, of the parity of ``n``."""
    length = max(n, math.ceil(min_length))
    if n % 2 == 0:
        return 2 * smooth_length(-(-length // 2))
    length += 1 - length % 2
    while smooth_length(length) != length:
        length += 2
    return length
