"""The table ``[camera.aberrations]`` of a camera file."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from clplen.cameras.optics.camera_aberrations import Aberrations, LensletScatter
from clplen.config.tables import Finite, NotNegative, Positive, Seed, Table, divided, of

Pair = Annotated[tuple[Finite, Finite], of(2, "two numbers, [along Y, along X]")]


def _indices(value: object) -> object:
    """Keys of a TOML table, which are words, as Noll's indices."""
    if not isinstance(value, dict):
        raise ValueError("must be a table of Noll's indices, such as { 5 = 0.5 }")
    bad = [key for key in value if not (str(key).isdecimal() and int(key) >= 1)]
    if bad:
        raise ValueError(f"has Noll's indices, 1 or more, for keys, not {bad[0]!r}")
    found = {int(key): number for key, number in value.items()}
    if len(found) < len(value):
        raise ValueError(f"has an index twice, {', '.join(map(str, value))}")
    return found


class AberrationsTable(Table):
    """``[camera.aberrations]``."""

    main_lens_waves: Annotated[dict[int, Finite], BeforeValidator(_indices)] = Field({})
    main_lens_field_waves_per_mm: Annotated[dict[int, Pair], BeforeValidator(_indices)] = Field({})
    lenslets_waves: Annotated[dict[int, Finite], BeforeValidator(_indices)] = Field({})
    lenslet_circle_um: Positive | None = None
    focal_length_scatter: Annotated[float, Field(ge=0, le=0.2, strict=True)] = 0.0
    tilt_scatter_mrad: NotNegative = 0.0
    position_scatter_um: NotNegative = 0.0
    scatter_seed: Seed = 0
    sensor_shift_um: Finite = 0.0

    def build(self, wavelength: float) -> Aberrations:
        """The aberrations, in SI units; waves are of this length in metres."""
        field = {
            j: (y * wavelength * 1e3, x * wavelength * 1e3)
            for j, (y, x) in self.main_lens_field_waves_per_mm.items()
        }
        return Aberrations(
            main_lens={j: c * wavelength for j, c in self.main_lens_waves.items()},
            main_lens_field=field,
            lenslets={j: c * wavelength for j, c in self.lenslets_waves.items()},
            lenslet_circle=divided(self.lenslet_circle_um, 1e6),
            scatter=LensletScatter(
                self.focal_length_scatter,
                self.tilt_scatter_mrad / 1e3,
                self.position_scatter_um / 1e6,
                self.scatter_seed,
            ),
            sensor_shift=self.sensor_shift_um / 1e6,
        )
