"""The commented job file."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from clplen.batch import Job
from clplen.batch.jobs.sweep import SweepTable
from clplen.batch.jobs.tables import (
    EXAMPLE,
    AllInFocusTable,
    DeconvolveTable,
    DepthTable,
    InputTable,
    LayoutTable,
    LightFieldTable,
    RawTable,
    SceneTable,
    SimulationTable,
    StackTable,
    ViewsTable,
)
from clplen.cameras.scenes.gallery import SCENES
from clplen.config.tables import Table

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TABLES: dict[str, type[Table]] = {
    "": Job,
    "inputs": InputTable,
    "inputs.layout": LayoutTable,
    "simulations": SimulationTable,
    "simulations.sweep": SweepTable,
    "scenes": SceneTable,
    "scenes.sweep": SweepTable,
    "stack": StackTable,
    "depth": DepthTable,
    "all_in_focus": AllInFocusTable,
    "views": ViewsTable,
    "light_field": LightFieldTable,
    "deconvolve": DeconvolveTable,
    "raw": RawTable,
}
NO_DEFAULT = "default:", "needed"  # what comments of such keys say
LINES = EXAMPLE.splitlines()
HEADER = re.compile(r"(# )?\[+([\w.]+)\]+( |$)")


def shown(line: str) -> tuple[str, str]:
    """Key and value of a line of the example."""
    key, _, value = line.lstrip("# ").partition(" = ")
    return key, value.partition(" #")[0].strip()


def by_table() -> dict[str, list[str]]:
    """The lines with keys below each header."""
    table = ""
    found: dict[str, list[str]] = {"": []}
    for line in LINES:
        if header := HEADER.match(line):
            table = header[2]
            found[table] = []
        elif " = " in line:
            found[table].append(line)
    return found


def uncommented() -> str:
    """Everything at once, but for one of two keys that exclude each other."""
    taken, table = [], ""
    for line in LINES:
        if header := HEADER.match(line):
            table = header[2]
        key = shown(line)[0] if " = " in line else ""
        if key == "disparities" and table != "all_in_focus":
            continue
        if (table, key) in (("scenes", "camera"), ("deconvolve", "lattice")):
            continue
        taken.append(line.removeprefix("# ") if key or header else line)
    return "\n".join(taken)


def test_the_example_is_a_job(tmp_path: Path):
    (tmp_path / "job.toml").write_text(EXAMPLE)
    job = Job.read(tmp_path / "job.toml")
    assert job.output_folder == tmp_path / "results"
    assert not job.inputs  # it runs where there are no files yet
    assert [one.kind for one in job.scenes] == [["bars", "spheres"]]
    assert job.stack is not None
    assert job.stack.disparities is not None
    assert len(job.stack.disparities) == 41
    assert job.depth is None
    assert not job.simulations


def test_the_example_shows_every_key():
    found = by_table()
    assert list(found) == list(TABLES)
    for table, model in TABLES.items():
        inner = {name.rpartition(".")[2] for name in TABLES if name.rpartition(".")[0] == table}
        known = [name for name in model.model_fields if name not in inner]
        assert sorted(shown(line)[0] for line in found[table]) == sorted(known), table


def test_the_example_shows_every_default():
    """What is commented out, taken in, changes nothing, unless its comment says otherwise."""
    judged = []
    for table, lines in by_table().items():
        fields = TABLES[table].model_fields
        for line in lines:
            key, value = shown(line)
            if not line.startswith("# ") or any(word in line for word in NO_DEFAULT):
                continue
            says = tomllib.loads(f"value = {value}")["value"]
            default = fields[key].default
            assert says == (list(default) if isinstance(default, tuple) else default), line
            judged.append(key)
    assert len(judged) == 20, judged


def test_what_needs_a_value_says_so():
    for table, lines in by_table().items():
        for line in lines:
            key, needed = shown(line)[0], "needed" in line
            if table:
                assert needed == TABLES[table].model_fields[key].is_required(), line


def test_what_the_example_has_in_comments_is_valid(tmp_path: Path):
    (tmp_path / "job.toml").write_text(uncommented())
    job = Job.read(tmp_path / "job.toml")
    assert job.memory == 4 << 30
    assert job.inputs[0].layout.max_bytes == 2 << 30
    assert job.simulations[0].sweep[0].key == "scene.points_mm.*.2"
    assert job.scenes[0].sweep[0].values == [0.0, 0.1]
    assert job.depth is not None
    assert job.views is not None
    assert job.views.at == [(4, 4), (0, 4)]
    assert None not in (job.light_field, job.raw, job.all_in_focus)


@pytest.mark.parametrize("kind", SCENES)
def test_the_example_names_every_scene(kind: str):
    assert re.search(rf"\b{kind}\b", EXAMPLE)


def test_lines_are_no_longer_than_those_of_the_package():
    assert max(map(len, LINES)) <= 100
