"""Settings of stacks, depth maps, pictures and views of light fields."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from clplen.checks import is_finite, is_integer
from clplen.settings.declaration import (
    LENGTHS,
    PLANES,
    SettingError,
    Settings,
    named,
    setting,
    settings_of,
)

MAX_PLANES = 10**6
INTERPOLATIONS = ("linear", "nearest", "cubic", "fourier")
CUES = ("energy", "correspondence", "structure-tensor", "combined")
Interpolation = Literal["linear", "nearest", "cubic", "fourier"]
Cue = Literal["energy", "correspondence", "structure-tensor", "combined"]
_DISPARITIES = "Planes by disparity, in pixels a view step; nearer is larger."
_ALPHAS = "Planes by alpha = F/F'; requires the spacing of the light field."
_SUITABLE = "planes that suit the light field"
_RANGE = "START:STOP:N"
_F_NUMBER = re.compile(r"\s*f\s*/\s*(\d+\.?\d*|\.\d+)\s*", re.IGNORECASE)


def planes_of(value: Any) -> list[float]:
    """Convert planes from numbers, or from START:STOP:N with both ends included."""
    if isinstance(value, str):
        return _planes_between(value)
    if not isinstance(value, list | tuple) or not value or not all(map(_is_number, value)):
        raise ValueError('must be START:STOP:N or a list of finite numbers, such as "-1:1:41"')
    return [float(plane) for plane in value]


def _is_number(value: Any) -> bool:
    return is_finite(value) and not isinstance(value, bool)


def _planes_between(text: str) -> list[float]:
    parts = text.split(":")
    try:
        start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = -1
    if len(parts) != 3 or not 1 <= count <= MAX_PLANES or not np.isfinite([start, stop]).all():
        raise ValueError(f'must be START:STOP:N with 1 to {MAX_PLANES:,} planes, such as "-2:2:33"')
    if (count == 1) != (start == stop):
        raise ValueError(
            "must have at least 2 planes between two different ends, or 1 plane with START equal "
            "to STOP"
        )
    return [float(plane) for plane in np.linspace(start, stop, count)]


def f_number_of(text: str) -> float:
    """Return the number of "f/66", 0 for another text."""
    match = _F_NUMBER.fullmatch(text)
    return 0.0 if match is None else float(match[1])


def aperture_of(value: Any) -> int | float | str:
    """Return views across, a fraction of the diameter, or an f-number such as "f/66"."""
    if isinstance(value, str) and f_number_of(value) > 0:
        return value
    is_float = isinstance(value, float | np.floating)
    if is_float and 0 < value <= 1:
        return float(value)
    if not is_float and is_integer(value) and value >= 1:
        return int(value)
    raise ValueError('must be views across (9), a fraction of the diameter (0.5) or "f/66"')


def view_list_of(value: Any) -> list[tuple[float, float]]:
    """Convert views [v, u] from a list of pairs."""
    pairs: Any = value if isinstance(value, list | tuple) and value else [value]
    if not all(
        isinstance(pair, list | tuple) and len(pair) == 2 and all(map(_is_number, pair))
        for pair in pairs
    ):
        raise ValueError("must be a list of views [v, u], such as [[4, 4], [0, 4]]")
    return [(float(v), float(u)) for v, u in pairs]


def one_of_planes(alphas: Any, disparities: Any) -> None:
    """Reject planes that are set by alphas and by disparities."""
    if alphas is not None and disparities is not None:
        other = named("disparities")
        raise SettingError("alphas", f"and {other} both set the planes; pass one of them")


@dataclass(frozen=True)
class PlaneSettings(Settings):
    """Planes of a stack or of a depth search."""

    disparities: list[float] | None = setting(
        None, _DISPARITIES, check=planes_of, group=PLANES, default_text=_SUITABLE,
        example="-2:2:41", metavar=_RANGE,
    )  # fmt: skip
    alphas: list[float] | None = setting(
        None, _ALPHAS, check=planes_of, group=PLANES, default_text=_SUITABLE,
        example="0.8:1.2:41", metavar=_RANGE,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of_planes(self.alphas, self.disparities)


@dataclass(frozen=True)
class ApertureSettings(PlaneSettings):
    """Planes, and the part of the main lens in use."""

    aperture: Any = setting(
        None,
        "Part of the main lens to use: views across (9), fraction of the diameter (0.5) or "
        "f-number (f/66).",
        check=aperture_of, default_text="all views", example=9, metavar="N|FRACTION|f/NUMBER",
    )  # fmt: skip


@dataclass(frozen=True)
class StackSettings(ApertureSettings):
    """Settings of `clplen.focal_stack`."""

    interpolation: Interpolation = setting(
        "linear", "Interpolation between pixels of a view.", kind=str, choices=INTERPOLATIONS
    )


@dataclass(frozen=True)
class DepthSettings(ApertureSettings):
    """Settings of `clplen.depth_map`."""

    cue: Cue | None = setting(
        None, "Depth cue.", kind=str, choices=CUES,
        default_text="combined, for a microscope energy", example="combined",
    )  # fmt: skip


@dataclass(frozen=True)
class AllInFocusSettings(Settings):
    """Settings of `clplen.all_in_focus`."""

    disparities: list[float] | None = setting(
        None, _DISPARITIES, check=planes_of, group=PLANES, default_text=_SUITABLE,
        example="-2:2:33", metavar=_RANGE,
    )  # fmt: skip


@dataclass(frozen=True)
class ViewSettings(Settings):
    """Single views."""

    at: list[tuple[float, float]] | None = setting(
        None, "Views [v, u] from 0; fractions lie between views.", check=view_list_of,
        default_text="the centre view", example=[[4, 4], [0, 4]],
    )  # fmt: skip


@dataclass(frozen=True)
class ViewLengths(Settings):
    """Lengths of the views' camera, which convert disparities to metres."""

    baseline: float | None = setting(
        None, "Distance between neighbouring views.", above=0, unit="mm", group=LENGTHS
    )
    focal_length: float | None = setting(
        None, "Distance from the lens to the sensor.", above=0, unit="mm", group=LENGTHS
    )
    pixel_pitch: float | None = setting(
        None, "Pitch of the pixels.", above=0, unit="um", key="pixel_um", group=LENGTHS
    )
    focus_distance: float | None = setting(
        None, "Distance at which the disparity is 0.", above=0, unit="m", key="focus_m",
        group=LENGTHS, default_text="infinity",
    )  # fmt: skip

    @property
    def lengths(self) -> dict[str, float]:
        """Lengths in metres that are set, in the form of `clplen.metric_depth`."""
        values = {item.name: getattr(self, item.name) for item in settings_of(self)}
        return {name: value for name, value in values.items() if value is not None}
