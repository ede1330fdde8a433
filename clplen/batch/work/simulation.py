"""Light fields of simulated items, and the products of focused (plenoptic 2.0) raw images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from clplen import io
from clplen.batch.jobs.simulations import (
    InstrumentFile,
    check_traceable,
    sample_scene,
    validate_content,
)
from clplen.batch.work.product_files import Product, in_formats
from clplen.cameras.scenes.ground_truth import Truth
from clplen.compute.device import Device
from clplen.config.camera_file import CameraFile
from clplen.files import PathLike
from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.wave.coherence.averaging import Progress

_UNSUPPORTED = {
    "views": "does not record views: leave [views] out",
    "light_field": "does not record a light field, raw.h5 is written instead: leave [light_field] "
    "out",
}


def is_focused(raw: Any) -> bool:
    """Return True for a raw image of a focused camera."""
    return raw is not None and raw.camera is not None and raw.camera.kind == "focused"


def focused_products(raw: RawImage, work: dict[str, Any]) -> Iterator[Product]:
    """Yield raw.h5, and the requested stack, depth and all_in_focus."""
    for name, reason in _UNSUPPORTED.items():
        if name in work:
            raise ValueError(f"A focused camera {reason}.")
    formats = work["formats"]
    yield Product("raw.h5", lambda path: io.write_raw(path, raw, durable=True))
    if "stack" in work:
        stack = focused_stack(raw, ms=_ms(raw, work["stack"]))
        yield from in_formats("stack", formats, io.write_focused, stack)
    if "depth" not in work and "all_in_focus" not in work:
        return
    depth = focused_depth(raw)
    if "depth" in work:
        maps = focused_maps(raw, depth)
        yield from in_formats("depth", formats, io.write_focused_depth, depth, maps)
    if "all_in_focus" in work:
        picture = render_focused(raw, method="depth", depth=depth)
        yield from in_formats("all_in_focus", formats, io.write_focused, picture)


def _ms(raw: RawImage, table: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Return m = b/(z2 - F/alpha) of the planes."""
    camera: Any = raw.camera
    if "alphas" not in table:
        raise ValueError(
            "The planes of a focused camera must be given as alphas = F/F': set alphas in "
            "[stack] instead of disparities."
        )
    alphas = np.asarray(table["alphas"], np.float64)
    return np.asarray(
        camera.sensor_distance / (camera.array_distance - camera.image_distance / alphas)
    )


@dataclass(frozen=True, eq=False)
class Simulation:
    """Light field of a simulation, with the raw image of a camera and the truth of a scene."""

    light_field: LightField
    raw: RawImage | None = None
    truth: Truth | None = None


def simulate(
    origin: dict[str, Any],
    *,
    device: Device,
    base: PathLike = ".",
    progress: Progress | None = None,
) -> Simulation:
    """Simulate an item; the result is reproducible to the last bit on a device."""
    if origin["kind"] == "camera":
        return _by_waves(origin, Path(base, origin["folder"]), device, progress)
    if "content" in origin:
        return _by_rays(origin, device)
    sample = sample_scene(origin, tuple(origin["shape"]))
    lf, truth = sample.scene.light_field(
        tuple(origin["views"]),
        tuple(origin["shape"]),
        device=device,
        noise=sample.noise if origin["noise"] is None else origin["noise"],
        seed=origin["seed"],
    )
    return Simulation(lf, truth=truth)


def _by_waves(
    origin: dict[str, Any], folder: Path, device: Device, progress: Progress | None
) -> Simulation:
    file = validate_content(CameraFile, origin["content"], folder)
    raw = file.camera.build(device).expose(**file.exposure(), progress=progress)
    return Simulation(_decode(raw), raw)


def _by_rays(origin: dict[str, Any], device: Device) -> Simulation:
    file = validate_content(InstrumentFile, origin["content"], Path())
    camera = check_traceable(file.camera.build(device))
    raw = camera.expose(
        sample_scene(origin, camera.mla.count).scene,
        model="rays",
        sensor=None if file.sensor is None else file.sensor.build(),
    )
    return Simulation(_decode(raw), raw, cast("Truth | None", raw.truth))


def _decode(raw: RawImage) -> LightField:
    """Decode the light field; naively for a focused camera, whose raw image is used instead."""
    return LightField.from_raw(raw, decode="naive" if is_focused(raw) else "calibrated")
