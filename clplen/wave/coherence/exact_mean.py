"""Mean intensities without noise: coherent light, and sums over the source where they are exact."""

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

AFFORDABLE = 1e11  # operations that "auto" spends in any case: well below a minute on a CPU
TIMES = 10.0  # and so many times what the snapshots would cost
SNAPSHOT_TRANSFORMS = 4  # two of the light, two of the system


def without_noise(image: Image, grid: Grid, method: str, terms: int) -> MeanIntensity:
    """An intensity in which nothing is random."""
    none = Image(image.device.zeros(image.shape, image.data.dtype), image.device)
    return MeanIntensity(image, none, terms, np.empty((0, 2)), method, grid)


def weighted(fields: Iterable[Field], shares: list[float]) -> tuple[Image, Grid]:
    """Sum of the intensities of fields with weights, and the grid that they share."""
    total = grid = None
    for field, share in zip(fields, shares, strict=True):
        require_image(field)
        device = field.device
        if total is None or grid is None:
            total, grid = device.zeros(field.grid.shape, device.real), field.grid
        if field.grid != grid:
            raise ShapeError(
                f"The system's image has another grid at another wavelength, {field.grid} after "
                f"{grid}: give its last distance an out_grid."
            )
        accumulate(total, field.data, share, device)
    assert total is not None
    assert grid is not None
    return Image(total, device), grid


def require_image(field: object) -> None:
    """Refuse what is no single field."""
    if not isinstance(field, Field):
        raise TypeError(f"A system returns a Field, not {type(field).__name__}.")
    if len(field.shape) != 2:
        raise ShapeError(
            f"The system returns a batch of shape {field.shape}; a mean intensity is of one field "
            "of shape (ny, nx): use one distance at a time."
        )


def sum_over_source(
    light: SpatialModel,
    system: Callable[[Field], Field],
    objects: list[Field],
    shares: list[float],
    how: Averaging,
    *,
    forced: bool,
) -> MeanIntensity | None:
    """The exact mean, wavelength by wavelength."""
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
            if index == 0 and not (forced or _worth(transmission, transfer, source, shares, how)):
                return None
            result = abbe_image(transmission, transfer, source)
            image, used = result.intensity, result.terms
        Window.of(how.region, transmission.grid.shape)
        values = share * image.to_numpy().astype(np.float64)
        total, terms = values if total is None else total + values, terms + used
    device, grid = objects[0].device, objects[0].grid
    data = device.upload(np.asarray(total, device.real))
    return without_noise(Image(data, device), grid, "incoherent" if incoherent else "abbe", terms)


def _worth(
    transmission: Field, transfer: Any, source: Any, shares: list[float], how: Averaging
) -> bool:
    """Whether the sum is affordable at all wavelengths."""
    samples = transmission.grid.shape[0] * transmission.grid.shape[1]
    snapshot = SNAPSHOT_TRANSFORMS * 5 * samples * np.log2(max(samples, 2))
    many = 0.0 if how.rtol is not None else TIMES * snapshot * how.most
    cost = abbe_cost(transmission.grid, transfer, source)
    return bool(len(shares) * cost <= max(AFFORDABLE, len(shares) * many))
