"""The content of a job: what is read, what is made of it, and where it goes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, model_validator

from clplen.batch.jobs.sweep import SweepTable
from clplen.batch.jobs.tables import (
    WORK,
    DeconvolveTable,
    Format,
    InputTable,
    LightFieldTable,
    RawTable,
    RunTable,
    SceneTable,
    SimulationTable,
)
from clplen.config.operations import (
    AllInFocusTable,
    DepthTable,
    LayoutTable,
    StackTable,
    ViewsTable,
)
from clplen.config.settings import commented, setting
from clplen.config.tables import Table, listed, problems_of, read_toml, validated
from clplen.errors import FormatError
from clplen.files import PathLike

Spec = TypeVar("Spec", bound="JobSpec")


class JobSpec(RunTable):
    """Many light fields, and what is made of each; `clplen.batch.Job` runs it."""

    output: str = setting(
        ..., "Folder of the results, with a folder for each item.", example="results"
    )
    formats: Annotated[list[Format], BeforeValidator(listed), Field(min_length=1)] = setting(
        ["ome-tiff"], 'Formats of stacks, maps and pictures: "ome-tiff", "ome-zarr" or both.'
    )
    inputs: Annotated[list[InputTable], BeforeValidator(listed)] = Field(default=[])
    simulations: Annotated[list[SimulationTable], BeforeValidator(listed)] = Field(default=[])
    scenes: Annotated[list[SceneTable], BeforeValidator(listed)] = Field(default=[])
    stack: StackTable | None = None
    depth: DepthTable | None = None
    all_in_focus: AllInFocusTable | None = None
    views: ViewsTable | None = None
    light_field: LightFieldTable | None = None
    deconvolve: DeconvolveTable | None = None
    raw: RawTable | None = None

    _folder: Path = PrivateAttr(default_factory=Path.cwd)

    @model_validator(mode="after")
    def _not_empty(self: Spec) -> Spec:
        if not (self.inputs or self.simulations or self.scenes):
            raise ValueError(
                "the job has no light fields: give [[inputs]], [[simulations]] or [[scenes]]"
            )
        if self.inputs and not any(getattr(self, name) is not None for name in WORK[:-1]):
            raise ValueError(
                "the job makes nothing of its inputs: give [stack], [depth], [all_in_focus], "
                "[views], [light_field] or [deconvolve]"
            )
        strange = [
            f"inputs.{i}.layout.{word}"
            for i, one in enumerate(self.inputs)
            for word in sorted(one.layout.model_fields_set - {"white", "dark", "force"})
        ]
        if strange and not any(getattr(self, name) is not None for name in WORK[:-2]):
            raise ValueError(f"{strange[0]} says nothing to [deconvolve]: leave it out")
        return self

    @classmethod
    def read(cls: type[Spec], path: PathLike) -> Spec:
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
        return validated(cls, content, path).relative_to(path.parent)

    def relative_to(self: Spec, folder: PathLike) -> Spec:
        """The same job with file names relative to another folder than the current one."""
        job = self.model_copy()
        job._folder = Path(folder).absolute()
        return job

    def with_settings(
        self: Spec,
        *,
        workers: int | None = None,
        device: str | list[str] | None = None,
        memory: int | str | None = None,
    ) -> Spec:
        """The same job with other settings of its run; see `clplen.batch.run_job`."""
        given = {"workers": workers, "device": device, "memory": memory}
        given = {name: value for name, value in given.items() if value is not None}
        try:
            how = RunTable.model_validate(given)
        except ValidationError as error:
            raise FormatError(f"{problems_of(RunTable, error)}.") from error
        return self.model_copy(update={name: getattr(how, name) for name in given})

    @property
    def folder(self) -> Path:
        """From where names of files are seen."""
        return self._folder

    @property
    def output_folder(self) -> Path:
        """Where the results go."""
        return self._folder / self.output

    def contents(self) -> dict[str, Any]:
        """All keys that decide the results, without those of the run: for comparing jobs."""
        how = {*RunTable.model_fields, "output"}
        return self.model_dump(mode="json", exclude=how, exclude_defaults=True)


# Headers of a commented job file with their tables and comments; "" is the file itself.
_TABLES: tuple[tuple[str, type[Table], str], ...] = (
    ("", JobSpec, ""),
    ("[inputs]", InputTable, "your own files, in place of the [[scenes]] below"),
    ("inputs.layout", LayoutTable, "how the files are read, as by read_lightfield in Python"),
    ("[simulations]", SimulationTable, "light fields of a camera file"),
    ("[simulations.sweep]", SweepTable, "one item for each combination of all sweeps"),
    ("[scenes]", SceneTable, "scenes whose depth is known exactly"),
    ("[scenes.sweep]", SweepTable, "keys: shape, views and noise, or those of the camera file"),
    ("stack", StackTable, "pictures refocused at many planes"),
    ("depth", DepthTable, "disparity, confidence, and alpha and z where they are known"),
    ("all_in_focus", AllInFocusTable, "sharp everywhere; by the depth map where there is one"),
    ("views", ViewsTable, "single views"),
    ("light_field", LightFieldTable, "the light field, as it was decoded"),
    ("deconvolve", DeconvolveTable, "the volume behind raw frames of a light-field microscope"),
    ("raw", RawTable, "the raw image of simulations and scenes; it has no keys"),
)
_SHOWN: dict[str, dict[str, Any]] = {  # keys that are not commented out
    "": {"output": "results"},
    "[scenes]": {"kind": ["bars", "spheres"], "shape": [128, 128], "views": [5, 5]},
    "stack": {"disparities": "-2:2:41"},
}
_EXAMPLES = {"[scenes.sweep]": {"key": "noise", "values": [0.0, 0.1], "name": "noise"}}
_HIDDEN = {"deconvolve": ("start", "motion_um", "batch", "rolling")}  # of series, refused in jobs
_INTRODUCTION = """\
# Many light fields, and what is made of each: clplen batch job.toml
# Keys and tables that begin with # are left out. Names of files are seen from the folder of this
# file. Inputs are any of [[inputs]], [[simulations]] and [[scenes]], several of each; of each input
# is made what the other tables ask for. Planes are "START:STOP:N" or a list of numbers.
"""


def commented_job() -> str:
    """Return a job file that shows every key with a comment."""
    parts = [_INTRODUCTION]
    for header, model, words in _TABLES:
        shown = _SHOWN.get(header, {})
        examples, hidden = _EXAMPLES.get(header, {}), _HIDDEN.get(header, ())
        lines = list(commented(model, shown=shown, examples=examples, hidden=hidden))
        if header:
            key = f"{'' if shown else '# '}[{header}]"
            lines.insert(0, f"{key:<31} # {words}")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)
