"""The commented job file."""

from __future__ import annotations

import re
from pathlib import Path

from clplen.batch import Job
from clplen.batch.jobs.spec import commented_job
from clplen.cameras.scenes.gallery import SCENES


def test_the_example_is_a_job(tmp_path: Path):
    text = commented_job()
    assert "One of linear, nearest," in text
    assert text.count("ome-zarr") == 1  # the description already lists the choices
    assert all(re.search(rf"\b{kind}\b", text) for kind in SCENES)
    (tmp_path / "job.toml").write_text(text)
    job = Job.read(tmp_path / "job.toml")
    assert job.output_folder == tmp_path / "results"
    assert not job.inputs  # it runs where there are no files yet
    assert [one.kind for one in job.scenes] == [["bars", "spheres"]]
    assert job.stack is not None
    assert job.stack.disparities is not None
    assert len(job.stack.disparities) == 41
    assert job.depth is None
    assert not job.simulations


def test_all_that_the_example_has_in_comments_is_valid(tmp_path: Path):
    """But for one of two keys that exclude each other."""
    table, lines, left_out = "", [], {("[[scenes]]", "camera"), ("[deconvolve]", "lattic")}
    for line in commented_job().split("\n\n", 1)[1].splitlines():
        text = line.removeprefix("# ")
        table = text.partition(" ")[0] if text.startswith("[") else table
        if not text.startswith("alphas") and (table, text[:6]) not in left_out:
            lines.append(text)
    assert max(map(len, lines)) <= 100
    (tmp_path / "job.toml").write_text("\n".join(lines))
    job = Job.read(tmp_path / "job.toml")
    assert job.memory == 4 << 30
    assert job.inputs[0].layout.max_bytes == 2 << 30
    assert job.simulations[0].sweep[0].key == "scene.points_mm.*.2"
    assert job.scenes[0].sweep[0].values == [0.0, 0.1]
    assert job.depth is not None
    assert job.views is not None
    assert job.views.at == [(4, 4), (0, 4)]
    assert None not in (job.light_field, job.raw, job.all_in_focus)
