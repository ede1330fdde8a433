"""Checks of fields and their propagation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, multiplied, window
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs
from clplen.wave.field.adjoints import conjugate, inner_product, intensity_gradient
from clplen.wave.field.field import Field, Grid, row_powers
from clplen.wave.field.intensity import Statistics, Window, accumulate, add_scaled
from clplen.wave.field.transmission import multiply, multiply_separable, multiply_sphere
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.propagation.transfer_function import Transfer, impulse_response

LAM = 532e-9
GRID = Grid((13, 37), (6e-6, 5e-6), origin=(2e-6, -3e-6))


def _field(device: Device, grid: Grid = GRID, count: int = 2) -> tuple[twins.Array, Field]:
    """Random fields: on the host in double, and on the device."""
    u = twins.waves(1, count, *grid.shape)
    field = Field.from_array(u, grid, wavelength=LAM, device=device)
    return u.astype(np.complex128), field


def _window(device: Device) -> Pairs:
    u = twins.waves(2, 2, 7, 12)
    got = device.download(window(device.upload(u), (2, 10, 9), device))
    expected = np.zeros((2, 10, 9), complex)
    expected[:, 2:9] = u[:, :, 2:11]  # sample N//2 stays on N//2: 3 on 5, 6 on 4
    yield expected, got


def _multiply(device: Device) -> Pairs:
    u, field = _field(device)
    t = twins.waves(3, *GRID.shape)
    yield u * t, multiply(field, device.upload(t)).to_numpy()


def _separable(device: Device) -> Pairs:
    u, field = _field(device)
    ty, tx = twins.waves(4, GRID.shape[0]), twins.waves(5, GRID.shape[1])
    yield u * ty[:, None] * tx, multiply_separable(field, ty, tx).to_numpy()


def _filter(device: Device) -> Pairs:
    ny, nx = 7, 67
    u, H = twins.waves(6, 2, ny, nx), twins.waves(7, ny // 2 + 1, nx // 2 + 1)
    y, x = np.arange(ny), np.arange(nx)
    whole = H[np.minimum(y, ny - y)[:, None], np.minimum(x, nx - x)]
    spectrum = Spectrum(device.upload(H), (ny, nx))
    for one, factors in ((spectrum, whole), (spectrum.conjugate(), whole.conj())):
        got = multiplied(device.upload(u), one, device, copy=False)
        yield u.astype(np.complex128) * factors, device.download(got)


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


def _statistics(device: Device) -> Pairs:
    u = twins.waves(1, 5, *GRID.shape).astype(complex)
    power = np.abs(u) ** 2
    region = (slice(2, 9), slice(3, 30))
    for is_image in (False, True):
        statistics = Statistics(GRID.shape, device)
        for k in range(5):
            one = Field.from_array(u[k], GRID, wavelength=LAM, device=device)
            statistics.add(one.intensity().data if is_image else one)
        error = power.std(axis=0, ddof=1) / np.sqrt(5)
        yield power.mean(axis=0), statistics.image().to_numpy()
        yield error, statistics.standard_error().to_numpy()
        inside = (error[region] ** 2).mean() ** 0.5 / power[:, 2:9, 3:30].mean()
        yield inside, statistics.relative_error(Window.of(region, GRID.shape))


def _transfer_of(z: float, highest: float, phase: str) -> Callable[[Device], Pairs]:
    """exp(ikz(sqrt(1 - s) - 1)) up to a highest frequency over 1/lam, evanescent from 1 on."""

    def pairs(device: Device) -> Pairs:
        fy, fx = (np.linspace(0, highest / LAM / np.sqrt(2), n) for n in (9, 37))
        wy, wx = 1 - 0.02 * np.arange(9.0), 1 - 0.01 * np.arange(37.0)
        factor = Transfer((17, 73), (fy, fx), (wy, wx), z, LAM)
        s = LAM**2 * (fy[:, None] ** 2 + fx**2)
        H = np.exp(2j * np.pi * z / LAM * (np.sqrt(1 - s + 0j) - 1))
        yield wy[:, None] * wx * H, device.download(factor.on_device(device, phase).values)

    return pairs


def _slope(device: Device) -> Pairs:
    """Derivative of the transfer function by z, propagating and evanescent."""
    fy, fx = (np.linspace(0, 1.2 / LAM, n) for n in (9, 37))
    ones, z, k = (np.ones(9), np.ones(37)), 1e-7, 2 * np.pi / LAM
    factor = Transfer((17, 73), (fy, fx), ones, z, LAM, is_slope=True)
    root = np.sqrt(1 - LAM**2 * (fy[:, None] ** 2 + fx**2) + 0j)
    slope = 1j * k * (root - 1) * np.exp(1j * k * z * (root - 1))
    yield slope / k, device.download(factor.on_device(device, "tables").values) / k


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
        got = device.download(impulse_response(shape, pitch, z, LAM, device, phase))
        yield np.conj(h) * pitch[0] * pitch[1], got


def _sphere(device: Device) -> Pairs:
    u, field = _field(device)
    z, centre = 4e-3, (40e-6, -31e-6)
    y, x = GRID.y[:, None] - centre[0], GRID.x - centre[1]
    r = np.sqrt(y**2 + x**2 + z**2)
    expected = u * np.exp(2j * np.pi * (r - z) / LAM) / r
    yield expected, multiply_sphere(field, z, centre, fades=True, phase="tables").to_numpy()


def _finite(device: Device) -> Pairs:
    values = np.ones((3, 5, 7), np.complex64)
    values[0, 0, 0], values[2, 4, 6], values[1, 2, 3] = np.nan, -np.inf, 1j * np.inf
    bad = np.count_nonzero(~np.isfinite(values.view(np.float32)))
    yield bad, count_bad(device.upload(values), device)
    yield 0, count_bad(device.upload(np.full((9, 11), 3e38, np.float32)), device)


def _propagation(device: Device) -> Pairs:
    grid = Grid((48, 35), (5e-6, 4e-6))
    u, field = _field(device, grid)
    z = 1.5e-3
    s = LAM**2 * (np.fft.fftfreq(48, 5e-6)[:, None] ** 2 + np.fft.fftfreq(35, 4e-6) ** 2)
    H = np.exp(2j * np.pi * z / LAM * (np.sqrt(1 - s) - 1))
    plan = Propagator(grid, z, wavelength=LAM, method="as", pad=1, device=device)
    yield np.fft.ifft2(np.fft.fft2(u) * H), plan(field).to_numpy()


# float32 rounds a sum, a product and a table once each, a phase in turns by 4e-7 rad a turn.
CHECKS = (
    Check("finite", "count of NaN and infinite samples", _finite, 0.0, ("finite.cl",)),
    Check("window", "padding and cropping about the middle", _window, 0.0, ("window.cl",)),
    Check("multiply", "fields times a transmission", _multiply, 8 * EPS,
          ("multiply.cl", "common.cl")),
    Check("separable", "fields times two 1-D tables", _separable, 8 * EPS,
          ("separable.cl", "lanes_complex.cl", "lanes.cl")),
    Check("spectral_filter", "spectra times a mirrored quadrant", _filter, 8 * EPS,
          ("spectral_filter.cl",)),
    Check("intensity", "intensities, weighted sums, power of rows", _intensity, 16 * EPS,
          ("intensity.cl",)),
    Check("statistics", "mean and standard error of 5 snapshots", _statistics, 64 * EPS,
          ("statistics.cl",)),
    Check("transfer", "transfer function of free space",
          _transfer_of(3e-4, 0.3, "tables"), 1e-5, ("transfer.cl",)),
    Check("transfer, far", "the same over 2 m, phase in two floats",
          _transfer_of(2.0, 0.3, "twofloat"), 1e-5, ("twofloat.cl",)),
    Check("transfer, near", "the same over 0.3 um, evanescent waves",
          _transfer_of(3e-7, 1.6, "twofloat"), 1e-5, ("transfer.cl",)),
    Check("transfer, slope", "derivative of the transfer function by z",
          _slope, 1e-5, ("transfer_slope.cl",)),
    Check("adjoint", "conjugates, inner products, intensity gradients", _adjoint, 16 * EPS,
          ("adjoint.cl",)),
    Check("sommerfeld", "impulse response of free space", _impulse_response, 1e-5,
          ("sommerfeld.cl",)),
    Check("sphere", "light from a point", _sphere, 1e-5, ("sphere.cl",)),
    Check("propagation", "angular spectrum, transforms included", _propagation, 1e-5),
)  # fmt: skip
