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

SMALLEST_PITCH = 2  # samples a lenslet
_CONTRADICTION = 0.005  # of a focal length, from that of the surface

Values = np.ndarray[Any, np.dtype[np.float64]]


@alias_argument(f="focal_length")
@dataclass(frozen=True, init=False, repr=False)
class MicrolensArray(OneLine):
    """Thin lenslets on a square or hexagonal lattice, centred on the axis.

    Lenslet (i, k) is centred at rotation * ((k - (nx - 1)/2) pitch, (i - (ny - 1)/2) height) +
    offset, with height = pitch (square) or sqrt(3)/2 pitch (hexagonal, odd rows moved by
    +pitch/2). Outside its lenslets the array is opaque, but for clear gaps.

    Parameters
    ----------
    pitch : float
        Between neighbours of a row, in metres.
    focal_length : float or sequence of float, optional
        Of a lenslet in metres, not 0; a ``surface`` has its own. Several make a multi-focus array:
        kind (k + s i) mod n on a square lattice of n kinds, s = 1 for 2 and 3 of them, else 2, and
        (k - i//2 + 2 i) mod 3 on a hexagonal one, which has 3 or 1; neighbours differ.
    count : int or tuple of int
        Lenslets, (ny, nx) or one number for both.
    lattice : {"square", "hexagonal"}
        How the centres lie: see above.
    fill : {"circular", "full"}
        Aperture of a lenslet: a disc, or the lattice cell (square or hexagon). On a square lattice
        "square" is another word for "full".
    diameter : float, optional
        Of the disc, or width of the cell, in metres, at most ``pitch``; None: ``pitch``.
    offset : tuple of float
        (y, x) of the array's centre in metres.
    rotation : float
        In radians; positive turns +x towards +y (y down).
    surface : LensletSurface or sequence of LensletSurface, optional
        Of the lenslets, one a kind: the phase -2 pi (n(lam) - 1) z(r)/lam, which follows the
        wavelength, in place of a thin lens' -pi r^2/(lam f).
    gap : {"opaque", "clear"}
        What lies between round lenslets within the cells of the lattice: nothing passes, or plane
        glass level with the rims of the lenslets. With "clear" the phase is that from this plane,
        so that lenslets of several kinds stand on one piece of glass.
    map : LensletMap, optional
        A measured sag or phase, added to the thin lens or the surface, or in its place.

    Attributes
    ----------
    focal_length, f : float
        The focal length, or the first of several; of a surface R/(n - 1) at its design wavelength.
    focal_lengths : tuple of float
        Of the kinds of lenslets, all different.
    surface : tuple of LensletSurface
        Of the kinds of lenslets; empty for thin lenses.

    Raises
    ------
    ValueError
        For a length, count, lattice or fill outside its range; a focal length that differs by more
        than .5 % from that of the surface; a surface or a map that ends within a lenslet.
    ShapeError
        If there are maps of each lenslet, but not as many as lenslets.

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
            raise ValueError(f"The count of lenslets is one number or (ny, nx), not {count!r}.")
        counts = np.broadcast_to(np.asarray(count), (2,))
        if not (is_finite(pitch) and pitch > 0):
            raise ValueError(f"The pitch of lenslets is positive, in metres, not {pitch!r}.")
        units.LENSLET_PITCH.check(pitch, "The pitch of lenslets")
        if not all(is_integer(n) and n >= 1 for n in counts):
            raise ValueError(f"The count of lenslets is positive integers (ny, nx), not {count!r}.")
        if lattice not in ("square", "hexagonal"):
            raise ValueError(f"lattice is 'square' or 'hexagonal', not {lattice!r}.")
        surfaces = _surfaces(surface)
        given = _focal_length_of(surfaces, focal_length)
        focal_lengths = _focal_lengths(given, lattice)
        if fill == "square" and lattice == "square":
            fill = "full"
        if fill not in ("circular", "full"):
            raise ValueError(f"fill is 'circular' or 'full', not {fill!r}.")
        numbers = (*np.ravel(offset), rotation)
        if np.shape(offset) != (2,) or not all(is_finite(value) for value in numbers):
            raise ValueError(
                "offset is (y, x) in metres and rotation an angle in radians, all finite, not "
                f"{offset!r} and {rotation!r}."
            )
        units.OFFSET.check(offset, "The offset of the array")
        width = pitch if diameter is None else diameter
        if not (is_finite(width) and 0 < width <= pitch * (1 + 1e-12)):
            raise ValueError(
                f"The diameter of a lenslet lies between 0 and its pitch of {pitch:g} m, "
                f"not {diameter!r}."
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
        _check_made(self)

    def __repr__(self) -> str:
        shown = {one.name: getattr(self, one.name) for one in fields(self)}
        plain = {"surface": (), "gap": "opaque", "map": None}
        return one_line(self, {k: v for k, v in shown.items() if k not in plain or v != plain[k]})

    def describe(self) -> str:
        """Count, pitch, focal length, lattice, fill, and how the lenslets are made."""
        text = f"{self.count[0]} x {self.count[1]}, pitch {metres(self.pitch)}, "
        text += f"f = {metres(self.focal_length)}, {self.lattice}, {self.fill}"
        made = ["surface"] * bool(self.surface) + ["map"] * (self.map is not None)
        made += ["clear gaps"] * (self.gap == "clear")
        return ", ".join([text, *made])

    @property
    def is_thin(self) -> bool:
        """Whether the lenslets are thin lenses in an opaque mask."""
        return not self.surface and self.gap == "opaque" and self.map is None

    @property
    def row_pitch(self) -> float:
        """Distance of neighbouring rows in metres."""
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
        """s: by how much the kind changes from a lenslet to its neighbour below (hexagonal: right).

        Lenslet (i, k) is of the kind (q + s i) mod n, q = k, or k - i//2 on a hexagonal lattice.
        """
        return 2 if self.lattice == "hexagonal" or len(self.focal_lengths) > 3 else 1

    def replaced(self, *, rotation: float, offset: tuple[float, float]) -> MicrolensArray:
        """The same lenslets, turned by another angle about another centre."""
        made = copy.copy(self)
        object.__setattr__(made, "rotation", float(rotation))
        object.__setattr__(made, "offset", (float(offset[0]), float(offset[1])))
        return made

    def types(self) -> np.ndarray:
        """The kind of every lenslet, an index into ``focal_lengths``, shape (ny, nx)."""
        i, k = np.indices(self.count)
        q = k - i // 2 if self.lattice == "hexagonal" else k
        return np.asarray((q + self.type_step * i) % len(self.focal_lengths))

    def centres(self) -> np.ndarray:
        """Centres (y, x) of the lenslets in metres, shape (ny, nx, 2)."""
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
        """The field behind the array.

        Parameters
        ----------
        field : Field
            On a grid with equal pitch along y and x or not; any origin.
        aliasing : {"raise", "warn", "allow"}
            As in `thin_lens`, for a lenslet's phase.

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
                f"The lenslets' pitch of {self.pitch:g} m is {self.pitch / largest:.3g} samples of "
                f"{largest:g} m; at least {SMALLEST_PITCH} are needed: sample more finely."
            )
        half = self.diameter / 2
        as_steep = half / self.steepest_slope(field.wavelength)
        check_lens_sampling(field.grid, as_steep, half, field.wavelength, aliasing)
        return multiply(field, self.transmission(field.grid, field.wavelength, field.device))

    def adjoint(self, field: Field) -> Field:
        """The adjoint of `apply`: the field times the conjugate transmission."""
        require_field(field)
        transmission = self.transmission(field.grid, field.wavelength, field.device)
        return multiply(field, transmission, conjugate=True)

    def gradient(self, field: Field, cotangent: Field) -> dict[str, Any]:
        """The gradient of a loss with respect to the array, from that of the field behind it.

        It is exact for the transmission as sampled, the covered share of every sample included.

        Parameters
        ----------
        field : Field
            In front of the array, shape (..., ny, nx).
        cotangent : Field
            dL/dRe + i dL/dIm of the field behind the array, of the shape of ``field``.

        Returns
        -------
        dict of str to float or numpy.ndarray
            "pitch" (the diameter stays), "diameter", "rotation"; "offset" (y, x); "focal_length",
            all kinds together, and "focal_lengths" of each kind; "centres" and
            "lenslet_focal_lengths", as if every lenslet had its own: shapes (ny, nx, 2), (y, x),
            and (ny, nx). All per metre or radian, float64. An array whose diameter follows its
            pitch has the sum of "pitch" and "diameter".

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        ValueError
            For lenslets with a surface, a map or clear gaps.

        Notes
        -----
        Where cells without gaps touch, the share counts as the sum of both, not at most 1: "pitch"
        is the gradient towards larger and "diameter" that towards smaller ones.
        """
        self._require_thin()
        found = transmission_gradient(field, cotangent)
        return array_gradient(self, found, field.grid, field.wavelength, field.device)

    def jacobian(
        self, grid: Grid, wavelength: float, device: DeviceLike | None = None
    ) -> dict[str, np.ndarray]:
        """Derivatives of `transmission` with respect to the array, the forward mode of `gradient`.

        Parameters
        ----------
        grid : Grid
        wavelength : float
            In metres.
        device : Device or str, optional
            None is ``Device.open()``.

        Returns
        -------
        dict of str to numpy.ndarray
            "pitch" (the diameter stays), "diameter", "rotation", shape (1, ny, nx); "offset" (y,
            x), shape (2, ny, nx); "focal_lengths" of each kind, shape (kinds, ny, nx), whose sum is
            that by all kinds together. Complex, per metre or radian.

        Raises
        ------
        ValueError
            For lenslets with a surface, a map or clear gaps.
        """
        self._require_thin()
        opened, rates = as_device(device), array_rates(self, wavelength)
        together = np.concatenate(list(rates.values()))
        changes = opened.download(array_tangents(self, together, grid, wavelength, opened))
        ends = np.cumsum([len(one) for one in rates.values()])[:-1]
        return dict(zip(rates, np.split(changes, ends), strict=True))

    def _require_thin(self) -> None:
        if not self.is_thin:
            raise ValueError(
                "Gradients are those of thin lenslets; this array has a surface, a map or clear "
                "gaps: describe it by focal lengths and LensletErrors."
            )

    def steepest_slope(self, wavelength: float) -> float:
        """The steepest slope that a lenslet adds to rays: d/(2 f) of a thin lens.

        Of a surface, that within the diameter; a map adds the largest step of its samples.

        Parameters
        ----------
        wavelength : float
            In metres.
        """
        half, of_map = self.diameter / 2, 0.0
        if self.map is not None:
            of_map = self.map.steepest() * abs(self.map.path(wavelength))
            if self.map.whole:
                return of_map
        if not self.surface:
            return half / min(abs(f) for f in self.focal_lengths) + of_map
        r = np.linspace(0, half, 257)
        slopes = [np.abs((s.index(wavelength) - 1) * s.slope(r)).max() for s in self.surface]
        return float(max(slopes)) + of_map

    def bend(self, lenslet: Any, y: Any, x: Any, wavelength: float) -> tuple[Any, Any]:
        """Slopes (y, x) that lenslets add to rays: -(y, x)/f for thin lenses.

        Parameters
        ----------
        lenslet : numpy.ndarray
            Which of them: row times columns plus column.
        y, x : numpy.ndarray
            From the centre of the lenslet, along the array's rows and columns, in metres.
        wavelength : float
            In metres.
        """
        kind = self.types().ravel()[lenslet]
        if self.map is not None and self.map.whole:
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
        """Complex transmission on a grid, shape (ny, nx).

        Parameters
        ----------
        grid : Grid
            With equal pitch along y and x if ``rim`` is given.
        wavelength : float
            In metres.
        device : Device or str, optional
            None is ``Device.open()``.
        rim : tuple of float, optional
            None: a sample at the rim of a lenslet has the share of its cell that is covered, and
            the result is kept on the device for the next call. Else the rim is a step filtered as
            by `rim_weights`: cycles a sample that stay, and from which on none are left; lenslets
            with a surface or a map have the covered share.

        Returns
        -------
        pyopencl.array.Array
        """
        opened, key = as_device(device), ("lenslets", self, grid, wavelength)
        kept = opened.plans.get(key) if rim is None else None
        if kept is not None:
            return kept
        if self.is_thin:
            samples = self._transmission(grid, wavelength, opened, rim)
        else:
            samples = self._made(grid, wavelength, opened)
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

    def _made(self, grid: Grid, wavelength: float, device: Device) -> cla.Array:
        """`transmission` of surfaces, maps and clear gaps, in float64 where there is any."""
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
            per, zero = self.map.places()
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
            int(self.map is not None and self.map.is_of_each),
            *maps.shape[-2:],
            *self.count,
            *grid.shape,
        )
        return out

    def _shapes(self, wavelength: float) -> Values:
        """c, q, the rim's turns and e_0, e_1, ... of every kind for the kernel."""
        if self.map is not None and self.map.whole:
            rows = [[0.0, 0.0] for _ in self.focal_lengths]
        elif self.surface:
            rows = [one.turns(wavelength, self.pitch) for one in self.surface]
        else:
            rows = [[self.pitch**2 / (wavelength * f), 0.0] for f in self.focal_lengths]
        found = np.zeros((len(rows), 1 + max(len(row) for row in rows)))
        u = (self.diameter / self.pitch / 2) ** 2
        for shape, (c, q, *higher) in zip(found, rows, strict=True):
            shape[:2], shape[3 : 3 + len(higher)] = (c, q), higher
            if self.gap == "clear":
                rim = c * u / (1 + math.sqrt(max(1 - q * u, 0.0)))
                shape[2] = rim + sum(e * u ** (2 + i) for i, e in enumerate(higher))
        return found

    def lattice_defines(self, *, double: bool) -> dict[str, Any]:
        """Return the definitions of a kernel that finds the lenslet of a sample."""
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
        """What y and x add to the column and row coordinate: a(y), b(y), a(x), b(x).

        Of ``dtype``, default that of the device's fields.
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
    """Diameter of the circle about the aperture of a lenslet, in metres."""
    if mla.fill == "circular":
        return mla.diameter
    return mla.diameter * (2 / math.sqrt(3) if mla.lattice == "hexagonal" else math.sqrt(2))


def _surfaces(surface: Any) -> tuple[LensletSurface, ...]:
    """The surfaces of an array, one a kind."""
    found = () if surface is None else surface
    found = (found,) if isinstance(found, LensletSurface) else tuple(found)
    if not all(isinstance(one, LensletSurface) for one in found):
        raise TypeError(
            f"surface is a LensletSurface or several, one a kind of lenslet, not {surface!r}."
        )
    return found


def _focal_length_of(surfaces: tuple[LensletSurface, ...], given: Any) -> Any:
    """The focal lengths of surfaces, which those that are given must not contradict."""
    if not surfaces:
        if given is None:
            raise ValueError("Lenslets need a focal_length in metres, or a surface.")
        return given
    own = tuple(one.focal_length() for one in surfaces)
    if given is None:
        return own
    asked = np.atleast_1d(np.asarray(given, np.float64)).ravel()
    if len(asked) != len(own):
        raise ValueError(
            f"There are {len(own)} surfaces and {len(asked)} focal lengths: give one surface a "
            "kind of lenslet."
        )
    for one, f, other in zip(surfaces, own, asked, strict=True):
        if not abs(other - f) <= _CONTRADICTION * abs(f):
            radius = other * (one.index(one.design_wavelength) - 1)
            raise ValueError(
                f"A surface of radius {one.radius:g} m and index "
                f"{one.index(one.design_wavelength):.5g} at {one.design_wavelength:g} m has the "
                f"focal length {f:.6g} m, not {other:g}: give focal_length={f:.6g}, none, or the "
                f"radius {radius:.6g} m."
            )
    return own


def _check_made(mla: MicrolensArray) -> None:
    """Refuse surfaces, gaps and maps that do not fit an array."""
    if mla.gap not in ("opaque", "clear"):
        raise ValueError(f"gap is 'opaque' or 'clear', not {mla.gap!r}.")
    if mla.gap == "clear" and mla.fill != "circular":
        raise ValueError("gap='clear' is for round lenslets: use fill='circular'.")
    far = circumscribed(mla) / 2
    for one in mla.surface:
        if far >= one.reach:
            raise ValueError(
                f"A surface of radius {one.radius:g} m and conic constant {one.conic:g} ends "
                f"{one.reach:.4g} m from its vertex, within a lenslet that reaches to {far:.4g} m: "
                "give a larger radius or a smaller diameter."
            )
    if mla.map is None:
        return
    if not isinstance(mla.map, LensletMap):
        raise TypeError(f"map is a LensletMap, not of type {type(mla.map).__name__}.")
    if mla.map.is_of_each and mla.map.values.shape[:2] != mla.count:
        raise ShapeError(
            f"There are maps of {mla.map.values.shape[:2]} lenslets, but {mla.count} (rows, "
            "columns) in the array: give one for each, or one for all."
        )
    if mla.map.whole and (mla.surface or mla.gap == "clear"):
        what = "surface" if mla.surface else "gap='clear'"
        raise ValueError(
            f"A map with whole=True is the lenslet itself: leave out {what}, or use whole=False."
        )
    corner = 2 / math.sqrt(3) if mla.fill == "full" and mla.lattice == "hexagonal" else 1.0
    mla.map.check_reach((mla.diameter / 2 * corner, mla.diameter / 2))


def _focal_lengths(f: float | Sequence[float], lattice: str) -> tuple[float, ...]:
    """The focal lengths of an array, checked."""
    given = np.ravel(np.asarray(f, object)).tolist()
    if not given or not all(is_finite(value) and value != 0 for value in given):
        raise ValueError(f"The focal length of lenslets is finite and not 0, not {f!r}.")
    values = tuple(float(value) for value in given)
    units.LENSLET_FOCAL_LENGTH.check(values, "The focal length of lenslets")
    if len(set(values)) < len(values):
        raise ValueError(f"The focal lengths of a multi-focus array differ, unlike {f!r}.")
    if lattice == "hexagonal" and len(values) not in (1, 3):
        raise ValueError(
            f"A hexagonal array has lenslets of one kind or of three, not {len(values)}: its "
            "neighbours would be alike."
        )
    return values
