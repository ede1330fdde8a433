"""The camera file: a camera, a scene and a sensor in TOML, with units in the names of the keys."""

from __future__ import annotations

import difflib
import math
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.plenoptic1 import Plenoptic1
from clplen.cameras.scene import PointSources
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.lightfield.sensor import Sensor
from clplen.wave.lenslets import MicrolensArray

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# Strict: "120", true and 101.5 are no whole numbers here.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Count = Annotated[int, Field(ge=1, strict=True)]
Switch = Annotated[bool, Field(strict=True)]

EXAMPLE = """\
# A plenoptic camera of type 1, three points and a sensor: clplen simulate camera.toml -o OUT
# A key that begins with # shows its default.

[camera]
focal_length_mm = 120.0         # main lens
wavelength_nm = 532.0
pixels_per_lenslet = 30         # may be fractional
# object_distance_mm = 240.0    # to the focused plane; default: twice the focal length, or by
# image_distance_mm = 240.0     # the lens law from the other one; main lens to microlens array
# aperture_diameter_mm = 3.6    # default: f-number matched to the lenslets
# field_lens = false            # a lens at the array that centres every sub-image

[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 10.0          # also the distance from the array to the sensor
count = 101                     # or [rows, columns]
fill = "full"                   # or "circular" (default)
# lattice = "square"            # or "hexagonal"
# diameter_um = 150.0           # default: the pitch
# offset_um = [0.0, 0.0]        # y, x
# rotation_deg = 0.0            # positive turns +x towards +y (y down)

[scene]
# x, y, dz of each point: from the axis point of the focused plane, dz > 0 farther from the lens
points_mm = [[-3.0, -3.0, -50.0], [0.0, 0.0, 0.0], [3.0, 3.0, 50.0]]
diameter_um = 10.0              # of each source, a coherent disc; 0 (default): a point
# power = 1.0                   # energy through the aperture; one number, or one for each point

[sensor]                        # without it, or without exposure: energies, no noise
# exposure_electrons = 1e6      # photo-electrons for the energy 1; all below need it
# shot_noise = false
# read_noise_electrons = 0.0
# full_well_electrons = 20000.0 # default: no saturation
# bit_depth = 12                # up to full_well_electrons; default: values are not rounded
# seed = 0
"""


def _twice(value: Any) -> Any:
    """One number for rows and columns."""
    return value if isinstance(value, list) else [value, value]


def _of(count: int, words: str) -> BeforeValidator:
    """Refuse, in these words, what is no list of so many values."""

    def check(value: Any) -> Any:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be {words}")
        return value

    return BeforeValidator(check)


def _listed(value: Any) -> Any:
    """One number for all points."""
    return value if isinstance(value, list) else [value]


class _Table(BaseModel):
    """A table of the file; keys that it does not know are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MicrolensTable(_Table):
    """``[camera.microlenses]``."""

    pitch_um: Positive
    focal_length_mm: Positive
    count: Annotated[
        tuple[Count, Count], _of(2, "one number or [rows, columns]"), BeforeValidator(_twice)
    ]
    lattice: Literal["square", "hexagonal"] = "square"
    fill: Literal["circular", "full"] = "circular"
    diameter_um: Positive | None = None
    offset_um: Annotated[tuple[Finite, Finite], _of(2, "two numbers, [y, x]")] = (0.0, 0.0)
    rotation_deg: Finite = 0.0

    def build(self) -> MicrolensArray:
        """The array, in SI units."""
        return MicrolensArray(
            self.pitch_um / 1e6,
            self.focal_length_mm / 1e3,
            count=self.count,
            lattice=self.lattice,
            fill=self.fill,
            diameter=_divided(self.diameter_um, 1e6),
            offset=(self.offset_um[0] / 1e6, self.offset_um[1] / 1e6),
            rotation=math.radians(self.rotation_deg),
        )


class CameraTable(_Table):
    """``[camera]``."""

    focal_length_mm: Positive
    wavelength_nm: Positive
    pixels_per_lenslet: Positive
    microlenses: MicrolensTable
    object_distance_mm: Positive | None = None
    image_distance_mm: Positive | None = None
    aperture_diameter_mm: Positive | None = None
    field_lens: Switch = False

    def build(self, device: Device) -> Plenoptic1:
        """The camera, in SI units, on a device."""
        return PlenopticCamera.type1(
            focal_length=self.focal_length_mm / 1e3,
            mla=self.microlenses.build(),
            wavelength=self.wavelength_nm / 1e9,
            pixels_per_lenslet=self.pixels_per_lenslet,
            device=device,
            object_distance=_divided(self.object_distance_mm, 1e3),
            image_distance=_divided(self.image_distance_mm, 1e3),
            aperture_diameter=_divided(self.aperture_diameter_mm, 1e3),
            field_lens=self.field_lens,
        )


Point = Annotated[tuple[Finite, Finite, Finite], _of(3, "three numbers, [x, y, dz]")]


class SceneTable(_Table):
    """``[scene]``."""

    points_mm: Annotated[list[Point], Field(min_length=1)]
    diameter_um: NotNegative = 0.0
    power: Annotated[list[Finite], BeforeValidator(_listed)] = Field(default=[1.0])

    def build(self) -> PointSources:
        """The point sources, in SI units."""
        positions = [tuple(value / 1e3 for value in point) for point in self.points_mm]
        power = self.power if len(self.power) > 1 else self.power[0]
        return PointSources(positions, diameter=self.diameter_um / 1e6, power=power)


class SensorTable(_Table):
    """``[sensor]``."""

    exposure_electrons: Positive | None = None
    shot_noise: Switch = False
    read_noise_electrons: NotNegative = 0.0
    bit_depth: Annotated[int, Field(ge=1, le=24, strict=True)] | None = None
    full_well_electrons: Positive | None = None
    seed: Annotated[int, Field(ge=0, strict=True)] = 0

    def build(self) -> Sensor:
        """The sensor."""
        return Sensor(
            exposure=self.exposure_electrons,
            shot_noise=self.shot_noise,
            read_noise=self.read_noise_electrons,
            bit_depth=self.bit_depth,
            full_well=self.full_well_electrons,
            seed=self.seed,
        )


class CameraFile(_Table):
    """A whole camera file."""

    camera: CameraTable
    scene: SceneTable
    sensor: SensorTable | None = None


def read_camera_file(path: PathLike) -> CameraFile:
    """Read a camera file.

    Parameters
    ----------
    path : path-like
        TOML as ``clplen simulate --example`` prints it.

    Returns
    -------
    CameraFile

    Raises
    ------
    FormatError
        If there is no such file, it is not TOML, or a key is unknown (with the nearest known
        one), missing or out of range.
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
        return CameraFile.model_validate(content)
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
        said = error["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
        return f"{_key(error)} {said[0].lower()}{said[1:]} (found {error['input']!r})"
    table = _TABLES[path[-2]] if len(path) > 1 else CameraFile
    known = list(table.model_fields)
    near = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known here are {', '.join(known)}"
    return f"unknown key {key}; {hint}"


def _key(error: Any) -> str:
    """Where it was found: without the place in a pair of numbers, where the value tells enough."""
    path = list(error["loc"])
    if isinstance(path[-1], int) and error["type"] != "value_error":
        path.pop()
    return ".".join(map(str, path))


_TABLES: dict[str, type[_Table]] = {
    "camera": CameraTable,
    "microlenses": MicrolensTable,
    "scene": SceneTable,
    "sensor": SensorTable,
}


def _divided(value: float | None, by: float) -> float | None:
    """In SI units: 200 / 1e6 is 0.0002, while 200 * 1e-6 is 0.00019999999999999998."""
    return None if value is None else value / by
