"""Content of a job file: inputs, operations and output."""

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
    """Inputs, operations and output of a job; `clplen.batch.Job` runs it."""

    output: str = setting(
        ..., "Folder of the results; each item has its own folder inside.", example="results"
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
                "the job has inputs but no operation: give [stack], [depth], [all_in_focus], "
                "[views], [light_field] or [deconvolve]"
            )
        unused = [
            f"inputs.{i}.layout.{key}"
            for i, table in enumerate(self.inputs)
            for key in sorted(table.layout.model_fields_set - {"white", "dark", "force"})
        ]
        if unused and not any(getattr(self, name) is not None for name in WORK[:-2]):
            raise ValueError(f"{unused[0]} is not used by [deconvolve]: leave it out")
        return self

    @classmethod
    def read(cls: type[Spec], path: PathLike) -> Spec:
        """Read a job file.

        Parameters
        ----------
        path : path-like
            TOML file as printed by ``clplen batch --example``. Relative paths in it are resolved
            against its folder.

        Returns
        -------
        Job

        Raises
        ------
        FormatError
            If the file does not exist or is not TOML, or a key is unknown (the message suggests
            the nearest valid key), missing, out of range or inconsistent with others.
        """
        path = Path(path)
        content = read_toml(path, f"job file {path}; 'clplen batch --example' prints one")
        return validated(cls, content, path).relative_to(path.parent)

    def relative_to(self: Spec, folder: PathLike) -> Spec:
        """Return a copy of the job that resolves relative paths against a folder."""
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
        """Return a copy of the job with other run settings; see `clplen.batch.run_job`."""
        settings = {"workers": workers, "device": device, "memory": memory}
        settings = {name: value for name, value in settings.items() if value is not None}
        try:
            table = RunTable.model_validate(settings)
        except ValidationError as error:
            raise FormatError(f"{problems_of(RunTable, error)}.") from error
        return self.model_copy(update={name: getattr(table, name) for name in settings})

    @property
    def folder(self) -> Path:
        """Folder that relative paths are resolved against."""
        return self._folder

    @property
    def output_folder(self) -> Path:
        """Folder of the results."""
        return self._folder / self.output

    def contents(self) -> dict[str, Any]:
        """Return the settings that affect the results, for comparing jobs."""
        run_settings = {*RunTable.model_fields, "output"}
        return self.model_dump(mode="json", exclude=run_settings, exclude_defaults=True)


# Headers of a commented job file with their models and comments; "" is the top level.
_TABLES: tuple[tuple[str, type[Table], str], ...] = (
    ("", JobSpec, ""),
    ("[inputs]", InputTable, "your files, instead of the [[scenes]] below"),
    ("inputs.layout", LayoutTable, "layout of the files, as in read_lightfield"),
    ("[simulations]", SimulationTable, "light fields of a camera file"),
    ("[simulations.sweep]", SweepTable, "one item for each combination of all sweeps"),
    ("[scenes]", SceneTable, "synthetic scenes with exact depth"),
    ("[scenes.sweep]", SweepTable, "keys: shape, views, noise, or keys of the camera file"),
    ("stack", StackTable, "pictures refocused at many planes"),
    ("depth", DepthTable, "disparity, confidence; alpha and z if the camera is known"),
    ("all_in_focus", AllInFocusTable, "sharp everywhere; uses the map of [depth] if present"),
    ("views", ViewsTable, "single views"),
    ("light_field", LightFieldTable, "decoded light field"),
    ("deconvolve", DeconvolveTable, "volumes from raw frames of a light-field microscope"),
    ("raw", RawTable, "raw image of simulations and scenes; has no keys"),
)
_ACTIVE_KEYS: dict[str, dict[str, Any]] = {  # keys that are not commented out
    "": {"output": "results"},
    "[scenes]": {"kind": ["bars", "spheres"], "shape": [128, 128], "views": [5, 5]},
    "stack": {"disparities": "-2:2:41"},
}
_EXAMPLES = {"[scenes.sweep]": {"key": "noise", "values": [0.0, 0.1], "name": "noise"}}
_HIDDEN = {"deconvolve": ("start", "motion_um", "batch", "rolling")}  # for series only
_INTRODUCTION = """\
# Batch job for many light fields: clplen batch job.toml
# Remove the # to activate a key or table. Relative paths are resolved against the folder of this
# file. Light fields come from any number of [[inputs]], [[simulations]] and [[scenes]]; the other
# tables are applied to each of them. Planes are "START:STOP:N" or a list of numbers.
"""


def commented_job() -> str:
    """Return a job file with a comment on every key."""
    parts = [_INTRODUCTION]
    for header, model, comment in _TABLES:
        active = _ACTIVE_KEYS.get(header, {})
        examples, hidden = _EXAMPLES.get(header, {}), _HIDDEN.get(header, ())
        lines = list(commented(model, active=active, examples=examples, hidden=hidden))
        if header:
            key = f"{'' if active else '# '}[{header}]"
            lines.insert(0, f"{key:<31} # {comment}")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)
