"""Attributes of a light field in HDF5 and Zarr: names and parameters.

Attributes of the array ``lightfield``: ``axes`` ("v:u:y:x" or "v:u:y:x:c"), ``spacing`` (signed dv,
du, dy, dx in metres), ``wavelength`` (metres), ``centre`` (v, u of the central view), ``decode``.
Further members are the array ``weights`` (V, U), the array ``positions`` (V, U, 2) of views off the
grid, and the group ``camera``. Its attributes are the parameters of the camera in SI units; its
subgroup ``camera/opd`` (opd_arrays.py) has the OPD maps of the main lens, if any.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.camera_aberrations import NONE, Aberrations
from clplen.cameras.optics.objective import APODISATION, CoverGlass
from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.errors import ClplenError, FormatError, warn_caller
from clplen.io.formats.untrusted import UNREADABLE
from clplen.lightfield.model.light_field import LightField
from clplen.wave.elements.lenslet_surface import LensletSurface
from clplen.wave.elements.lenslets import MicrolensArray

SAMPLES = "lightfield"
RAW = "raw"
COMPANIONS = ("weights", "positions")
CAMERA = "camera"
NAMES = ("axes", "spacing", "decode", "parametrisation")  # attributes restored on reading
_CAMERA = (
    "focal_length",
    "wavelength",
    "pixels_per_lenslet",
    "object_distance",
    "image_distance",
    "aperture_diameter",
)
_ARRAY = ("pitch", "f", "count", "lattice", "fill", "diameter", "offset", "rotation")
_MICROSCOPE = (
    "magnification",
    "na",
    "medium_index",
    "tube_lens",
    "wavelength",
    "pixels_per_lenslet",
)
_APODISATION = "apodisation"  # files without it get the default
_PUPIL = "pupil"  # JSON: Noll's index to metres
_COVER = ("thickness", "index", "designed_thickness", "designed_index")
_KIND_PARAMETERS = {
    "type1": (*_CAMERA, "field_lens"),
    "type2": (*_CAMERA, "m"),
    "microscope": _MICROSCOPE,
}
_KIND = {"standard": "type1", "focused": "type2", "microscope": "microscope"}  # names used in files
_ABERRATIONS = "aberrations"  # JSON; absent without aberrations
_PIXELS = "pixels"  # JSON; absent for point-sampling pixels on the grid
_LENS_MODEL = "lens_model"  # default: thin lens
_SURFACES, _GAP = "mla_surface", "mla_gap"  # JSON list, string; absent for thin lenslets
_MAX_ATTRIBUTE = 60000  # characters; HDF5 limits an attribute to 64 kB
_MAX_LENSLETS = 10**7  # lenslets with scatter; a few bytes are allocated for each
CAMERA_NAMES = (
    "kind",
    *dict.fromkeys(name for names in _KIND_PARAMETERS.values() for name in names),
    _ABERRATIONS,
    _PIXELS,
    _LENS_MODEL,
    _APODISATION,
    _PUPIL,
    *(f"mla_{name}" for name in _ARRAY),
    _SURFACES,
    _GAP,
    *(f"cover_{name}" for name in _COVER),
)
_CHOICES = {"decode": ("calibrated", "naive"), "parametrisation": ("two-plane", "point-angle")}


def sample_attributes(lf: LightField) -> dict[str, Any]:
    """Return the attributes of the array of samples, as plain Python."""
    attributes: dict[str, Any] = {
        "axes": ":".join("vuyxc"[: len(lf.shape)]),
        "centre": [(lf.shape[0] - 1) / 2, (lf.shape[1] - 1) / 2],
        "decode": lf.decode,
    }
    if lf.parametrisation != "two-plane":
        attributes["parametrisation"] = lf.parametrisation
    if lf.spacing is not None:
        attributes["spacing"] = [float(step) for step in lf.spacing]
    if lf.camera is not None:
        attributes["wavelength"] = float(lf.camera.wavelength)
    return attributes


def companion_arrays(lf: LightField) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays stored next to the samples."""
    arrays = {name: getattr(lf, name) for name in COMPANIONS}
    return {name: array for name, array in arrays.items() if array is not None}


def camera_attributes(camera: Any) -> dict[str, Any] | None:
    """Return the attributes of the group of a camera; None if the camera cannot be stored.

    ``mla_f`` is a list if the lenslets have several focal lengths.
    """
    is_supported = isinstance(camera, PlenopticCamera)
    if not is_supported:
        return None
    kind = _KIND[camera.kind]
    parameters = {name: getattr(camera, name) for name in _KIND_PARAMETERS[kind]}
    mla, pixels = camera.mla, camera.pixels
    if pixels is not None:
        mla = pixels.unturned(mla)
        parameters[_PIXELS] = _pixels_text(pixels)
    parameters |= {f"mla_{name}": getattr(mla, name) for name in _ARRAY}
    if len(mla.focal_lengths) > 1:
        parameters["mla_f"] = mla.focal_lengths
    if mla.surface:
        parameters[_SURFACES] = json.dumps([surface.to_json() for surface in mla.surface])
    if mla.gap != "opaque":
        parameters[_GAP] = mla.gap
    if mla.map is not None:
        warn_caller(
            "Files cannot store lenslet maps: the camera in this file has none.", UserWarning
        )
    if kind == "microscope":
        parameters[_APODISATION] = camera.apodisation
        if camera.pupil is not None:
            parameters[_PUPIL] = json.dumps(camera.pupil.coefficients)
        if camera.cover is not None:
            parameters |= {f"cover_{name}": getattr(camera.cover, name) for name in _COVER}
    else:
        parameters[_LENS_MODEL] = camera.lens_model
        if camera.aberrations != NONE:
            parameters[_ABERRATIONS] = camera.aberrations.to_json()
    return {"kind": kind} | {name: plain(value) for name, value in parameters.items()}


def _pixels_text(pixels: PixelArray) -> str:
    text = pixels.to_json()
    if len(text) > _MAX_ATTRIBUTE:
        raise ValueError(
            f"The sensitivities of the colour filters take {len(text):,} characters, but a file "
            f"stores at most {_MAX_ATTRIBUTE:,}: sample them at fewer wavelengths, such as every "
            "5 nm."
        )
    return text


def plain(value: Any) -> Any:
    """Return an attribute as plain Python: numbers, strings and tuples."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return tuple(value) if isinstance(value, list) else value


def axes_in(attributes: dict[str, Any]) -> str | None:
    """Return the axes stored in a file, in the letters v, u, y, x, c."""
    axes = attributes.get("axes")
    return None if axes is None else "".join(str(axes).split(":"))


def spacing_in(attributes: dict[str, Any], path: Path) -> tuple[float, float, float, float] | None:
    """Return the signed spacing (dv, du, dy, dx) stored in a file, in metres, or None."""
    spacing = attributes.get("spacing")
    if spacing is None:
        return None
    numbers = isinstance(spacing, tuple | list) and all(isinstance(n, int | float) for n in spacing)
    if not numbers or len(spacing) != 4:
        raise FormatError(
            f"{path}: spacing must be (dv, du, dy, dx) in metres, all nonzero, got {spacing!r}."
        )
    dv, du, dy, dx = spacing
    return dv, du, dy, dx


def choices_in(attributes: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the decode method and the parametrisation of a light field."""
    choices = {name: str(attributes.get(name, options[0])) for name, options in _CHOICES.items()}
    for name, choice in choices.items():
        if choice not in _CHOICES[name]:
            raise FormatError(
                f"{path}: the attribute {name!r} must be "
                f"{' or '.join(map(repr, _CHOICES[name]))}, got {choice!r}."
            )
    return choices


def read_camera(
    values: dict[str, Any], path: Path, device: Device, maps: OPDMaps | None = None
) -> Plenoptic1 | Plenoptic2 | Microscope | None:
    """Return the camera of a light field or raw image; None for an unknown kind."""
    kind = str(values.get("kind"))
    if kind not in _KIND_PARAMETERS:
        return None
    try:
        mla = {name: values[f"mla_{name}"] for name in _ARRAY}
        camera = {name: values[name] for name in _KIND_PARAMETERS[kind]}
        has_cover = f"cover_{_COVER[0]}" in values
        glass = {name: values[f"cover_{name}"] for name in _COVER} if has_cover else None
    except KeyError as error:
        raise FormatError(f"The camera in {path} has no parameter {error}.") from error
    pitch, focal_length = mla.pop("pitch"), mla.pop("f")
    try:
        surfaces = json.loads(str(values.get(_SURFACES, "[]")))
        mla["surface"] = [LensletSurface.from_json(str(surface)) for surface in surfaces]
        mla["gap"] = str(values.get(_GAP, "opaque"))
        camera |= {"mla": MicrolensArray(pitch, focal_length, **mla), "device": device}
        if _PIXELS in values:
            camera[_PIXELS] = PixelArray.from_json(str(values[_PIXELS]))
        if kind == "microscope":
            cover = None if glass is None else CoverGlass(**glass)
            camera[_APODISATION] = values.get(_APODISATION, APODISATION)
            if _PUPIL in values:
                terms = json.loads(str(values[_PUPIL]))
                camera[_PUPIL] = {int(j): float(c) for j, c in terms.items()}
            return PlenopticCamera.microscope(cover=cover, **camera)
        if _ABERRATIONS in values:
            if not np.prod(mla["count"], dtype=np.float64) <= _MAX_LENSLETS:
                raise ValueError(f"{mla['count']} lenslets are more than {_MAX_LENSLETS:,}")
            camera[_ABERRATIONS] = Aberrations.from_json(
                str(values[_ABERRATIONS]), main_lens_opd=maps
            )
        camera[_LENS_MODEL] = str(values.get(_LENS_MODEL, "thin"))
        if kind == "type2":
            return PlenopticCamera.type2(**camera)
        return PlenopticCamera.type1(**camera)
    except (*UNREADABLE, ClplenError) as error:
        raise FormatError(f"The camera in {path} is invalid: {error}") from error
