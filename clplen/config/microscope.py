"""Files of a light-field microscope: ``[camera]`` of a camera file, or the names of LFAnalyze.

LFAnalyze and napari-LF know an instrument by flat names: micrometres for the array and the sensor,
millimetres for the tube lens, nanometres for the wavelength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from clplen.cameras.optics.objective import APODISATION
from clplen.config.camera import CameraTable, CoverTable, PupilTerms, SensorTable
from clplen.config.kinds import refuse_fourier, what_takes
from clplen.config.scene import CoherenceTable, SceneTable
from clplen.config.tables import Count, Positive, Table, read_toml, validated
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.microscopy.frames.prepare import MIN_PIXELS_PER_PITCH
from clplen.microscopy.model.binning import suitable_binning

_POWERS = (3, -3, 6, -6, 9, -9)  # of 10: from m, mm, um and nm to one another


@dataclass(frozen=True)
class Range:
    """Range of values of instruments that exist, both ends included."""

    low: float
    high: float
    unit: str = ""

    def check(self, value: float) -> float:
        """The value, refused outside the range."""
        if self.low <= value <= self.high:
            return value
        said = f"lies between {self.low:g} and {self.high:g}"
        if self.unit:
            said = f"is in {self.unit} here, from {self.low:g} to {self.high:g}"
        for power in _POWERS if self.unit else ():
            meant = value * 10.0**power
            if self.low <= meant <= self.high:
                said += f": did you mean {meant:.6g}?"
                break
        raise ValueError(said)


MAGNIFICATION = Range(1, 250)
NA = Range(0.01, 1.8)
INDEX = Range(1, 2.5)
WAVELENGTH = Range(150, 3000, "nm")
TUBE_LENS = Range(10, 2000, "mm")
PITCH = Range(3, 5000, "um")
FOCAL_LENGTH = Range(10, 2e5, "um")
FOCAL_LENGTH_MM = Range(0.01, 200, "mm")
PIXEL = Range(0.3, 200, "um")
STEP = Range(1e-4, 1e4, "um")
PIXELS = Range(3, 1000)  # of a lenslet, along an axis
F_NUMBER = Range(0.5, 1000)  # of a lenslet
NEAR = 0.1  # of a pixel, by which a lenslet may miss a whole number of them


FINER = 1.5  # pixels of point images for one of a frame that is not rectified, along an axis
PARTS = 2  # of such a pixel, at least, to integrate over those of the frame
_COUNT = 35  # lenslets of the camera that is built: point images do not depend on it
_PRINTED = "'clplen microscope psf --example' prints one"
_F_NUMBER = "the f-number of the lenslets, focal length over pitch, is {:.3g}; it"


class ObjectiveTable(Table):
    """What tables of microscopes have of the objective."""

    magnification: Annotated[Positive, AfterValidator(MAGNIFICATION.check)]
    na: Annotated[Positive, AfterValidator(NA.check)]
    apodisation: Annotated[float, Field(ge=-1, le=1, strict=True)] = APODISATION
    cover: CoverTable | None = None


class KnownTable(ObjectiveTable):
    """A microscope by the names of LFAnalyze; the whole file."""

    medium_index: Annotated[Positive, AfterValidator(INDEX.check)]
    wavelength: Annotated[Positive, AfterValidator(WAVELENGTH.check)]
    tubelens_focal_length: Annotated[Positive, AfterValidator(TUBE_LENS.check)] = 200.0
    ulens_pitch: Annotated[Positive, AfterValidator(PITCH.check)]
    ulens_focal_length: Annotated[Positive, AfterValidator(FOCAL_LENGTH.check)]
    ulens_lattice: Literal["square", "hexagonal"] = "square"
    pixel_size: Annotated[Positive, AfterValidator(PIXEL.check)]
    pupil_nm: PupilTerms | None = None
    num_slices: Count | None = None
    um_per_slice: Annotated[Positive, AfterValidator(STEP.check)] | None = None
    supersample: Count | None = None
    pixels_per_lenslet: Count | None = None

    @model_validator(mode="after")
    def _pixels_of_lenslets(self) -> KnownTable:
        _in_range("pixel_size gives a lenslet {:.3g} pixels, a number that",
                  self.ulens_pitch / self.pixel_size, PIXELS)  # fmt: skip
        _in_range(_F_NUMBER, self.ulens_focal_length / self.ulens_pitch, F_NUMBER)
        return self

    def camera(self) -> CameraTable:
        """The same as ``[camera]``."""
        lenslets = {
            "pitch_um": self.ulens_pitch,
            "focal_length_mm": self.ulens_focal_length / 1e3,
            "count": _COUNT,
            "fill": "full",
            "lattice": self.ulens_lattice,
        }
        return CameraTable.model_validate(
            {
                "kind": "microscope",
                "magnification": self.magnification,
                "na": self.na,
                "medium_index": self.medium_index,
                "wavelength_nm": self.wavelength,
                "tube_lens_mm": self.tubelens_focal_length,
                "apodisation": self.apodisation,
                "cover": self.cover and self.cover.model_dump(),
                "pupil_nm": self.pupil_nm,
                "pixels_per_lenslet": self.ulens_pitch / self.pixel_size,
                "microlenses": lenslets,
            }
        )


class _CameraAlone(Table):
    """A camera file that needs no scene."""

    camera: CameraTable
    scene: SceneTable | None = None
    coherence: CoherenceTable | None = None
    sensor: SensorTable | None = None

    @model_validator(mode="after")
    def _of_a_microscope(self) -> _CameraAlone:
        camera, array = self.camera, self.camera.microlenses
        if camera.kind != "microscope":
            return self
        focal = array.focal_length_mm[0]
        for key, value, limits in (
            ("magnification", camera.magnification or 0, MAGNIFICATION),
            ("na", camera.na or 0, NA),
            ("medium_index", camera.medium_index, INDEX),
            ("wavelength_nm", camera.wavelength_nm, WAVELENGTH),
            ("tube_lens_mm", camera.tube_lens_mm, TUBE_LENS),
            ("pixels_per_lenslet", camera.pixels_across, PIXELS),
            ("microlenses.pitch_um", array.pitch_um, PITCH),
            ("microlenses.focal_length_mm", focal, FOCAL_LENGTH_MM),
        ):
            _in_range(f"camera.{key} = {{:g}}", value, limits)
        _in_range(_F_NUMBER, 1e3 * focal / array.pitch_um, F_NUMBER)
        return self


def _in_range(words: str, value: float, limits: Range) -> None:
    """Refuse a value with these words before what is said of it."""
    try:
        limits.check(value)
    except ValueError as error:
        raise ValueError(f"{words.format(value)} {error}") from None


@dataclass(frozen=True)
class MicroscopeFile:
    """Content of a file of a microscope.

    The camera has a whole number of pixels a lenslet, ``binning`` (at least ``least``) times those
    of the sensor; ``pixels`` is the file's own number. Frames that are not ``rectified`` have
    `FINER` times as many. ``taken`` says what is assumed for values that the file leaves out;
    ``voxels`` are those of a lenslet along an axis.
    """

    camera: CameraTable
    pixels: float
    rectified: bool = True
    binning: int = 1
    least: int = 1
    taken: tuple[str, ...] = ()
    slices: int | None = None
    um_per_slice: float | None = None
    voxels: int | None = None


def read_microscope_file(
    path: PathLike,
    *,
    binning: int | None = None,
    pixels: int | None = None,
    rectified: bool = True,
) -> MicroscopeFile:
    """Read the parameters of a light-field microscope."""
    path = Path(path)
    content = read_toml(path, f"file {path} of a microscope; {_PRINTED}")
    refuse_fourier(content, path)
    if "camera" in content:
        _check_not_both(content, path)
        camera = validated(_CameraAlone, content, path).camera
        if camera.kind != "microscope":
            raise FormatError(
                f"{path} is of kind {camera.kind!r}, not 'microscope': {what_takes(camera.kind)}."
            )
        return replace(
            _simulable(camera, binning, pixels, rectified, path),
            taken=_taken(camera, "medium_index", "tube_lens_mm"),
        )
    if not KnownTable.model_fields.keys() & content.keys():
        raise FormatError(f"{path} has neither [camera] nor the names of LFAnalyze; {_PRINTED}.")
    known = validated(KnownTable, content, path)
    camera = known.camera()
    return replace(
        _simulable(camera, binning, pixels or known.pixels_per_lenslet, rectified, path),
        taken=_taken(known, "tubelens_focal_length"),
        slices=known.num_slices,
        um_per_slice=known.um_per_slice,
        voxels=known.supersample,
    )


def _check_not_both(content: dict[str, Any], path: Path) -> None:
    """Refuse flat names beside ``[camera]``."""
    stray = next((key for key in content if key in KnownTable.model_fields), None)
    if stray is not None:
        raise FormatError(
            f"{path} has {stray} beside [camera]: give all in [camera], or all by the flat names, "
            "among which a cover glass is cover = { thickness_um = 150 }."
        )


def _taken(table: Table, *keys: str) -> tuple[str, ...]:
    """Of these keys those that the file leaves out, in sentences."""
    meaning = {
        "medium_index": "air; water is 1.33",
        "tube_lens_mm": "no point image depends on it",
        "tubelens_focal_length": "mm; no point image depends on it",
    }
    return tuple(
        f"{key} is not given: {getattr(table, key):g} is taken ({meaning[key]})."
        for key in keys
        if key not in table.model_fields_set
    )


def _simulable(
    camera: CameraTable, binning: int | None, pixels: int | None, rectified: bool, path: Path
) -> MicroscopeFile:
    """With a whole number of pixels a lenslet, in parts."""
    across, array = camera.pixels_across, camera.microlenses
    rectified &= array.lattice == "square" and len(array.focal_length_mm) == 1
    if not rectified:
        return _unrectified(camera, binning, pixels, path)
    if pixels is None:
        pixels = whole_pixels(across)
    if not MIN_PIXELS_PER_PITCH * across <= pixels <= PIXELS.high:
        raise FormatError(
            f"{path} has {across:.5g} pixels a lenslet, and frames of {pixels} would step over "
            f"light or are none: give {math.ceil(MIN_PIXELS_PER_PITCH * across)} to "
            f"{PIXELS.high:g}, or leave the number out."
        )
    size = array.pitch_um / pixels
    least = math.floor(size / _coarsest(camera)) + 1
    lenslet = (array.diameter_um or array.pitch_um, 1e3 * array.focal_length_mm[0])
    binning = binning or max(
        least,
        suitable_binning(
            camera.na or 0, camera.magnification or 1, camera.wavelength_nm / 1e3, *lenslet, size
        ),
    )
    fine = camera.model_copy(update={"pixels_per_lenslet": float(pixels * binning)})
    return MicroscopeFile(fine, across, rectified, binning, least)


def _unrectified(
    camera: CameraTable, binning: int | None, pixels: int | None, path: Path
) -> MicroscopeFile:
    """With finer pixels, in parts, for frames as they are."""
    if pixels is not None:
        raise FormatError(
            f"{path}: pixels a lenslet are those of rectified frames, and these are not: leave "
            "them out."
        )
    pixels = math.ceil(round(FINER * camera.pixels_across, 6))
    least = math.floor(camera.microlenses.pitch_um / (_coarsest(camera) * pixels)) + 1
    binning = binning or max(least, PARTS)
    fine = camera.model_copy(update={"pixels_per_lenslet": float(pixels * binning)})
    return MicroscopeFile(fine, camera.pixels_across, False, binning, least)


def whole_pixels(across: float) -> int:
    """Pixels a lenslet of rectified frames: the nearest number within a tenth, else the next."""
    nearest = round(across)
    return nearest if abs(across - nearest) <= NEAR else math.ceil(across)


def _coarsest(camera: CameraTable) -> float:
    """Pixels below this size, in um, sample the light: see `check_sampling`."""
    array = camera.microlenses
    slope = (camera.na or 0) / (camera.magnification or 1)
    slope += (array.diameter_um or array.pitch_um) / (2e3 * min(array.focal_length_mm))
    return camera.wavelength_nm / (2e3 * slope)
