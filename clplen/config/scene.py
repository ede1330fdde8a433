"""Tables ``[scene]`` and ``[coherence]`` of a camera file."""

from __future__ import annotations

import logging
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources
from clplen.config.tables import (
    Count,
    File,
    Finite,
    NotNegative,
    Positive,
    Seed,
    Switch,
    Table,
    listed,
    of,
    twice,
    value_of,
)
from clplen.io import read_picture
from clplen.units import metres
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.extended_source import ExtendedSource
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.coherence.spatial_models import IncoherentLight, SpatialModel
from clplen.wave.spectrum.spectral_distribution import SpectralDistribution
from clplen.wave.spectrum.spectrum import Spectrum

GREY = (0.2126, 0.7152, 0.0722)  # R, G, B: luminance (Rec. ITU-R BT.709)
POINT_KEYS = ("diameter_um", "power")

Values = np.ndarray[Any, Any]
logger = logging.getLogger(__name__)


class PictureTable(Table):
    """``[[scene.pictures]]``: a flat picture."""

    file: File
    width_mm: Positive
    z_mm: Finite = 0.0
    mode: Literal["emission", "transmission"] = "emission"
    srgb: Switch = False
    opacity_file: File | None = None

    def build(self) -> PicturePlane:
        """Return the picture in grey and linear light, in SI units."""
        stored = read_picture(self.file)
        try:
            plane = PicturePlane(
                _grey(_linear(stored, self.srgb)),
                self.width_mm / 1e3,
                self.z_mm / 1e3,
                mode=self.mode,
                opacity=self._opacity(),
            )
        except ValueError as error:
            raise ValueError(f"{self.file}: {error}") from error
        weights = " + ".join(f"{w:g} {c}" for w, c in zip(GREY, "RGB", strict=True))
        logger.info(
            "read %s: %d x %d samples (y x x) of %s, %s, mode %s",
            self.file,
            *plane.image.shape[:2],
            metres(plane.pitch),
            "grey" if stored.ndim == 2 else f"colours as {weights}",
            self.mode,
        )
        return plane

    def _opacity(self) -> Values | None:
        """Read the opacity of the samples, 1 for white."""
        if self.opacity_file is None:
            return None
        return _grey(_linear(read_picture(self.opacity_file), False))


Point = Annotated[tuple[Finite, Finite, Finite], of(3, "three numbers, [x, y, z]")]


class SceneTable(Table):
    """``[scene]``: point sources and pictures."""

    points_mm: Annotated[list[Point], Field(min_length=1)] | None = None
    diameter_um: NotNegative = 0.0
    power: Annotated[list[Finite], BeforeValidator(listed)] = Field(default=[1.0])
    pictures: list[PictureTable] = Field(default=[])

    @model_validator(mode="after")
    def _not_empty(self) -> SceneTable:
        if self.points_mm is not None:
            return self
        stray = [key for key in POINT_KEYS if key in self.model_fields_set]
        if stray:
            raise ValueError(f"has {stray[0]}, which needs points_mm")
        if not self.pictures:
            raise ValueError("is empty: give points_mm or [[scene.pictures]]")
        return self

    def slides(self) -> list[int]:
        """Return the indices of the pictures that are slides."""
        return [i for i, picture in enumerate(self.pictures) if picture.mode == "transmission"]

    def build(self) -> list[PointSources | PicturePlane]:
        """Return the point sources, if any, and the pictures in SI units."""
        parts: list[PointSources | PicturePlane] = []
        if self.points_mm is not None:
            positions = [tuple(value / 1e3 for value in point) for point in self.points_mm]
            power = self.power if len(self.power) > 1 else self.power[0]
            parts.append(PointSources(positions, diameter=self.diameter_um / 1e6, power=power))
        for i, picture in enumerate(self.pictures):
            with value_of(f"scene.pictures.{i}.file"):
                parts.append(picture.build())
        return parts


def _linear(values: Values, srgb: bool) -> Values:
    """Convert stored values to linear light, float64; sRGB by IEC 61966-2-1 (1999), eqs 5 and 6.

    Integers are divided by the maximum of their type, or by 1 for one-bit pictures; floats stay.
    """
    if srgb and values.dtype != np.uint8:
        raise ValueError(f"srgb = true needs 8-bit values, got {values.dtype}: leave it out.")
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    full = 1 if values.max() <= 1 else np.iinfo(values.dtype).max
    share = values / full
    if not srgb:
        return share
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _grey(values: Values) -> Values:
    """Return the luminance of linear colours, at most the maximum of the three."""
    if values.ndim == 2:
        return values
    return np.minimum(values @ np.array(GREY), values.max(axis=2))


# Keys that are valid for a single spatial model, and keys that a model requires.
KEYS = {
    "mask": ("cell_um", "kernel", "kind"),
    "source": ("source_size_mm", "source_distance_mm"),
}
NEEDED = {"mask": ("cell_um",), "source": ("source_size_mm", "source_distance_mm")}
SPECTRA = ("spectrum", "fwhm_nm", "spectrum_file", "lines_nm")


class CoherenceTable(Table):
    """``[coherence]``: spatial coherence and spectrum of the light."""

    spatial: Literal["coherent", "incoherent", "mask", "source"] = "coherent"
    cell_um: (
        Annotated[tuple[Positive, Positive], of(2, "one number or [y, x]"), BeforeValidator(twice)]
        | None
    ) = None
    kernel: Literal["square", "gaussian"] = "square"
    kind: Literal["field", "phase"] = "field"
    source_size_mm: Positive | None = None
    source_distance_mm: Positive | None = None
    spectrum: Literal["white-led", "mercury", "A", "D65", "E"] | None = None
    fwhm_nm: Positive | None = None
    spectrum_file: File | None = None
    lines_nm: Annotated[list[Positive], Field(min_length=1), BeforeValidator(listed)] | None = None
    line_powers: Annotated[list[NotNegative], BeforeValidator(listed)] | None = None
    wavelengths: Count | None = None
    seed: Seed = 0
    snapshots: Count | None = None
    rtol: Positive | None = None
    koehler: Switch = True

    @model_validator(mode="after")
    def _one_spatial_model(self) -> CoherenceTable:
        for spatial, keys in KEYS.items():
            stray = [key for key in keys if key in self.model_fields_set]
            if stray and self.spatial != spatial:
                raise ValueError(f"has {stray[0]}, which applies to spatial = {spatial!r} only")
        missing = [key for key in NEEDED.get(self.spatial, ()) if getattr(self, key) is None]
        if missing:
            raise ValueError(f"needs {' and '.join(missing)} for spatial = {self.spatial!r}")
        stray = [key for key in ("snapshots", "rtol") if key in self.model_fields_set]
        if stray and not self.is_random:
            raise ValueError(
                f"has {stray[0]}, but all snapshots of a plane wave are equal: leave it out, or "
                "set spatial"
            )
        return self

    @model_validator(mode="after")
    def _one_spectrum(self) -> CoherenceTable:
        spectra = [key for key in SPECTRA if getattr(self, key) is not None]
        if len(spectra) > 1:
            raise ValueError(f"has {' and '.join(spectra)}, but needs a single spectrum")
        sampled = self.spectrum != "mercury" and self.lines_nm is None
        if self.wavelengths is not None and not (spectra and sampled):
            raise ValueError(
                "has wavelengths, which needs fwhm_nm, spectrum_file or a smooth spectrum"
            )
        if self.line_powers is not None:
            lines = 0 if self.lines_nm is None else len(self.lines_nm)
            if len(self.line_powers) != lines:
                raise ValueError(
                    f"must have as many line_powers as lines_nm, {lines}, got "
                    f"{len(self.line_powers)}"
                )
        return self

    @property
    def is_random(self) -> bool:
        """Flag that the light is a mean over random snapshots."""
        return self.spatial != "coherent"

    def of_slides(self) -> list[str]:
        """Return the keys in use that apply to slides only."""
        return ["spatial"] * self.is_random + ["koehler"] * ("koehler" in self.model_fields_set)

    def build(self, wavelength: float) -> Coherence:
        """Return the light in SI units."""
        return Coherence(
            self._spatial(),
            self._spectrum(wavelength),
            wavelengths=self.wavelengths,
            seed=self.seed,
        )

    def _spatial(self) -> SpatialModel | None:
        if self.cell_um is not None:
            cell = (self.cell_um[0] / 1e6, self.cell_um[1] / 1e6)
            return RandomPhaseMask(cell, kernel=self.kernel, kind=self.kind)
        if self.source_size_mm is not None and self.source_distance_mm is not None:
            return ExtendedSource(self.source_size_mm / 1e3, self.source_distance_mm / 1e3)
        return IncoherentLight() if self.spatial == "incoherent" else None

    def _spectrum(self, wavelength: float) -> Spectrum | None:
        if self.spectrum in ("A", "D65", "E"):
            return SpectralDistribution.illuminant(self.spectrum).spectrum
        if self.spectrum is not None:
            return Spectrum.white_led() if self.spectrum == "white-led" else Spectrum.mercury()
        if self.fwhm_nm is not None:
            with value_of("coherence.fwhm_nm"):
                return Spectrum.gaussian(wavelength, self.fwhm_nm / 1e9)
        if self.spectrum_file is not None:
            with value_of("coherence.spectrum_file"):
                return Spectrum.read(self.spectrum_file)
        if self.lines_nm is not None:
            powers = self.line_powers or [1.0] * len(self.lines_nm)
            with value_of("coherence.lines_nm"):
                return Spectrum.lines([value / 1e9 for value in self.lines_nm], powers)
        return None
