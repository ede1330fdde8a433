"""What HDF5 and Zarr keep of a light field beside its samples: names and parameters.

Attributes of the array ``lightfield``: ``axes`` ("v:u:y:x" or "v:u:y:x:c"), ``spacing`` (signed dv,
du, dy, dx in metres), ``wavelength`` (metres), ``centre`` (v, u of the central view), ``decode``.
Beside it the array ``weights`` (V, U), the array ``positions`` (V, U, 2) of views that lie on no
grid, and the group ``camera`` with the parameters of the camera as attributes, in SI units, and the
OPD maps of its main lens as the group ``camera/opd`` (opd_arrays.py), where it has some.
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
BESIDE = ("weights", "positions")
CAMERA = "camera"
NAMES = ("axes", "spacing", "decode", "parametrisation")  # attributes that are read again
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
_APODISATION = "apodisation"  # files without it have that of a camera to which none is given
_PUPIL = "pupil"  # JSON: Noll's index to metres
_COVER = ("thickness", "index", "designed_thickness", "designed_index")
_OF_KIND = {
    "type1": (*_CAMERA, "field_lens"),
    "type2": (*_CAMERA, "m"),
    "microscope": _MICROSCOPE,
}
_KIND = {"standard": "type1", "focused": "type2", "microscope": "microscope"}  # as files say it
_ABERRATIONS = "aberrations"  # JSON, where there are any
_PIXELS = "pixels"  # JSON, where they integrate or have a place of their own
_LENS_MODEL = "lens_model"  # files without it have a thin lens
_SURFACES, _GAP = "mla_surface", "mla_gap"  # a list of JSON, a word; where lenslets are not thin
_LONGEST = 60000  # characters of an attribute: HDF5 holds 64 kB
_LENSLETS = 10**7  # that may scatter: some bytes for each are allocated
CAMERA_NAMES = (
    "kind",
    *dict.fromkeys(name for names in _OF_KIND.values() for name in names),
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
_WORDS = {"decode": ("calibrated", "naive"), "parametrisation": ("two-plane", "point-angle")}


def of_samples(lf: LightField) -> dict[str, Any]:
    """The attributes of the array of samples, as plain Python."""
    found: dict[str, Any] = {
        "axes": ":".join("vuyxc"[: len(lf.shape)]),
        "centre": [(lf.shape[0] - 1) / 2, (lf.shape[1] - 1) / 2],
        "decode": lf.decode,
    }
    if lf.parametrisation != "two-plane":
        found["parametrisation"] = lf.parametrisation
    if lf.spacing is not None:
        found["spacing"] = [float(step) for step in lf.spacing]
    if lf.camera is not None:
        found["wavelength"] = float(lf.camera.wavelength)
    return found


def arrays_beside(lf: LightField) -> dict[str, np.ndarray[Any, Any]]:
    """The arrays that lie beside the samples."""
    found = {name: getattr(lf, name) for name in BESIDE}
    return {name: array for name, array in found.items() if array is not None}


def of_camera(camera: Any) -> dict[str, Any] | None:
    """The attributes of the group of a camera, as plain Python; None without one to keep.

    ``mla_f`` is a list where the lenslets have several focal lengths.
    """
    is_known = isinstance(camera, PlenopticCamera)
    if not is_known:
        return None
    kind = _KIND[camera.kind]
    found = {name: getattr(camera, name) for name in _OF_KIND[kind]}
    mla, pixels = camera.mla, camera.pixels
    if pixels is not None:
        mla = pixels.unturned(mla)
        found[_PIXELS] = _pixels_text(pixels)
    found |= {f"mla_{name}": getattr(mla, name) for name in _ARRAY}
    if len(mla.focal_lengths) > 1:
        found["mla_f"] = mla.focal_lengths
    if mla.surface:
        found[_SURFACES] = json.dumps([one.to_json() for one in mla.surface])
    if mla.gap != "opaque":
        found[_GAP] = mla.gap
    if mla.map is not None:
        warn_caller(
            "Files keep no maps of lenslets: the camera in this one is without.", UserWarning
        )
    if kind == "microscope":
        found[_APODISATION] = camera.apodisation
        if camera.pupil is not None:
            found[_PUPIL] = json.dumps(camera.pupil.coefficients)
        if camera.cover is not None:
            found |= {f"cover_{name}": getattr(camera.cover, name) for name in _COVER}
    else:
        found[_LENS_MODEL] = camera.lens_model
        if camera.aberrations != NONE:
            found[_ABERRATIONS] = camera.aberrations.to_json()
    return {"kind": kind} | {name: plain(value) for name, value in found.items()}


def _pixels_text(pixels: PixelArray) -> str:
    text = pixels.to_json()
    if len(text) > _LONGEST:
        raise ValueError(
            f"The sensitivities of the colour filters take {len(text):,} characters, a file keeps "
            f"{_LONGEST:,}: give them at fewer wavelengths, such as every 5 nm."
        )
    return text


def plain(value: Any) -> Any:
    """An attribute as plain Python: numbers, words and tuples."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return tuple(value) if isinstance(value, list) else value


def axes_in(attributes: dict[str, Any]) -> str | None:
    """The axes that a file says, in the letters v, u, y, x, c."""
    axes = attributes.get("axes")
    return None if axes is None else "".join(str(axes).split(":"))


def spacing_in(attributes: dict[str, Any], path: Path) -> tuple[float, float, float, float] | None:
    """The signed spacing (dv, du, dy, dx) in metres that a file says; None without one."""
    spacing = attributes.get("spacing")
    if spacing is None:
        return None
    numbers = isinstance(spacing, tuple | list) and all(isinstance(n, int | float) for n in spacing)
    if not numbers or len(spacing) != 4:
        raise FormatError(
            f"{path}: spacing is (dv, du, dy, dx) in metres, none of them 0, not {spacing!r}."
        )
    dv, du, dy, dx = spacing
    return dv, du, dy, dx


def words_in(attributes: dict[str, Any], path: Path) -> dict[str, Any]:
    """How the light field was decoded from its raw image, and what its views are."""
    found = {name: str(attributes.get(name, known[0])) for name, known in _WORDS.items()}
    for name, word in found.items():
        if word not in _WORDS[name]:
            raise FormatError(
                f"{path}: the attribute {name!r} is {word!r}, not "
                f"{' or '.join(map(repr, _WORDS[name]))}."
            )
    return found


def read_camera(
    values: dict[str, Any], path: Path, device: Device, maps: OPDMaps | None = None
) -> Plenoptic1 | Plenoptic2 | Microscope | None:
    """The camera of a light field or raw image; None where it is of a kind unknown here."""
    kind = str(values.get("kind"))
    if kind not in _OF_KIND:
        return None
    try:
        mla = {name: values[f"mla_{name}"] for name in _ARRAY}
        camera = {name: values[name] for name in _OF_KIND[kind]}
        covered = f"cover_{_COVER[0]}" in values
        glass = {name: values[f"cover_{name}"] for name in _COVER} if covered else None
    except KeyError as error:
        raise FormatError(f"The camera in {path} lacks {error}.") from error
    pitch, focal_length = mla.pop("pitch"), mla.pop("f")
    try:
        surfaces = json.loads(str(values.get(_SURFACES, "[]")))
        mla["surface"] = [LensletSurface.from_json(str(one)) for one in surfaces]
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
            if not np.prod(mla["count"], dtype=np.float64) <= _LENSLETS:
                raise ValueError(f"{mla['count']} lenslets are more than {_LENSLETS:,}")
            camera[_ABERRATIONS] = Aberrations.from_json(
                str(values[_ABERRATIONS]), main_lens_opd=maps
            )
        camera[_LENS_MODEL] = str(values.get(_LENS_MODEL, "thin"))
        if kind == "type2":
            return PlenopticCamera.type2(**camera)
        return PlenopticCamera.type1(**camera)
    except (*UNREADABLE, ClplenError) as error:
        raise FormatError(f"The camera in {path} is none: {error}") from error
