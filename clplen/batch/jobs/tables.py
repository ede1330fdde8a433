"""Tables of a job file, with the forms of their values: planes, memory sizes, apertures."""

from __future__ import annotations

import difflib
import re
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clplen.batch.jobs.sweep import SweepTable, swept_once
from clplen.cameras.gallery import SCENES
from clplen.config.tables import Count, NotNegative, Positive, Seed, Switch, Table, listed

_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30, "TIB": 1 << 40}
_SIZE = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*([KMGT]?I?B?)\s*", re.IGNORECASE)
_MOST_PLANES = 100_000


def bytes_of(value: Any) -> int:
    """A size of memory, as 2000000, "512 MiB" or "4 GB", in bytes.

    Raises
    ------
    ValueError
        If it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError('must be a whole number of bytes or a size such as "4 GiB"')
    found = _SIZE.fullmatch(str(value))
    unit = found[2].upper() if found else ""
    if found is None or unit not in _UNITS:
        raise ValueError('must be a whole number of bytes or a size such as "512 MiB" or "4 GB"')
    return int(float(found[1]) * _UNITS[unit])


def planes_of(value: Any) -> list[float]:
    """Planes as a list, or as START:STOP:N, both ends included.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if isinstance(value, str):
        return _range(value)
    if not isinstance(value, list) or not value:
        raise ValueError('must be a list of numbers or "START:STOP:N", such as "-1:1:41"')
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in value):
        raise ValueError("must hold numbers only")
    planes = [float(one) for one in value]
    if not np.isfinite(planes).all():
        raise ValueError("must hold finite numbers only")
    return planes


def _range(text: str) -> list[float]:
    parts = text.split(":")
    try:
        start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = -1
    if len(parts) != 3 or not 1 <= count <= _MOST_PLANES or not np.isfinite([start, stop]).all():
        raise ValueError(f'must be "START:STOP:N" with 1 to {_MOST_PLANES} planes')
    if (count == 1) != (start == stop):
        raise ValueError("needs at least 2 planes between two different ends")
    return [float(plane) for plane in np.linspace(start, stop, count)]


def aperture_of(value: Any) -> int | float | str:
    """Views across, a fraction of the diameter, or an f-number such as "f/66"."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    if is_number or (isinstance(value, str) and re.fullmatch(r"f/\d+(\.\d+)?", value)):
        return value
    raise ValueError('must be views across (9), a fraction of the diameter (0.5) or "f/66"')


Size = Annotated[int, BeforeValidator(bytes_of), Field(ge=1)]
Planes = Annotated[list[float], BeforeValidator(planes_of)]
Aperture = Annotated[Any, BeforeValidator(aperture_of)]


Format = Literal["ome-tiff", "ome-zarr"]
Pair = tuple[Count, Count]
EVERY = "all"  # kinds of sample scenes
SEEN = ("shape", "views", "noise")  # of scenes without a camera


class LayoutTable(Table):
    """``[inputs.layout]``: the words of `clplen.read_lightfield`."""

    pattern: str | None = None
    views: Pair | None = None
    flip_v: Switch = False
    flip_u: Switch = False
    swap_uv: Switch = False
    order: str | None = None
    white: str | None = None
    dark: str | None = None
    grid: str | None = None
    allow_missing: Switch = False
    positions: str | None = None
    srgb: Switch = False
    step: float | None = None
    lattice: Literal["rectangular", "hexagonal"] | None = None
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    demosaic: Literal["after", "before"] | None = None
    devignette: Switch | None = None
    dataset: str | None = None
    max_bytes: Size | None = None
    force: Switch = False


class InputTable(Table):
    """``[[inputs]]``: files or folders that hold light fields."""

    files: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
    name: str = "{stem}"
    layout: LayoutTable = LayoutTable()


class SimulationTable(Table):
    """``[[simulations]]``: a camera file, its keys swept."""

    camera: str
    name: str | None = None
    sweep: Annotated[list[SweepTable], AfterValidator(swept_once)] = Field(default=[])


def _known(kinds: list[str]) -> list[str]:
    """Refuse what is no kind of sample scene."""
    for kind in kinds:
        if kind not in (EVERY, *SCENES):
            near = difflib.get_close_matches(kind, SCENES, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(SCENES)}"
            raise ValueError(f"knows no scene {kind!r}; {hint}")
    return kinds


class SceneTable(Table):
    """``[[scenes]]``: synthetic scenes of exact depth, as light fields or through a camera."""

    kind: Annotated[list[str], AfterValidator(_known), BeforeValidator(listed), Field(min_length=1)]
    name: str | None = None
    seeds: Annotated[list[Seed], BeforeValidator(listed), Field(min_length=1)] = Field(default=[0])
    shape: Pair = (512, 512)
    views: Pair = (9, 9)
    noise: NotNegative | None = None
    camera: str | None = None
    sweep: Annotated[list[SweepTable], AfterValidator(swept_once)] = Field(default=[])

    @model_validator(mode="after")
    def _seen_by(self) -> SceneTable:
        swept = [one.key.split(".")[0] for one in self.sweep]
        strange = [one.key for one in self.sweep if one.key.split(".")[0] not in SEEN]
        if self.camera is None and strange:
            raise ValueError(
                f"sweeps {strange[0]}, but without a camera only {', '.join(SEEN)} can be swept"
            )
        stray = [key for key in SEEN if key in self.model_fields_set or key in swept]
        if self.camera is not None and stray:
            raise ValueError(
                f"has {stray[0]} and a camera, which decides that by its lenslets and its "
                "[sensor]: leave one out"
            )
        return self


class StackTable(Table):
    """``[stack]``: the focal stack."""

    alphas: Planes | None = None
    disparities: Planes | None = None
    aperture: Aperture | None = None
    interpolation: Literal["linear", "nearest", "cubic", "fourier"] = "linear"

    @model_validator(mode="after")
    def _one_of(self) -> StackTable:
        return _not_both(self)


class DepthTable(Table):
    """``[depth]``: the depth map."""

    alphas: Planes | None = None
    disparities: Planes | None = None
    cue: Literal["energy", "correspondence", "structure-tensor", "combined"] | None = None

    @model_validator(mode="after")
    def _one_of(self) -> DepthTable:
        return _not_both(self)


class AllInFocusTable(Table):
    """``[all_in_focus]``: a picture sharp everywhere; by the depth map where there is one."""

    disparities: Planes | None = None


class ViewsTable(Table):
    """``[views]``: single views, (v, u) from 0, fractions too; without ``at`` the centre view."""

    at: list[tuple[float, float]] | None = None


class LightFieldTable(Table):
    """``[light_field]``: the light field itself, as decoded or simulated."""

    format: Literal["hdf5", "zarr"] = "hdf5"


class RawTable(Table):
    """``[raw]``: the raw image of simulations."""


class DeconvolveTable(Table):
    """``[deconvolve]``: the volume behind frames of a light-field microscope."""

    psf: str
    iterations: Count = 20
    background: NotNegative = 0.0
    gain: Positive = 1.0
    saturation: Positive | None = None
    haze: Switch = False
    residual: Positive | Literal["noise"] | None = None
    accelerate: Switch = False
    prior: Literal["tv", "gaussian"] | None = None
    strength: Positive = 1.0


WORK = ("stack", "depth", "all_in_focus", "views", "light_field", "deconvolve", "raw")


class RunTable(Table):
    """How a job is done; it decides no result."""

    device: Annotated[list[str], BeforeValidator(listed)] | None = None
    memory: Size | None = None
    workers: Count = 1
    certificates: Annotated[str, Field(min_length=1)] | None = None
    retries: Annotated[int, Field(ge=0, le=100, strict=True)] = 1


def _not_both(table: Any) -> Any:
    if table.alphas is not None and table.disparities is not None:
        raise ValueError("has alphas and disparities: give one of them")
    return table
