"""Real lenslets: aspheric surfaces of glass, and measured maps of the sag or phase."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clplen import units
from clplen.checks import fits_float64, float64_array, real_array
from clplen.errors import ShapeError
from clplen.reprs import one_line
from clplen.wave.elements.glass import LINE_D, Glass, index_of

Values = np.ndarray[Any, np.dtype[np.float64]]
_LARGEST_RADIUS = units.Length(20.0, (5e-6, 1.0), ("mm", "um"))
_LARGEST_SAG = units.Length(1e-2, (1e-9, 5e-3), ("um", "nm", "mm"))
_BORDER = 2  # samples that cubic convolution needs on each side of a map


@dataclass(frozen=True, init=False, repr=False)
class LensletSurface:
    """Surface of a plano-convex (or concave) lenslet, as a thin element.

    The sag is z(r) = r^2/(R (1 + sqrt(1 - (1 + K) r^2/R^2))) + a4 r^4 + a6 r^6 + ... (ISO 10110-12,
    eq. 3), the optical path -(n(lam) - 1) z(r), and the focal length R/(n - 1) (Born and Wolf 1999,
    section 4.4.3).

    Parameters
    ----------
    radius : float
        Radius R of the vertex in metres; positive converges.
    glass : Glass, str or float
        Material, its name (`Glass.named`), or an index for all wavelengths.
    conic : float
        Conic constant K: 0 a sphere, -1 a paraboloid.
    aspheric : sequence of float
        Coefficients (a4, a6, ...) in m^-3, m^-5, ...
    design_wavelength : float
        Wavelength in metres of `MicrolensArray.focal_length`; by default helium's yellow line.

    Raises
    ------
    ValueError
        If the radius is 0, a number not finite, or the index 1 or not positive.

    Examples
    --------
    >>> surface = clplen.wave.LensletSurface(1e-3, "N-BK7", conic=-1.0)
    >>> f"f {surface.focal_length() * 1e3:.3f} mm, sag {surface.sag(50e-6) * 1e6:.2f} um"
    'f 1.935 mm, sag 1.25 um'
    >>> mla = clplen.MicrolensArray(100e-6, surface=surface, count=8)
    >>> mla.count, f"{mla.focal_length * 1e3:.3f} mm"
    ((8, 8), '1.935 mm')
    """

    radius: float
    glass: Glass | float
    conic: float
    aspheric: tuple[float, ...]
    design_wavelength: float

    def __init__(
        self,
        radius: float,
        glass: Glass | str | float,
        *,
        conic: float = 0.0,
        aspheric: Sequence[float] = (),
        design_wavelength: float = LINE_D,
    ) -> None:
        material = _material(glass, "a surface")
        size = _number(radius, "The radius of a surface")
        if size == 0:
            raise ValueError("The radius of a surface must not be 0.")
        _LARGEST_RADIUS.check(size, "The radius of a surface")
        if not isinstance(material, Glass):
            units.WAVELENGTH.check(design_wavelength, "The design wavelength of a surface")
        wavelength = _number(design_wavelength, "The design wavelength of a surface")
        if not wavelength > 0:
            raise ValueError(
                f"The design wavelength of a surface must be positive, got {design_wavelength!r}."
            )
        index_of(material, wavelength)  # raises if the index is unknown
        values = {
            "radius": size,
            "glass": material,
            "conic": _number(conic, "The conic constant of a surface"),
            "aspheric": tuple(_number(a, "An aspheric coefficient of a surface") for a in aspheric),
            "design_wavelength": wavelength,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        glass = self.glass.name if isinstance(self.glass, Glass) else self.glass
        settings: dict[str, Any] = {"radius": self.radius, "glass": glass}
        settings |= {"conic": self.conic} if self.conic else {}
        settings |= {"aspheric": self.aspheric} if self.aspheric else {}
        return one_line(self, settings)

    @classmethod
    def from_json(cls, text: str) -> LensletSurface:
        """Return a surface from the text of `to_json`."""
        values = json.loads(text)
        if isinstance(values["glass"], dict):
            values["glass"] = Glass(**values["glass"])
        return cls(**values)

    def to_json(self) -> str:
        """Return the surface as JSON text with full precision."""
        return json.dumps(asdict(self))

    @property
    def reach(self) -> float:
        """Largest radius of the surface in metres: abs(R)/sqrt(1 + K), or infinite."""
        return abs(self.radius) / math.sqrt(1 + self.conic) if self.conic > -1 else math.inf

    def index(self, wavelength: float) -> float:
        """Return the refractive index at a wavelength in metres."""
        return index_of(self.glass, wavelength)

    def focal_length(self, wavelength: float | None = None) -> float:
        """Return R/(n - 1) in metres at a wavelength, by default the design wavelength."""
        lam = self.design_wavelength if wavelength is None else wavelength
        return self.radius / (self.index(lam) - 1)

    def sag(self, r: Any) -> Values:
        """Return the sag in metres at distances from the vertex in metres."""
        u = float64_array(r) ** 2
        conic = u / (self.radius * (1 + self._root(u)))
        return np.asarray(conic + u**2 * np.polyval(self.aspheric[::-1] or (0.0,), u))

    def slope(self, r: Any) -> Values:
        """Return dz/dr at distances from the vertex in metres; infinite at `reach`."""
        r = np.asarray(r, np.float64)
        with np.errstate(divide="ignore"):
            conic = r / (self.radius * self._root(r**2))
        powers = [(2 * i + 4) * a for i, a in enumerate(self.aspheric)]
        return np.asarray(conic + r**3 * np.polyval(powers[::-1] or (0.0,), r**2))

    def turns(self, wavelength: float, unit: float) -> list[float]:
        """Return the arguments c, q and e_0, e_1, ... of the kernel for a unit length in metres.

        The phase in turns is c u/(1 + sqrt(1 - q u)) + u^2 (e_0 + u (e_1 + ...)) at r = unit
        sqrt(u).
        """
        scale = (self.index(wavelength) - 1) / wavelength
        q = (1 + self.conic) * (unit / self.radius) ** 2
        higher = [scale * a * unit ** (2 * i + 4) for i, a in enumerate(self.aspheric)]
        return [scale * unit**2 / self.radius, q, *higher]

    def _root(self, u: Any) -> Any:
        return np.sqrt(np.maximum(1 - (1 + self.conic) * u / self.radius**2, 0))


@dataclass(frozen=True, init=False, repr=False, eq=False)
class LensletMap:
    """Measured map of the sag or phase, common to all lenslets of an array or one for each.

    Values between samples are interpolated by cubic convolution (Keys 1981), exact for parabolas.

    Parameters
    ----------
    sag : array_like, optional
        Distance in metres of the surface behind its vertex, larger where the glass is thinner; the
        path is -(n - 1) sag. Shape (y, x) for all lenslets or (rows, columns, y, x) for each, with
        y and x along the array's rows and columns.
    phase : array_like, optional
        Phase in radians at ``wavelength``, instead of the sag; positive retards as exp(+ikz) does.
        The path, phase wavelength/(2 pi), is equal at all wavelengths. Shape as for ``sag``.
    pitch : float or tuple of float
        Pitch of the samples in metres, (dy, dx) or a single number.
    glass : Glass, str or float, optional
        Material of the sag, as for `LensletSurface`.
    wavelength : float, optional
        Wavelength of the phase in metres.
    origin : tuple of float
        Position (y, x) in metres of sample (ny//2, nx//2) relative to the centre of the lenslet.
    complete : bool
        True if the map describes the complete lenslet; False adds it to the thin lens or surface.

    Raises
    ------
    ShapeError
        If the map has another number of axes, or fewer than 4 samples along a side.
    ValueError
        Unless either sag and glass or phase and wavelength are given, or if a value is NaN or
        infinite; the message has the index of the first.

    Examples
    --------
    >>> r = 8e-6 * (np.arange(17) - 8)
    >>> sag = (r[:, None] ** 2 + r**2) / (2 * 1e-3)  # a paraboloid of R = 1 mm
    >>> measured = clplen.wave.LensletMap(sag, pitch=8e-6, glass="N-BK7", complete=True)
    >>> measured
    LensletMap(values=<float64 (17, 17)>, pitch=(8e-06, 8e-06), complete=True)
    >>> mla = clplen.MicrolensArray(120e-6, 1.935e-3, count=4, map=measured)
    >>> mla.count, mla.map.is_per_lenslet  # common to all lenslets
    ((4, 4), False)
    """

    values: Values
    pitch: tuple[float, float]
    glass: Glass | float | None
    origin: tuple[float, float]
    complete: bool

    def __init__(
        self,
        sag: Any = None,
        *,
        phase: Any = None,
        pitch: float | tuple[float, float],
        glass: Glass | str | float | None = None,
        wavelength: float | None = None,
        origin: tuple[float, float] = (0.0, 0.0),
        complete: bool = False,
    ) -> None:
        if (sag is None) == (phase is None):
            raise ValueError("A map of lenslets requires either sag= or phase=.")
        if sag is not None and (glass is None or wavelength is not None):
            raise ValueError("A map of sag requires glass= and no wavelength=.")
        if phase is not None and (wavelength is None or glass is not None):
            raise ValueError("A map of phase requires wavelength= and no glass=.")
        what = "The sag of a map" if phase is None else "The phase of a map"
        values = _finite(real_array(sag if phase is None else phase, what, np.float64), what)
        if wavelength is not None:
            units.WAVELENGTH.check(wavelength, "The wavelength of a map")
            lam = _number(wavelength, "The wavelength of a map")
            if not lam > 0:
                raise ValueError(f"The wavelength of a map must be positive, got {wavelength!r}.")
            values = values * (lam / (2 * np.pi))
        else:
            values = values.copy()
            _LARGEST_SAG.check(np.ptp(values), "The range of a map of sag")
        spacing = float64_array(pitch)
        if spacing.shape not in ((), (2,)) or not (np.isfinite(spacing) & (spacing > 0)).all():
            raise ValueError(f"The pitch of a map must be positive, in metres, got {pitch!r}.")
        units.LENSLET_PITCH.check(spacing, "The pitch of a map")
        if np.shape(origin) != (2,) or not np.isfinite(origin).all():
            raise ValueError(
                f"The origin of a map must be (y, x) in metres, finite, got {origin!r}."
            )
        material = None if glass is None else _material(glass, "a map")
        values.flags.writeable = False
        dy, dx = np.broadcast_to(spacing, 2)
        settings = {
            "values": values,
            "pitch": (float(dy), float(dx)),
            "glass": material,
            "origin": (float(origin[0]), float(origin[1])),
            "complete": bool(complete),
        }
        for name, value in settings.items():
            object.__setattr__(self, name, value)
        key = [material.B, material.C] if isinstance(material, Glass) else material
        heading = [values.shape, self.pitch, key, self.origin, self.complete]
        digest = hashlib.sha256(repr(heading).encode())
        digest.update(values.tobytes())
        object.__setattr__(self, "_digest", digest.hexdigest())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LensletMap) and self._digest == other._digest  # type: ignore[attr-defined]

    def __hash__(self) -> int:
        return hash(self._digest)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        return one_line(
            self, {"values": self.values, "pitch": self.pitch, "complete": self.complete}
        )

    @property
    def is_per_lenslet(self) -> bool:
        """True if each lenslet has its own map."""
        return self.values.ndim == 4

    def path(self, wavelength: float) -> float:
        """Return the optical path in metres for a value of 1: -(n - 1) for sag, 1 for phase."""
        return 1.0 if self.glass is None else 1 - index_of(self.glass, wavelength)

    def check_reach(self, half: tuple[float, float]) -> None:
        """Raise if a map is smaller than the aperture of a lenslet.

        Parameters
        ----------
        half : tuple of float
            Largest (y, x) of the aperture relative to its centre, in metres.
        """
        for axis, name in enumerate("yx"):
            n, d, o = self.values.shape[axis - 2], self.pitch[axis], self.origin[axis]
            low, high = o - (n // 2 + 0.5) * d, o + (n - n // 2 - 0.5) * d
            if low > -half[axis] + 1e-9 * d or high < half[axis] - 1e-9 * d:
                raise ValueError(
                    f"The map of {n} samples of {d:g} m along {name} extends from {low:.4g} to "
                    f"{high:.4g} m, less than its lenslet, {-half[axis]:.4g} to "
                    f"{half[axis]:.4g} m; use a larger map or a smaller diameter, or set origin= "
                    f"for sample {n // 2}, by default the lenslet's centre."
                )

    def padded(self) -> Values:
        """Return the values with two samples more per side, on parabolas through the outer 3."""
        padded = self.values
        for axis in (-2, -1):
            for _ in range(_BORDER):
                first, last = (np.take(padded, k, axis=axis) for k in ((0, 1, 2), (-1, -2, -3)))
                ends = [
                    np.expand_dims(
                        3 * np.take(three, 0, axis=axis)
                        - 3 * np.take(three, 1, axis=axis)
                        + np.take(three, 2, axis=axis),
                        axis,
                    )
                    for three in (first, last)
                ]
                padded = np.concatenate([ends[0], padded, ends[1]], axis=axis)
        return np.ascontiguousarray(padded)

    def sampling(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return samples per metre (y, x), and the index in `padded` of a lenslet's centre."""
        per = (1 / self.pitch[0], 1 / self.pitch[1])
        ny, nx = self.values.shape[-2:]
        zero = (
            ny // 2 + _BORDER - self.origin[0] * per[0],
            nx // 2 + _BORDER - self.origin[1] * per[1],
        )
        return per, zero

    def steepest(self) -> float:
        """Return the largest slope of neighbouring values."""
        steps = [np.abs(np.diff(self.values, axis=k)).max() / self.pitch[k] for k in (-2, -1)]
        return float(math.hypot(*steps))

    def slopes(self, lenslet: Any, y: Any, x: Any) -> tuple[Values, Values]:
        """Return the derivatives of the interpolated values along (y, x).

        Parameters
        ----------
        lenslet : numpy.ndarray
            Index of the lenslet: row times number of columns plus column.
        y, x : numpy.ndarray
            Position relative to the centre of the lenslet, along the array's rows and columns, in
            metres.
        """
        maps = self.padded()
        ny, nx = maps.shape[-2:]
        maps = maps.reshape(-1, ny, nx)
        (py, px), (zy, zx) = self.sampling()
        row = np.clip(np.asarray(y) * py + zy, 1.5, ny - 2.5)
        column = np.clip(np.asarray(x) * px + zx, 1.5, nx - 2.5)
        i, k = row.astype(np.int64), column.astype(np.int64)
        index = np.asarray(lenslet) if self.is_per_lenslet else np.zeros_like(i)
        taps = np.arange(-1, 3)
        near = maps[index[..., None, None], (i[..., None] + taps)[..., None],
                    (k[..., None] + taps)[..., None, :]]  # fmt: skip
        (wy, sy), (wx, sx) = _cubic(row - i), _cubic(column - k)
        down = np.einsum("...jm,...j,...m->...", near, sy, wx) * py
        right = np.einsum("...jm,...j,...m->...", near, wy, sx) * px
        return down, right


def _cubic(t: Any) -> tuple[Values, Values]:
    """Return weights of four samples at t from the second to the third, and their derivatives."""
    t = np.asarray(t)[..., None]
    square = np.array([2, -5, 4, -1]) / 2
    linear, cube = np.array([-1, 0, 1, 0]) / 2, np.array([-1, 3, -3, 1]) / 2
    weights = np.array([0, 1, 0, 0]) + t * (linear + t * (square + t * cube))
    return weights, linear + t * (2 * square + 3 * t * cube)


def _finite(values: Any, what: str) -> Any:
    if values.ndim not in (2, 4) or min(values.shape[-2:], default=0) < 4 or not values.size:
        raise ShapeError(
            f"{what} must have shape (y, x) or (rows, columns, y, x) with at least 4 samples per "
            f"side, got {values.shape}."
        )
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise ValueError(
            f"{what} has {len(bad)} values that are NaN or infinite, the first at "
            f"{tuple(int(k) for k in bad[0])}: replace them."
        )
    return values


def _material(glass: Any, what: str) -> Glass | float:
    if isinstance(glass, str):
        return Glass.named(glass)
    if isinstance(glass, Glass):
        return glass
    index = _number(glass, f"The glass of {what}, if not a Glass or its name,")
    if index <= 0 or index == 1:
        raise ValueError(f"The index of {what} must be above 0 and not 1, got {glass!r}.")
    return index


def _number(value: Any, what: str) -> float:
    """Return a finite number, or raise a ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{what} must be a number, got {value!r}.")
    if not fits_float64(value):
        raise ValueError(f"{what} must be finite, got {value!r}.")
    return float(value)
