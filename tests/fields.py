"""For the tests of propagation: random fields, the way to a device and back, a GPU's route."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from clplen import Device, Field, Grid, SamplingWarning, propagate
from clplen.compute.fft import routes
from clplen.compute.fft.routes import FFTRoute

LAM = 550e-9


def band_limited(
    shape: Sequence[int], seed: int = 0, share: float = 0.75, mean: float = 0.2
) -> np.ndarray:
    """Random, asymmetric, of non-zero mean, below a share of the Nyquist frequency."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.fft2(rng.normal(size=shape) + 1j * rng.normal(size=shape))
    keep = np.multiply.outer(*(np.abs(np.fft.fftfreq(n)) <= share / 2 for n in shape))
    return np.fft.ifft2(spectrum * keep) + mean


def field_of(
    u: np.ndarray, grid: Grid | float | Sequence[float], device: Device, wavelength: float = LAM
) -> Field:
    """u (..., ny, nx) on a grid of a device, or on one of a pitch about the axis."""
    if not isinstance(grid, Grid):
        grid = Grid(u.shape[-2:], grid)
    return Field.from_array(u, grid, wavelength=wavelength, device=device)


def step(
    u: np.ndarray,
    grid: Grid | float | Sequence[float],
    z: float,
    device: Device,
    *,
    wavelength: float = LAM,
    **options: Any,
) -> np.ndarray:
    """u (..., ny, nx) after z on the host."""
    return propagate(field_of(u, grid, device, wavelength), z, **options).to_numpy()


def go(
    u: np.ndarray, grid: Grid, z: float | Sequence[float], device: Device, **options: Any
) -> np.ndarray:
    """u after z on the host, whatever the warnings about its sampling."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        return propagate(field_of(u, grid, device), z, **options).to_numpy()


def numpy_for_vkfft(array: Any, device: Device, axes: tuple[int, ...], forward: bool) -> None:
    """What ``routes._vkfft`` does, by NumPy."""
    with device.on_host(array) as values:
        values[...] = (np.fft.fftn if forward else np.fft.ifftn)(values, axes=axes)


def staying(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device as one whose arrays stay on it, as with VkFFT."""
    monkeypatch.setattr(routes, "_vkfft", numpy_for_vkfft)
    other = Device(device.cl_device, precision=device.precision)
    other.fft = FFTRoute("vkfft", 1)
    return other
