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
EVERY = "all"  # kinds of sample scenes
SEEN = ("shape", "views", "noise")  # of scenes without a camera


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
    """

    files: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)] = setting(
        ..., "Files or folders of views; * and ** as in a shell.", example=["captures/*.h5"]
    )
    name: str = setting(
        "{stem}", "Name of the item; {name}, {parent}, {path} and {index} are known, too."
    )
    layout: LayoutTable = LayoutTable()


class SimulationTable(Table):
    """``[[simulations]]``: a camera file, its keys swept."""

    camera: str = setting(
        ..., "Camera file, as 'clplen simulate --example' prints it.", example="camera.toml"
    )
    name: str | None = setting(
        None, "Name of the items.", default_text="the camera file's without suffix",
        example="depths",
    )  # fmt: skip
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

    kind: Annotated[
        list[str], AfterValidator(_known), BeforeValidator(listed), Field(min_length=1)
    ] = setting(..., f'"all", or any of: {", ".join(SCENES)}.', example=["bars", "spheres"])
    name: str | None = setting(
        None, "Word before kind and seed in the names of items.", default_text="none", example="set"
    )
    seeds: Annotated[list[Seed], BeforeValidator(listed), Field(min_length=1)] = setting(
        [0], "Seeds; each draws another scene."
    )
    shape: Pair = setting(
        (512, 512), "Pixels of a view, [y, x]; not with a camera.", example=[128, 128]
    )
    views: Pair = setting(
        (9, 9), "Number of views, [rows, columns]; not with a camera.", example=[5, 5]
    )
    noise: NotNegative | None = setting(
        None, "Noise as a fraction of white; not with a camera.",
        default_text="0, 0.01, 0.02 or 0.05 in turn", example=0.02,
    )  # fmt: skip
    camera: str | None = setting(
        None, "Camera file, through which the scene is seen by rays, without its [scene].",
        default_text="none", example="camera.toml",
    )  # fmt: skip
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


class LightFieldTable(Table):
    """``[light_field]``: the light field itself, as decoded or simulated."""

    format: Literal["hdf5", "zarr"] = setting("hdf5", 'File format; or "zarr".')


class RawTable(Table):
    """``[raw]``: the raw image of simulations."""


DeconvolveTable: Any = table_of(
    "DeconvolveTable",
    __name__,
    "``[deconvolve]``: the volume behind frames of a light-field microscope.",
    DeconvolutionSettings,
    LatticeSettings,
    psf=(str, setting(..., "Point images of 'clplen microscope psf'.", example="psf.h5")),
)


WORK = ("stack", "depth", "all_in_focus", "views", "light_field", "deconvolve", "raw")


class RunTable(Table):
    """How a job is done; it decides no result."""

    device: Annotated[list[str], BeforeValidator(listed)] | None = setting(
        None, "Device; a list has one for each worker.",
        default_text="the first GPU, else the CPU", example="gpu",
    )  # fmt: skip
    memory: Size | None = setting(
        None, "Memory of each worker; larger light fields are streamed.",
        default_text="half of the free memory, shared by the workers", example="4 GiB",
    )  # fmt: skip
    workers: Count = setting(
        1, 'Number of processes; more than one needs pip install "clplen[batch]".'
    )
    retries: Annotated[int, Field(ge=0, le=100, strict=True)] = setting(
        1, "How often an item that was lost, or failed for a temporary reason, is tried again."
    )
