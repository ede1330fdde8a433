"""Mean intensities without noise: coherent light, and exact sums over the source."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from clplen.compute.arrays import Image
from clplen.errors import SamplingError, ShapeError
from clplen.wave.coherence.abbe import abbe_cost, abbe_image, incoherent_image
from clplen.wave.coherence.averaging import Averaging
from clplen.wave.coherence.spatial_models import IncoherentLight, SpatialModel
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import MeanIntensity, Window, accumulate
from clplen.wave.systems.pupil_filter import transfer_of

MAX_EXACT_FLOPS = 1e11  # "auto" takes the sum below this cost, well below a minute on a CPU
MAX_COST_RATIO = 10.0  # "auto" takes the sum up to this multiple of the cost of snapshots
SNAPSHOT_TRANSFORMS = 4  # transforms per snapshot: two for the light, two for the system


def without_noise(image: Image, grid: Grid, method: str, terms: int) -> MeanIntensity:
    """Return an intensity with a standard error of zero."""
    zeros = Image(image.device.zeros(image.shape, image.data.dtype), image.device)
    return MeanIntensity(image, zeros, terms, np.empty((0, 2)), method, grid)


def weighted(fields: Iterable[Field], shares: list[float]) -> tuple[Image, Grid]:
    """Return the weighted sum of the intensities of fields, and their common grid."""
    total = grid = None
    for field, share in zip(fields, shares, strict=True):
        require_image(field)
        device = field.device
        if total is None or grid is None:
            total, grid = device.zeros(field.grid.shape, device.real), field.grid
        if field.grid != grid:
            raise ShapeError(
                f"The image grid must be equal at all wavelengths, got {grid} and {field.grid}; "
                "set out_grid for the system's last distance."
            )
        accumulate(total, field.data, share, device)
    assert total is not None
    assert grid is not None
    return Image(total, device), grid


def require_image(field: object) -> None:
    """Raise unless a system returned a single field."""
    if not isinstance(field, Field):
        raise TypeError(f"The system must return a Field, got {type(field).__name__}.")
    if len(field.shape) != 2:
        raise ShapeError(
            "The system must return a single field of shape (ny, nx), got a batch of shape "
            f"{field.shape}; use a single distance."
        )


def sum_over_source(
    light: SpatialModel,
    system: Callable[[Field], Field],
    objects: list[Field],
    shares: list[float],
    settings: Averaging,
    *,
    forced: bool,
) -> MeanIntensity | None:
    """Return the exact mean, summed over wavelengths, or None if the sum does not apply."""
    incoherent, terms, total = isinstance(light, IncoherentLight), 0, None
    for index, (transmission, share) in enumerate(zip(objects, shares, strict=True)):
        transfer = transfer_of(system, transmission.grid, transmission.wavelength)
        if transfer is None:
            if forced:
                raise SamplingError(
                    "method='abbe' sums over the source of a shift-invariant system, made of "
                    "Pupil and Space(method='as', pad=1) parts alone; for this system use "
                    "method='monte-carlo'."
                )
            return None
        if incoherent:
            image, used = incoherent_image(transmission, transfer), 1
        else:
            if not (forced or getattr(light, "degree_is_exact", True)):
                return None
            source = light.power_spectrum(transmission.grid, wavelength=transmission.wavelength)
            if index == 0 and not (
                forced or _is_affordable(transmission, transfer, source, shares, settings)
            ):
                return None
            result = abbe_image(transmission, transfer, source)
            image, used = result.intensity, result.terms
        Window.of(settings.region, transmission.grid.shape)
        values = share * image.to_numpy().astype(np.float64)
        total, terms = values if total is None else total + values, terms + used
    device, grid = objects[0].device, objects[0].grid
    data = device.upload(np.asarray(total, device.real))
    return without_noise(Image(data, device), grid, "incoherent" if incoherent else "abbe", terms)


def _is_affordable(
    transmission: Field, transfer: Any, source: Any, shares: list[float], settings: Averaging
) -> bool:
    """Return True if the sum is affordable at all wavelengths."""
    samples = transmission.grid.shape[0] * transmission.grid.shape[1]
    snapshot = SNAPSHOT_TRANSFORMS * 5 * samples * np.log2(max(samples, 2))
    sampled = 0.0 if settings.rtol is not None else MAX_COST_RATIO * snapshot * settings.limit
    cost = abbe_cost(transmission.grid, transfer, source)
    return bool(len(shares) * cost <= max(MAX_EXACT_FLOPS, len(shares) * sampled))
