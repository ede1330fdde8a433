"""Tables of a job file, with the forms of their values: planes, memory sizes, apertures."""

from __future__ import annotations

import difflib
import re
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from clplen.batch.jobs.sweep import SweepTable, swept_once
from clplen.cameras.scenes.gallery import SCENES
from clplen.config.setting_tables import lines_of, setting_fields, take_settings
from clplen.config.tables import Count, NotNegative, Positive, Seed, Switch, Table, listed
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings
from clplen.units import bytes_of

_MOST_PLANES = 100_000


def planes_of(value: Any) -> list[float]:
    """Planes as a list, or as START:STOP:N, both ends included."""
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
    calibration: str | None = None
    allow_missing: Switch = False
    positions: str | None = None
    srgb: Switch = False
    step: Positive | None = None
    lattice: Literal["square", "hexagonal"] | None = None
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    demosaic: Literal["within", "after", "before"] | None = None
    devignette: Switch | None = None
    dataset: str | None = None
    max_bytes: Size | None = None
    trust_lattice: Switch = False
    intrinsics: str | None = None
    force: Switch = False


class InputTable(Table):
    """``[[inputs]]``: files or folders that hold light fields.

    Attributes
    ----------
    files : list of str
        Patterns of files or folders of views, * and ** as in a shell; at least one.
    name : str
        Of the items; {stem}, {name}, {parent}, {path} and {index} are known in it.
    layout : LayoutTable
        How the files are read: the words of `clplen.read_lightfield`.

    Examples
    --------
    >>> table = clplen.batch.InputTable(files="captures/*.h5", layout={"views": [9, 9]})
    >>> table.files, table.name, table.layout.views
    (['captures/*.h5'], '{stem}', (9, 9))
    """

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
    """``[stack]``: the focal stack.

    Attributes
    ----------
    alphas : list of float or None
        Planes F/F', as a list or "START:STOP:N", where the spacing is known.
    disparities : list of float or None
        Planes in pixels a view step, nearer larger, in the same forms; not together with
        ``alphas``. None of both: planes that suit the light field.
    aperture : int, float, str or None
        Views across, a fraction of the diameter (0.5) or "f/66"; None: all views.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        Between the pixels of the views.

    Examples
    --------
    >>> clplen.batch.StackTable(disparities="-1:1:5", aperture=0.5).disparities
    [-1.0, -0.5, 0.0, 0.5, 1.0]
    """

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


_Deconvolve: Any = create_model(
    "_Deconvolve",
    __base__=Table,
    psf=(str, ...),
    **setting_fields(DeconvolutionSettings, LatticeSettings),
)


class DeconvolveTable(_Deconvolve):
    """``[deconvolve]``: the volume behind frames of a light-field microscope."""

    @model_validator(mode="after")
    def _go_together(self) -> DeconvolveTable:
        values = self.model_dump()
        take_settings(DeconvolutionSettings, values)
        take_settings(LatticeSettings, values)
        return self


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


EXAMPLE = """\
# Many light fields, and what is made of each: clplen batch job.toml
# A key that begins with # shows its default; a table that begins with # is left out.
# Names of files are seen from the folder of this file.

output = "results"              # a folder in it for each light field
# formats = ["ome-tiff"]        # of stacks, depth maps and pictures: "ome-tiff", "ome-zarr" or both
# device = "gpu"                # default: the first GPU, else the CPU; a list: one for each worker
# memory = "4 GiB"              # default: half of what is free, shared by the workers; of each
                                # worker, larger light fields are streamed
# workers = 1                   # processes; more than one needs pip install "clplen[batch]"
# certificates = "certificates" # default: none; for workers on several computers, the folder of
                                # 'clplen batch --make-certificates'
# retries = 1                   # of what failed for a reason that may pass, or was lost

# Where light fields come from: any of [[inputs]], [[simulations]] and [[scenes]], several of each

# [[inputs]]                    # your own files, in place of the [[scenes]] below
# files = ["captures/*.h5"]     # needed; * and ** as in a shell; also folders of views
# name = "{stem}"               # of the item; {name}, {parent}, {path} and {index} are known, too

# [inputs.layout]               # how the files are read, as by read_lightfield in Python
# pattern = "view_{v}_{u}.png"  # default: guessed; {i} counts row by row, {n} counts anything
# views = [9, 9]                # default: found out; [rows, columns]
# flip_v = false
# flip_u = false
# swap_uv = false               # before the axes are reversed
# order = "vuyx"                # default: found out; axes of an array or a mosaic
# white = "white.png"           # default: none; the white image of raw images
# dark = "dark.png"             # default: none; their dark frame
# grid = "lattice.json"         # default: found out; the lattice of the lenslets
# calibration = "caldata.tar"   # default: none; white images of a Lytro camera
# allow_missing = false         # true: views may be missing, and get the weight 0
# positions = "names"           # default: a grid; or a CSV with the columns v, u, y, x
# srgb = false                  # true: decode to linear light from 0 to 1
# step = 1.0                    # default: found out; pixels a view of a raw image
# lattice = "square"            # default: found out; or "hexagonal"
# bayer = "RGGB"                # default: none; or "BGGR", "GRBG" or "GBRG"
# demosaic = "within"           # default: within lenslets; or "after" or "before" slicing
# devignette = true             # default: where there is a white image
# dataset = "LF"                # default: found out; of a file that holds several arrays
# max_bytes = "2 GiB"           # default: half of the free memory; that a file may ask for
# trust_lattice = false         # true: take the lattice found in a raw image, though in doubt
# intrinsics = "camera.json"    # default: none; of 'clplen calibrate', to rectify the views
# force = false                 # true: a white image will do whose lattice is not to be trusted

# [[simulations]]               # light fields of a camera file
# camera = "camera.toml"        # needed; 'clplen simulate --example' prints one
# name = "depths"               # default: the camera file's without suffix

# [[simulations.sweep]]         # one item for each combination of all sweeps of this table
# key = "scene.points_mm.*.2"   # needed; of the camera file. Numbers count entries from 0, * is all
# values = [-100, -50, 0, 50]   # needed
# name = "z_mm"                 # default: the key's last word that is no number; in items' names

[[scenes]]                      # scenes whose depth is known exactly
kind = ["bars", "spheres"]      # needed; "all", or any of: plane, slant, layers, roof, valley,
                                # staircase, spheres, bars, backgammon, dots, stripes, pyramids,
                                # room, glossy, clutter
# name = "set"                  # default: none; before kind and seed in items' names
# seeds = [0]                   # other seeds draw other scenes
shape = [128, 128]              # default: [512, 512]; of a view, [y, x]; not with a camera
views = [5, 5]                  # default: [9, 9]; [rows, columns]; not with a camera
# noise = 0.02                  # default: 0, 0.01, 0.02 or 0.05 in turn; fraction of white; not
                                # with a camera
# camera = "camera.toml"        # default: none; through it by rays, without its [scene]

# [[scenes.sweep]]              # keys: shape, views and noise, or those of the camera file
# key = "noise"                 # needed
# values = [0.0, 0.1]           # needed
# name = "noise"                # default: as above

# What is made of each: at least one of the tables below, or nothing but [[simulations]] and
# [[scenes]], whose raw image, light field and truth are always written

[stack]                         # pictures refocused at many planes
disparities = "-2:2:41"         # START:STOP:N or a list, pixels a view step, nearer is larger;
                                # default: planes that suit the light field
# alphas = "0.8:1.2:41"         # default: as disparities say; F/F', where the spacing is known
# aperture = 9                  # default: all; views across, 0.5 of the diameter, or "f/66"
# interpolation = "linear"      # or "nearest", "cubic" or "fourier"

# [depth]                       # disparity, confidence, and alpha and z where they are known
# alphas = "0.65:1.35:33"       # default: as [stack]
# disparities = "-2:2:33"       # default: as [stack]
# cue = "combined"              # default: combined, of a microscope energy; or "correspondence" or
                                # "structure-tensor"

# [all_in_focus]                # sharp everywhere; by the depth map where there is one
# disparities = "-2:2:33"       # default: planes that suit the light field

# [views]                       # single views
# at = [[4, 4], [0, 4]]         # default: the centre; [v, u] from 0, fractions too

# [light_field]                 # as it was decoded
# format = "hdf5"               # or "zarr"

# [deconvolve]                  # the volume behind raw frames of a light-field microscope, whose
                                # white and dark frame [inputs.layout] names
# psf = "psf.h5"                # needed; 'clplen microscope psf' makes it
@settings@

# [raw]                         # of simulations and scenes; it has no keys
""".replace("@settings@", lines_of(DeconvolutionSettings, LatticeSettings))
