"""The table ``[coherence]`` of a camera file: the light on slides, and the scene's spectrum."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from clplen.config.tables import (
    Count,
    File,
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
from clplen.wave.coherence import Coherence
from clplen.wave.extended import ExtendedSource
from clplen.wave.masks import RandomPhaseMask
from clplen.wave.spatial import IncoherentLight, SpatialModel
from clplen.wave.spectrum import Spectrum

# What says how coherent the light is, and the keys that only it has and needs.
KEYS = {
    "mask": ("cell_um", "kernel", "kind"),
    "source": ("source_size_mm", "source_distance_mm"),
}
NEEDED = {"mask": ("cell_um",), "source": ("source_size_mm", "source_distance_mm")}
SPECTRA = ("spectrum", "fwhm_nm", "spectrum_file", "lines_nm")


class CoherenceTable(Table):
    """``[coherence]``."""

    spatial: Literal["coherent", "incoherent", "mask", "source"] = "coherent"
    cell_um: (
        Annotated[tuple[Positive, Positive], of(2, "one number or [y, x]"), BeforeValidator(twice)]
        | None
    ) = None
    kernel: Literal["square", "gaussian"] = "square"
    kind: Literal["field", "phase"] = "field"
    source_size_mm: Positive | None = None
    source_distance_mm: Positive | None = None
    spectrum: Literal["white-led", "mercury"] | None = None
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
                raise ValueError(f"has {stray[0]}, which belongs to spatial = {spatial!r}")
        missing = [key for key in NEEDED.get(self.spatial, ()) if getattr(self, key) is None]
        if missing:
            raise ValueError(f"needs {' and '.join(missing)} for spatial = {self.spatial!r}")
        stray = [key for key in ("snapshots", "rtol") if key in self.model_fields_set]
        if stray and not self.is_random:
            raise ValueError(
                f"has {stray[0]}, but a plane wave is the same in every snapshot: leave it out, or "
                "set spatial"
            )
        return self

    @model_validator(mode="after")
    def _one_spectrum(self) -> CoherenceTable:
        given = [key for key in SPECTRA if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"has {' and '.join(given)}, two spectra: leave one out")
        sampled = self.spectrum != "mercury" and self.lines_nm is None
        if self.wavelengths is not None and not (given and sampled):
            raise ValueError(
                "has wavelengths, which belongs to fwhm_nm, spectrum_file or spectrum = 'white-led'"
            )
        if self.line_powers is not None:
            lines = 0 if self.lines_nm is None else len(self.lines_nm)
            if len(self.line_powers) != lines:
                raise ValueError(
                    f"has {len(self.line_powers)} line_powers for {lines} lines_nm: give one each"
                )
        return self

    @property
    def is_random(self) -> bool:
        """Whether the light is a mean over snapshots."""
        return self.spatial != "coherent"

    def of_slides(self) -> list[str]:
        """The keys that were given and make sense for slides only."""
        return ["spatial"] * self.is_random + ["koehler"] * ("koehler" in self.model_fields_set)

    def build(self, wavelength: float) -> Coherence:
        """The light, in SI units.

        Parameters
        ----------
        wavelength : float
            Of the camera in metres: the middle of a Gaussian spectrum.

        Returns
        -------
        Coherence

        Raises
        ------
        FormatError
            If a spectrum is out of range, or its file cannot be read; naming the key.
        """
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
