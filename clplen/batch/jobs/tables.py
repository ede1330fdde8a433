"""Tables of a job file: inputs, simulations, scenes, outputs and the run."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clplen.batch.jobs.sweep import SweepTable, swept_once
from clplen.cameras.scenes.gallery import SCENES
from clplen.config.operations import LayoutTable
from clplen.config.setting_tables import table_of
from clplen.config.settings import Pair, Size, setting
from clplen.config.tables import Count, NotNegative, Seed, Table, listed
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings

Format = Literal["ome-tiff", "ome-zarr"]
ALL_KINDS = "all"  # stands for every kind of sample scene
VIEW_KEYS = ("shape", "views", "noise")  # keys of scenes without a camera


class InputTable(Table):
    """``[[inputs]]``: files or folders of light fields.

    Attributes
    ----------
    files : list of str
        Patterns of files or folders of views, * and ** as in a shell; at least one.
    name : str
        Name of the items, a template with {stem}, {name}, {parent}, {path} and {index}.
    layout : LayoutTable
        Layout of the files, as in `clplen.read_lightfield`.
    """

    files: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)] = setting(
        ..., "Files or folders of views; * and ** as in a shell.", example=["captures/*.h5"]
    )
    name: str = setting(
        "{stem}", "Name of the items, a template with {stem}, {name}, {parent}, {path}, {index}."
    )
    layout: LayoutTable = LayoutTable()


class SimulationTable(Table):
    """``[[simulations]]``: light fields of a camera file with swept keys."""

    camera: str = setting(
        ..., "Camera file, as 'clplen simulate --example' prints it.", example="camera.toml"
    )
    name: str | None = setting(
        None, "Name of the items.", default_text="the name of the camera file without suffix",
        example="depths",
    )  # fmt: skip
    sweep: Annotated[list[SweepTable], AfterValidator(swept_once)] = Field(default=[])


def _check_kinds(kinds: list[str]) -> list[str]:
    """Raise an error for an unknown kind of sample scene."""
    for kind in kinds:
        if kind not in (ALL_KINDS, *SCENES):
            near = difflib.get_close_matches(kind, SCENES, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"use any of {', '.join(SCENES)}"
            raise ValueError(f"must be a kind of scene, not {kind!r}; {hint}")
    return kinds


class SceneTable(Table):
    """``[[scenes]]``: synthetic scenes with exact depth, as light fields or through a camera."""

    kind: Annotated[
        list[str], AfterValidator(_check_kinds), BeforeValidator(listed), Field(min_length=1)
    ] = setting(..., f'"all", or any of: {", ".join(SCENES)}.', example=["bars", "spheres"])
    name: str | None = setting(
        None, "Prefix of kind and seed in the names of items.", default_text="none", example="set"
    )
    seeds: Annotated[list[Seed], BeforeValidator(listed), Field(min_length=1)] = setting(
        [0], "Random seeds; each gives another scene."
    )
    shape: Pair = setting(
        (512, 512), "Number of pixels of a view, [y, x]; not with a camera.", example=[128, 128]
    )
    views: Pair = setting(
        (9, 9), "Number of views, [rows, columns]; not with a camera.", example=[5, 5]
    )
    noise: NotNegative | None = setting(
        None, "Noise as a fraction of white; not with a camera.",
        default_text="0, 0.01, 0.02 or 0.05 in turn", example=0.02,
    )  # fmt: skip
    camera: str | None = setting(
        None, "Camera file; the scene is ray-traced through it, without its [scene].",
        default_text="none", example="camera.toml",
    )  # fmt: skip
    sweep: Annotated[list[SweepTable], AfterValidator(swept_once)] = Field(default=[])

    @model_validator(mode="after")
    def _check_view_keys(self) -> SceneTable:
        roots = [table.key.split(".")[0] for table in self.sweep]
        others = [table.key for table in self.sweep if table.key.split(".")[0] not in VIEW_KEYS]
        if self.camera is None and others:
            raise ValueError(
                f"sweeps {others[0]}, but without a camera only {', '.join(VIEW_KEYS)} can be swept"
            )
        conflicts = [key for key in VIEW_KEYS if key in self.model_fields_set or key in roots]
        if self.camera is not None and conflicts:
            raise ValueError(
                f"has {conflicts[0]} and a camera, whose lenslets and [sensor] set it: leave one "
                "out"
            )
        return self


class LightFieldTable(Table):
    """``[light_field]``: the decoded or simulated light field."""

    format: Literal["hdf5", "zarr"] = setting("hdf5", 'File format, "hdf5" or "zarr".')


class RawTable(Table):
    """``[raw]``: the raw image of simulations."""


DeconvolveTable: Any = table_of(
    "DeconvolveTable",
    __name__,
    "``[deconvolve]``: volumes from raw frames of a light-field microscope.",
    DeconvolutionSettings,
    LatticeSettings,
    psf=(str, setting(..., "Point images from 'clplen microscope psf'.", example="psf.h5")),
)


WORK = ("stack", "depth", "all_in_focus", "views", "light_field", "deconvolve", "raw")


class RunTable(Table):
    """Settings of a run, which do not affect the results."""

    device: Annotated[list[str], BeforeValidator(listed)] | None = setting(
        None, "Device, or a list with a device for each worker.",
        default_text="the first GPU, else the CPU", example="gpu",
    )  # fmt: skip
    memory: Size | None = setting(
        None, "Memory limit of each worker; larger light fields are processed in tiles.",
        default_text="half of the free memory, shared by the workers", example="4 GiB",
    )  # fmt: skip
    workers: Count = setting(
        1, 'Number of processes; values above 1 need pip install "clplen[batch]".'
    )
    retries: Annotated[int, Field(ge=0, le=100, strict=True)] = setting(
        1, "Number of retries of an item that was lost or failed for a temporary reason."
    )
