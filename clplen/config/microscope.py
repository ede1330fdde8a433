"""Files of a light-field microscope: ``[camera]`` of a camera file, or the names of LFAnalyze.

LFAnalyze and napari-LF know an instrument by flat names: micrometres for the array and the sensor,
millimetres for the tube lens, nanometres for the wavelength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from clplen.cameras.objective import APODISATION
from clplen.config.camera import CameraTable, SensorTable
from clplen.config.light import CoherenceTable
from clplen.config.reading import read_toml, validated
from clplen.config.scene import SceneTable
from clplen.config.tables import Count, Positive, Table
from clplen.errors import FormatError
from clplen.files import PathLike

_COUNT = 35  # lenslets of the camera that is built: point images do not depend on it


class KnownTable(Table):
    """A microscope by the names of LFAnalyze; the whole file."""

    magnification: Positive
    na: Positive
    medium_index: Positive = 1.0
    wavelength: Positive
    tubelens_focal_length: Positive = 200.0
    ulens_pitch: Positive
    ulens_focal_length: Positive
    pixel_size: Positive
    apodisation: Annotated[float, Field(ge=-1, le=1, strict=True)] = APODISATION
    num_slices: Count | None = None
    um_per_slice: Positive | None = None
    supersample: Count | None = None

    def camera(self) -> CameraTable:
        """The same as ``[camera]``."""
        lenslets = {
            "pitch_um": self.ulens_pitch,
            "focal_length_mm": self.ulens_focal_length / 1e3,
            "count": _COUNT,
            "fill": "full",
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


@dataclass(frozen=True)
class MicroscopeFile:
    """What a file says of a microscope.

    Attributes
    ----------
    camera : CameraTable
        With a whole number of pixels a lenslet, ``binning`` times those of the sensor.
    pixels : float
        A lenslet, as the file has them: frames are rectified to the next whole number.
    binning : int
        Of `point_images`.
    slices : int or None
    um_per_slice : float or None
    voxels : int or None
        Of a lenslet, along an axis.
    """

    camera: CameraTable
    pixels: float
    binning: int = 1
    slices: int | None = None
    um_per_slice: float | None = None
    voxels: int | None = None


def read_microscope_file(path: PathLike, *, binning: int | None = None) -> MicroscopeFile:
    """Read the parameters of a light-field microscope.

    Parameters
    ----------
    path : path-like
        TOML: a camera file with ``kind = "microscope"``, whose scene may be missing, or the names
        magnification, na, medium_index, wavelength (nm), tubelens_focal_length (mm), ulens_pitch,
        ulens_focal_length, pixel_size (um), num_slices, um_per_slice, supersample; apodisation.
    binning : int, optional
        Parts of a pixel of the sensor, along an axis, that light is simulated on; default the
        fewest that sample it.

    Returns
    -------
    MicroscopeFile

    Raises
    ------
    FormatError
        If there is no such file, it is not TOML or of another camera, or a key is unknown, missing
        or out of range.
    """
    path = Path(path)
    content = read_toml(path, f"file {path} of a microscope")
    if "camera" in content:
        camera = validated(_CameraAlone, content, path).camera
        if camera.kind != "microscope":
            raise FormatError(f"{path} is of kind {camera.kind!r}, not 'microscope'.")
        return _simulable(camera, binning)
    known = validated(KnownTable, content, path)
    camera = known.camera()
    return replace(
        _simulable(camera, binning),
        slices=known.num_slices,
        um_per_slice=known.um_per_slice,
        voxels=known.supersample,
    )


def _simulable(camera: CameraTable, binning: int | None) -> MicroscopeFile:
    """With the next whole number of pixels a lenslet, in parts; round-off is no pixel."""
    pixels = math.ceil(round(camera.pixels_per_lenslet, 6))
    if binning is None:
        binning = math.floor(camera.microlenses.pitch_um / (_coarsest(camera) * pixels)) + 1
    fine = camera.model_copy(update={"pixels_per_lenslet": float(pixels * binning)})
    return MicroscopeFile(fine, camera.pixels_per_lenslet, binning)


def _coarsest(camera: CameraTable) -> float:
    """Pixels below this size, in um, sample the light: see `check_sampling`."""
    array = camera.microlenses
    slope = (camera.na or 0) / (camera.magnification or 1)
    slope += (array.diameter_um or array.pitch_um) / (2e3 * array.focal_length_mm[0])
    return camera.wavelength_nm / (2e3 * slope)
