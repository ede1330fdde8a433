"""Fields through plans: several that share a transform, sums of terms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, add, run
from clplen.compute.fft.lines import Separable
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.description import Description

SHARING = 8  # plans that share the field's transform at a time: more hold memory and gain nothing

Way = tuple[Separable, Spectrum | None, Separable]


class Plan(Protocol):
    """What is needed of a `Propagator`."""

    description: Description
    out_grid: Grid
    device: Device

    @property
    def spectrum(self) -> Spectrum | None: ...

    @property
    def spectra(self) -> list[Spectrum]: ...

    @property
    def nbytes(self) -> int: ...


def run_plans(field: Field, plans: Sequence[Plan]) -> list[Field]:
    """A field by several plans; those that begin with the same transform share it."""
    groups: dict[Any, list[int]] = {}
    for index, plan in enumerate(plans):
        into, shares = plan.description.into, plan.description.kind == "fft"
        key = ("fft", into.widest(field.grid.shape)) if shares else index
        groups.setdefault(key, []).append(index)
    results: dict[int, Field] = {}
    for members in groups.values():
        for start in range(0, len(members), SHARING):
            indices = members[start : start + SHARING]
            fields = _run_group(field, [plans[index] for index in indices])
            results.update(zip(indices, fields, strict=True))
    return [results[index] for index in range(len(plans))]


def _run_group(field: Field, plans: Sequence[Plan]) -> list[Field]:
    """A field by plans that begin alike."""
    first = plans[0].description
    if first.kind == "nothing":
        return [field for _ in plans]
    if 0 in field.shape:
        shape = (*field.shape[:-2], *first.out_grid.shape)
        empty = field.device.empty(shape, field.device.complex)
        return [replace(field, data=empty, grid=plan.out_grid) for plan in plans]
    require_memory(field.shape[:-2], plans)
    if first.terms:
        ways = [
            (into, factor, back)
            for (into, back), factor in zip(first.terms, plans[0].spectra, strict=True)
        ]
        data = sum_of_ways(field.data, ways, field.device)
        return [replace(field, data=data, grid=first.out_grid)]
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    outputs = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=data, grid=plan.out_grid)
        for plan, data in zip(plans, outputs, strict=True)
    ]


def sum_of_ways(data: cla.Array, ways: Sequence[Way], device: Device) -> cla.Array:
    """Samples by several ways (maps, factor, maps; without a factor the first maps), added up."""
    total = None
    for into, factor, back in ways:
        spectra, after = ([], []) if factor is None else ([factor], [back])
        (made,) = run(data, into, spectra, after, device)
        if total is None:
            total = made
        else:
            add(total, made, device)
    assert total is not None
    return total


def require_memory(batch: tuple[int, ...], plans: Sequence[Plan]) -> None:
    """Refuse a batch of fields that does not fit the device."""
    first, device = plans[0].description, plans[0].device
    count = math.prod(batch)
    out = max(math.prod(first.out_grid.shape), math.prod(first.request.grid.shape))
    samples = first.work_samples
    if device.fft.name == "vkfft":
        samples = 2 * math.prod(first.window)
    nbytes = count * (samples + len(plans) * (samples + out)) * device.complex.itemsize
    device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")
