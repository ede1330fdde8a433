"""Lenslets as they are made: aspheric surfaces of glass, and measured maps of one or of each."""

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
_BORDER = 2  # samples that cubic convolution needs beside a map


@dataclass(frozen=True, init=False, repr=False)
class LensletSurface:
    """The surface of a plano-convex (or concave) lenslet, as a thin element.

    Its sag is z(r) = r^2/(R (1 + sqrt(1 - (1 + K) r^2/R^2))) + a4 r^4 + a6 r^6 + ... (ISO 10110-12,
    eq. 3), its optical path -(n(lam) - 1) z(r), its focal length R/(n - 1) (Born and Wolf 1999,
    section 4.4.3).

    Parameters
    ----------
    radius : float
        Radius R of the vertex in metres; positive converges.
    glass : Glass, str or float
        A material, the name of one (`Glass.named`), or an index at all wavelengths.
    conic : float
        Conic constant K: 0 a sphere, -1 a paraboloid.
    aspheric : sequence of float
        Coefficients (a4, a6, ...) in m^-3, m^-5, ...
    design_wavelength : float
        In metres: where the number `MicrolensArray.focal_length` is that of the lenslets. By
        default helium's yellow line.

    Raises
    ------
    ValueError
        For a radius of 0, numbers that are not finite, or an index that bends nothing.

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
        size = _number(radius, "The radius of a surface is")
        if size == 0:
            raise ValueError("The radius of a surface is not 0: a plane has no focal length.")
        _LARGEST_RADIUS.check(size, "The radius of a surface")
        if not isinstance(material, Glass):
            units.WAVELENGTH.check(design_wavelength, "The design wavelength of a surface")
        wavelength = _number(design_wavelength, "The design wavelength of a surface is")
        if not wavelength > 0:
            raise ValueError(
                f"The design wavelength of a surface is positive, not {design_wavelength!r}."
            )
        index_of(material, wavelength)  # which it must have
        values = {
            "radius": size,
            "glass": material,
            "conic": _number(conic, "The conic constant of a surface is"),
            "aspheric": tuple(
                _number(a, "An aspheric coefficient of a surface is") for a in aspheric
            ),
            "design_wavelength": wavelength,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        glass = self.glass.name if isinstance(self.glass, Glass) else self.glass
        shown: dict[str, Any] = {"radius": self.radius, "glass": glass}
        shown |= {"conic": self.conic} if self.conic else {}
        shown |= {"aspheric": self.aspheric} if self.aspheric else {}
        return one_line(self, shown)

    @classmethod
    def from_json(cls, text: str) -> LensletSurface:
        """What `to_json` wrote."""
        values = json.loads(text)
        if isinstance(values["glass"], dict):
            values["glass"] = Glass(**values["glass"])
        return cls(**values)

    def to_json(self) -> str:
        """As text, all digits kept."""
        return json.dumps(asdict(self))

    @property
    def reach(self) -> float:
        """Largest r in metres that the surface has: abs(R)/sqrt(1 + K), or infinite."""
        return abs(self.radius) / math.sqrt(1 + self.conic) if self.conic > -1 else math.inf

    def index(self, wavelength: float) -> float:
        """Refractive index at a wavelength in metres."""
        return index_of(self.glass, wavelength)

    def focal_length(self, wavelength: float | None = None) -> float:
        """R/(n - 1) in metres, at the design wavelength or at another."""
        lam = self.design_wavelength if wavelength is None else wavelength
        return self.radius / (self.index(lam) - 1)

    def sag(self, r: Any) -> Values:
        """Sag in metres at distances from the vertex in metres."""
        u = float64_array(r) ** 2
        conic = u / (self.radius * (1 + self._root(u)))
        return np.asarray(conic + u**2 * np.polyval(self.aspheric[::-1] or (0.0,), u))

    def slope(self, r: Any) -> Values:
        """dz/dr at distances from the vertex in metres; infinite at `reach`."""
        r = np.asarray(r, np.float64)
        with np.errstate(divide="ignore"):
            conic = r / (self.radius * self._root(r**2))
        powers = [(2 * i + 4) * a for i, a in enumerate(self.aspheric)]
        return np.asarray(conic + r**3 * np.polyval(powers[::-1] or (0.0,), r**2))

    def turns(self, wavelength: float, unit: float) -> list[float]:
        """What the kernel takes: c, q and e_0, e_1, ..., with lengths in ``unit`` metres.

        Turns c u/(1 + sqrt(1 - q u)) + u^2 (e_0 + u (e_1 + ...)) at r = unit sqrt(u).
        """
        scale = (self.index(wavelength) - 1) / wavelength
        q = (1 + self.conic) * (unit / self.radius) ** 2
        higher = [scale * a * unit ** (2 * i + 4) for i, a in enumerate(self.aspheric)]
        return [scale * unit**2 / self.radius, q, *higher]

    def _root(self, u: Any) -> Any:
        return np.sqrt(np.maximum(1 - (1 + self.conic) * u / self.radius**2, 0))


@dataclass(frozen=True, init=False, repr=False, eq=False)
class LensletMap:
    """A measured map over one lenslet, the same for all of an array or one for each.

    Between samples it is interpolated by cubic convolution (Keys 1981), which keeps parabolas.

    Parameters
    ----------
    sag : array_like, optional
        Metres by which the surface lies behind its vertex, larger where the glass is thinner: the
        path is -(n - 1) sag. Shape (y, x) for all lenslets or (rows, columns, y, x) for each, y and
        x along the array's own rows and columns.
    phase : array_like, optional
        In its place: radians at ``wavelength``, positive retards as exp(+ikz) does; the path, phase
        wavelength/(2 pi), is the same at all wavelengths. Shape as of ``sag``.
    pitch : float or tuple of float
        Of the map's samples in metres, (dy, dx) or one number.
    glass : Glass, str or float, optional
        Material of the sag, as for `LensletSurface`.
    wavelength : float, optional
        Of the phase, in metres.
    origin : tuple of float
        (y, x) in metres of sample (ny//2, nx//2) from the centre of the lenslet.
    whole : bool
        Whether the map is the whole lenslet; False: it is added to the thin lens or the surface.

    Raises
    ------
    ShapeError
        For a map of another number of axes, or of fewer than 4 samples a side.
    ValueError
        If not one of sag and phase is given with its glass or wavelength, or a value is NaN or
        infinite, with the place of the first.

    Examples
    --------
    >>> r = 8e-6 * (np.arange(17) - 8)
    >>> sag = (r[:, None] ** 2 + r**2) / (2 * 1e-3)  # a paraboloid of R = 1 mm
    >>> measured = clplen.wave.LensletMap(sag, pitch=8e-6, glass="N-BK7", whole=True)
    >>> measured
    LensletMap(values=<float64 (17, 17)>, pitch=(8e-06, 8e-06), whole=True)
    >>> mla = clplen.MicrolensArray(120e-6, 1.935e-3, count=4, map=measured)
    >>> mla.count, mla.map.is_of_each  # the same for all lenslets
    ((4, 4), False)
    """

    values: Values
    pitch: tuple[float, float]
    glass: Glass | float | None
    origin: tuple[float, float]
    whole: bool

    def __init__(
        self,
        sag: Any = None,
        *,
        phase: Any = None,
        pitch: float | tuple[float, float],
        glass: Glass | str | float | None = None,
        wavelength: float | None = None,
        origin: tuple[float, float] = (0.0, 0.0),
        whole: bool = False,
    ) -> None:
        if (sag is None) == (phase is None):
            raise ValueError("A map of lenslets is a sag or a phase: give one of them.")
        if sag is not None and (glass is None or wavelength is not None):
            raise ValueError("A map of sag needs a glass, or its index, and no wavelength.")
        if phase is not None and (wavelength is None or glass is not None):
            raise ValueError("A map of phase needs the wavelength it is for, and no glass.")
        what = "The sag of a map" if phase is None else "The phase of a map"
        values = _finite(real_array(sag if phase is None else phase, what, np.float64), what)
        if wavelength is not None:
            units.WAVELENGTH.check(wavelength, "The wavelength of a map")
            lam = _number(wavelength, "The wavelength of a map is")
            if not lam > 0:
                raise ValueError(f"The wavelength of a map is positive, not {wavelength!r}.")
            values = values * (lam / (2 * np.pi))
        else:
            values = values.copy()
            _LARGEST_SAG.check(np.ptp(values), "The range of a map of sag")
        spacing = float64_array(pitch)
        if spacing.shape not in ((), (2,)) or not (np.isfinite(spacing) & (spacing > 0)).all():
            raise ValueError(f"The pitch of a map is positive, in metres, not {pitch!r}.")
        units.LENSLET_PITCH.check(spacing, "The pitch of a map")
        if np.shape(origin) != (2,) or not np.isfinite(origin).all():
            raise ValueError(f"The origin of a map is (y, x) in metres, finite, not {origin!r}.")
        material = None if glass is None else _material(glass, "a map")
        values.flags.writeable = False
        dy, dx = np.broadcast_to(spacing, 2)
        made = {
            "values": values,
            "pitch": (float(dy), float(dx)),
            "glass": material,
            "origin": (float(origin[0]), float(origin[1])),
            "whole": bool(whole),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)
        of = [material.B, material.C] if isinstance(material, Glass) else material
        about = [values.shape, self.pitch, of, self.origin, self.whole]
        digest = hashlib.sha256(repr(about).encode())
        digest.update(values.tobytes())
        object.__setattr__(self, "_digest", digest.hexdigest())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LensletMap) and self._digest == other._digest  # type: ignore[attr-defined]

    def __hash__(self) -> int:
        return hash(self._digest)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        return one_line(self, {"values": self.values, "pitch": self.pitch, "whole": self.whole})

    @property
    def is_of_each(self) -> bool:
        """Whether every lenslet has a map of its own."""
        return self.values.ndim == 4

    def path(self, wavelength: float) -> float:
        """Metres of optical path for one of the values: -(n - 1) for sag, 1 for phase."""
        return 1.0 if self.glass is None else 1 - index_of(self.glass, wavelength)

    def check_reach(self, half: tuple[float, float]) -> None:
        """Refuse a map that does not reach as far as the aperture of a lenslet.

        Parameters
        ----------
        half : tuple of float
            Largest (y, x) of the aperture from its centre, in metres.
        """
        for axis, name in enumerate("yx"):
            n, d, o = self.values.shape[axis - 2], self.pitch[axis], self.origin[axis]
            low, high = o - (n // 2 + 0.5) * d, o + (n - n // 2 - 0.5) * d
            if low > -half[axis] + 1e-9 * d or high < half[axis] - 1e-9 * d:
                raise ValueError(
                    f"The map of {n} samples of {d:g} m along {name} reaches from {low:.4g} to "
                    f"{high:.4g} m, less than its lenslet, {-half[axis]:.4g} to "
                    f"{half[axis]:.4g} m: give a larger map, a smaller diameter, or the origin of "
                    f"sample {n // 2}, which lies on the lenslet's centre by default."
                )

    def padded(self) -> Values:
        """The values with two samples more on each side, on parabolas through the outer three."""
        found = self.values
        for axis in (-2, -1):
            for _ in range(_BORDER):
                first, last = (np.take(found, k, axis=axis) for k in ((0, 1, 2), (-1, -2, -3)))
                ends = [
                    np.expand_dims(
                        3 * np.take(three, 0, axis=axis)
                        - 3 * np.take(three, 1, axis=axis)
                        + np.take(three, 2, axis=axis),
                        axis,
                    )
                    for three in (first, last)
                ]
                found = np.concatenate([ends[0], found, ends[1]], axis=axis)
        return np.ascontiguousarray(found)

    def places(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Samples a metre (y, x), and the fractional sample of `padded` at a lenslet's centre."""
        per = (1 / self.pitch[0], 1 / self.pitch[1])
        ny, nx = self.values.shape[-2:]
        zero = (
            ny // 2 + _BORDER - self.origin[0] * per[0],
            nx // 2 + _BORDER - self.origin[1] * per[1],
        )
        return per, zero

    def steepest(self) -> float:
        """The largest difference of neighbouring values over their distance."""
        steps = [np.abs(np.diff(self.values, axis=k)).max() / self.pitch[k] for k in (-2, -1)]
        return float(math.hypot(*steps))

    def slopes(self, lenslet: Any, y: Any, x: Any) -> tuple[Values, Values]:
        """Derivatives of the values along (y, x), as interpolated.

        Parameters
        ----------
        lenslet : numpy.ndarray
            Which of them, row times columns plus column.
        y, x : numpy.ndarray
            From the centre of the lenslet along the array's rows and columns, in metres.
        """
        maps = self.padded()
        ny, nx = maps.shape[-2:]
        maps = maps.reshape(-1, ny, nx)
        (py, px), (zy, zx) = self.places()
        row = np.clip(np.asarray(y) * py + zy, 1.5, ny - 2.5)
        column = np.clip(np.asarray(x) * px + zx, 1.5, nx - 2.5)
        i, k = row.astype(np.int64), column.astype(np.int64)
        which = np.asarray(lenslet) if self.is_of_each else np.zeros_like(i)
        taps = np.arange(-1, 3)
        near = maps[which[..., None, None], (i[..., None] + taps)[..., None],
                    (k[..., None] + taps)[..., None, :]]  # fmt: skip
        (wy, sy), (wx, sx) = _cubic(row - i), _cubic(column - k)
        down = np.einsum("...jm,...j,...m->...", near, sy, wx) * py
        right = np.einsum("...jm,...j,...m->...", near, wy, sx) * px
        return down, right


def _cubic(t: Any) -> tuple[Values, Values]:
    """Weights of four samples at t from the second to the third, and their derivatives."""
    t = np.asarray(t)[..., None]
    square = np.array([2, -5, 4, -1]) / 2
    linear, cube = np.array([-1, 0, 1, 0]) / 2, np.array([-1, 3, -3, 1]) / 2
    weights = np.array([0, 1, 0, 0]) + t * (linear + t * (square + t * cube))
    return weights, linear + t * (2 * square + 3 * t * cube)


def _finite(values: Any, what: str) -> Any:
    if values.ndim not in (2, 4) or min(values.shape[-2:], default=0) < 4 or not values.size:
        raise ShapeError(
            f"{what} has shape (y, x), or (rows, columns, y, x) for every lenslet, of at least 4 "
            f"samples a side, not {values.shape}."
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
    index = _number(glass, f"The glass of {what} is a Glass, the name of one, or an index:")
    if index <= 0 or index == 1:
        raise ValueError(
            f"The index of {what} is above 0 and not 1, which bends nothing: {glass!r}."
        )
    return index


def _number(value: Any, what: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{what} a number, not {value!r}.")
    if not fits_float64(value):
        raise ValueError(f"{what} finite, not {value!r}.")
    return float(value)
