"""Simulations and sample scenes that a job asks for: one source each, checked, not computed."""

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
from clplen.batch.jobs.tables import EVERY, SceneTable, SimulationTable
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

STEEPEST = 8.0  # |gy| + |gx| of a sample scene's planes, below this over half the shorter side

Model = TypeVar("Model", bound=BaseModel)


class InstrumentFile(Table):
    """A camera file as scenes use it: without its own scene and the light on it."""

    camera: CameraTable
    sensor: SensorTable | None = None


def simulations_of(table: SimulationTable, folder: Path) -> list[Source]:
    """The items of a camera file, one for each combination of what is swept.

    Nothing is simulated, but every rule that a camera, its sensor and its scene of points and
    pictures must obey is checked.
    """
    path = folder / table.camera
    content, device = _content(path), _any_device()
    known: dict[PictureTable, PointSources] = {}
    found = []
    for settings in combinations(table.sweep):
        name = _joined(table.name or path.stem, label(settings))
        with _said_of(path, name, settings):
            changed = with_values(content, settings)
            file = validate_content(CameraFile, changed, path.parent)
            _check_camera(file, _extent(file.scene, known), device)
        words = {"kind": "camera", "content": changed, "folder": str(Path(table.camera).parent)}
        files = tuple(os.path.relpath(one, folder) for one in _files(file))
        found.append(Source(name, words, files))
    return found


def scenes_of(table: SceneTable, folder: Path) -> list[Source]:
    """The items of sample scenes, one for each kind, seed and combination of what is swept."""
    path = folder / (table.camera or "")
    content = _own_content(table) if table.camera is None else _instrument_content(path)
    device = None if table.camera is None else _any_device()
    kinds = list(SCENES) if EVERY in table.kind else table.kind
    found = []
    for settings in combinations(table.sweep):
        for kind in dict.fromkeys(kinds):
            for seed in dict.fromkeys(table.seeds):
                name = _joined(table.name, kind, str(seed), label(settings))
                with _said_of(path if device else None, name, settings):
                    changed = with_values(content, settings)
                    words = {"kind": "scene", "scene": kind, "seed": seed}
                    words |= _seen(changed, words, device, path.parent)
                found.append(Source(name, words))
    return found


def check_traceable(camera: Plenoptic | Microscope) -> Plenoptic:
    """A camera that rays are traced through."""
    if isinstance(camera, Microscope):
        raise ValueError(
            "Rays are not traced through a microscope: give a plenoptic1 or plenoptic2, or points."
        )
    return camera


def sample_scene(words: dict[str, Any], shape: tuple[int, ...]) -> SampleScene:
    """The scene of a kind and a seed."""
    ny, nx = shape
    return next(one for one in sample_scenes(words["seed"], (ny, nx)) if one.name == words["scene"])


def _content(path: Path) -> dict[str, Any]:
    return read_toml(path, f"camera file {path}; 'clplen simulate --example' prints one")


def _instrument_content(path: Path) -> dict[str, Any]:
    own = ("scene", "coherence")
    return {key: value for key, value in _content(path).items() if key not in own}


def _own_content(table: SceneTable) -> dict[str, Any]:
    return {"shape": list(table.shape), "views": list(table.views), "noise": table.noise}


def _any_device() -> Device:
    """A device to build cameras on: nothing is compiled for it, nor is memory taken."""
    return Device.all()[0]


def _joined(*parts: str | None) -> str:
    return "_".join(part for part in parts if part)


@contextmanager
def _said_of(path: Path | None, name: str, settings: Iterable[Setting]) -> Iterator[None]:
    """Put file, item and values before what is wrong with them."""
    try:
        yield
    except (ValueError, ClplenError) as error:
        values = ", ".join(f"{one.key} = {one.value!r}" for one in settings)
        item = f"item {name!r}" + (f" ({values})" if values else "")
        where = "" if path is None else f"{path}, "
        raise FormatError(f"{where}{item}: {str(error).rstrip('.')}.") from error


def validate_content(model: type[Model], content: dict[str, Any], folder: Path) -> Model:
    try:
        return model.model_validate(content, context={"folder": folder})
    except ValidationError as error:
        raise FormatError(f"{problems_of(model, error)}.") from error


def _files(file: CameraFile) -> list[Path]:
    """What a camera file reads."""
    lamp = None if file.coherence is None else file.coherence.spectrum_file
    pictures = [picture.file for picture in file.scene.pictures]
    return list(dict.fromkeys(pictures if lamp is None else [*pictures, lamp]))


def _extent(scene: SceneKeys, known: dict[PictureTable, PointSources]) -> list[PointSources]:
    """Points, and the corners of pictures; a picture is read once for all depths."""
    found: list[Any] = scene.model_copy(update={"pictures": []}).build()
    for number, picture in enumerate(scene.pictures):
        flat = picture.model_copy(update={"z_mm": 0.0})
        if flat not in known:
            with value_of(f"scene.pictures.{number}.file"):
                known[flat] = flat.build().corners()
        moved = np.array([0, 0, picture.z_mm / 1e3])
        found.append(PointSources(known[flat].positions + moved))
    return found


def _check_camera(file: CameraFile, extent: list[PointSources], device: Device) -> None:
    """Refuse what `Plenoptic.expose` would refuse before it computes."""
    camera = _built(file, device)
    light = file.light()
    if isinstance(camera, Microscope):
        if file.scene.pictures:
            raise ValueError("A microscope exposes points, and the scene has pictures.")
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
    """Refuse lenses, before slides and at the array, whose phase the pixels do not sample."""
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


def _seen(
    content: dict[str, Any], words: dict[str, Any], device: Device | None, folder: Path
) -> dict[str, Any]:
    """The words on who sees a scene, checked."""
    if device is None:
        known = validate_content(SceneTable, {"kind": words["scene"], **content}, folder)
        V, U = known.views
        _check_steepness(words, known.shape, ((V - 1) / 2, (U - 1) / 2))
        return _own_content(known)
    camera = check_traceable(_built(validate_content(InstrumentFile, content, folder), device))
    _check_steepness(words, camera.mla.count, view_reach(camera))
    return {"content": content}


def _check_steepness(
    words: dict[str, Any], shape: tuple[int, int], reach: tuple[float, float]
) -> None:
    """Refuse planes that are seen edge-on; a scene is drawn only where that may be."""
    if max(reach) * STEEPEST / (min(shape) / 2) > 1 - EDGE_ON:
        sample_scene(words, shape).scene.check_views(*reach)
