"""Microlens arrays in closed form at real coordinates, and the errors of their lenslets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen import units
from clplen.checks import Aliasing, is_finite
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.deprecation import renamed_argument, renamed_attribute
from clplen.errors import SamplingError
from clplen.reprs import OneLine
from clplen.wave.elements.lens import check_lens_sampling
from clplen.wave.elements.rims import rim_weights
from clplen.wave.elements.zernike import zernike_gradient, zernike_monomials
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.transmission import multiply, whole_and_part

SMALLEST_PITCH = 2  # samples a lenslet


@renamed_argument(old="f", new="focal_length", warn=False)
@dataclass(frozen=True, init=False, repr=False)
class MicrolensArray(OneLine):
    """Thin lenslets on a square or hexagonal lattice, centred on the axis.

    Lenslet (i, k) is centred at rotation * ((k - (nx - 1)/2) pitch, (i - (ny - 1)/2) height) +
    offset, with height = pitch (square) or sqrt(3)/2 pitch (hexagonal, odd rows moved by
    +pitch/2). Outside its lenslets the array is opaque.

    Parameters
    ----------
    pitch : float
        Between neighbours of a row, in metres.
    focal_length : float or sequence of float
        Of a lenslet in metres, not 0. Several make a multi-focus array: kind
        (k + s i) mod n on a square lattice of n kinds, s = 1 for 2 and 3 of them, else 2, and
        (k - i//2 + 2 i) mod 3 on a hexagonal one, which has 3 or 1; neighbours differ.
    count : int or tuple of int
        Lenslets, (ny, nx) or one number for both.
    lattice : {"square", "hexagonal"}
    fill : {"circular", "full"}
        Aperture of a lenslet: a disc, or the lattice cell (square or hexagon). On a square lattice
        "square" is another word for "full".
    diameter : float, optional
        Of the disc, or width of the cell, in metres, at most ``pitch``; None: ``pitch``.
    offset : tuple of float
        (y, x) of the array's centre in metres.
    rotation : float
        In radians; positive turns +x towards +y (y down).

    Attributes
    ----------
    focal_length, f : float
        The focal length, or the first of several.
    focal_lengths : tuple of float
        Of the kinds of lenslets, all different.

    Raises
    ------
    ValueError
        For a length, count, lattice or fill outside its range.
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
    f = renamed_attribute("f", "focal_length", warn=False)

    def __init__(
        self,
        pitch: float,
        focal_length: float | Sequence[float],
        *,
        count: int | tuple[int, int],
        lattice: Literal["square", "hexagonal"] = "square",
        fill: Literal["circular", "full", "square"] = "circular",
        diameter: float | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        rotation: float = 0.0,
    ) -> None:
        if np.ndim(count) > 1 or np.size(count) not in (1, 2):
            raise ValueError(f"The count of lenslets is one number or (ny, nx), not {count!r}.")
        counts = np.broadcast_to(np.asarray(count), (2,))
        if not (is_finite(pitch) and pitch > 0):
            raise ValueError(f"The pitch of lenslets is positive, in metres, not {pitch!r}.")
        units.LENSLET_PITCH.check(pitch, "The pitch of lenslets")
        if any(int(n) != n or n < 1 for n in counts):
            raise ValueError(f"The count of lenslets is positive integers (ny, nx), not {count!r}.")
        if lattice not in ("square", "hexagonal"):
            raise ValueError(f"lattice is 'square' or 'hexagonal', not {lattice!r}.")
        focal_lengths = _focal_lengths(focal_length, lattice)
        if fill == "square" and lattice == "square":
            fill = "full"
        if fill not in ("circular", "full"):
            raise ValueError(f"fill is 'circular' or 'full', not {fill!r}.")
        if not (np.shape(offset) == (2,) and all(map(is_finite, (*offset, rotation)))):
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
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

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
        return MicrolensArray(
            self.pitch,
            self.focal_lengths,
            count=self.count,
            lattice=self.lattice,  # type: ignore[arg-type]
            fill=self.fill,  # type: ignore[arg-type]
            diameter=self.diameter,
            offset=offset,
            rotation=rotation,
        )

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
        steepest = min(self.focal_lengths, key=abs)
        check_lens_sampling(field.grid, steepest, self.diameter / 2, field.wavelength, aliasing)
        return multiply(field, self.transmission(field.grid, field.wavelength, field.device))

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
            by `rim_weights`: cycles a sample that stay, and from which on none are left.

        Returns
        -------
        pyopencl.array.Array
        """
        opened = as_device(device)
        if rim is not None:
            return self._transmission(grid, wavelength, opened, rim)
        return opened.plans.get(
            ("lenslets", self, grid, wavelength),
            lambda: self._transmission(grid, wavelength, opened),
            lambda array: int(array.nbytes),
        )

    def _transmission(
        self,
        grid: Grid,
        wavelength: float,
        device: Device,
        rim: tuple[float, float] | None = None,
    ) -> cla.Array:
        real = device.real.type
        out = device.empty(grid.shape, device.complex)
        defines = device.wave_defines()
        defines |= {"HEXAGONAL": True} if self.lattice == "hexagonal" else {}
        defines |= {"FULL": True} if self.fill == "full" else {}
        defines |= {"TYPES": len(self.focal_lengths), "TYPE_STEP": self.type_step}
        defines |= {"FILTERED": True} if rim else {}
        weights = rim_weights(*rim) if rim else np.zeros(1)
        turns = self.pitch**2 / (2 * wavelength * np.asarray(self.focal_lengths))
        kernel = device.kernel("lenslets.cl", "lenslets", **defines)
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        device.launch_rows(
            kernel,
            grid.shape,
            out,
            *(device.upload(t) for t in self.lattice_tables(grid, device)),
            device.upload(turns.astype(device.real)),
            real(self.diameter / self.pitch / 2),
            np.array([cos, sin], device.real),
            real(self.rotation),
            real(grid.pitch[0] / self.pitch / 2),
            real(grid.pitch[1] / self.pitch / 2),
            device.upload(weights.astype(device.real)),
            np.int32(len(weights)),
            np.int32(self.count[0]),
            np.int32(self.count[1]),
            np.int32(grid.shape[0]),
            np.int32(grid.shape[1]),
        )
        return out

    def lattice_tables(self, grid: Grid, device: DeviceLike | None = None) -> list[np.ndarray]:
        """What y and x add to the column and row coordinate: a(y), b(y), a(x), b(x)."""
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
        return [whole_and_part(v, as_device(device).real) for v in values]


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


Values = np.ndarray[Any, np.dtype[np.float64]]
Orders = tuple[int, int]
HIGHEST_ORDER = 8  # of a lenslet's Zernike terms; float32 polynomials keep 4e-4 rad a wave there


@dataclass(frozen=True, eq=False, repr=False)
class LensletErrors(OneLine):
    """Departures of the lenslets of one array, along its own columns (x) and rows (y).

    Attributes
    ----------
    terms : dict of (int, int) to float
        Zernike polynomials (n, m) of every lenslet, in metres rms over a circle about its centre.
    circle : float
        Diameter of that circle in metres.
    focal_lengths : numpy.ndarray
        Of each lenslet, in metres, shape (ny, nx).
    tilt : numpy.ndarray
        (y, x) of the slope that each adds to rays, in radians, shape (ny, nx, 2).
    position : numpy.ndarray
        (y, x) of each vertex from the centre of its aperture, in metres, shape (ny, nx, 2).
    """

    terms: dict[Orders, float]
    circle: float
    focal_lengths: Values
    tilt: Values
    position: Values

    def phase(
        self, mla: MicrolensArray, grid: Grid, wavelength: float, device: DeviceLike | None = None
    ) -> cla.Array:
        """exp(i phase) that multiplies the transmission of an array, shape of the grid.

        The vertex of a lenslet lies beside the centre of its aperture, which stays: of
        -pi abs(r - s)^2/(lam f) its transmission has the term with r^2 and the focal length of its
        kind.
        """
        device = as_device(device)
        real = device.real
        order = max((n for n, _ in self.terms), default=0)
        defines = device.wave_defines() | {"ORDER": order}
        defines |= {"HEXAGONAL": True} if mla.lattice == "hexagonal" else {}
        out = device.empty(grid.shape, device.complex)
        device.launch_rows(
            device.kernel("lenslet_errors.cl", "lenslet_errors", **defines),
            grid.shape,
            out,
            *(device.upload(table) for table in mla.lattice_tables(grid, device)),
            device.upload(self._polynomial(order, mla.pitch, wavelength).astype(real)),
            device.upload(self._own(mla, wavelength).astype(real)),
            *(np.int32(n) for n in (*mla.count, *grid.shape)),
        )
        return out

    def _polynomial(self, order: int, pitch: float, wavelength: float) -> Values:
        """Turns c[i, k] of b^i a^k, b and a in pitches."""
        coefficients = np.zeros((order + 1, order + 1))
        powers = (2 * pitch / self.circle) ** np.arange(order + 1)
        for (n, m), metres in self.terms.items():
            coefficients[: n + 1, : n + 1] += metres / wavelength * zernike_monomials(n, m)
        return coefficients * np.outer(powers, powers)

    def _own(self, mla: MicrolensArray, wavelength: float) -> Values:
        """Turns (constant, along a, along b, quadratic) of each lenslet, in pitches."""
        designed = np.asarray(mla.focal_lengths)[mla.types()]
        bent = 1 / (2 * wavelength * self.focal_lengths)
        slope = self.tilt / wavelength + 2 * bent[..., None] * self.position
        columns = (
            -bent * (self.position**2).sum(axis=-1),
            slope[..., 1] * mla.pitch,
            slope[..., 0] * mla.pitch,
            (1 / (2 * wavelength * designed) - bent) * mla.pitch**2,
        )
        return np.stack(columns, axis=-1)

    def bend(self, lenslet: Any, y: Any, x: Any) -> tuple[Any, Any]:
        """Slopes (y, x) that lenslets add to rays, in place of -(y, x)/f.

        Parameters
        ----------
        lenslet : numpy.ndarray
            Which of them: row times columns plus column.
        y, x : numpy.ndarray
            From the centre of its aperture, along the array's rows and columns, in metres.
        """
        f = self.focal_lengths.ravel()[lenslet]
        tilt, position = (values.reshape(-1, 2)[lenslet] for values in (self.tilt, self.position))
        down = tilt[..., 0] - (y - position[..., 0]) / f
        right = tilt[..., 1] - (x - position[..., 1]) / f
        radius = self.circle / 2
        for (n, m), metres in self.terms.items():
            steps = zernike_gradient(n, m, y / radius, x / radius)
            down, right = down + metres / radius * steps[0], right + metres / radius * steps[1]
        return down, right
