"""Camera files: camera, scene and sensor in TOML, with units in the names of the keys."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import model_validator

from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.standard_camera import Plenoptic1
from clplen.checks import is_integer
from clplen.compute.device import DeviceLike, as_device
from clplen.config.camera import CameraTable, SensorTable
from clplen.config.kinds import refuse_fourier, refuse_lfanalyze
from clplen.config.scene import CoherenceTable, SceneTable
from clplen.config.tables import Model, Table, read_toml, validated
from clplen.files import PathLike
from clplen.wave.coherence.coherence import Coherence


class CameraFile(Table):
    """Content of a camera file."""

    camera: CameraTable
    scene: SceneTable
    coherence: CoherenceTable | None = None
    sensor: SensorTable | None = None

    @model_validator(mode="after")
    def _light_for_slides(self) -> CameraFile:
        slides = self.scene.slides()
        if slides and self.coherence is None:
            raise ValueError(
                f"scene.pictures.{slides[0]} is a slide (mode = 'transmission') without light: "
                "add a table [coherence]"
            )
        if self.coherence is not None and not slides:
            stray = self.coherence.of_slides()
            if stray:
                raise ValueError(
                    f"coherence.{stray[0]} applies to slides, but the scene has none: set mode = "
                    "'transmission' in a table [[scene.pictures]], or leave it out"
                )
        return self

    def light(self) -> Coherence | None:
        """Return the light on the slides and the spectrum of the scene in SI units, or None."""
        if self.coherence is None:
            return None
        return self.coherence.build(self.camera.wavelength_nm / 1e9)

    def exposure(self) -> dict[str, Any]:
        """Return the arguments of ``expose``: scene, light, sensor and snapshots."""
        settings = self.coherence or CoherenceTable()
        return {
            "scene": self.scene.build(),
            "coherence": self.light(),
            "sensor": None if self.sensor is None else self.sensor.build(),
            "koehler": settings.koehler,
            "snapshots": settings.snapshots,
            "rtol": settings.rtol,
        }

    @property
    def label(self) -> str:
        """Digest of camera and scene for checkpoints, which compare the light separately."""
        koehler = self.coherence is not None and self.coherence.koehler
        text = f"{self.model_dump_json(exclude={'coherence'})}, koehler={koehler}"
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_camera_file(path: PathLike) -> CameraFile:
    """Read a camera file."""
    return _read(CameraFile, Path(path))


def _read(model: type[Model], path: Path) -> Model:
    content = read_toml(path, f"camera file {path}; 'clplen simulate --example' prints one")
    refuse_fourier(content, path)
    refuse_lfanalyze(content, path)
    return validated(model, content, path)


class _CameraOnly(Table):
    """Camera file of which only the camera is validated."""

    camera: CameraTable
    scene: Any = None
    coherence: Any = None
    sensor: Any = None


def read_camera(
    path: PathLike,
    *,
    device: DeviceLike | None = None,
    count: int | tuple[int, int] | None = None,
) -> Plenoptic1 | Plenoptic2 | Microscope:
    """Read the camera of a camera file.

    Parameters
    ----------
    path : path-like
        TOML file as printed by ``clplen simulate --example``; the scene is optional.
    device : Device or str, optional
        Device of the simulation; None means ``Device.open()``.
    count : int or tuple of int, optional
        Number of lenslets (ny, nx) that replaces the number in the file, to simulate the central
        part of a large camera; the number of pixels is adapted.

    Returns
    -------
    Plenoptic1, Plenoptic2 or Microscope
        Camera of the ``kind`` in the file.

    Raises
    ------
    FormatError
        If the file does not exist, is not TOML or describes a Fourier microscope, or a key is
        unknown, missing or out of range.
    ValueError, SamplingError
        If the camera is impossible or undersampled; see `PlenopticCamera`.

    Examples
    --------
    >>> with open("camera.toml", "w") as file:
    ...     lines = file.write('''
    ... [camera]
    ... focal_length_mm = 10.0
    ... wavelength_nm = 550.0
    ... pixels_per_lenslet = 5
    ...
    ... [camera.microlenses]
    ... pitch_um = 100.0
    ... focal_length_mm = 1.0
    ... count = 11
    ... ''')
    >>> clplen.read_camera("camera.toml")
    <Plenoptic1 f = 10 mm, 11 x 11 lenslets of 100 um, 55 x 55 pixels, 550 nm, ...>
    """
    table = _read(_CameraOnly, Path(path)).camera
    if count is not None:
        counts = np.ravel(count)
        if counts.size not in (1, 2) or not all(is_integer(n) and n >= 1 for n in counts):
            raise ValueError(
                f"count must be a number of lenslets, 1 or more, or a pair (ny, nx), got {count!r}."
            )
        ny, nx = (int(n) for n in np.broadcast_to(counts, (2,)))
        changes: dict[str, Any] = {
            "microlenses": table.microlenses.model_copy(update={"count": (ny, nx)})
        }
        if table.pixels is not None:
            changes["pixels"] = table.pixels.model_copy(update={"shape": None})
        table = table.model_copy(update=changes)
    return table.build(as_device(device))
