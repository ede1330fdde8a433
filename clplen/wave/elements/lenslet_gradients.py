"""Gradients with respect to the lenslets of an array.

The device sums over the samples of every lenslet (kernels/wave/lenslet_gradient.cl and
lenslet_moments.cl); the chain rule is applied to these sums in float64 on the host. In forward
mode, the same rates of all lenslets give the change of the transmission.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.types import Float64Array
from clplen.wave.field.field import Grid

_ITEMS = 2**14  # work-items that occupy a GPU


class LensletLattice(Protocol):
    """Properties of a `MicrolensArray` that gradients need."""

    @property
    def pitch(self) -> float: ...
    @property
    def row_pitch(self) -> float: ...
    @property
    def focal_lengths(self) -> tuple[float, ...]: ...
    @property
    def count(self) -> tuple[int, int]: ...
    @property
    def lattice(self) -> str: ...
    @property
    def fill(self) -> str: ...
    @property
    def diameter(self) -> float: ...
    @property
    def offset(self) -> tuple[float, float]: ...
    @property
    def rotation(self) -> float: ...
    def lattice_defines(self, *, double: bool) -> dict[str, Any]: ...
    def aperture_numbers(self, grid: Grid, dtype: np.dtype[Any]) -> list[Any]: ...
    def lens_turns(self, wavelength: float) -> Float64Array: ...
    def types(self) -> np.ndarray: ...
    def centres(self) -> np.ndarray: ...
    def lattice_tables(
        self, grid: Grid, device: Any = None, *, dtype: Any = None
    ) -> list[np.ndarray]: ...


def array_gradient(
    mla: LensletLattice, of_transmission: cla.Array, grid: Grid, wavelength: float, device: Device
) -> dict[str, Any]:
    """Return the gradient with respect to an array of thin lenslets."""
    sums = array_sums(mla, of_transmission, grid, wavelength, device)
    lengths = np.asarray(mla.focal_lengths)[mla.types()]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    # phase -pi r^2/(lam f): its slopes along the array's columns and rows, then along x and y
    right, down = 2 * np.pi * mla.pitch / (wavelength * lengths) * np.moveaxis(sums[..., :2], -1, 0)
    centres = np.stack([right * sin + down * cos, right * cos - down * sin], axis=-1)
    centres += sums[..., 4:2:-1] / mla.pitch
    each = np.pi * mla.pitch**2 / (wavelength * lengths**2) * sums[..., 2]
    away = mla.centres() - mla.offset
    turned = centres[..., 0] * away[..., 1] - centres[..., 1] * away[..., 0]
    return {
        "pitch": float((centres * away).sum() / mla.pitch),
        "diameter": float(sums[..., 6].sum() / (2 * mla.pitch)),
        "focal_length": float(each.sum()),
        "focal_lengths": np.bincount(
            mla.types().ravel(), each.ravel(), minlength=len(mla.focal_lengths)
        ),
        "offset": centres.sum(axis=(0, 1)),
        "rotation": float(turned.sum() + sums[..., 5].sum()),
        "centres": centres,
        "lenslet_focal_lengths": each,
    }


def array_sums(
    mla: LensletLattice, of_transmission: cla.Array, grid: Grid, wavelength: float, device: Device
) -> Float64Array:
    """Return the seven sums of lenslet_gradient.cl, shape (rows, columns, 7)."""
    parts, columns = _parts(mla, device), mla.count[1]
    out = device.empty((*mla.count, parts, 7), _real(device))
    device.launch(
        device.kernel("lenslet_gradient.cl", "lenslet_gradient", **_defines(mla, device)),
        (mla.count[0] * columns * parts,),
        out,
        of_transmission,
        *_tables(mla, grid, device),
        device.upload(_aperture_boxes(mla, grid)),
        *_apertures(mla, grid, wavelength, device),
        parts,
        *mla.count,
        grid.shape[1],
    )
    return np.asarray(device.download(out).sum(axis=2, dtype=np.float64))


def _real(device: Device) -> np.dtype[Any]:
    """Return the dtype of sums and positions: float64 if the device supports it.

    In float32 a rim may miss a cell that it just touches, with an error of up to 1e-2 in a centre.
    """
    wide = device.precision == "double" or device.has_fp64
    return np.dtype(np.float64 if wide else np.float32)


def _defines(mla: LensletLattice, device: Device) -> dict[str, Any]:
    sample = "double2" if device.precision == "double" else "float2"
    defines = mla.lattice_defines(double=_real(device) == np.float64)
    return defines | {"SAMPLE": sample}


def _tables(mla: LensletLattice, grid: Grid, device: Device) -> list[cla.Array]:
    """Return the arguments a_of_y, b_of_y, a_of_x and b_of_x of lenslet_gradient.cl."""
    tables = mla.lattice_tables(grid, device, dtype=_real(device))
    return [device.upload(table) for table in tables]


def _apertures(mla: LensletLattice, grid: Grid, wavelength: float, device: Device) -> list[Any]:
    """Return the arguments turns, radius, turn, angle, hy and hx of lenslet_gradient.cl."""
    dtype = _real(device)
    turns = mla.lens_turns(wavelength).astype(dtype)
    return [device.upload(turns), *mla.aperture_numbers(grid, dtype)]


def array_rates(mla: LensletLattice, wavelength: float) -> dict[str, Float64Array]:
    """Return derivatives of the lenslets by the array's parameters, for lenslet_gradient.cl."""
    lengths = np.asarray(mla.focal_lengths)[mla.types()]
    away, pitch = mla.centres() - mla.offset, mla.pitch
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    bent = 2 * np.pi * pitch / (wavelength * lengths)

    def rates(down: Any = 0.0, right: Any = 0.0, **sums: Any) -> Float64Array:
        """Return the rates for centres that move by (down, right) or for single sums."""
        table = np.zeros((*mla.count, 7))
        table[..., 0] = bent * (down * sin + right * cos)
        table[..., 1] = bent * (down * cos - right * sin)
        table[..., 3], table[..., 4] = right / pitch, down / pitch
        for name, value in sums.items():
            table[..., {"square": 2, "angle": 5, "radius": 6}[name]] = value
        return table

    square = np.pi * pitch**2 / (wavelength * lengths**2)
    kinds = [mla.types() == kind for kind in range(len(mla.focal_lengths))]
    return {
        "pitch": rates(away[..., 0] / pitch, away[..., 1] / pitch)[None],
        "diameter": rates(radius=1 / (2 * pitch))[None],
        "focal_lengths": np.stack([rates(square=square * kind) for kind in kinds]),
        "offset": np.stack([rates(down=1.0), rates(right=1.0)]),
        "rotation": rates(away[..., 1], -away[..., 0], angle=1.0)[None],
    }


def array_tangents(
    mla: LensletLattice, rates: Float64Array, grid: Grid, wavelength: float, device: Device
) -> cla.Array:
    """Return derivatives of the transmission of an array, the transpose of `array_gradient`."""
    out = device.zeros((len(rates), *grid.shape), device.complex)
    device.launch_rows(
        device.kernel("lenslet_gradient.cl", "lenslet_tangent", **_defines(mla, device)),
        grid.shape,
        out,
        device.upload(np.ascontiguousarray(rates, _real(device))),
        *_tables(mla, grid, device),
        *_apertures(mla, grid, wavelength, device),
        len(rates),
        *mla.count,
        *grid.shape,
    )
    return out


def lenslet_moments(
    mla: LensletLattice, of_log: cla.Array, grid: Grid, device: Device, order: int
) -> Float64Array:
    """Return moments of the gradient by the phase over the samples of each lenslet."""
    parts = _parts(mla, device)
    power = np.array([(i, k) for i in range(order + 1) for k in range(order + 1 - i)])
    out = device.empty((*mla.count, parts, len(power)), device.real)
    defines = dict(device.wave_defines()) | {"ORDER": order}
    defines |= {"HEXAGONAL": True} if mla.lattice == "hexagonal" else {}
    device.launch(
        device.kernel("lenslet_moments.cl", "lenslet_moments", **defines),
        (mla.count[0] * mla.count[1] * parts,),
        out,
        of_log,
        *(device.upload(table) for table in mla.lattice_tables(grid, device)),
        device.upload(_nearest_boxes(mla, grid)),
        parts,
        *mla.count,
        grid.shape[1],
    )
    moments = np.zeros((*mla.count, order + 1, order + 1))
    moments[..., power[:, 0], power[:, 1]] = device.download(out).sum(axis=2, dtype=np.float64)
    return moments


def _parts(mla: LensletLattice, device: Device) -> int:
    """Return the number of work-items of a lenslet."""
    return 1 if device.rows else max(1, min(16, _ITEMS // (mla.count[0] * mla.count[1])))


def _aperture_boxes(mla: LensletLattice, grid: Grid) -> np.ndarray:
    """Return the rows and columns of samples that depend on a lenslet.

    Their distance from the centre is at most the aperture's radius plus half a sample's diagonal.
    """
    corner = (2 / math.sqrt(3) if mla.lattice == "hexagonal" else math.sqrt(2)) / 2
    far = mla.diameter * (corner if mla.fill == "full" else 0.5) + math.hypot(*grid.pitch)
    centres = mla.centres().reshape(-1, 2)
    return _boxes(centres - far, centres + far, grid)


def _nearest_boxes(mla: LensletLattice, grid: Grid) -> np.ndarray:
    """Return the rows and columns of the samples whose nearest lenslet is each of an array.

    On the border of the array the rectangles extend to the end of the window.
    """
    (rows, columns), hexagonal = mla.count, mla.lattice == "hexagonal"
    i, k = (n.ravel() for n in np.indices(mla.count))
    middle = k - (columns - 1) / 2 + (i % 2 / 2 if hexagonal else 0)
    # A hexagonal cell extends two thirds of a row, at the ends of rows one and a half rows.
    end_rows = ((k == 0) | (k == columns - 1)).astype(np.int64) if hexagonal else np.zeros_like(k)
    half = np.where(end_rows > 0, 1.5, 2 / 3 if hexagonal else 0.5)
    endless = math.hypot(*grid.extent) + math.hypot(*grid.origin) + math.hypot(*mla.offset)
    endless += math.hypot(rows * mla.row_pitch, columns * mla.pitch)
    left = np.where(k == 0, -endless, (middle - 0.5) * mla.pitch)
    right = np.where(k == columns - 1, endless, (middle + 0.5) * mla.pitch)
    height = i - (rows - 1) / 2
    top = np.where(i <= end_rows, -endless, (height - half) * mla.row_pitch)
    bottom = np.where(i >= rows - 1 - end_rows, endless, (height + half) * mla.row_pitch)
    y, x = np.stack([top, top, bottom, bottom]), np.stack([left, right, left, right])
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    corners = np.stack([x * sin + y * cos, x * cos - y * sin], axis=-1) + mla.offset
    return _boxes(corners.min(axis=0) - grid.pitch, corners.max(axis=0) + grid.pitch, grid)


def _boxes(low: Float64Array, high: Float64Array, grid: Grid) -> np.ndarray:
    """Return (first row, end, first column, end) of the samples between positions (y, x), int32."""
    start, step = np.array([grid.y[0], grid.x[0]]), np.array(grid.pitch)
    first = np.clip(np.ceil((low - start) / step), 0, grid.shape)
    end = np.clip(np.floor((high - start) / step) + 1, first, grid.shape)
    return np.ascontiguousarray(np.stack([first, end], axis=-1).reshape(-1, 4), np.int32)
