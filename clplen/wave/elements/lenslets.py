"""Microlens arrays in closed form at real coordinates."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen import units
from clplen.checks import Aliasing, alias_argument, is_finite, is_integer
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError, ShapeError
from clplen.reprs import OneLine, one_line
from clplen.types import Float64Array
from clplen.units import metres
from clplen.wave.elements.lens import check_lens_sampling
from clplen.wave.elements.lenslet_gradients import (
    array_gradient,
    array_rates,
    array_tangents,
)
from clplen.wave.elements.lenslet_surface import LensletMap, LensletSurface
from clplen.wave.elements.rims import rim_weights
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.field_gradients import transmission_gradient
from clplen.wave.field.transmission import multiply, whole_and_part

SMALLEST_PITCH = 2  # minimum number of samples of a lenslet
_FOCAL_TOLERANCE = 0.005  # relative deviation of a focal length from that of the surface

Values = np.ndarray[Any, np.dtype[np.float64]]


@alias_argument(f="focal_length")
@dataclass(frozen=True, init=False, repr=False)
class MicrolensArray(OneLine):
    """Lenslets on a square or hexagonal lattice, centred on the axis.

    Lenslet (i, k) is centred at rotation * ((k - (nx - 1)/2) pitch, (i - (ny - 1)/2) height) +
    offset, with height = pitch (square) or sqrt(3)/2 pitch (hexagonal, odd rows shifted by
    +pitch/2). The array is opaque outside of its lenslets, unless gaps are clear.

    Parameters
    ----------
    pitch : float
        Distance between neighbours of a row in metres.
    focal_length : float or sequence of float, optional
        Focal length of a lenslet in metres, not 0; defined by ``surface`` if there is one. A
        sequence makes a multi-focus array. Its kinds are (k + s i) mod n on a square lattice of n
        kinds (s = 1 for n = 2 and 3, else 2), and (k - i//2 + 2 i) mod 3 on a hexagonal lattice,
        which has 1 or 3 kinds; neighbours differ.
    count : int or tuple of int
        Numbers of lenslets (ny, nx), or a single number for both.
    lattice : {"square", "hexagonal"}
        Lattice of the centres.
    fill : {"circular", "full"}
        Aperture of a lenslet: a disc, or the lattice cell (square or hexagon). On a square lattice
        "square" is a synonym of "full".
    diameter : float, optional
        Diameter of the disc or width of the cell in metres, at most ``pitch``; None: ``pitch``.
    offset : tuple of float
        Position (y, x) of the array's centre in metres.
    rotation : float
        Angle in radians; positive turns +x towards +y (y down).
    surface : LensletSurface or sequence of LensletSurface, optional
        Surfaces of the lenslets, one for each kind, with the phase -2 pi (n(lam) - 1) z(r)/lam
        instead of -pi r^2/(lam f) of a thin lens.
    gap : {"opaque", "clear"}
        Area between round lenslets: "opaque", or "clear" for plane glass level with their rims. The
        phase is then relative to this plane, so that lenslets of several kinds share a substrate.
    map : LensletMap, optional
        Measured sag or phase, added to the thin lens or surface or replacing it.

    Attributes
    ----------
    focal_length, f : float
        Focal length, or the first of several, in metres; for a surface R/(n - 1) at its design
        wavelength.
    focal_lengths : tuple of float
        Focal lengths of the kinds of lenslets, all different, in metres.
    surface : tuple of LensletSurface
        Surfaces of the kinds of lenslets; empty for thin lenses.

    Raises
    ------
    ValueError
        If a length, count, lattice or fill is out of range, a focal length differs by more than
        0.5 % from that of the surface, or a surface or map ends within a lenslet.
    ShapeError
        If the numbers of maps and lenslets differ.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 2e-3, count=(4, 6), lattice="hexagonal")
    >>> mla.count, f"{mla.row_pitch * 1e6:.1f} um from row to row"
    ((4, 6), '86.6 um from row to row')
    >>> wave = clplen.wave.plane_wave(clplen.Grid((40, 64), 10e-6), wavelength=500e-9)
    >>> clplen.OpticalSystem([mla, 2e-3])(wave).shape  # in the focal plane
    (40, 64)
    """

    pitch: float
    focal_length: float
    focal_lengths: tuple[float, ...]
    count: tuple[int, int]
    lattice: str
    fill: str
    diameter: float
    offset: tuple[float, float]
    rotation: float
    surface: tuple[LensletSurface, ...]
    gap: str
    map: LensletMap | None
    f = property(attrgetter("focal_length"), doc="Focal length in metres.")
    label = "lenslets"

    def __init__(
        self,
        pitch: float,
        focal_length: float | Sequence[float] | None = None,
        *,
        count: int | tuple[int, int],
        lattice: Literal["square", "hexagonal"] = "square",
        fill: Literal["circular", "full", "square"] = "circular",
        diameter: float | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        rotation: float = 0.0,
        surface: LensletSurface | Sequence[LensletSurface] | None = None,
        gap: Literal["opaque", "clear"] = "opaque",
        map: LensletMap | None = None,
    ) -> None:
        if np.ndim(count) > 1 or np.size(count) not in (1, 2):
            raise ValueError(
                f"The count of lenslets must be one number or (ny, nx), got {count!r}."
            )
        counts = np.broadcast_to(np.asarray(count), (2,))
        if not (is_finite(pitch) and pitch > 0):
            raise ValueError(f"The pitch of lenslets must be positive, in metres, got {pitch!r}.")
        units.LENSLET_PITCH.check(pitch, "The pitch of lenslets")
        if not all(is_integer(n) and n >= 1 for n in counts):
            raise ValueError(
                f"The count of lenslets must be positive integers (ny, nx), got {count!r}."
            )
        if lattice not in ("square", "hexagonal"):
            raise ValueError(f"lattice must be 'square' or 'hexagonal', got {lattice!r}.")
        surfaces = _surfaces(surface)
        requested = _focal_length_of(surfaces, focal_length)
        focal_lengths = _focal_lengths(requested, lattice)
        if fill == "square" and lattice == "square":
            fill = "full"
        if fill not in ("circular", "full"):
            raise ValueError(f"fill must be 'circular' or 'full', got {fill!r}.")
        numbers = (*np.ravel(offset), rotation)
        if np.shape(offset) != (2,) or not all(is_finite(value) for value in numbers):
            raise ValueError(
                "offset must be (y, x) in metres and rotation an angle in radians, all finite, got "
                f"{offset!r} and {rotation!r}."
            )
        units.OFFSET.check(offset, "The offset of the array")
        width = pitch if diameter is None else diameter
        if not (is_finite(width) and 0 < width <= pitch * (1 + 1e-12)):
            raise ValueError(
                f"The diameter of a lenslet must lie between 0 and its pitch of {pitch:g} m, "
                f"got {diameter!r}."
            )
        values = {
            "pitch": float(pitch),
            "focal_length": focal_lengths[0],
            "focal_lengths": focal_lengths,
            "count": (int(counts[0]), int(counts[1])),
            "lattice": lattice,
            "fill": fill,
            "diameter": float(width),
            "offset": (float(offset[0]), float(offset[1])),
            "rotation": float(rotation),
            "surface": surfaces,
            "gap": gap,
            "map": map,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        _check_surfaces(self)

    def __repr__(self) -> str:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        plain = {"surface": (), "gap": "opaque", "map": None}
        return one_line(self, {k: v for k, v in values.items() if k not in plain or v != plain[k]})

    def describe(self) -> str:
        """Return count, pitch, focal length, lattice, fill, and deviations from thin lenslets."""
        text = f"{self.count[0]} x {self.count[1]}, pitch {metres(self.pitch)}, "
        text += f"f = {metres(self.focal_length)}, {self.lattice}, {self.fill}"
        features = ["surface"] * bool(self.surface) + ["map"] * (self.map is not None)
        features += ["clear gaps"] * (self.gap == "clear")
        return ", ".join([text, *features])

    @property
    def is_thin(self) -> bool:
        """True if the lenslets are thin lenses in an opaque mask."""
        return not self.surface and self.gap == "opaque" and self.map is None

    @property
    def row_pitch(self) -> float:
        """Distance between neighbouring rows in metres."""
        return self.pitch * (math.sqrt(3) / 2 if self.lattice == "hexagonal" else 1.0)

    @property
    def extent(self) -> tuple[float, float]:
        """Height and width of the unrotated array in metres."""
        ny, nx = self.count
        if self.lattice == "square":
            return (ny * self.pitch, nx * self.pitch)
        height = (ny - 1) * self.row_pitch + 2 * self.pitch / math.sqrt(3)
        return (height, (nx + (0.5 if ny > 1 else 0.0)) * self.pitch)

    @property
    def type_step(self) -> int:
        """Step s of the kind from a lenslet to its neighbour below (hexagonal: to the right).

        Lenslet (i, k) has the kind (q + s i) mod n, with q = k, or k - i//2 on a hexagonal lattice.
        """
        return 2 if self.lattice == "hexagonal" or len(self.focal_lengths) > 3 else 1

    def replaced(self, *, rotation: float, offset: tuple[float, float]) -> MicrolensArray:
        """Return a copy of the array with another rotation and offset."""
        array = copy.copy(self)
        object.__setattr__(array, "rotation", float(rotation))
        object.__setattr__(array, "offset", (float(offset[0]), float(offset[1])))
        return array

    def types(self) -> np.ndarray:
        """Return the kind of every lenslet, an index into ``focal_lengths``, shape (ny, nx)."""
        i, k = np.indices(self.count)
        q = k - i // 2 if self.lattice == "hexagonal" else k
        return np.asarray((q + self.type_step * i) % len(self.focal_lengths))

    def centres(self) -> np.ndarray:
        """Return the centres (y, x) of the lenslets in metres, shape (ny, nx, 2)."""
        i, k = np.indices(self.count, dtype=np.float64)
        a = k - (self.count[1] - 1) / 2
        if self.lattice == "hexagonal":
            a = a + (i % 2) / 2
        x, y = a * self.pitch, (i - (self.count[0] - 1) / 2) * self.row_pitch
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        return np.stack(
            [x * sin + y * cos + self.offset[0], x * cos - y * sin + self.offset[1]], axis=-1
        )

    def apply(self, field: Field, *, aliasing: Aliasing = "raise") -> Field:
        """Return the field behind the array.

        Parameters
        ----------
        field : Field
            Field on a grid of any pitch and origin.
        aliasing : {"raise", "warn", "allow"}
            Action on aliasing of a lenslet's phase, as in `thin_lens`.

        Returns
        -------
        Field

        Raises
        ------
        SamplingError
            If the pitch is below 2 samples, or a lenslet's phase is aliased.
        """
        require_field(field)
        largest = max(field.grid.pitch)
        if self.pitch < SMALLEST_PITCH * largest * (1 - 1e-12):
            raise SamplingError(
                f"The lenslets' pitch must be at least {SMALLEST_PITCH} samples, got "
                f"{self.pitch:g} m with samples of {largest:g} m; use finer samples."
            )
        half = self.diameter / 2
        equivalent = half / self.steepest_slope(field.wavelength)
        check_lens_sampling(field.grid, equivalent, half, field.wavelength, aliasing)
        return multiply(field, self.transmission(field.grid, field.wavelength, field.device))

    def adjoint(self, field: Field) -> Field:
        """Return the adjoint of `apply`: the field times the conjugate transmission."""
        require_field(field)
        transmission = self.transmission(field.grid, field.wavelength, field.device)
        return multiply(field, transmission, conjugate=True)

    def gradient(self, field: Field, cotangent: Field) -> dict[str, Any]:
        """Return the gradient of a loss with respect to the array.

        It is exact for the sampled transmission, including the covered fraction of each sample.

        Parameters
        ----------
        field : Field
            Field in front of the array, shape (..., ny, nx).
        cotangent : Field
            Gradient dL/dRe + i dL/dIm with respect to the field behind the array, with the shape of
            ``field``.

        Returns
        -------
        dict of str to float or numpy.ndarray
            Gradients per metre or radian, float64: "pitch" (at constant diameter), "diameter",
            "rotation"; "offset" (y, x); "focal_length", common to all kinds, and "focal_lengths" of
            each kind; "centres" (y, x), shape (ny, nx, 2), and "lenslet_focal_lengths", shape (ny,
            nx), of independent lenslets. For an array whose diameter equals its pitch, add "pitch"
            and "diameter".

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        ValueError
            If the lenslets have a surface, a map or clear gaps.

        Notes
        -----
        Where cells without gaps touch, the covered fraction is the sum of both, without the limit
        of 1: "pitch" is the one-sided gradient towards larger values, "diameter" towards smaller.
        """
        self._require_thin()
        of_transmission = transmission_gradient(field, cotangent)
        return array_gradient(self, of_transmission, field.grid, field.wavelength, field.device)

    def jacobian(
        self, grid: Grid, wavelength: float, device: DeviceLike | None = None
    ) -> dict[str, np.ndarray]:
        """Return derivatives of `transmission` by the array, the forward mode of `gradient`.

        Parameters
        ----------
        grid : Grid
            Samples of the plane.
        wavelength : float
            Wavelength in metres.
        device : Device or str, optional
            None is ``Device.open()``.

        Returns
        -------
        dict of str to numpy.ndarray
            Complex derivatives per metre or radian: "pitch" (at constant diameter), "diameter",
            "rotation", shape (1, ny, nx); "offset" (y, x), shape (2, ny, nx); "focal_lengths" of
            each kind, shape (kinds, ny, nx), whose sum is the derivative by all kinds together.

        Raises
        ------
        ValueError
            If the lenslets have a surface, a map or clear gaps.
        """
        self._require_thin()
        opened, rates = as_device(device), array_rates(self, wavelength)
        together = np.concatenate(list(rates.values()))
        changes = opened.download(array_tangents(self, together, grid, wavelength, opened))
        ends = np.cumsum([len(rows) for rows in rates.values()])[:-1]
        return dict(zip(rates, np.split(changes, ends), strict=True))

    def _require_thin(self) -> None:
        if not self.is_thin:
            raise ValueError(
                "Gradients require thin lenslets, but this array has a surface, a map or clear "
                "gaps; describe it by focal lengths and LensletErrors."
            )

    def steepest_slope(self, wavelength: float) -> float:
        """Return the largest slope that a lenslet adds to rays, d/(2 f) for a thin lens.

        For a surface it is the largest within the diameter; a map adds its largest slope.

        Parameters
        ----------
        wavelength : float
            Wavelength in metres.
        """
        half, of_map = self.diameter / 2, 0.0
        if self.map is not None:
            of_map = self.map.steepest() * abs(self.map.path(wavelength))
            if self.map.complete:
                return of_map
        if not self.surface:
            return half / min(abs(f) for f in self.focal_lengths) + of_map
        r = np.linspace(0, half, 257)
        slopes = [np.abs((s.index(wavelength) - 1) * s.slope(r)).max() for s in self.surface]
        return float(max(slopes)) + of_map

    def bend(self, lenslet: Any, y: Any, x: Any, wavelength: float) -> tuple[Any, Any]:
        """Return the slopes (y, x) that lenslets add to rays, -(y, x)/f for thin lenses.

        Parameters
        ----------
        lenslet : numpy.ndarray
            Index of the lenslet: row times number of columns plus column.
        y, x : numpy.ndarray
            Position relative to the centre of the lenslet, along the array's rows and columns, in
            metres.
        wavelength : float
            Wavelength in metres.
        """
        kind = self.types().ravel()[lenslet]
        if self.map is not None and self.map.complete:
            down, right = np.zeros_like(y), np.zeros_like(x)
        elif self.surface:
            r = np.hypot(y, x)
            each = [(s.index(wavelength) - 1) * s.slope(r) for s in self.surface]
            over = np.take_along_axis(np.array(each), kind[None], 0)[0] / np.where(r > 0, r, 1)
            down, right = -over * y, -over * x
        else:
            f = np.asarray(self.focal_lengths)[kind]
            down, right = -y / f, -x / f
        if self.map is not None:
            by_map, path = self.map.slopes(lenslet, y, x), self.map.path(wavelength)
            down, right = down + path * by_map[0], right + path * by_map[1]
        return down, right

    def transmission(
        self,
        grid: Grid,
        wavelength: float,
        device: DeviceLike | None = None,
        *,
        rim: tuple[float, float] | None = None,
    ) -> cla.Array:
        """Return the complex transmission on a grid, shape (ny, nx).

        Parameters
        ----------
        grid : Grid
            Samples of the plane, of equal pitch along y and x if ``rim`` is set.
        wavelength : float
            Wavelength in metres.
        device : Device or str, optional
            None is ``Device.open()``.
        rim : tuple of float, optional
            Pass band and stop band in cycles per sample of a low-pass filter on the rims, as in
            `rim_weights`. None: a sample on the rim has the covered fraction of its cell, and the
            device caches the result. Lenslets with a surface or map always have the covered
            fraction.

        Returns
        -------
        pyopencl.array.Array
        """
        opened, key = as_device(device), ("lenslets", self, grid, wavelength)
        cached = opened.plans.get(key) if rim is None else None
        if cached is not None:
            return cached
        if self.is_thin:
            samples = self._transmission(grid, wavelength, opened, rim)
        else:
            samples = self._surface_transmission(grid, wavelength, opened)
        return opened.plans.keep(key, samples, int(samples.nbytes)) if rim is None else samples

    def _transmission(
        self,
        grid: Grid,
        wavelength: float,
        device: Device,
        rim: tuple[float, float] | None = None,
    ) -> cla.Array:
        out = device.empty(grid.shape, device.complex)
        defines = self.lattice_defines(double=device.precision == "double")
        defines |= {"FILTERED": True} if rim else {}
        if rim and len(self.focal_lengths) == 1 and device.rows and device.precision == "single":
            defines["LANES"] = True
        weights = rim_weights(*rim) if rim else np.zeros(1)
        device.launch_rows(
            device.kernel("lenslets.cl", "lenslets", **defines),
            grid.shape,
            out,
            *(device.upload(t) for t in self.lattice_tables(grid, device)),
            device.upload(self.lens_turns(wavelength).astype(device.real)),
            *self.aperture_numbers(grid, device.real),
            device.upload(weights.astype(device.real)),
            len(weights),
            *self.count,
            *grid.shape,
        )
        return out

    def _surface_transmission(self, grid: Grid, wavelength: float, device: Device) -> cla.Array:
        """Return `transmission` of surfaces, maps and clear gaps, in float64 if supported."""
        wide = device.precision == "double" or device.has_fp64
        real = np.dtype(np.float64 if wide else np.float32)
        out = device.empty(grid.shape, device.complex)
        shapes = self._shapes(wavelength)
        defines = self.lattice_defines(double=wide)
        defines["RESULT"] = "double2" if device.precision == "double" else "float2"
        defines |= {"CLEAR": True} if self.gap == "clear" else {}
        defines["POWERS"] = shapes.shape[1] - 3
        maps, per, zero = np.zeros((1, 1)), (0.0, 0.0), (0.0, 0.0)
        if self.map is not None:
            defines["MAP"] = True
            maps = self.map.padded() * (self.map.path(wavelength) / wavelength)
            per, zero = self.map.sampling()
        device.launch_rows(
            device.kernel("made_lenslets.cl", "made_lenslets", **defines),
            grid.shape,
            out,
            *(device.upload(t) for t in self.lattice_tables(grid, device, dtype=real)),
            device.upload(shapes.astype(real)),
            device.upload(maps.astype(real)),
            *self.aperture_numbers(grid, real),
            np.array(per, real) * real.type(self.pitch),
            np.array(zero, real),
            int(self.map is not None and self.map.is_per_lenslet),
            *maps.shape[-2:],
            *self.count,
            *grid.shape,
        )
        return out

    def _shapes(self, wavelength: float) -> Values:
        """Return c, q, the rim's turns and e_0, e_1, ... of every kind for the kernel."""
        if self.map is not None and self.map.complete:
            rows = [[0.0, 0.0] for _ in self.focal_lengths]
        elif self.surface:
            rows = [surface.turns(wavelength, self.pitch) for surface in self.surface]
        else:
            rows = [[self.pitch**2 / (wavelength * f), 0.0] for f in self.focal_lengths]
        shapes = np.zeros((len(rows), 1 + max(len(row) for row in rows)))
        u = (self.diameter / self.pitch / 2) ** 2
        for shape, (c, q, *higher) in zip(shapes, rows, strict=True):
            shape[:2], shape[3 : 3 + len(higher)] = (c, q), higher
            if self.gap == "clear":
                rim = c * u / (1 + math.sqrt(max(1 - q * u, 0.0)))
                shape[2] = rim + sum(e * u ** (2 + i) for i, e in enumerate(higher))
        return shapes

    def lattice_defines(self, *, double: bool) -> dict[str, Any]:
        """Return the definitions of a kernel that locates the lenslet of a sample."""
        defines: dict[str, Any] = {"DOUBLE": True} if double else {}
        defines |= {"HEXAGONAL": True} if self.lattice == "hexagonal" else {}
        defines |= {"FULL": True} if self.fill == "full" else {}
        return defines | {"TYPES": len(self.focal_lengths), "TYPE_STEP": self.type_step}

    def aperture_numbers(self, grid: Grid, dtype: np.dtype[Any]) -> list[Any]:
        """Return the arguments radius, turn, angle, hy and hx of kernels: lengths in pitches."""
        real = dtype.type
        return [
            real(self.diameter / self.pitch / 2),
            np.array([math.cos(self.rotation), math.sin(self.rotation)], dtype),
            real(self.rotation),
            real(grid.pitch[0] / self.pitch / 2),
            real(grid.pitch[1] / self.pitch / 2),
        ]

    def lens_turns(self, wavelength: float) -> Float64Array:
        """Return the phase of each kind of lenslet one pitch from its centre, in turns."""
        return self.pitch**2 / (2 * wavelength * np.asarray(self.focal_lengths))

    def lattice_tables(
        self, grid: Grid, device: DeviceLike | None = None, *, dtype: Any = None
    ) -> list[np.ndarray]:
        """Return the parts a(y), b(y), a(x) and b(x) of the column and row coordinates.

        The dtype is by default that of the device's fields.
        """
        real = as_device(device).real if dtype is None else np.dtype(dtype)
        y, x = grid.y - self.offset[0], grid.x - self.offset[1]
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        column = (self.count[1] - 1) / 2
        row = (self.count[0] - 1) / 2
        values = (
            y * sin / self.pitch + column,
            y * cos / self.row_pitch + row,
            x * cos / self.pitch,
            -x * sin / self.row_pitch,
        )
        return [whole_and_part(v, real) for v in values]


def circumscribed(mla: MicrolensArray) -> float:
    """Return the diameter of the circle around the aperture of a lenslet, in metres."""
    if mla.fill == "circular":
        return mla.diameter
    return mla.diameter * (2 / math.sqrt(3) if mla.lattice == "hexagonal" else math.sqrt(2))


def _surfaces(surface: Any) -> tuple[LensletSurface, ...]:
    """Return the surfaces of an array, one for each kind."""
    surfaces = () if surface is None else surface
    surfaces = (surfaces,) if isinstance(surfaces, LensletSurface) else tuple(surfaces)
    if not all(isinstance(item, LensletSurface) for item in surfaces):
        raise TypeError(
            f"surface must be a LensletSurface or one for each kind of lenslet, got {surface!r}."
        )
    return surfaces


def _focal_length_of(surfaces: tuple[LensletSurface, ...], requested: Any) -> Any:
    """Return the focal lengths of surfaces; raise if requested focal lengths differ."""
    if not surfaces:
        if requested is None:
            raise ValueError("Lenslets require a focal_length in metres, or a surface.")
        return requested
    lengths = tuple(surface.focal_length() for surface in surfaces)
    if requested is None:
        return lengths
    values = np.atleast_1d(np.asarray(requested, np.float64)).ravel()
    if len(values) != len(lengths):
        raise ValueError(
            f"There must be one surface for each focal length, got {len(lengths)} surfaces and "
            f"{len(values)} focal lengths."
        )
    for surface, f, value in zip(surfaces, lengths, values, strict=True):
        if not abs(value - f) <= _FOCAL_TOLERANCE * abs(f):
            index = surface.index(surface.design_wavelength)
            raise ValueError(
                f"A surface of radius {surface.radius:g} m and index {index:.5g} at "
                f"{surface.design_wavelength:g} m has the focal length {f:.6g} m, not {value:g}; "
                f"set focal_length={f:.6g}, omit it, or use the radius {value * (index - 1):.6g} m."
            )
    return lengths


def _check_surfaces(mla: MicrolensArray) -> None:
    """Raise if surfaces, gaps or maps do not fit an array."""
    if mla.gap not in ("opaque", "clear"):
        raise ValueError(f"gap must be 'opaque' or 'clear', got {mla.gap!r}.")
    if mla.gap == "clear" and mla.fill != "circular":
        raise ValueError("gap='clear' requires round lenslets; use fill='circular'.")
    radius = circumscribed(mla) / 2
    for surface in mla.surface:
        if radius >= surface.reach:
            raise ValueError(
                f"A surface of radius {surface.radius:g} m and conic constant {surface.conic:g} "
                f"ends {surface.reach:.4g} m from its vertex, within a lenslet of radius "
                f"{radius:.4g} m; use a larger radius of the surface or a smaller diameter."
            )
    if mla.map is None:
        return
    if not isinstance(mla.map, LensletMap):
        raise TypeError(f"map must be a LensletMap, got {type(mla.map).__name__}.")
    if mla.map.is_per_lenslet and mla.map.values.shape[:2] != mla.count:
        raise ShapeError(
            f"Maps of all lenslets must have the array's (rows, columns) {mla.count}, got "
            f"{mla.map.values.shape[:2]}; else use a single map."
        )
    if mla.map.complete and (mla.surface or mla.gap == "clear"):
        what = "surface" if mla.surface else "gap='clear'"
        raise ValueError(
            f"A map with complete=True replaces {what}; omit {what}, or use complete=False."
        )
    corner = 2 / math.sqrt(3) if mla.fill == "full" and mla.lattice == "hexagonal" else 1.0
    mla.map.check_reach((mla.diameter / 2 * corner, mla.diameter / 2))


def _focal_lengths(f: float | Sequence[float], lattice: str) -> tuple[float, ...]:
    """Return the focal lengths of an array after validation."""
    lengths = np.ravel(np.asarray(f, object)).tolist()
    if not lengths or not all(is_finite(value) and value != 0 for value in lengths):
        raise ValueError(f"The focal length of lenslets must be finite and not 0, got {f!r}.")
    values = tuple(float(value) for value in lengths)
    units.LENSLET_FOCAL_LENGTH.check(values, "The focal length of lenslets")
    if len(set(values)) < len(values):
        raise ValueError(f"The focal lengths of a multi-focus array differ, unlike {f!r}.")
    if lattice == "hexagonal" and len(values) not in (1, 3):
        raise ValueError(
            f"A hexagonal array must have one or three kinds of lenslets, got {len(values)}; else "
            "neighbours would be of one kind."
        )
    return values
