"""Checks of fields and their propagation."""

from __future__ import annotations

import numpy as np

from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.compute.fft.blocks import window
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs
from clplen.wave.field.adjoints import conjugate, inner_product, intensity_gradient
from clplen.wave.field.field import Field, Grid, row_powers
from clplen.wave.field.intensity import accumulate, add_scaled
from clplen.wave.field.transmission import multiply
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.propagation.transfer_function import Transfer, impulse_response

LAM = 532e-9
GRID = Grid((13, 37), (6e-6, 5e-6), origin=(2e-6, -3e-6))


def _field(device: Device, grid: Grid = GRID, count: int = 2) -> tuple[twins.Array, Field]:
    """Return random fields, on the host in double and on the device."""
    u = twins.waves(1, count, *grid.shape)
    field = Field.from_array(u, grid, wavelength=LAM, device=device)
    return u.astype(np.complex128), field


def _multiply(device: Device) -> Pairs:
    """Check a transmission and padding: sample N//2 stays on N//2, 3 on 5 and 6 on 4."""
    u, t = twins.waves(2, 2, 7, 12), twins.waves(3, 7, 12)
    field = Field.from_array(u, Grid((7, 12), 5e-6), wavelength=LAM, device=device)
    yield u * t.astype(np.complex128), multiply(field, device.upload(t)).to_numpy()
    expected = np.zeros((2, 10, 9), complex)
    expected[:, 2:9] = u[:, :, 2:11]
    yield expected, device.download(window(device.upload(u), (2, 10, 9), device))


def _intensity(device: Device) -> Pairs:
    u, field = _field(device, count=3)
    power = np.abs(u) ** 2
    yield power, field.intensity().to_numpy()
    yield power.sum(axis=-1), row_powers(field)
    start, weights = twins.reals(8, *GRID.shape), np.array([0.5, 2.0, 0.25])
    total = device.upload(start)
    accumulate(total, field.data, weights, device)
    yield start + np.tensordot(weights, power, 1), device.download(total)
    other = twins.reals(9, *GRID.shape)
    total = device.upload(start)
    add_scaled(total, device.upload(other), -0.375, device)
    yield start - 0.375 * other.astype(float), device.download(total)


def _transfer(device: Device) -> Pairs:
    """Check exp(ikz(sqrt(1 - s) - 1)) over 2 m, with its phase in two floats."""
    fy, fx = (np.linspace(0, 0.3 / LAM / np.sqrt(2), n) for n in (9, 37))
    wy, wx = 1 - 0.02 * np.arange(9.0), 1 - 0.01 * np.arange(37.0)
    factor = Transfer((17, 73), (fy, fx), (wy, wx), 2.0, LAM)
    s = LAM**2 * (fy[:, None] ** 2 + fx**2)
    H = np.exp(4j * np.pi / LAM * (np.sqrt(1 - s) - 1))
    yield wy[:, None] * wx * H, device.download(factor.on_device(device, "twofloat").values)


def _adjoint(device: Device) -> Pairs:
    u, field = _field(device)
    w = np.abs(twins.waves(8, 2, *GRID.shape)).astype(np.float32)
    yield u.conj(), conjugate(field).to_numpy()
    yield 2 * w * u, intensity_gradient(field, w).to_numpy()
    _, other = _field(device, count=2)
    other = intensity_gradient(other, w)
    yield (np.vdot(u, 2 * w * u),), np.array([inner_product(field, other)])


def _impulse_response(device: Device) -> Pairs:
    shape, pitch, z = (12, 15), (6e-5, 5e-5), -8e-3
    y, x = (
        np.minimum(k, n - k) * d
        for n, d, k in zip(shape, pitch, map(np.arange, shape), strict=True)
    )
    r = np.sqrt(y[:, None] ** 2 + x**2 + z**2)
    k = 2 * np.pi / LAM
    h = abs(z) / (2 * np.pi * r**2) * (1 / r - 1j * k) * np.exp(1j * k * (r - abs(z)))
    for phase in ("tables", "fp64") if device.has_fp64 else ("tables",):
        computed = device.download(impulse_response(shape, pitch, z, LAM, device, phase))
        yield np.conj(h) * pitch[0] * pitch[1], computed


def _finite(device: Device) -> Pairs:
    values = np.ones((3, 5, 7), np.complex64)
    values[0, 0, 0], values[2, 4, 6], values[1, 2, 3] = np.nan, -np.inf, 1j * np.inf
    bad = np.count_nonzero(~np.isfinite(values.view(np.float32)))
    yield bad, count_bad(device.upload(values), device)
    yield 0, count_bad(device.upload(np.full((9, 11), 3e38, np.float32)), device)


def _propagation(device: Device) -> Pairs:
    (ny, nx), z = (24, 35), 1.5e-3
    grid, wide = Grid((ny, nx), (5e-6, 4e-6)), (2 * ny, 2 * nx)
    u, field = _field(device, grid)
    s = LAM**2 * (np.fft.fftfreq(2 * ny, 5e-6)[:, None] ** 2 + np.fft.fftfreq(2 * nx, 4e-6) ** 2)
    H = np.exp(2j * np.pi * z / LAM * (np.sqrt(1 - s) - 1))
    plan = Propagator(grid, z, wavelength=LAM, method="as", pad=2, device=device)
    yield np.fft.ifft2(np.fft.fft2(u, wide) * H)[..., :ny, :nx], plan(field).to_numpy()


# float32 rounds sums, products and tables once each, a phase in turns by 4e-7 rad per turn.
CHECKS = (
    Check("finite", "count of NaN and infinite samples", _finite, 0.0, ("finite.cl",)),
    Check("multiply", "fields times a transmission, and padded", _multiply, 8 * EPS,
          ("multiply.cl", "window.cl", "common.cl")),
    Check("intensity", "intensities, weighted sums, power of rows", _intensity, 16 * EPS,
          ("intensity.cl",)),
    Check("transfer, far", "transfer function over 2 m, in two floats", _transfer,
          1e-5, ("transfer.cl", "twofloat.cl")),
    Check("adjoint", "conjugates, inner products, intensity gradients", _adjoint, 16 * EPS,
          ("adjoint.cl",)),
    Check("sommerfeld", "impulse response of free space", _impulse_response, 1e-5,
          ("sommerfeld.cl",)),
    Check("propagation", "angular spectrum, transforms included", _propagation, 1e-5,
          ("transfer.cl",)),
)  # fmt: skip
