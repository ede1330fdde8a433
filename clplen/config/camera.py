"""Tables ``[camera]``, with its sub-tables, and ``[sensor]`` of a camera file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.camera_aberrations import NONE, Aberrations, LensletScatter
from clplen.cameras.optics.color_filters import ORDERS, ColorFilterArray
from clplen.cameras.optics.lenslet_camera import PITCH_TOLERANCE
from clplen.cameras.optics.objective import APODISATION, CoverGlass
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.standard_camera import Plenoptic1
from clplen.checks import is_finite
from clplen.compute.device import Device
from clplen.config.tables import (
    Count,
    Finite,
    NotNegative,
    Positive,
    Seed,
    Switch,
    Table,
    listed,
    of,
    twice,
)
from clplen.lightfield.raw.raw_image import MAX_PRNU, Sensor
from clplen.wave.elements.lenslets import MicrolensArray

Pair = Annotated[tuple[Finite, Finite], of(2, "two numbers, [along Y, along X]")]


def _indices(value: object) -> object:
    """Convert the keys of a TOML table to Noll's indices."""
    if not isinstance(value, dict):
        raise ValueError("must be a table of Noll's indices, such as { 5 = 0.5 }")
    bad = [key for key in value if not (str(key).isdecimal() and int(key) >= 1)]
    if bad:
        raise ValueError(f"must have Noll's indices, 1 or more, as keys, not {bad[0]!r}")
    terms = {int(key): number for key, number in value.items()}
    if len(terms) < len(value):
        raise ValueError(f"must not repeat an index, has {', '.join(map(str, value))}")
    return terms


def pupil_of(terms: dict[int, float] | None) -> PupilAberration | None:
    """Return the aberration of terms in nanometres; None without terms."""
    return PupilAberration({j: c / 1e9 for j, c in terms.items()}) if terms else None


def _pupil_indices(value: object) -> object:
    """Convert the keys of a TOML table to Noll's indices; reject the piston."""
    terms = _indices(value)
    if isinstance(terms, dict) and 1 in terms:
        raise ValueError("has term 1, a piston, which has no effect on images: start with 2")
    return terms


PupilTerms = Annotated[dict[int, Finite], BeforeValidator(_pupil_indices)]


class AberrationsTable(Table):
    """``[camera.aberrations]``: aberrations of main lens and lenslets, scatter and tilt."""

    main_lens_waves: Annotated[dict[int, Finite], BeforeValidator(_indices)] = Field({})
    main_lens_field_waves_per_mm: Annotated[dict[int, Pair], BeforeValidator(_indices)] = Field({})
    lenslets_waves: Annotated[dict[int, Finite], BeforeValidator(_indices)] = Field({})
    lenslet_circle_um: Positive | None = None
    focal_length_scatter: Annotated[float, Field(ge=0, le=0.2, strict=True)] = 0.0
    tilt_scatter_mrad: NotNegative = 0.0
    position_scatter_um: NotNegative = 0.0
    scatter_seed: Seed = 0
    sensor_shift_um: Finite = 0.0
    sensor_tilt_mrad: Pair = (0.0, 0.0)

    def build(self, wavelength: float) -> Aberrations:
        """Return the aberrations in SI units, for a wavelength in metres."""
        values = self.in_si("main_lens_field_waves_per_mm")
        field = {
            j: (y * wavelength * 1e3, x * wavelength * 1e3)
            for j, (y, x) in self.main_lens_field_waves_per_mm.items()
        }
        return Aberrations(
            main_lens={j: c * wavelength for j, c in self.main_lens_waves.items()},
            main_lens_field=field,
            lenslets={j: c * wavelength for j, c in self.lenslets_waves.items()},
            lenslet_circle=values["lenslet_circle"],
            scatter=LensletScatter(
                self.focal_length_scatter,
                values["tilt_scatter"],
                values["position_scatter"],
                self.scatter_seed,
            ),
            sensor_shift=values["sensor_shift"],
            sensor_tilt=values["sensor_tilt"],
        )


# Keys that are valid for a single kind of camera, required keys, and keys of a main lens.
KEYS = {
    "plenoptic1": ("field_lens",),
    "plenoptic2": ("m", "a_mm", "match"),
    "microscope": (
        "magnification",
        "na",
        "medium_index",
        "tube_lens_mm",
        "cover",
        "apodisation",
        "pupil_nm",
    ),
}
NEEDED = {
    "plenoptic1": ("focal_length_mm",),
    "plenoptic2": ("focal_length_mm",),
    "microscope": ("magnification", "na"),
}
MAIN_LENS_KEYS = (
    "focal_length_mm", "object_distance_mm", "image_distance_mm", "aperture_diameter_mm",
    "lens_model",
)  # fmt: skip


class MicrolensTable(Table):
    """``[camera.microlenses]``: the microlens array."""

    pitch_um: Positive
    focal_length_mm: Annotated[list[Positive], Field(min_length=1), BeforeValidator(listed)]
    count: Annotated[
        tuple[Count, Count], of(2, "one number or [rows, columns]"), BeforeValidator(twice)
    ]
    lattice: Literal["square", "hexagonal"] = "square"
    fill: Literal["circular", "square", "full"] = "circular"
    diameter_um: Positive | None = None
    offset_um: Annotated[tuple[Finite, Finite], of(2, "two numbers, [y, x]")] = (0.0, 0.0)
    rotation_deg: Finite = 0.0

    @model_validator(mode="after")
    def _fits_the_lattice(self) -> MicrolensTable:
        if self.fill == "square" and self.lattice != "square":
            raise ValueError("has fill = 'square', but its cells are hexagons: set fill = 'full'")
        return self

    def build(self) -> MicrolensArray:
        """Return the array in SI units."""
        fill = "circular" if self.fill == "circular" else "full"
        return MicrolensArray(**self.in_si() | {"fill": fill})


def _shares(rows: list[list[float]]) -> list[list[float]]:
    """Raise an error for an impossible matrix of crosstalk."""
    widths = {len(row) for row in rows}
    if len(widths) != 1 or len(rows) % 2 == 0 or min(widths) % 2 == 0:
        raise ValueError("must be an odd number of rows of equal, odd length")
    if min(map(min, rows)) < 0 or sum(map(sum, rows)) > 1 + 1e-9:
        raise ValueError("must be non-negative fractions with a sum of at most 1")
    return rows


def _filters(name: str) -> str:
    """Raise an error for an unknown colour-filter array."""
    if name not in FILTERS:
        raise ValueError(f"must be one of {', '.join(map(repr, FILTERS))}")
    return name


def _color_filters(name: str) -> ColorFilterArray:
    if name == "monochrome":
        return ColorFilterArray.monochrome()
    quad, _, order = name.rpartition(" ")
    return ColorFilterArray.quad_bayer(order) if quad else ColorFilterArray.bayer(order)


FILTERS = (*ORDERS, *(f"quad {order}" for order in ORDERS), "monochrome")


class PixelsTable(Table):
    """``[camera.pixels]``: the pixels of the sensor."""

    pitch_um: Positive | None = None
    shape: Annotated[tuple[Count, Count], of(2, "[rows, columns]")] | None = None
    fill_factor: Annotated[float, Field(ge=0, le=1, strict=True)] = 1.0
    offset_um: Annotated[tuple[Finite, Finite], of(2, "two numbers, [y, x]")] = (0.0, 0.0)
    rotation_deg: Finite = 0.0
    crosstalk: Annotated[list[list[Finite]], AfterValidator(_shares)] | None = None
    filters: Annotated[str, AfterValidator(_filters)] | None = None

    def build(self) -> PixelArray:
        """Return the pixels in SI units."""
        kernel = None if self.crosstalk is None else tuple(map(tuple, self.crosstalk))
        filters = None if self.filters is None else _color_filters(self.filters)
        return PixelArray(**self.in_si() | {"crosstalk": kernel, "filters": filters})


class CoverTable(Table):
    """``[camera.cover]``: a cover glass other than that of the objective's design."""

    thickness_um: NotNegative
    index: Positive = 1.5255
    designed_thickness_um: NotNegative = 170.0
    designed_index: Positive = 1.5255

    def build(self) -> CoverGlass:
        """Return the cover glass in SI units."""
        return CoverGlass(**self.in_si())


class CameraTable(Table):
    """``[camera]``: the camera."""

    kind: Literal["plenoptic1", "plenoptic2", "microscope"] = "plenoptic1"
    focal_length_mm: Positive | None = None
    wavelength_nm: Positive
    pixels_per_lenslet: Positive | None = None
    microlenses: MicrolensTable
    pixels: PixelsTable | None = None
    object_distance_mm: Positive | None = None
    image_distance_mm: Positive | None = None
    aperture_diameter_mm: Positive | None = None
    field_lens: Switch = False
    m: Finite | None = None
    a_mm: Finite | None = None
    match: Literal["pupil", "cone"] = "pupil"
    aberrations: AberrationsTable | None = None
    lens_model: Literal["auto", "thin", "corrected"] = "auto"
    magnification: Positive | None = None
    na: Positive | None = None
    medium_index: Positive = 1.0
    tube_lens_mm: Positive = 200.0
    cover: CoverTable | None = None
    apodisation: Annotated[float, Field(ge=-1, le=1, strict=True)] = APODISATION
    pupil_nm: PupilTerms | None = None

    @model_validator(mode="after")
    def _keys_of_its_kind(self) -> CameraTable:
        for kind, keys in KEYS.items():
            stray = [key for key in keys if key in self.model_fields_set]
            if stray and self.kind != kind:
                raise ValueError(f"has {stray[0]}, which applies to kind = {kind!r} only")
        for key in NEEDED[self.kind]:
            if getattr(self, key) is None:
                raise ValueError(f"needs {key} for kind = {self.kind!r}")
        without = MAIN_LENS_KEYS if self.kind == "microscope" else ()
        stray = [key for key in without if key in self.model_fields_set]
        if stray:
            raise ValueError(f"has {stray[0]}, which does not apply to kind = 'microscope'")
        if self.kind == "plenoptic2" and (self.m is None) == (self.a_mm is None):
            count = "neither" if self.m is None else "both"
            raise ValueError(f"needs either m or a_mm for kind = 'plenoptic2', has {count}")
        if (
            self.kind not in ("plenoptic2", "microscope")
            and len(self.microlenses.focal_length_mm) > 1
        ):
            raise ValueError(
                "has microlenses of several focal lengths, which need kind = 'plenoptic2'"
            )
        return self

    @model_validator(mode="after")
    def _pixels_of_one_size(self) -> CameraTable:
        count = self.pixels_per_lenslet
        pitch = None if self.pixels is None else self.pixels.pitch_um
        if count is None and pitch is None:
            raise ValueError("needs pixels_per_lenslet or pixels.pitch_um")
        if count is not None and pitch is not None:
            across = self.microlenses.pitch_um / pitch
            if abs(count - across) > PITCH_TOLERANCE * across:
                raise ValueError(
                    f"has pixels_per_lenslet = {count:g}, but pixels.pitch_um = {pitch:g} gives "
                    f"{across:.6g} for lenslets of {self.microlenses.pitch_um:g} um: leave one out"
                )
        return self

    @property
    def pixels_across(self) -> float:
        """Number of pixels per lenslet, from the number or the pitch."""
        if self.pixels_per_lenslet is not None:
            return self.pixels_per_lenslet
        assert self.pixels is not None
        assert self.pixels.pitch_um is not None
        return self.microlenses.pitch_um / self.pixels.pitch_um

    def build(self, device: Device) -> Plenoptic1 | Plenoptic2 | Microscope:
        """Return the camera in SI units on a device."""
        wavelength = self.wavelength_nm / 1e9
        shared: dict[str, Any] = {
            "mla": self.microlenses.build(),
            "wavelength": wavelength,
            "device": device,
            "pixels": self.pixels.build() if self.pixels else None,
        }
        if self.kind == "microscope":
            assert self.magnification is not None
            assert self.na is not None
            return PlenopticCamera.microscope(
                magnification=self.magnification,
                na=self.na,
                medium_index=self.medium_index,
                tube_lens=self.tube_lens_mm / 1e3,
                cover=self.cover.build() if self.cover else None,
                apodisation=self.apodisation,
                pupil=pupil_of(self.pupil_nm),
                pixels_per_lenslet=self.pixels_across,
                **shared,
            )
        values = self.in_si()
        shared |= {name: values[name] for name in _PLENOPTIC_ARGUMENTS}
        shared["aberrations"] = self.aberrations.build(wavelength) if self.aberrations else NONE
        if self.kind == "plenoptic1":
            return PlenopticCamera.type1(field_lens=self.field_lens, **shared)
        return PlenopticCamera.type2(m=self.m, a=values["a"], match=self.match, **shared)


_PLENOPTIC_ARGUMENTS = (
    "focal_length", "object_distance", "image_distance", "aperture_diameter", "pixels_per_lenslet",
    "lens_model",
)  # fmt: skip


def _gain(gain: Any) -> Any:
    """Raise an error unless the gain is a positive number or a table of numbers."""
    values = list(gain.values()) if isinstance(gain, dict) else [gain]
    if not values or not all(is_finite(value) and value > 0 for value in values):
        raise ValueError(
            "must be a number above 0, or a table such as { R = 2.0, G = 1.0, B = 1.6 }"
        )
    return gain


class SensorTable(Table):
    """``[sensor]``: exposure, noise and quantisation."""

    exposure_electrons: Positive | None = None
    shot_noise: Switch = False
    read_noise_electrons: NotNegative = 0.0
    bit_depth: Annotated[int, Field(ge=1, le=24, strict=True)] | None = None
    full_well_electrons: Positive | None = None
    seed: Seed = 0
    prnu: Annotated[float, Field(ge=0, le=MAX_PRNU, strict=True)] = 0.0
    dark_current_electrons_per_s: NotNegative = 0.0
    exposure_time_s: NotNegative = 0.0
    black_level: NotNegative = 0.0
    white_level: Positive | None = None
    gain: Annotated[Any, AfterValidator(_gain)] = 1.0

    def build(self) -> Sensor:
        """Return the sensor."""
        dark = self.dark_current_electrons_per_s
        return Sensor(**self.in_si("dark_current_electrons_per_s"), dark_current=dark)
