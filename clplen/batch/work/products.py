"""Results of one item: computed in memory where there is room, else streamed to their files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clplen import io
from clplen.batch.jobs.items import layout_in
from clplen.batch.jobs.task import Task
from clplen.batch.work.resources import Resources
from clplen.batch.work.simulation import focused_products, is_focused, simulate
from clplen.batch.work.volume_products import volume_products
from clplen.compute.device import Device
from clplen.errors import DeviceError
from clplen.files import filling, replacing
from clplen.lightfield.depth.best_focus import suitable_planes
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.lightfield.streaming.streamed_results import (
    stream_all_in_focus,
    stream_depth,
    stream_stack,
)
from clplen.reprs import OneLine

Advance = Callable[[int, int], None]
Values = np.ndarray[Any, Any]
Write = Callable[[Path], Any]

SUFFIXES = {"ome-tiff": ".ome.tif", "ome-zarr": ".ome.zarr"}
_EVERYTHING = (slice(None),) * 4
_MAPS = 12  # float32 maps, besides one for each plane, that finding depth takes


@dataclass(frozen=True)
class Light:
    """A light field of an item.

    Attributes
    ----------
    stored : StoredLightField or None
        Where it is read from, if from files.
    values : numpy.ndarray or None
        Its samples on the host; None if they are streamed.
    made : LightField or None
        If it was simulated.
    raw, truth
        What the simulation knows besides.
    """

    stored: StoredLightField | None = None
    values: Values | None = None
    made: LightField | None = None
    raw: Any = None
    truth: Any = None


@dataclass(frozen=True)
class Product:
    """A file or folder to write: its name, and what writes it under that name."""

    name: str
    write: Write


@dataclass(frozen=True, repr=False)
class HostStack(OneLine):
    """A focal stack on the host, in one tile; ``held`` keeps the memory of the device mapped.

    It is iterated over and written as `clplen.lightfield.StackTiles` are.

    Attributes
    ----------
    pictures : numpy.ndarray
        float32, shape (n, y, x[, c]).
    disparities : numpy.ndarray
        float64, shape (n,): pixels a view step, nearer larger.
    alphas : numpy.ndarray
        float64, shape (n,): F/F'; NaN where unknown.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres of the light field.
    camera : CameraModel or None
        The camera that took it.
    held : object
        What keeps ``pictures`` valid, if they are memory of a device; else None.

    Examples
    --------
    >>> d = np.array([-1.0, 0.0, 1.0])
    >>> pictures = np.zeros((3, 16, 24), np.float32)
    >>> stack = clplen.batch.HostStack(pictures, d, np.full(3, np.nan), None, None)
    >>> [values.shape for planes, rows, columns, values in stack]
    [(3, 16, 24)]
    """

    pictures: Values
    disparities: Values
    alphas: Values
    spacing: Any
    camera: Any
    held: Any = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, y, x[, c])."""
        return tuple(self.pictures.shape)

    def __iter__(self) -> Iterator[tuple[slice, slice, slice, Values]]:
        n, ny, nx = self.pictures.shape[:3]
        yield slice(0, n), slice(0, ny), slice(0, nx), self.pictures


@contextmanager
def read(
    task: Task, resources: Resources, seconds: dict[str, float], advance: Advance
) -> Iterator[Light]:
    """The light field of a task, on the host, or open to be streamed."""
    if task.source["kind"] != "file":
        with resources.budget.of(resources.memory), resources.stage("compute", seconds):
            made = simulate(task.source, device=resources.device, base=task.base, progress=advance)
        yield Light(made=made.light_field, raw=made.raw, truth=made.truth)
        return
    if not {*task.work} - {"deconvolve", "formats"}:
        with resources.budget.of(resources.memory):
            yield Light()
        return
    path = Path(task.base, task.source["path"])
    layout = layout_in(task.source["layout"], task.base)
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
    """Bytes on host and device for a light field and what is made of it, in core."""
    samples = int(np.prod(stored.shape, dtype=np.int64)) * stored.dtype.itemsize
    picture = 4 * int(np.prod(stored.shape[2:], dtype=np.int64))
    ny_nx = 4 * int(np.prod(stored.shape[2:4], dtype=np.int64))
    planes = {name: _count(stored, work.get(name)) for name in ("stack", "depth", "all_in_focus")}
    stack = 2 * planes["stack"] * picture
    depth = (2 * planes["depth"] + _MAPS) * ny_nx if planes["depth"] else 0
    blend = planes["all_in_focus"] * (picture + ny_nx) if "depth" not in work else 0
    return 2 * samples + stack + max(depth, blend) + 4 * picture


def bytes_written(stored: StoredLightField, work: dict[str, Any]) -> int:
    """Bytes of what is made of a light field, uncompressed."""
    picture = 4 * int(np.prod(stored.shape[2:], dtype=np.int64))
    ny_nx = 4 * int(np.prod(stored.shape[2:4], dtype=np.int64))
    total = _count(stored, work.get("stack")) * picture
    total += 4 * ny_nx * ("depth" in work) + picture * ("all_in_focus" in work)
    if "views" in work:
        total += picture * len(_places(stored.shape, work["views"]))
    total *= len(work["formats"])
    if "light_field" in work:
        total += int(np.prod(stored.shape, dtype=np.int64)) * stored.dtype.itemsize
    return total


def _count(stored: StoredLightField, table: dict[str, Any] | None) -> int:
    if table is None:
        return 0
    return len(next(iter(_planes(stored, table).values())))


def _planes(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    """The planes of a table, else those that suit the light field."""
    given: dict[str, Any] = {
        name: np.array(table[name]) for name in ("alphas", "disparities") if name in table
    }
    return given or suitable_planes(lf)


def compute(
    task: Task, light: Light, resources: Resources, seconds: dict[str, float], advance: Advance
) -> list[Product]:
    """What is to be written, computed unless it is streamed."""
    found: list[Product] = []
    if "deconvolve" in task.work:
        with resources.stage("compute", seconds):
            found = [
                Product(*one)
                for one in volume_products(task, light.raw, resources, SUFFIXES, advance)
            ]
    if light.stored is not None or light.made is not None:
        found += _of_light(task, light, resources, seconds, advance)
    return found


def _of_light(
    task: Task, light: Light, resources: Resources, seconds: dict[str, float], advance: Advance
) -> list[Product]:
    """What is made of a light field."""
    if light.made is None and light.values is None:
        return _streamed(task, light.stored, resources, advance)
    with resources.stage("compute", seconds):
        if is_focused(light.raw):
            made = focused_products(light.raw, task.work, SUFFIXES)
            return [*_simulated(light), *(Product(*one) for one in made)]
        lf = light.made if light.made is not None else _loaded(light, resources)
        return [*_simulated(light), *_own_light(light, task.work), *_in_core(lf, task.work)]


def write(
    folder: Path, products: list[Product], resources: Resources, seconds: dict[str, float]
) -> list[str]:
    """Write everything and name it."""
    with resources.stage("write", seconds):
        for product in products:
            resources.check()
            product.write(folder / product.name)
    return [product.name for product in products]


def _loaded(light: Light, resources: Resources) -> LightField:
    stored, values = light.stored, light.values
    assert stored is not None
    assert values is not None
    lf = LightField.from_array(
        values,
        device=resources.device,
        spacing=stored.spacing,
        weights=stored.weights,
        camera=stored.camera,
        positions=stored.positions,
    )
    return replace(lf, decode=stored.decode, parametrisation=stored.parametrisation)


def _own_light(light: Light, work: dict[str, Any]) -> list[Product]:
    """The light field of a simulation, unless it is asked for and so written anyhow."""
    if light.made is None or "light_field" in work:
        return []
    return [_light_field(light.made, "hdf5")]


def _simulated(light: Light) -> list[Product]:
    """What a simulation knows besides: raw image and truth, whatever else is made."""
    found = []
    if light.raw is not None:
        raw = light.raw.to_numpy()
        found.append(Product("raw.tif", partial(_write_raw, raw)))
    if light.truth is not None:
        found.append(
            Product("truth.h5", lambda path: io.write_truth(path, light.truth, durable=True))
        )
    return found


def _in_core(lf: LightField, work: dict[str, Any]) -> list[Product]:
    found: list[Product] = []
    formats, spacing = work["formats"], lf.spacing
    if "stack" in work:
        stack = focal_stack(lf, **_stack_words(lf, work["stack"]))
        found += _stacks(_on_host(stack), formats)
    depth: DepthMap | None = None
    if "depth" in work:
        depth = depth_map(lf, cue=work["depth"].get("cue"), **_planes(lf, work["depth"]))
        found += _depths(depth, spacing, formats)
    if "all_in_focus" in work:
        planes = {} if depth is not None else _disparities(lf, work["all_in_focus"])
        sharp = all_in_focus(lf, depth=depth, **planes).to_numpy()
        found += _pictures("all_in_focus", sharp, spacing, formats)
    if "views" in work:
        for v, u in _places(lf.shape, work["views"]):
            found += _pictures(_view_name(v, u), lf.view(v, u).to_numpy(), spacing, formats)
    if "light_field" in work:
        found.append(_light_field(lf, work["light_field"]["format"]))
    return found


def _streamed(task: Task, stored: Any, resources: Resources, advance: Advance) -> list[Product]:
    """The same of a light field that does not fit, each streamed when it is written."""
    work, formats = task.work, task.work["formats"]
    how: dict[str, Any] = {
        "memory": resources.memory,
        "device": resources.device,
        "progress": advance,
    }
    found: list[Product] = []
    if "light_field" in work:
        raise DeviceError(
            f"The light field of shape {stored.shape} and its results need more than the memory of "
            f"{resources.memory:,} bytes, and [light_field] writes it as a whole: raise memory=, "
            "or leave the table out."
        )
    if "stack" in work:
        words = _stack_words(stored, work["stack"])
        for name in formats:
            found.append(
                Product(
                    f"stack{SUFFIXES[name]}",
                    lambda path: _write_stack(stream_stack(stored, **words, **how), path),
                )
            )
    depth: DepthMap | None = None
    if "depth" in work:
        depth = stream_depth(
            stored, cue=work["depth"].get("cue"), **_planes(stored, work["depth"]), **how
        )
        found += _depths(depth, stored.spacing, formats)
    if "all_in_focus" in work:
        planes = {} if depth is not None else _disparities(stored, work["all_in_focus"])
        sharp = stream_all_in_focus(stored, depth=depth, **planes, **how)
        found += _pictures("all_in_focus", sharp, stored.spacing, formats)
    if "views" in work:
        found += _streamed_views(stored, work["views"], formats, resources.device)
    return found


def _streamed_views(
    stored: Any, table: dict[str, Any], formats: list[str], device: Device
) -> list[Product]:
    """Each from the views beside it alone."""
    found: list[Product] = []
    for v, u in _places(stored.shape, table):
        if not (0 <= v <= stored.shape[0] - 1 and 0 <= u <= stored.shape[1] - 1):
            raise ValueError(
                f"The view ({v:g}, {u:g}) lies outside the {stored.shape[0]} x {stored.shape[1]} "
                "views: mend [views]."
            )
        beside = tuple(slice(math.floor(at), math.ceil(at) + 1) for at in (v, u))
        weights = stored.weights[beside]
        part = LightField.from_array(
            stored.read((*beside, slice(None), slice(None))),
            device=device,
            weights=weights if weights.any() else np.ones_like(weights),
        )
        picture = part.view(v - beside[0].start, u - beside[1].start).to_numpy()
        found += _pictures(_view_name(v, u), picture, stored.spacing, formats)
    return found


def _stack_words(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    words = {name: table[name] for name in ("aperture", "interpolation") if name in table}
    return words | _planes(lf, table)


def _disparities(lf: Any, table: dict[str, Any]) -> dict[str, Any]:
    planes = _planes(lf, table)
    return {"disparities": lf.disparity(planes["alphas"])} if "alphas" in planes else planes


def _on_host(stack: FocalStack) -> HostStack:
    """Without a copy on a CPU: what is held ends with the stack, when it is written."""
    held = stack.device.on_host(stack.data, write=False)
    pictures = held.__enter__()
    return HostStack(pictures, stack.disparities, stack.alphas, stack.spacing, stack.camera, held)


def _places(shape: tuple[int, ...], table: dict[str, Any]) -> list[tuple[float, float]]:
    middle = ((shape[0] - 1) / 2, (shape[1] - 1) / 2)
    return [(float(v), float(u)) for v, u in table.get("at", [middle])]


def _view_name(v: float, u: float) -> str:
    return f"view_{v:g}_{u:g}"


def _stacks(stack: Any, formats: list[str]) -> list[Product]:
    return [Product(f"stack{SUFFIXES[name]}", partial(_write_stack, stack)) for name in formats]


def _write_stack(stack: Any, path: Path) -> None:
    io.write_stack(path, stack, durable=True, replace=True)


def _depths(depth: DepthMap, spacing: Any, formats: list[str]) -> list[Product]:
    def put(path: Path) -> None:
        io.write_depth(path, depth, spacing=spacing, durable=True, replace=True)

    return [Product(f"depth{SUFFIXES[name]}", put) for name in formats]


def _pictures(stem: str, picture: Values, spacing: Any, formats: list[str]) -> list[Product]:
    def put(path: Path) -> None:
        io.write_image(path, picture, spacing=spacing, durable=True, replace=True)

    return [Product(f"{stem}{SUFFIXES[name]}", put) for name in formats]


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
