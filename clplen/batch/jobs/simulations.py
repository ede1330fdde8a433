"""Sources of the simulations and sample scenes of a job, checked but not computed."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from clplen.batch.jobs.sweep import Setting, combinations, label, with_values
from clplen.batch.jobs.tables import ALL_KINDS, SceneTable, SimulationTable
from clplen.batch.jobs.task import Source
from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.exposure.surface_rays import view_reach
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.scenes.gallery import SCENES, SampleScene, sample_scenes
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.scenes.surface_scene import EDGE_ON
from clplen.compute.device import Device
from clplen.config.camera import CameraTable, SensorTable
from clplen.config.camera_file import CameraFile
from clplen.config.scene import PictureTable
from clplen.config.scene import SceneTable as SceneKeys
from clplen.config.tables import Table, problems_of, read_toml, value_of
from clplen.errors import ClplenError, FormatError
from clplen.wave.elements.lens import check_lens_sampling

# Upper bound of |gy| + |gx| of the planes of a sample scene, times half the shorter side.
MAX_SLOPE = 8.0

Model = TypeVar("Model", bound=BaseModel)


class InstrumentFile(Table):
    """Camera file for sample scenes, without its scene and coherence."""

    camera: CameraTable
    sensor: SensorTable | None = None


def simulations_of(table: SimulationTable, folder: Path) -> list[Source]:
    """Return a source for each combination of swept values of a camera file.

    The rules for camera, sensor and scene are checked without any simulation.
    """
    path = folder / table.camera
    content, device = _content(path), _any_device()
    corners: dict[PictureTable, PointSources] = {}
    sources = []
    for settings in combinations(table.sweep):
        name = _joined(table.name or path.stem, label(settings))
        with _error_context(path, name, settings):
            changed = with_values(content, settings)
            file = validate_content(CameraFile, changed, path.parent)
            _check_camera(file, _extent(file.scene, corners), device)
        origin = {"kind": "camera", "content": changed, "folder": str(Path(table.camera).parent)}
        files = tuple(os.path.relpath(file_path, folder) for file_path in _files(file))
        sources.append(Source(name, origin, files))
    return sources


def scenes_of(table: SceneTable, folder: Path) -> list[Source]:
    """Return a source for each kind, seed and combination of swept values of sample scenes."""
    path = folder / (table.camera or "")
    content = _scene_content(table) if table.camera is None else _instrument_content(path)
    device = None if table.camera is None else _any_device()
    kinds = list(SCENES) if ALL_KINDS in table.kind else table.kind
    sources = []
    for settings in combinations(table.sweep):
        for kind in dict.fromkeys(kinds):
            for seed in dict.fromkeys(table.seeds):
                name = _joined(table.name, kind, str(seed), label(settings))
                with _error_context(path if device else None, name, settings):
                    changed = with_values(content, settings)
                    origin = {"kind": "scene", "scene": kind, "seed": seed}
                    origin |= _checked_views(changed, origin, device, path.parent)
                sources.append(Source(name, origin))
    return sources


def check_traceable(camera: Plenoptic | Microscope) -> Plenoptic:
    """Return a camera that supports ray tracing; raise an error for a microscope."""
    if isinstance(camera, Microscope):
        raise ValueError(
            "Rays cannot be traced through a microscope: use a camera of kind plenoptic1 or "
            "plenoptic2, or [[simulations]] with points."
        )
    return camera


def sample_scene(origin: dict[str, Any], shape: tuple[int, ...]) -> SampleScene:
    """Return the sample scene of a kind and seed."""
    ny, nx = shape
    scenes = sample_scenes(origin["seed"], (ny, nx))
    return next(scene for scene in scenes if scene.name == origin["scene"])


def _content(path: Path) -> dict[str, Any]:
    return read_toml(path, f"camera file {path}; 'clplen simulate --example' prints one")


def _instrument_content(path: Path) -> dict[str, Any]:
    ignored = ("scene", "coherence")
    return {key: value for key, value in _content(path).items() if key not in ignored}


def _scene_content(table: SceneTable) -> dict[str, Any]:
    return {"shape": list(table.shape), "views": list(table.views), "noise": table.noise}


def _any_device() -> Device:
    """Return a device for building cameras; no kernel is compiled and no memory allocated."""
    return Device.all()[0]


def _joined(*parts: str | None) -> str:
    return "_".join(part for part in parts if part)


@contextmanager
def _error_context(path: Path | None, name: str, settings: Iterable[Setting]) -> Iterator[None]:
    """Prepend file, item and swept values to error messages."""
    try:
        yield
    except (ValueError, ClplenError) as error:
        values = ", ".join(f"{setting.key} = {setting.value!r}" for setting in settings)
        item = f"item {name!r}" + (f" ({values})" if values else "")
        file_prefix = "" if path is None else f"{path}, "
        raise FormatError(f"{file_prefix}{item}: {str(error).rstrip('.')}.") from error


def validate_content(model: type[Model], content: dict[str, Any], folder: Path) -> Model:
    try:
        return model.model_validate(content, context={"folder": folder})
    except ValidationError as error:
        raise FormatError(f"{problems_of(model, error)}.") from error


def _files(file: CameraFile) -> list[Path]:
    """Return the files that a camera file reads."""
    lamp = None if file.coherence is None else file.coherence.spectrum_file
    pictures = [picture.file for picture in file.scene.pictures]
    return list(dict.fromkeys(pictures if lamp is None else [*pictures, lamp]))


def _extent(scene: SceneKeys, corners: dict[PictureTable, PointSources]) -> list[PointSources]:
    """Return the points and the corners of pictures; ``corners`` caches pictures at z = 0."""
    extent: list[Any] = scene.model_copy(update={"pictures": []}).build()
    for number, picture in enumerate(scene.pictures):
        flat = picture.model_copy(update={"z_mm": 0.0})
        if flat not in corners:
            with value_of(f"scene.pictures.{number}.file"):
                corners[flat] = flat.build().corners()
        offset = np.array([0, 0, picture.z_mm / 1e3])
        extent.append(PointSources(corners[flat].positions + offset))
    return extent


def _check_camera(file: CameraFile, extent: list[PointSources], device: Device) -> None:
    """Apply the checks of `Plenoptic.expose` without computing an exposure."""
    camera = _built(file, device)
    light = file.light()
    if isinstance(camera, Microscope):
        if file.scene.pictures:
            raise ValueError(
                "The scene of a microscope must consist of points, got pictures: leave out "
                "[[scene.pictures]]."
            )
        for wavelength, _ in camera.lines(light):
            for part in extent:
                replace(camera, wavelength=wavelength).window(part)
        return
    lines = [(camera.wavelength, 1.0)] if light is None else light.lines(camera.wavelength)
    for wavelength, _ in lines:
        coloured = replace(camera, wavelength=wavelength)
        for part in extent:
            coloured.check_scene(part)
        _check_lenses(file, coloured)


def _check_lenses(file: CameraFile, camera: Plenoptic) -> None:
    """Raise an error if the pixels undersample the phase of a field lens or slide lens."""
    lenses: list[tuple[float, float | None]] = []  # focal length, radius
    if camera.field_lens:
        lenses.append((camera.array_distance, None))
    for number in file.scene.slides():
        if file.coherence is None or file.coherence.koehler:
            z = camera.object_distance + file.scene.pictures[number].z_mm / 1e3
            lenses.append((z, None))
        lenses.append((camera.focal_length, camera.aperture_diameter / 2))
    for f, radius in lenses:
        check_lens_sampling(camera.grid, f, radius, camera.wavelength, "raise")


def _built(file: CameraFile | InstrumentFile, device: Device) -> Plenoptic | Microscope:
    if file.sensor is not None:
        file.sensor.build()
    return file.camera.build(device)


def _checked_views(
    content: dict[str, Any], origin: dict[str, Any], device: Device | None, folder: Path
) -> dict[str, Any]:
    """Return the settings of the views or the camera of a scene, after checking them."""
    if device is None:
        table = validate_content(SceneTable, {"kind": origin["scene"], **content}, folder)
        V, U = table.views
        _check_slopes(origin, table.shape, ((V - 1) / 2, (U - 1) / 2))
        return _scene_content(table)
    camera = check_traceable(_built(validate_content(InstrumentFile, content, folder), device))
    _check_slopes(origin, camera.mla.count, view_reach(camera))
    return {"content": content}


def _check_slopes(
    origin: dict[str, Any], shape: tuple[int, int], reach: tuple[float, float]
) -> None:
    """Raise an error if views see planes edge-on; draw the scene only if the bound allows it."""
    if max(reach) * MAX_SLOPE / (min(shape) / 2) > 1 - EDGE_ON:
        sample_scene(origin, shape).scene.check_views(*reach)
