"""The job file: what it says, and what is said about a wrong one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clplen.batch import Job
from clplen.batch.jobs.items import tasks_of
from clplen.batch.running.runner import check_settings
from clplen.errors import FormatError
from clplen.settings.light_fields import planes_of
from clplen.units import bytes_of

BASE = 'output = "out"\n[[inputs]]\nfiles = "in/*.npy"\n'


def read(tmp_path: Path, text: str) -> Job:
    path = tmp_path / "job.toml"
    path.write_text(text, encoding="utf-8")
    return Job.read(path)


def inputs(tmp_path: Path, *names: str) -> None:
    for name in names:
        path = tmp_path / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.ones((2, 2, 8, 9), np.uint8))


def test_a_job_is_read(tmp_path: Path):
    job = read(tmp_path, f'memory = "2 GiB"\n{BASE}[stack]\ndisparities = "-1:1:5"\n')
    assert job.memory == 2 << 30
    assert job.stack is not None
    assert job.stack.disparities == [-1, -0.5, 0, 0.5, 1]
    assert job.formats == ["ome-tiff"]
    assert job.output_folder == tmp_path / "out"


def test_a_job_is_made_in_python(tmp_path: Path):
    inputs(tmp_path, "a.npy")
    job = Job(output="out", inputs=[{"files": "in/*.npy"}], stack={"disparities": [0.0, 0.5]})
    (task,) = tasks_of(job.relative_to(tmp_path))
    assert task.name == "a"
    assert task.files == ("in/a.npy",)
    assert task.work["stack"]["disparities"] == [0.0, 0.5]


def test_a_wrong_job_gets_one_sentence(tmp_path: Path):
    for text, said in (
        (f"{BASE}[stack]\ndisparites = [0]\n", "stack.disparites; did you mean disparities?"),
        (f"worker = 2\n{BASE}[stack]\n", "unknown key worker; did you mean workers?"),
        (f"{BASE}[inputs.layout]\nflip = true\n[stack]\n", "inputs.0.layout.flip; did you mean"),
        (BASE, "has inputs but no operation"),
        ('output = "out"\n[stack]\n', "no light fields"),
        ("[[inputs]]\nfiles = 'a'\n[stack]\n", "output is missing"),
        (f"{BASE}[stack]\ndisparities = '1:2'\n", "START:STOP:N"),
        (f"{BASE}[stack]\ndisparities = '1:1:3'\n", "two different ends"),
        (f"{BASE}[stack]\ndisparities = [0]\nalphas = [1]\n", "alphas and disparities"),
        (f"{BASE}[stack]\naperture = 'wide'\n", "f/66"),
        (f"memory = 'much'\n{BASE}[stack]\n", "512MiB"),
        (f"workers = 0\n{BASE}[stack]\n", "workers must be 1 or more"),
        (f"{BASE}[depth]\ncue = 'best'\n", "'combined'"),
        ("output = ", "is not TOML"),
    ):
        with pytest.raises(FormatError) as caught:
            read(tmp_path, text)
        assert said in str(caught.value)
        assert str(tmp_path / "job.toml") in str(caught.value)
        assert "\n" not in str(caught.value)


def test_no_job_file(tmp_path: Path):
    with pytest.raises(FormatError, match=r"no job file .* 'clplen batch --example'"):
        Job.read(tmp_path / "job.toml")


def test_a_pattern_without_files_is_refused(tmp_path: Path):
    job = read(tmp_path, f"{BASE}[stack]\n")
    with pytest.raises(FormatError, match=r"inputs\.0\.files: 'in/\*\.npy' matches no file"):
        tasks_of(job)


def test_two_inputs_of_one_name_are_refused(tmp_path: Path):
    inputs(tmp_path, "one/a.npy", "two/a.npy")
    text = BASE.replace("*.npy", "*/*.npy")
    with pytest.raises(FormatError, match=r"in/one/a\.npy and in/two/a\.npy.* name a:.*parent"):
        tasks_of(read(tmp_path, f"{text}[stack]\n"))
    text = text + 'name = "{parent}_{stem}"\n'
    names = [task.name for task in tasks_of(read(tmp_path, f"{text}[stack]\n"))]
    assert names == ["one_a", "two_a"]


def test_a_name_stays_in_the_output(tmp_path: Path):
    for name in ("../{stem}", "/tmp/{stem}", ".{stem}", "{what}", "", "{index[0]}"):
        inputs(tmp_path, "a.npy")
        with pytest.raises(FormatError, match=r"inputs\.0\.name"):
            tasks_of(read(tmp_path, f'{BASE}name = "{name}"\n[stack]\n'))


def test_an_item_in_another_is_refused(tmp_path: Path):
    inputs(tmp_path, "a.npy", "a/b.npy")
    text = 'output = "out"\n[[inputs]]\nfiles = ["in/*.npy", "in/*/*.npy"]\nname = "{path}"\n'
    with pytest.raises(FormatError, match="would lie inside that of"):
        tasks_of(read(tmp_path, f"{text}[stack]\n"))


def test_the_outputs_are_no_inputs(tmp_path: Path):
    inputs(tmp_path, "a.npy")
    np.save(tmp_path / "in" / "b.npy", np.ones(3))
    text = 'output = "in/out"\n[[inputs]]\nfiles = "in/**/*.npy"\n[stack]\n'
    (tmp_path / "in/out").mkdir()
    np.save(tmp_path / "in/out/c.npy", np.ones(3))
    assert [task.name for task in tasks_of(read(tmp_path, text))] == ["a", "b"]


def test_the_outputs_are_no_inputs_by_another_way(tmp_path: Path):
    """The folder of the job with .. in it, and an output behind a link."""
    inputs(tmp_path, "a.npy", "out/c.npy")
    (tmp_path / "link").symlink_to(tmp_path / "in" / "out")
    for output in (tmp_path / "in" / "out", tmp_path / "link"):
        job = Job(output=str(output), inputs=[{"files": "in/**/*.npy"}], stack={})
        within = tmp_path / "in" / ".."
        assert [task.name for task in tasks_of(job.relative_to(within))] == ["a"]
    job = Job(output=".", inputs=[{"files": "in/*.npy"}], stack={})
    with pytest.raises(FormatError, match="matches only files in the output"):
        tasks_of(job.relative_to(tmp_path))


def test_a_job_seen_from_elsewhere_is_another(tmp_path: Path):
    job = Job(output="out", inputs=[{"files": "*"}], stack={})
    one, two = job.relative_to(tmp_path / "one"), job.relative_to(tmp_path / "two")
    assert one.output_folder == tmp_path / "one" / "out"
    assert two.output_folder == tmp_path / "two" / "out"


def test_how_a_job_is_done_is_no_other_job(tmp_path: Path):
    job = Job(output="out", inputs=[{"files": "*"}], stack={}, workers=2).relative_to(tmp_path)
    other = job.with_settings(memory="2 kB", device="cpu")
    assert (other.workers, other.memory, other.device) == (2, 2000, ["cpu"])
    assert (other.folder, other.contents()) == (job.folder, job.contents())
    assert job.memory is None
    for how, said in (({"workers": 0}, "workers must be"), ({"memory": "much"}, "memory must be")):
        with pytest.raises(FormatError, match=said):
            job.with_settings(**how)


def test_a_white_image_has_to_be_there(tmp_path: Path):
    inputs(tmp_path, "a.npy")
    text = f'{BASE}[inputs.layout]\nwhite = "white.tif"\n[stack]\n'
    with pytest.raises(FormatError, match=r"inputs\.0\.layout\.white: the file .* does not exist"):
        tasks_of(read(tmp_path, text))


def test_what_differs_is_said(tmp_path: Path):
    old = read(tmp_path, f"{BASE}[stack]\ndisparities = [0.0, 1.0]\n")
    new = read(tmp_path, f"{BASE}[stack]\ndisparities = [0.0, 2.0]\n[depth]\n")
    with pytest.raises(FormatError) as caught:
        check_settings(old.contents(), new, force=False, output=tmp_path)
    for text in ("stack.disparities was [0.0, 1.0], is [0.0, 2.0]", "depth was missing", "force"):
        assert text in str(caught.value)
    check_settings(old.contents(), new, force=True, output=tmp_path)
    check_settings(None, new, force=False, output=tmp_path)
    how = read(tmp_path, f"workers = 3\nmemory = 5000\n{BASE}[stack]\ndisparities = [0.0, 1.0]\n")
    check_settings(old.contents(), how, force=False, output=tmp_path)


def test_parameters_tell_what_decides_the_result(tmp_path: Path):
    inputs(tmp_path, "a.npy")
    texts = [
        f"{BASE}[stack]\ndisparities = [0.0, 1.0]\n",
        f"{BASE}[stack]\ndisparities = '0:1:2'\n",
        f"{BASE}[stack]\ndisparities = [0.0, 2.0]\n",
        f"{BASE}[inputs.layout]\nflip_v = true\n[stack]\ndisparities = [0.0, 1.0]\n",
        f"formats = 'ome-zarr'\n{BASE}[stack]\ndisparities = [0.0, 1.0]\n",
    ]
    found = [tasks_of(read(tmp_path, text))[0].parameters for text in texts]
    assert found[0] == found[1]
    assert len(set(found)) == 4


def test_sizes_and_planes():
    assert [bytes_of(x) for x in (7, "7", "2 kB", "1.5 MiB", "3GB")] == [
        7,
        7,
        2000,
        3 << 19,
        3 * 10**9,
    ]
    for wrong in ("-1", "GB", True, 1.5, "1 XB"):
        with pytest.raises(ValueError, match="must be"):
            bytes_of(wrong)
    assert planes_of("0.5:0.5:1") == [0.5]
    for wrong in ([], ["a"], [True], [float("nan")], "0:1:1", 3):
        with pytest.raises(ValueError, match=r"must|needs"):
            planes_of(wrong)


def test_a_white_image_is_no_light_field(tmp_path: Path):
    inputs(tmp_path, "a.npy", "white.npy")
    text = f'{BASE}[inputs.layout]\nwhite = "in/white.npy"\n[stack]\n'
    assert [task.name for task in tasks_of(read(tmp_path, text))] == ["a"]


def test_single_brackets_are_one_table(tmp_path: Path):
    inputs(tmp_path, "a.npy")
    job = read(tmp_path, BASE.replace("[[inputs]]", "[inputs]") + "[stack]\n")
    assert [task.name for task in tasks_of(job)] == ["a"]
