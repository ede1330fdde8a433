"""The items of a job: one for each light field, with a name of its own."""

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

# Words of layout that may name files; a calibration may be a folder.
_BESIDE = ("white", "dark", "grid", "calibration", "positions", "intrinsics")
_NAMES = "names"  # the one word of positions that is no file


def tasks_of(job: JobSpec) -> list[Task]:
    """What the job asks for, in the order of its tables."""
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
    return [Task(one.name, output, one.words, work, base, (*one.files, *shared)) for one in sources]


def _shared(job: JobSpec) -> tuple[str, ...]:
    """Files that all items read."""
    if job.deconvolve is None:
        return ()
    psf = job.deconvolve.psf
    if not (job.folder / psf).is_file():
        raise FormatError(
            f"deconvolve.psf: there is no file {job.folder / psf}: mend the name, or make it by "
            "'clplen microscope psf'."
        )
    beside = (job.deconvolve.mask, job.deconvolve.lattice)
    return (psf, *(name for name in beside if name is not None))


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
    found: dict[str, None] = {}
    output = Path(os.path.realpath(job.output_folder))
    beside = {os.path.realpath(job.folder / layout[word]) for word in _BESIDE if word in layout}
    for pattern in inputs.files:
        matches = sorted(glob.glob(pattern, root_dir=job.folder, recursive=True))
        real = (Path(os.path.realpath(job.folder / path)) for path in matches)
        outside = [
            path for path, at in zip(matches, real, strict=True) if not _is_inside(at, output)
        ]
        if not outside:
            raise FormatError(
                f"{key}.files: {pattern!r} names no file in {job.folder}: mend the pattern."
                if not matches
                else f"{key}.files: {pattern!r} names only what lies in the output {output}: give "
                "the job another output."
            )
        found |= dict.fromkeys(
            path for path in outside if os.path.realpath(job.folder / path) not in beside
        )
    for index, path in enumerate(found):
        words = {"kind": "file", "path": path, "layout": layout}
        name = _name(inputs.name, path, index, key)
        yield Source(name, words, _files_of(path, layout, job.folder))


def _layout(inputs: InputTable, folder: Path, key: str) -> dict[str, Any]:
    """The words that were given; files that they name are there."""
    words = inputs.layout.model_dump(mode="json", exclude_defaults=True)
    for word in _BESIDE:
        if word in words and words[word] != _NAMES and not (folder / words[word]).exists():
            raise FormatError(
                f"{key}.layout.{word}: there is no file {folder / words[word]}: mend the name."
            )
    return words


def layout_in(words: dict[str, Any], base: str) -> dict[str, Any]:
    """The words of layout as the readers take them: files seen from the folder of the job."""
    known = {
        word: str(Path(base, value)) if word in _BESIDE and value != _NAMES else value
        for word, value in words.items()
    }
    return known | ({"views": tuple(known["views"])} if "views" in known else {})


def _files_of(path: str, layout: dict[str, Any], folder: Path) -> tuple[str, ...]:
    """The files of a light field; where they cannot be told, reading it says why."""
    named = [layout[word] for word in _BESIDE if layout.get(word, _NAMES) != _NAMES]
    beside = [name for name in named if not (folder / name).is_dir()]
    try:
        inside = files_of(folder / path, **layout_in(layout, str(folder)))
    except (ClplenError, ValueError, OSError):
        return (path, *beside)
    own = [file for file in inside if _is_inside(file, folder / path)]
    return (*(os.path.relpath(file, folder) for file in own), *beside) if own else (path, *beside)


def _is_inside(path: Path, folder: Path) -> bool:
    return folder == path or folder in path.parents


def _name(template: str, path: str, index: int, key: str) -> str:
    file = Path(path)
    words = {
        "stem": file.name if file.suffix == "" else file.stem,
        "name": file.name,
        "parent": file.parent.name,
        "path": PurePosixPath(file.parent, file.stem).as_posix().lstrip("/"),
        "index": index,
    }
    try:
        name = template.format(**words)
    except (KeyError, IndexError, ValueError, AttributeError, TypeError) as error:
        raise FormatError(
            f"{key}.name: {template!r} is no name: it may hold "
            f"{', '.join('{' + word + '}' for word in words)}, such as '{{parent}}_{{stem}}'."
        ) from error
    _check_name(name, key)
    return name


def _check_name(name: str, key: str) -> None:
    parts = PurePosixPath(name).parts
    if not parts or any(part.startswith(".") for part in parts) or name.startswith("/"):
        raise FormatError(
            f"{key}.name: an item cannot have the name {name}: its folder lies in the output's, "
            "and begins with no dot; give another, such as name = 'views'."
        )


def _check_names(sources: list[Source]) -> None:
    """One folder for each item, none in another's."""
    first: dict[str, Source] = {}
    for source in sources:
        name = source.name.casefold()  # some disks know no difference
        if name in first:
            raise FormatError(
                f"Two inputs, {_described(first[name])} and {_described(source)}, have the output "
                f"name {source.name}: give their table a name, such as "
                "name = '{parent}_{stem}'."
            )
        first[name] = source
    for name, source in first.items():
        for above in PurePosixPath(name).parents:
            if str(above) in first:
                raise FormatError(
                    f"The outputs of {source.name} would lie in those of "
                    f"{first[str(above)].name}: give one of them another name."
                )


def _described(source: Source) -> str:
    return str(source.words.get("path", source.name))
