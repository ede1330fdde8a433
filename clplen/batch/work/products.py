"""Results of an item, computed in memory if it suffices, else in tiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clplen import io
from clplen.batch.jobs.items import absolute_layout
from clplen.batch.jobs.task import Task
from clplen.batch.work.product_files import Product, in_formats
from clplen.batch.work.resources import Resources
from clplen.batch.work.simulation import focused_products, is_focused, simulate
from clplen.batch.work.volume_products import volume_products
from clplen.compute.device import Device
from clplen.errors import DeviceError
from clplen.files import filling, replacing
from clplen.lightfield.depth.all_in_focus import blend_memory
from clplen.lightfield.depth.best_focus import suitable_planes
from clplen.lightfield.depth.depth_maps import DepthMap, cue_named, default_cue
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import through
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import stack_memory
from clplen.lightfield.stacks import focal_stack, stack_tiles

Advance = Callable[[int, int], None]
Source = LightField | StoredLightField
Values = np.ndarray[Any, Any]
_EVERYTHING = (slice(None),) * 4


@dataclass(frozen=True)
class Light:
    """Light field of an item and, for simulations, its raw image and the ground truth.

    ``values`` are the samples of a stored light field that fits into the memory.
    """

    source: Source | None = None
    values: Values | None = None
    raw: Any = None
    truth: Any = None


@contextmanager
def read(
    task: Task, resources: Resources, seconds: dict[str, float], advance: Advance
) -> Iterator[Light]:
    """Open the light field of a task, in memory or for reading in tiles."""
    if task.source["kind"] != "file":
        with resources.budget.of(resources.memory), resources.stage("compute", seconds):
            result = simulate(
                task.source, device=resources.device, base=task.base, progress=advance
            )
        yield Light(result.light_field, raw=result.raw, truth=result.truth)
        return
    if not {*task.work} - {"deconvolve", "formats"}:
        with resources.budget.of(resources.memory):
            yield Light()
        return
    path = Path(task.base, task.source["path"])
    layout = absolute_layout(task.source["layout"], task.base)
    with io.open_lightfield(path, device=resources.device, **layout) as stored:
        needed = bytes_in_core(stored, task.work)
        with resources.budget.of(resources.memory if "deconvolve" in task.work else needed):
            if needed > resources.memory:
                yield Light(stored)
                return
            with resources.stage("read", seconds):
                values = stored.read(_EVERYTHING)
            yield Light(stored, values)


def bytes_in_core(stored: StoredLightField, work: dict[str, Any]) -> int:
    """Return the memory in bytes of an untiled light field and its results, host and device."""
    pixel = 2 * stored.bytes_per_pixel + 4 * 4 * (*stored.shape, 1)[4]
    planes = {
        name: _disparities(stored, work[name])["disparities"]
        for name in ("stack", "all_in_focus")
        if name in work
    }
    if "stack" in work:
        pixel += stack_memory(stored, planes["stack"])[0].per_pixel
    if "depth" in work:
        cue = cue_named(work["depth"].get("cue") or default_cue(stored))
        masked = through(stored, work["depth"].get("aperture"))
        disparities = _disparities(masked, work["depth"])["disparities"]
        estimate = cue.memory(masked, np.unique(disparities))
        pixel += estimate.per_pixel + estimate.result_bytes
    elif "all_in_focus" in work:
        pixel += blend_memory(stored, planes["all_in_focus"]).per_pixel
    return pixel * stored.shape[2] * stored.shape[3]


def bytes_written(stored: StoredLightField, work: dict[str, Any]) -> int:
    """Return the uncompressed size of the results of a light field in bytes."""
    picture = 4 * int(np.prod(stored.shape[2:], dtype=np.int64))
    ny_nx = 4 * int(np.prod(stored.shape[2:4], dtype=np.int64))
    total = _count(stored, work.get("stack")) * picture
    total += 4 * ny_nx * ("depth" in work) + picture * ("all_in_focus" in work)
    if "views" in work:
        total += picture * len(_view_positions(stored.shape, work["views"]))
    total *= len(work["formats"])
    if "light_field" in work:
        total += int(np.prod(stored.shape, dtype=np.int64)) * stored.dtype.itemsize
    return total


def _count(stored: StoredLightField, table: dict[str, Any] | None) -> int:
    if table is None:
        return 0
    return len(next(iter(_planes(stored, table).values())))


def _planes(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    """Return the planes of a table, else planes over the range of the light field."""
    planes: dict[str, Any] = {
        name: np.array(table[name]) for name in ("alphas", "disparities") if name in table
    }
    return planes or suitable_planes(lf)


def compute(
    task: Task, light: Light, resources: Resources, seconds: dict[str, float], advance: Advance
) -> list[Product]:
    """Return the products of a task; results in tiles are computed while they are written."""
    products: list[Product] = []
    if "deconvolve" in task.work:
        with resources.stage("compute", seconds):
            products = list(volume_products(task, light.raw, resources, advance))
    if light.source is None:
        return products
    if isinstance(light.source, StoredLightField) and light.values is None:
        return products + _light_field_products(light.source, task.work, resources, advance)
    with resources.stage("compute", seconds):
        if is_focused(light.raw):
            focused = focused_products(light.raw, task.work)
            return [*products, *_simulation_products(light), *focused]
        lf = light.source
        if isinstance(lf, StoredLightField):
            lf = lf.part(light.values, resources.device)
        elif "light_field" not in task.work:
            products.append(_light_field(lf, "hdf5"))
        products += _simulation_products(light)
        products += _light_field_products(lf, task.work, resources, None)
    return products


def write(
    folder: Path, products: list[Product], resources: Resources, seconds: dict[str, float]
) -> list[str]:
    """Write all products, and return their names."""
    with resources.stage("write", seconds):
        for product in products:
            resources.check()
            product.write(folder / product.name)
    return [product.name for product in products]


def _simulation_products(light: Light) -> list[Product]:
    """Return the raw image and the ground truth of a simulation."""
    products = []
    if light.raw is not None:
        raw = light.raw.to_numpy()
        products.append(Product("raw.tif", partial(_write_raw, raw)))
    if light.truth is not None:
        products.append(
            Product("truth.h5", lambda path: io.write_truth(path, light.truth, durable=True))
        )
    return products


def _light_field_products(
    lf: Source, work: dict[str, Any], resources: Resources, progress: Advance | None
) -> list[Product]:
    """Return the products of a light field in memory, or of a stored one in tiles."""
    if "light_field" in work and not isinstance(lf, LightField):
        raise DeviceError(
            f"The light field of shape {lf.shape} and its results need more than the memory of "
            f"{resources.memory:,} bytes, but [light_field] cannot be written in tiles: raise "
            "memory=, or leave the table out."
        )
    tiling: dict[str, Any] = {"memory": resources.memory, "device": resources.device}
    tiling["progress"] = progress
    products: list[Product] = []
    formats, spacing = work["formats"], lf.spacing
    if "stack" in work:
        products += _stacks(lf, _stack_arguments(lf, work["stack"]), tiling, formats)
    depth: DepthMap | None = None
    if "depth" in work:
        depth = depth_map(lf, **work["depth"], **tiling)
        products += in_formats("depth", formats, io.write_depth, depth, spacing=spacing)
    if "all_in_focus" in work:
        planes = {} if depth is not None else _disparities(lf, work["all_in_focus"])
        sharp = all_in_focus(lf, depth=depth, **planes, **tiling).to_numpy()
        products += in_formats("all_in_focus", formats, io.write_image, sharp, spacing=spacing)
    if "views" in work:
        for v, u in _view_positions(lf.shape, work["views"]):
            picture = _view(lf, v, u, resources.device)
            stem = f"view_{v:g}_{u:g}"
            products += in_formats(stem, formats, io.write_image, picture, spacing=spacing)
    if "light_field" in work:
        assert isinstance(lf, LightField)
        products.append(_light_field(lf, work["light_field"]["format"]))
    return products


def _stacks(
    lf: Source, arguments: dict[str, Any], tiling: dict[str, Any], formats: list[str]
) -> list[Product]:
    """Return a stack computed now, or in tiles while each file is written."""
    if isinstance(lf, LightField):
        stack = focal_stack(lf, **arguments)
        make: Callable[[], Any] = lambda: stack  # noqa: E731
    else:
        make = partial(stack_tiles, lf, **arguments, **tiling)

    return in_formats("stack", formats, lambda path, **more: io.write_stack(path, make(), **more))


def _view(lf: Source, v: float, u: float, device: Device) -> Values:
    """Return a view; a stored light field is read at the neighbouring views only."""
    if isinstance(lf, LightField):
        return lf.view(v, u).to_numpy()
    if not (0 <= v <= lf.shape[0] - 1 and 0 <= u <= lf.shape[1] - 1):
        raise ValueError(
            f"The view ({v:g}, {u:g}) lies outside the {lf.shape[0]} x {lf.shape[1]} "
            "views: correct [views]."
        )
    rows, columns = (slice(math.floor(at), math.ceil(at) + 1) for at in (v, u))
    weights = lf.weights[rows, columns]
    part = LightField.from_array(
        lf.read((rows, columns, slice(None), slice(None))),
        device=device,
        weights=weights if weights.any() else np.ones_like(weights),
    )
    return part.view(v - rows.start, u - columns.start).to_numpy()


def _stack_arguments(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    settings = {name: table[name] for name in ("aperture", "interpolation") if name in table}
    return settings | _planes(lf, table)


def _disparities(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    planes = _planes(lf, table)
    return {"disparities": lf.disparity(planes["alphas"])} if "alphas" in planes else planes


def _view_positions(shape: tuple[int, ...], table: dict[str, Any]) -> list[tuple[float, float]]:
    middle = ((shape[0] - 1) / 2, (shape[1] - 1) / 2)
    return [(float(v), float(u)) for v, u in table.get("at", [middle])]


def _light_field(lf: LightField, form: str) -> Product:
    def file(path: Path) -> None:
        with replacing(path, durable=True) as temporary:
            io.write_lightfield(temporary, lf)

    def folder(path: Path) -> None:
        with filling(path, durable=True, replace=True) as temporary:
            io.write_lightfield(temporary, lf)

    return {
        "hdf5": Product("lightfield.h5", file),
        "zarr": Product("lightfield.zarr", folder),
    }[form]


def _write_raw(raw: Values, path: Path) -> None:
    with replacing(path, durable=True) as temporary:
        io.write_picture(temporary, raw)
