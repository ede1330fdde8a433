"""A job: what is read, what is made of it, and where it goes. TOML, or from Python."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, model_validator

from clplen.batch.jobs.tables import (
    WORK,
    AllInFocusTable,
    DeconvolveTable,
    DepthTable,
    Format,
    HowTable,
    InputTable,
    LightFieldTable,
    RawTable,
    SceneTable,
    SimulationTable,
    StackTable,
    ViewsTable,
)
from clplen.config.reading import problems_of, read_toml, validated
from clplen.config.tables import listed
from clplen.errors import FormatError
from clplen.files import PathLike

if TYPE_CHECKING:
    from clplen.batch.running.runner import Summary, Watcher


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
    stack, depth, all_in_focus, views, light_field, deconvolve, raw
        What is made; at least one, or simulations and scenes, which write all that they know.
    device : str or None
        As for `Device.open`; a list gives each worker its own.
    memory : int or None
        Bytes that light field, results and what lies between may take in each worker; beyond it
        light fields are streamed. None: half of the free memory, shared by the workers.
    workers : int
        Processes on this computer; more than one needs the extra ``batch``.
    certificates : str or None
        Folder of ``clplen batch --make-certificates``, by which workers on several computers know
        each other; seen from the job file.
    retries : int
        How often an item that failed for a reason that may pass, or was lost, is tried again.
    """

    output: str
    formats: Annotated[list[Format], BeforeValidator(listed)] = Field(
        default=["ome-tiff"], min_length=1
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
    def _not_empty(self) -> Job:
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
        certificates: PathLike | None = None,
    ) -> Job:
        """The same job done otherwise; see `run`."""
        given = {"workers": workers, "device": device, "memory": memory}
        if certificates is not None:
            given["certificates"] = str(Path(certificates).absolute())
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
        host: str | None = None,
        certificates: PathLike | None = None,
        insecure: bool = False,
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
            Address of a Dask scheduler whose workers do it, ``tls://host:8786``.
        device : str or list of str, optional
            As for `Device.open`, a list for each worker its own; default: as the job says. Workers
            of a scheduler have theirs.
        memory : int or str, optional
            Bytes or a size such as "4 GiB" of each worker; default: as the job says.
        host : str, optional
            Address or name of this computer on which workers listen, so that others may join;
            default: 127.0.0.1.
        certificates : path-like, optional
            Folder of `make_certificates`; default: as the job says.
        insecure : bool
            Whether to go without TLS, also beyond this computer: anyone who reaches the ports runs
            programs as this user.
        force : bool
            Whether a job that differs from the one that ran before may go on in its output.
        watcher : Watcher, optional
            Is told how it goes on; see `clplen.batch.running.runner.Watcher`.

        Returns
        -------
        Summary
            ``failed`` has a sentence for each item that failed; the others are done.

        Raises
        ------
        FormatError
            If a value is out of range, the items cannot be told, the job differs from the one that
            ran before, certificates cannot be used, or the extra ``batch`` is needed and not
            installed.
        ValueError
            If ``host`` or ``scheduler`` is reached from beyond this computer without certificates
            and not ``insecure``, or ``host`` is no address of it.
        DeviceError
            If there is no such device, or the workers cannot do the job.
        BlockingIOError
            If another process is at work on the output.
        OSError
            If the output takes no files.
        """
        from clplen.batch.running.executors import executor_of
        from clplen.batch.running.runner import Silent, run_job

        job = self.done_by(workers=workers, device=device, memory=memory, certificates=certificates)
        watcher = watcher or Silent()
        executor = executor_of(
            job, scheduler=scheduler, host=host, insecure=insecure, running=watcher.running
        )
        return run_job(job, executor, watcher=watcher, force=force)

    @property
    def folder(self) -> Path:
        """From where names of files are seen."""
        return self._folder

    @property
    def output_folder(self) -> Path:
        """Where the results go."""
        return self._folder / self.output

    @property
    def certificates_folder(self) -> Path | None:
        """Where the certificates are."""
        return None if self.certificates is None else self._folder / self.certificates

    def what(self) -> dict[str, Any]:
        """What decides the results, without how they are computed: for comparing jobs."""
        how = {*HowTable.model_fields, "output"}
        return self.model_dump(mode="json", exclude=how, exclude_defaults=True)
