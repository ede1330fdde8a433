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

_NONE = {
    "views": "has no views of directions: leave [views] out",
    "light_field": "has no light field, its raw.h5 is written: leave [light_field] out",
}


def is_focused(raw: Any) -> bool:
    """Whether a raw image is of a focused camera."""
    return raw is not None and raw.camera is not None and raw.camera.kind == "focused"


def focused_products(raw: RawImage, work: dict[str, Any]) -> Iterator[Product]:
    """Yield raw.h5, and stack, depth and all_in_focus where they are asked for."""
    for name, why in _NONE.items():
        if name in work:
            raise ValueError(f"A focused camera {why}.")
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
    """m = b/(z2 - F/alpha) of the planes."""
    camera: Any = raw.camera
    if "alphas" not in table:
        raise ValueError(
            "The planes of a focused camera have no disparities: give alphas in [stack], F/F' as "
            "for other cameras."
        )
    alphas = np.asarray(table["alphas"], np.float64)
    return np.asarray(
        camera.sensor_distance / (camera.array_distance - camera.image_distance / alphas)
    )


@dataclass(frozen=True, eq=False)
class Simulated:
    """Results of a simulation: a camera gives a raw image, a scene of surfaces the truth."""

    light_field: LightField
    raw: RawImage | None = None
    truth: Truth | None = None


def simulate(
    words: dict[str, Any],
    *,
    device: Device,
    base: PathLike = ".",
    progress: Progress | None = None,
) -> Simulated:
    """Simulate an item; the same words give the same bits on the same device."""
    if words["kind"] == "camera":
        return _by_waves(words, Path(base, words["folder"]), device, progress)
    if "content" in words:
        return _by_rays(words, device)
    sample = sample_scene(words, tuple(words["shape"]))
    lf, truth = sample.scene.light_field(
        tuple(words["views"]),
        tuple(words["shape"]),
        device=device,
        noise=sample.noise if words["noise"] is None else words["noise"],
        seed=words["seed"],
    )
    return Simulated(lf, truth=truth)


def _by_waves(
    words: dict[str, Any], folder: Path, device: Device, progress: Progress | None
) -> Simulated:
    file = validate_content(CameraFile, words["content"], folder)
    raw = file.camera.build(device).expose(**file.exposure(), progress=progress)
    return Simulated(_decoded(raw), raw)


def _by_rays(words: dict[str, Any], device: Device) -> Simulated:
    file = validate_content(InstrumentFile, words["content"], Path())
    camera = check_traceable(file.camera.build(device))
    raw = camera.expose(
        sample_scene(words, camera.mla.count).scene,
        model="rays",
        sensor=None if file.sensor is None else file.sensor.build(),
    )
    return Simulated(_decoded(raw), raw, cast("Truth | None", raw.truth))


def _decoded(raw: RawImage) -> LightField:
    """The light field; of a focused camera, of which the raw image is used, its plain pixels."""
    return LightField.from_raw(raw, decode="naive" if is_focused(raw) else "calibrated")
