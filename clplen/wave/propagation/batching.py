"""One field by several plans, which share what they begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.blocks import run
from clplen.wave.field.field import Field

if TYPE_CHECKING:
    from clplen.wave.propagation.propagator import Propagator


TOGETHER = 8  # plans that share a beginning at a time: more hold memory and gain nothing


def together(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by several plans; those that begin alike share their beginning."""
    results: dict[int, Field] = {}
    groups: dict[Any, list[int]] = {}
    for place, one in enumerate(plans):
        made = one.description
        alone = made.kind != "fft"
        key = place if alone else ("fft", made.into.widest(field.grid.shape))
        groups.setdefault(key, []).append(place)
    parts = (
        places[start : start + TOGETHER]
        for places in groups.values()
        for start in range(0, len(places), TOGETHER)
    )
    for places in parts:
        chosen = [plans[place] for place in places]
        for place, result in zip(places, _run(field, chosen), strict=True):
            results[place] = result
    return [results[place] for place in range(len(plans))]


def _run(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    first = plans[0].description
    if first.kind == "nothing":
        return [field for _ in plans]
    if 0 in field.shape:
        shape = (*field.shape[:-2], *first.out_grid.shape)
        empty = field.device.empty(shape, field.device.complex)
        return [replace(field, data=empty, grid=plan.out_grid) for plan in plans]
    _require_memory(field, plans)
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    data = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=one, grid=plan.out_grid) for plan, one in zip(plans, data, strict=True)
    ]


def _require_memory(field: Field, plans: Sequence[Propagator]) -> None:
    made = plans[0].description
    count = int(np.prod(field.shape[:-2], dtype=np.int64))
    out = int(np.prod(made.out_grid.shape, dtype=np.int64))
    samples = made.work_samples
    if field.device.fft.name == "vkfft":
        samples = 2 * int(np.prod(made.window, dtype=np.int64))
    nbytes = count * (samples + len(plans) * (samples + out)) * field.device.complex.itemsize
    field.device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")
