"""The camera file: a camera, a scene and a sensor in TOML, with units in the names of the keys."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path
from typing import Any

from pydantic import ValidationError, model_validator

from clplen.config.camera import CameraTable, MicrolensTable, SensorTable
from clplen.config.example import EXAMPLE
from clplen.config.light import CoherenceTable
from clplen.config.scene import PictureTable, SceneTable
from clplen.config.tables import Table
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.wave.coherence import Coherence

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["EXAMPLE", "CameraFile", "CoherenceTable", "read_camera_file"]


class CameraFile(Table):
    """A whole camera file."""

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
                    f"coherence.{stray[0]} is for slides, and the scene has none: set mode = "
                    "'transmission' in a table of [[scene.pictures]], or leave it out"
                )
        return self

    def light(self) -> Coherence | None:
        """The light on the slides and the spectrum of the scene, in SI units, or None.

        Raises
        ------
        FormatError
            If a spectrum is out of range, or its file cannot be read.
        """
        if self.coherence is None:
            return None
        return self.coherence.build(self.camera.wavelength_nm / 1e9)


def read_camera_file(path: PathLike) -> CameraFile:
    """Read a camera file.

    Parameters
    ----------
    path : path-like
        TOML as ``clplen simulate --example`` prints it. Files that it names are seen from its
        folder; they must be there, and are read later.

    Returns
    -------
    CameraFile

    Raises
    ------
    FormatError
        If there is no such file, it is not TOML, or a key is unknown (with the nearest known
        one), missing or out of range, or does not fit the others.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(
            f"There is no camera file {path}; 'clplen simulate --example' prints one."
        )
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"{path} is not TOML: {error}.") from error
    try:
        return CameraFile.model_validate(content, context={"folder": path.parent})
    except ValidationError as error:
        problems = dict.fromkeys(_problem(problem) for problem in error.errors())
        raise FormatError(f"{path}: {'; '.join(problems)}.") from error


def _problem(error: Any) -> str:
    """One of pydantic's findings in words."""
    path = [str(part) for part in error["loc"]]
    key = ".".join(path)
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] != "extra_forbidden":
        return _wrong_value(error)
    tables = [part for part in path[:-1] if not part.isdigit()]
    table = _TABLES[tables[-1]] if tables else CameraFile
    known = list(table.model_fields)
    near = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known here are {', '.join(known)}"
    return f"unknown key {key}; {hint}"


def _wrong_value(error: Any) -> str:
    """A value, or values of a whole table that do not go together."""
    said = error["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
    sentence = f"{_key(error)} {said[0].lower()}{said[1:]}".lstrip()
    is_table = error["type"] == "value_error" and isinstance(error["input"], dict)
    return sentence if is_table else f"{sentence} (found {error['input']!r})"


def _key(error: Any) -> str:
    """Where it was found: without the place in a pair of numbers, where the value tells enough."""
    path = list(error["loc"])
    if path and isinstance(path[-1], int) and error["type"] != "value_error":
        path.pop()
    return ".".join(map(str, path))


_TABLES: dict[str, type[Table]] = {
    "camera": CameraTable,
    "microlenses": MicrolensTable,
    "scene": SceneTable,
    "pictures": PictureTable,
    "coherence": CoherenceTable,
    "sensor": SensorTable,
}
