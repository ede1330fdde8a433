"""Items of a job: a named task for each light field."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from clplen.batch.jobs.simulations import scenes_of, simulations_of
from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.tables import WORK, InputTable
from clplen.batch.jobs.task import Source, Task
from clplen.errors import ClplenError, FormatError
from clplen.io.lightfields.lightfield_files import files_of

# Layout settings that may be file names; a calibration may be a folder.
FILE_SETTINGS = ("white", "dark", "grid", "calibration", "positions", "intrinsics")
_NAMES = "names"  # positions = "names" is no file name


def tasks_of(job: JobSpec) -> list[Task]:
    """Return the tasks of a job, in the order of its tables."""
    sources = list(_sources(job))
    _check_names(sources)
    work: dict[str, Any] = {
        name: getattr(job, name).model_dump(mode="json", exclude_none=True)
        for name in WORK
        if getattr(job, name) is not None
    }
    work["formats"] = sorted(set(job.formats))
    output, base = str(job.output_folder), str(job.folder)
    shared = _shared(job)
    return [
        Task(source.name, output, source.origin, work, base, (*source.files, *shared))
        for source in sources
    ]


def _shared(job: JobSpec) -> tuple[str, ...]:
    """Return the files that all items read."""
    if job.deconvolve is None:
        return ()
    psf = job.deconvolve.psf
    if not (job.folder / psf).is_file():
        raise FormatError(
            f"deconvolve.psf: the file {job.folder / psf} does not exist: correct the name, or "
            "create the file with 'clplen microscope psf'."
        )
    others = (job.deconvolve.mask, job.deconvolve.lattice)
    return (psf, *(name for name in others if name is not None))


def _sources(job: JobSpec) -> Iterator[Source]:
    for i, inputs in enumerate(job.inputs):
        yield from _files(inputs, job, f"inputs.{i}")
    for i, simulation in enumerate(job.simulations):
        yield from _named(simulations_of(simulation, job.folder), f"simulations.{i}")
    for i, scene in enumerate(job.scenes):
        yield from _named(scenes_of(scene, job.folder), f"scenes.{i}")


def _named(sources: list[Source], key: str) -> list[Source]:
    for source in sources:
        _check_name(source.name, key)
    return sources


def _files(inputs: InputTable, job: JobSpec, key: str) -> Iterator[Source]:
    layout = _layout(inputs, job.folder, key)
    paths: dict[str, None] = {}
    output = Path(os.path.realpath(job.output_folder))
    auxiliary = {
        os.path.realpath(job.folder / layout[key]) for key in FILE_SETTINGS if key in layout
    }
    for pattern in inputs.files:
        matches = sorted(glob.glob(pattern, root_dir=job.folder, recursive=True))
        real = (Path(os.path.realpath(job.folder / path)) for path in matches)
        outside = [
            path for path, at in zip(matches, real, strict=True) if not _is_inside(at, output)
        ]
        if not outside:
            raise FormatError(
                f"{key}.files: {pattern!r} matches no file in {job.folder}: correct the pattern."
                if not matches
                else f"{key}.files: {pattern!r} matches only files in the output {output}: give "
                "the job another output."
            )
        paths |= dict.fromkeys(
            path for path in outside if os.path.realpath(job.folder / path) not in auxiliary
        )
    for index, path in enumerate(paths):
        origin = {"kind": "file", "path": path, "layout": layout}
        name = _name(inputs.name, path, index, key)
        yield Source(name, origin, _files_of(path, layout, job.folder))


def _layout(inputs: InputTable, folder: Path, key: str) -> dict[str, Any]:
    """Return the layout settings that differ from the defaults; check that their files exist."""
    layout = inputs.layout.model_dump(mode="json", exclude_defaults=True)
    for name in FILE_SETTINGS:
        if name in layout and layout[name] != _NAMES and not (folder / layout[name]).exists():
            raise FormatError(
                f"{key}.layout.{name}: the file {folder / layout[name]} does not exist: correct "
                "the name."
            )
    return layout


def absolute_layout(layout: dict[str, Any], base: str) -> dict[str, Any]:
    """Return layout settings for the readers, with paths relative to the folder of the job."""
    settings = {
        key: str(Path(base, value)) if key in FILE_SETTINGS and value != _NAMES else value
        for key, value in layout.items()
    }
    return settings | ({"views": tuple(settings["views"])} if "views" in settings else {})


def _files_of(path: str, layout: dict[str, Any], folder: Path) -> tuple[str, ...]:
    """Return the files of a light field; of an unreadable light field, its path."""
    names = [layout[key] for key in FILE_SETTINGS if layout.get(key, _NAMES) != _NAMES]
    auxiliary = [name for name in names if not (folder / name).is_dir()]
    try:
        files = files_of(folder / path, **absolute_layout(layout, str(folder)))
    except (ClplenError, ValueError, OSError):  # raised again when the item is read
        return (path, *auxiliary)
    inside = [os.path.relpath(file, folder) for file in files if _is_inside(file, folder / path)]
    return (*(inside or [path]), *auxiliary)


def _is_inside(path: Path, folder: Path) -> bool:
    return folder == path or folder in path.parents


def _name(template: str, path: str, index: int, key: str) -> str:
    file = Path(path)
    fields = {
        "stem": file.name if file.suffix == "" else file.stem,
        "name": file.name,
        "parent": file.parent.name,
        "path": PurePosixPath(file.parent, file.stem).as_posix().lstrip("/"),
        "index": index,
    }
    try:
        name = template.format(**fields)
    except (KeyError, IndexError, ValueError, AttributeError, TypeError) as error:
        raise FormatError(
            f"{key}.name: {template!r} is not a valid template: use "
            f"{', '.join('{' + name + '}' for name in fields)}, such as '{{parent}}_{{stem}}'."
        ) from error
    _check_name(name, key)
    return name


def _check_name(name: str, key: str) -> None:
    parts = PurePosixPath(name).parts
    if not parts or any(part.startswith(".") for part in parts) or name.startswith("/"):
        raise FormatError(
            f"{key}.name: an item name must be a path inside the output folder without leading "
            f"dots, got {name}: give another name, such as name = 'views'."
        )


def _check_names(sources: list[Source]) -> None:
    """Raise an error if two items have one folder, or an item lies in the folder of another."""
    first: dict[str, Source] = {}
    for source in sources:
        name = source.name.casefold()  # some file systems ignore case
        if name in first:
            raise FormatError(
                f"Two inputs, {_label(first[name])} and {_label(source)}, have the output name "
                f"{source.name}: set name in their table, such as name = '{{parent}}_{{stem}}'."
            )
        first[name] = source
    for name, source in first.items():
        for above in PurePosixPath(name).parents:
            if str(above) in first:
                raise FormatError(
                    f"The output folder of {source.name} would lie inside that of "
                    f"{first[str(above)].name}: give one of them another name."
                )


def _label(source: Source) -> str:
    return str(source.origin.get("path", source.name))
