"""Light fields of simulated items: cameras by waves, and scenes of exact depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clplen.batch.jobs.simulations import (
    InstrumentFile,
    check_traceable,
    sample_scene,
    validate_content,
)
from clplen.batch.work.focused import is_focused
from clplen.cameras.truth import Truth
from clplen.compute.device import Device
from clplen.config import CameraFile, CoherenceTable
from clplen.files import PathLike
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.raw import RawImage
from clplen.wave.average import Progress


@dataclass(frozen=True, eq=False)
class Simulated:
    """What a simulation gives.

    Attributes
    ----------
    light_field : LightField
    raw : RawImage or None
        Of a camera.
    truth : Truth or None
        Of a scene of surfaces.
    """

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
    """Simulate an item; the same words give the same bits on the same device.

    Parameters
    ----------
    words : dict
        Of its `Source`.
    device : Device
    base : path-like
        Folder of the job file, from where the folder of a camera file is seen.
    progress : callable, optional
        Called as ``progress(done, total)``; see `Plenoptic.expose`.

    Returns
    -------
    Simulated

    Raises
    ------
    FormatError
        If the words make no camera, or a picture cannot be read.
    ValueError, SamplingError, DeviceError
        As `Plenoptic.expose` and `SurfaceScene.light_field`.
    """
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
    how = file.coherence or CoherenceTable()
    raw = file.camera.build(device).expose(
        file.scene.build(),
        coherence=file.light(),
        sensor=None if file.sensor is None else file.sensor.build(),
        progress=progress,
        koehler=how.koehler,
        snapshots=how.snapshots,
        rtol=how.rtol,
    )
    return Simulated(_decoded(raw), raw)


def _by_rays(words: dict[str, Any], device: Device) -> Simulated:
    file = validate_content(InstrumentFile, words["content"], Path())
    camera = check_traceable(file.camera.build(device))
    raw = camera.expose(
        sample_scene(words, camera.mla.count).scene,
        model="rays",
        sensor=None if file.sensor is None else file.sensor.build(),
    )
    return Simulated(_decoded(raw), raw, raw.truth)


def _decoded(raw: RawImage) -> LightField:
    """The light field; of a focused camera, of which the raw image is used, its plain pixels."""
    return LightField.from_raw(raw, decode="naive" if is_focused(raw) else "calibrated")
