"""Files of a light-field microscope: ``[camera]`` of a camera file, or the names of LFAnalyze.

LFAnalyze and napari-LF describe an instrument without tables: micrometres for the array and the
sensor, millimetres for the tube lens, nanometres for the wavelength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from clplen.cameras.optics.objective import APODISATION
from clplen.config.camera import CameraTable, CoverTable, PupilTerms, SensorTable
from clplen.config.kinds import refuse_fourier, support_of
from clplen.config.scene import CoherenceTable, SceneTable
from clplen.config.tables import Count, Positive, Table, read_toml, validated
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.microscopy.frames.prepare import MIN_PIXELS_PER_PITCH
from clplen.microscopy.model.binning import suitable_binning

_POWERS = (3, -3, 6, -6, 9, -9)  # powers of 10 between m, mm, um and nm


@dataclass(frozen=True)
class Range:
    """Range of values of real instruments, both ends included."""

    low: float
    high: float
    unit: str = ""

    def check(self, value: float) -> float:
        """Return the value; raise an error outside the range."""
        if self.low <= value <= self.high:
            return value
        unit = f" {self.unit}" if self.unit else ""
        message = f"must be {self.low:g} to {self.high:g}{unit}"
        for power in _POWERS if self.unit else ():
            guess = value * 10.0**power
            if self.low <= guess <= self.high:
                message += f": did you mean {guess:.6g}?"
                break
        raise ValueError(message)


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
PIXELS = Range(3, 1000)  # per lenslet, along an axis
F_NUMBER = Range(0.5, 1000)  # of the lenslets
MAX_DEVIATION = 0.1  # pixels: a lenslet this close to a whole number of pixels is rounded


# Pixels of point images per pixel of a frame that is not rectified, along an axis.
OVERSAMPLING = 1.5
MIN_PARTS = 2  # samples per such pixel, to integrate over the pixels of the frame
_COUNT = 35  # lenslets of the camera; point images do not depend on it
_PRINTED = "'clplen microscope psf --example' prints one"
_F_NUMBER = "the f-number of the lenslets, focal length over pitch, is {:.3g}; it"


class ObjectiveTable(Table):
    """Keys of the objective, shared by the tables of microscopes."""

    magnification: Annotated[Positive, AfterValidator(MAGNIFICATION.check)]
    na: Annotated[Positive, AfterValidator(NA.check)]
    apodisation: Annotated[float, Field(ge=-1, le=1, strict=True)] = APODISATION
    cover: CoverTable | None = None


class LFAnalyzeTable(ObjectiveTable):
    """File of a microscope with the names of LFAnalyze."""

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
    def _pixels_of_lenslets(self) -> LFAnalyzeTable:
        _in_range("the number of pixels per lenslet by pixel_size is {:.3g}; it",
                  self.ulens_pitch / self.pixel_size, PIXELS)  # fmt: skip
        _in_range(_F_NUMBER, self.ulens_focal_length / self.ulens_pitch, F_NUMBER)
        return self

    def camera(self) -> CameraTable:
        """Return the microscope as a table ``[camera]``."""
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


class _CameraOnly(Table):
    """Camera file with an optional scene."""

    camera: CameraTable
    scene: SceneTable | None = None
    coherence: CoherenceTable | None = None
    sensor: SensorTable | None = None

    @model_validator(mode="after")
    def _check_microscope(self) -> _CameraOnly:
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
            _in_range(f"camera.{key} is {{:g}}; it", value, limits)
        _in_range(_F_NUMBER, 1e3 * focal / array.pitch_um, F_NUMBER)
        return self


def _in_range(prefix: str, value: float, limits: Range) -> None:
    """Raise an error, which begins with ``prefix``, for a value outside its range."""
    try:
        limits.check(value)
    except ValueError as error:
        raise ValueError(f"{prefix.format(value)} {error}") from None


@dataclass(frozen=True)
class MicroscopeFile:
    """Content of a file of a microscope.

    The camera has a whole number of pixels per lenslet: ``binning`` (at least ``min_binning``)
    times the rectified frames, or `OVERSAMPLING` times frames that are not ``rectified``.
    ``pixels`` is the number in the file, ``assumptions`` are sentences about missing values, and
    ``voxels`` is the number of voxels per lenslet along an axis.
    """

    camera: CameraTable
    pixels: float
    rectified: bool = True
    binning: int = 1
    min_binning: int = 1
    assumptions: tuple[str, ...] = ()
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
        camera = validated(_CameraOnly, content, path).camera
        if camera.kind != "microscope":
            raise FormatError(
                f"{path} has kind = {camera.kind!r}, not 'microscope': {support_of(camera.kind)}."
            )
        return replace(
            _simulable(camera, binning, pixels, rectified, path),
            assumptions=_assumptions(camera, "medium_index", "tube_lens_mm"),
        )
    if not LFAnalyzeTable.model_fields.keys() & content.keys():
        raise FormatError(f"{path} has neither [camera] nor the names of LFAnalyze; {_PRINTED}.")
    table = validated(LFAnalyzeTable, content, path)
    camera = table.camera()
    return replace(
        _simulable(camera, binning, pixels or table.pixels_per_lenslet, rectified, path),
        assumptions=_assumptions(table, "tubelens_focal_length"),
        slices=table.num_slices,
        um_per_slice=table.um_per_slice,
        voxels=table.supersample,
    )


def _check_not_both(content: dict[str, Any], path: Path) -> None:
    """Raise an error for names of LFAnalyze beside ``[camera]``."""
    stray = next((key for key in content if key in LFAnalyzeTable.model_fields), None)
    if stray is not None:
        raise FormatError(
            f"{path} has {stray} beside [camera]: put all keys in [camera], or use the names of "
            "LFAnalyze only, with cover = { thickness_um = 150 } for a cover glass."
        )


def _assumptions(table: Table, *keys: str) -> tuple[str, ...]:
    """Return a sentence about the default of each key that the file leaves out."""
    meaning = {
        "medium_index": "air; water is 1.33",
        "tube_lens_mm": "without effect on point images",
        "tubelens_focal_length": "mm; without effect on point images",
    }
    return tuple(
        f"{key} is not given; the default is {getattr(table, key):g} ({meaning[key]})."
        for key in keys
        if key not in table.model_fields_set
    )


def _simulable(
    camera: CameraTable, binning: int | None, pixels: int | None, rectified: bool, path: Path
) -> MicroscopeFile:
    """Return a camera with a whole number of pixels per lenslet that samples the light."""
    across, array = camera.pixels_across, camera.microlenses
    rectified &= array.lattice == "square" and len(array.focal_length_mm) == 1
    if not rectified:
        return _unrectified(camera, binning, pixels, path)
    if pixels is None:
        pixels = whole_pixels(across)
    if not MIN_PIXELS_PER_PITCH * across <= pixels <= PIXELS.high:
        raise FormatError(
            f"{path}: the number of pixels per lenslet must be "
            f"{math.ceil(MIN_PIXELS_PER_PITCH * across)} to {PIXELS.high:g} for frames "
            f"with {across:.5g}, got {pixels}: change it, or leave it out."
        )
    size = array.pitch_um / pixels
    min_binning = math.floor(size / _coarsest(camera)) + 1
    lenslet = (array.diameter_um or array.pitch_um, 1e3 * array.focal_length_mm[0])
    binning = binning or max(
        min_binning,
        suitable_binning(
            camera.na or 0, camera.magnification or 1, camera.wavelength_nm / 1e3, *lenslet, size
        ),
    )
    fine = camera.model_copy(update={"pixels_per_lenslet": float(pixels * binning)})
    return MicroscopeFile(fine, across, rectified, binning, min_binning)


def _unrectified(
    camera: CameraTable, binning: int | None, pixels: int | None, path: Path
) -> MicroscopeFile:
    """Return a camera with finer pixels for frames that are not rectified."""
    if pixels is not None:
        raise FormatError(
            f"{path}: the number of pixels per lenslet applies to rectified frames only: leave it "
            "out."
        )
    pixels = math.ceil(round(OVERSAMPLING * camera.pixels_across, 6))
    min_binning = math.floor(camera.microlenses.pitch_um / (_coarsest(camera) * pixels)) + 1
    binning = binning or max(min_binning, MIN_PARTS)
    fine = camera.model_copy(update={"pixels_per_lenslet": float(pixels * binning)})
    return MicroscopeFile(fine, camera.pixels_across, False, binning, min_binning)


def whole_pixels(across: float) -> int:
    """Round the number of pixels per lenslet to the nearest within 0.1, else up."""
    nearest = round(across)
    return nearest if abs(across - nearest) <= MAX_DEVIATION else math.ceil(across)


def _coarsest(camera: CameraTable) -> float:
    """Return the largest pixel size in um that samples the light; see `check_sampling`."""
    array = camera.microlenses
    slope = (camera.na or 0) / (camera.magnification or 1)
    slope += (array.diameter_um or array.pitch_um) / (2e3 * min(array.focal_length_mm))
    return camera.wavelength_nm / (2e3 * slope)
