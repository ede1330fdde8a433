"""A job: what is read, what is made of it, and where it goes. TOML, or from Python."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from clplen.batch.quantities import Aperture, Planes, Size
from clplen.batch.sweep import distinct, swept_once
from clplen.cameras.gallery import SCENES
from clplen.config.reading import problems_of, read_toml, validated
from clplen.config.tables import Count, NotNegative, Seed, Switch, Table, listed
from clplen.errors import FormatError
from clplen.files import PathLike

if TYPE_CHECKING:
    from clplen.batch.runner import Summary, Watcher

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


class InputTable(Table):
    """``[[inputs]]``: files or folders that hold light fields."""

    files: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
    name: str = "{stem}"
    layout: LayoutTable = LayoutTable()


class SweepTable(Table):
    """``[[simulations.sweep]]``: one key of the camera file, or of a scene, with its values."""

    key: Annotated[str, Field(pattern=r"^[^.]+(\.[^.]+)*$")]
    values: Annotated[list[Any], BeforeValidator(distinct)]
    name: Annotated[str, Field(min_length=1)] | None = None


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
    cue: Literal["energy", "correspondence", "structure-tensor", "combined"] = "combined"

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


WORK = ("stack", "depth", "all_in_focus", "views", "light_field", "raw")


class HowTable(Table):
    """How a job is done; it decides no result."""

    device: Annotated[list[str], BeforeValidator(listed)] | None = None
    memory: Size | None = None
    workers: Count = 1
    retries: Annotated[int, Field(ge=0, le=100, strict=True)] = 1


class Job(HowTable):
    """Many light fields, and what is made of each. See ``clplen batch --example``.

    Attributes
    ----------
    output : str
        Folder of the results, a folder in it for each item; seen from the job file.
    formats : list of str
        Of stacks, depth maps and pictures: "ome-tiff", "ome-zarr" or both.
    inputs, simulations, scenes : list
        Where light fields come from; at least one.
    stack, depth, all_in_focus, views, light_field, raw
        What is made; at least one, or simulations and scenes, which write all that they know.
    device : str or None
        As for `Device.open`; a list gives each worker its own.
    memory : int or None
        Bytes that light field, results and what lies between may take in each worker; beyond it
        light fields are streamed. None: half of the free memory, shared by the workers.
    workers : int
        Processes on this computer; more than one needs the extra ``batch``.
    retries : int
        How often an item that failed for a reason that may pass, or was lost, is tried again.
    """

    output: str
    formats: Annotated[list[Format], BeforeValidator(listed)] = Field(
        default=["ome-tiff"], min_length=1
    )
    inputs: list[InputTable] = Field(default=[])
    simulations: list[SimulationTable] = Field(default=[])
    scenes: list[SceneTable] = Field(default=[])
    stack: StackTable | None = None
    depth: DepthTable | None = None
    all_in_focus: AllInFocusTable | None = None
    views: ViewsTable | None = None
    light_field: LightFieldTable | None = None
    raw: RawTable | None = None

    _folder: Path = PrivateAttr(default_factory=Path.cwd)

    @model_validator(mode="after")
    def _not_empty(self) -> Job:
        if not (self.inputs or self.simulations or self.scenes):
            raise ValueError(
                "the job has no light fields: give [[inputs]], [[simulations]] or [[scenes]]"
            )
        if self.inputs and not any(getattr(self, name) is not None for name in WORK[:5]):
            raise ValueError(
                "the job makes nothing of its inputs: give [stack], [depth], [all_in_focus], "
                "[views] or [light_field]"
            )
        return self

    @classmethod
    def read(cls, path: PathLike) -> Job:
        """Read a job file.

        Parameters
        ----------
        path : path-like
            TOML as ``clplen batch --example`` prints it. Files that it names are seen from its
            folder.

        Returns
        -------
        Job

        Raises
        ------
        FormatError
            If there is no such file, it is not TOML, or a key is unknown (with the nearest known
            one), missing or out of range, or does not fit the others.
        """
        path = Path(path)
        content = read_toml(path, f"job file {path}; 'clplen batch --example' prints one")
        return validated(cls, content, path).within(path.parent)

    def within(self, folder: PathLike) -> Job:
        """The same job with the names of files seen from another folder than the current one."""
        job = self.model_copy()
        job._folder = Path(folder).absolute()
        return job

    def done_by(
        self,
        *,
        workers: int | None = None,
        device: str | list[str] | None = None,
        memory: int | str | None = None,
    ) -> Job:
        """The same job done otherwise; see `run`."""
        given = {"workers": workers, "device": device, "memory": memory}
        given = {name: value for name, value in given.items() if value is not None}
        try:
            how = HowTable.model_validate(given)
        except ValidationError as error:
            raise FormatError(f"{problems_of(HowTable, error)}.") from error
        return self.model_copy(update={name: getattr(how, name) for name in given})

    def run(
        self,
        *,
        workers: int | None = None,
        scheduler: str | None = None,
        device: str | list[str] | None = None,
        memory: int | str | None = None,
        force: bool = False,
        watcher: Watcher | None = None,
    ) -> Summary:
        """Do what is missing, changed or failed.

        Parameters
        ----------
        workers : int, optional
            Processes on this computer, at least 1; default: as the job says. With more than one, a
            script must call this below ``if __name__ == "__main__":``, as its workers import it.
        scheduler : str, optional
            Address of a Dask scheduler whose workers do it, ``tcp://host:8786``.
        device : str or list of str, optional
            As for `Device.open`, a list for each worker its own; default: as the job says. Workers
            of a scheduler have theirs.
        memory : int or str, optional
            Bytes or a size such as "4 GiB" of each worker; default: as the job says.
        force : bool
            Whether a job that differs from the one that ran before may go on in its output.
        watcher : Watcher, optional
            Is told how it goes on; see `clplen.batch.runner.Watcher`.

        Returns
        -------
        Summary
            ``failed`` has a sentence for each item that failed; the others are done.

        Raises
        ------
        FormatError
            If a value is out of range, the items cannot be told, the job differs from the one that
            ran before, or the extra ``batch`` is needed and not installed.
        DeviceError
            If there is no such device, or the workers cannot do the job.
        BlockingIOError
            If another process is at work on the output.
        OSError
            If the output takes no files.
        """
        from clplen.batch.executors import executor_of
        from clplen.batch.runner import Silent, run_job

        job, watcher = (
            self.done_by(workers=workers, device=device, memory=memory),
            watcher or Silent(),
        )
        executor = executor_of(job, scheduler=scheduler, running=watcher.running)
        return run_job(job, executor, watcher=watcher, force=force)

    @property
    def folder(self) -> Path:
        """From where names of files are seen."""
        return self._folder

    @property
    def output_folder(self) -> Path:
        """Where the results go."""
        return self._folder / self.output

    def what(self) -> dict[str, Any]:
        """What decides the results, without how they are computed: for comparing jobs."""
        how = set(HowTable.model_fields)
        return self.model_dump(mode="json", exclude=how, exclude_defaults=True)


def _not_both(table: Any) -> Any:
    if table.alphas is not None and table.disparities is not None:
        raise ValueError("has alphas and disparities: give one of them")
    return table
