"""What was found fastest is kept, and never changes a result."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from tolerance import relative_max

from clplen.compute.tuning import FILE, Tuning
from clplen.errors import DeviceError, KernelBuildError
from clplen.lightfield.arrays import shear
from clplen.lightfield.arrays.shear import FORMS, shear_sum

LABELS = ["first", "second", "third"]
SECOND = {"first": 0.02, "second": 0.0, "third": 0.02}  # the fastest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache folder of its own, and tuning as it is without settings."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("CLPLEN_TUNING", raising=False)
    monkeypatch.delenv("CLPLEN_SHEAR", raising=False)
    return tmp_path / "clplen"


def waiting(seconds, log=None):
    """A run of each label that takes so long."""

    def run(label):
        if log is not None:
            log.append(label)
        time.sleep(seconds[label])
        return 1.0

    return run


def test_the_fastest_is_taken_and_kept(device, folder):
    seconds = {"first": 0.03, "second": 0.01, "third": 0.02}
    assert Tuning(device).lookup("shear.cl", "some", LABELS) is None
    assert Tuning(device).fastest("shear.cl", "some", LABELS, waiting(seconds)) == "second"
    other = Tuning(device)
    assert other.lookup("shear.cl", "some", LABELS) == "second"
    assert other.lookup("shear.cl", "others", LABELS) is None
    assert other.lookup("views.cl", "some", LABELS) is None
    assert other.lookup("shear.cl", "some", ["first", "third"]) is None
    assert len(list(folder.iterdir())) == 1
    log = []  # as another thread, which the first one waited for
    assert Tuning(device).fastest("shear.cl", "some", LABELS, waiting(seconds, log)) == "second"
    assert log == []


def test_off(device, folder, monkeypatch):
    Tuning(device).fastest("shear.cl", "some", LABELS, waiting(SECOND))
    monkeypatch.setenv("CLPLEN_TUNING", "off")
    log = []
    tuning = Tuning(device)
    assert tuning.lookup("shear.cl", "some", LABELS) is None
    assert tuning.fastest("shear.cl", "some", LABELS, waiting({}, log)) == "first"
    assert log == []


def test_a_foreign_file_is_ignored_and_written_anew(device, folder):
    folder.mkdir()
    for text in ("{", '{"format": "another", "found": {}}', '{"format": "clplen tuning 1"}'):
        (folder / FILE).write_text(text)
        tuning = Tuning(device)
        with pytest.warns(RuntimeWarning, match=r"tuning\.json is not a tuning cache"):
            assert tuning.lookup("shear.cl", "some", LABELS) is None
        tuning.fastest("shear.cl", "some", LABELS, waiting(SECOND))
        assert Tuning(device).lookup("shear.cl", "some", LABELS) == "second"


def test_what_other_processes_found_stays(device, folder):
    one, other = Tuning(device), Tuning(device)
    for tuning, problem in ((one, "a"), (other, "b"), (one, "c")):
        tuning.lookup("shear.cl", problem, LABELS)
        tuning.fastest("shear.cl", problem, LABELS, waiting(dict.fromkeys(LABELS, 0.0)))
    held = json.loads((folder / FILE).read_text())["found"]
    assert [key[-1] for key in held] == ["a", "b", "c"]


def test_a_file_that_cannot_be_replaced(device, folder):
    (folder / FILE).mkdir(parents=True)
    tuning = Tuning(device)
    tuning.fastest("shear.cl", "x", LABELS, waiting(SECOND))
    assert tuning.lookup("shear.cl", "x", LABELS) == "second"
    assert [file.name for file in folder.iterdir()] == [FILE]


def sums(device, shape=(3, 4, 45, 301, 3), planes=5):
    rng = np.random.default_rng(1)
    data = device.upload(rng.uniform(20, 250, shape).astype(np.float32))
    d = np.linspace(-1.4, 1.1, planes)
    moves = [np.outer(d, (n - 1) / 2 - np.arange(n)) for n in shape[:2]]
    return device.download(shear_sum(data, np.ones(shape[:2]), *moves, device=device))


def test_tuned_sums_have_the_same_bits(device, folder, monkeypatch):
    monkeypatch.setattr(device, "rows", True)
    monkeypatch.setattr(shear, "_MIN_TUNED_SECONDS", 0.0)
    monkeypatch.setattr(shear, "_TRIAL_SECONDS", 1e-4)
    monkeypatch.setitem(device.__dict__, "tuning", Tuning(device))
    monkeypatch.setenv("CLPLEN_TUNING", "off")
    want = sums(device)
    assert not folder.exists()
    monkeypatch.delenv("CLPLEN_TUNING")
    blocks = []
    launch = shear._launch_blocks
    monkeypatch.setattr(
        shear, "_launch_blocks", lambda *args: (blocks.append(args[1].label), launch(*args))
    )
    np.testing.assert_array_equal(sums(device), want)
    assert len(set(blocks)) > 1
    (key,) = json.loads((folder / FILE).read_text())["found"]
    for label in set(blocks):  # whichever was found
        found = {"format": "clplen tuning 1", "found": {key: label}}
        (folder / FILE).write_text(json.dumps(found))
        monkeypatch.setitem(device.__dict__, "tuning", Tuning(device))
        blocks.clear()
        np.testing.assert_array_equal(sums(device), want)
        assert set(blocks) == {label}


def test_every_form_can_be_forced(device, monkeypatch):
    want, files = sums(device), []
    kernel = type(device).kernel
    monkeypatch.setattr(
        type(device), "kernel", lambda *args, **d: (files.append(d), kernel(*args, **d))[1]
    )
    for form in FORMS:
        files.clear()
        monkeypatch.setenv("CLPLEN_SHEAR", form)
        # round-off of 12 views, weights and a division: see tests/kernels/test_shear.py
        assert relative_max(want, sums(device)) <= 24 * 2.0**-24
        assert {"blocks": "LANES", "staged": "GROUP", "samples": "HEIGHT"}[form] in files[0]
        assert ("GROUP" in files[0]) == (form == "staged")
    monkeypatch.setenv("CLPLEN_SHEAR", "tiles")
    with pytest.raises(ValueError, match="must be one of blocks, staged, samples, got 'tiles'"):
        sums(device)


@pytest.mark.parametrize("rows", [True, False])
def test_a_form_that_does_not_run_is_left(device, rows, monkeypatch):
    monkeypatch.setattr(device, "rows", rows)
    monkeypatch.setitem(device.__dict__, "tuning", Tuning(device))
    first = shear._forms(device)[0]
    want = sums(device)
    tried = []

    def refused(work):
        tried.append(1)
        raise KernelBuildError("The compiler gave up.\nlog")

    monkeypatch.setitem(shear._ENQUEUE, first, refused)
    for _ in range(2):
        assert relative_max(want, sums(device)) <= 24 * 2.0**-24
    assert len(tried) == 1
    note = f"without shear {first} (The compiler gave up.)"
    assert device.tuning.note == note
    assert repr(device).endswith(f", {note}>")


def test_no_form_that_sums(device, monkeypatch):
    for form in FORMS:
        monkeypatch.setitem(shear._ENQUEUE, form, lambda work: False)
    with pytest.raises(DeviceError, match="runs no form of shear"):
        sums(device)


def test_work_counts(device):
    """Twice the work in one and a half times the time is faster."""
    seconds = {"first": 0.02, "second": 0.03}

    def run(label):
        time.sleep(seconds[label])
        return 2.0 if label == "second" else 1.0

    assert Tuning(device).fastest("shear.cl", "some", LABELS[:2], run) == "second"


def test_no_more_than_a_second(device, monkeypatch):
    monkeypatch.setattr("clplen.compute.tuning._BUDGET", 0.05)
    log = []
    run = waiting(dict.fromkeys(LABELS, 0.06), log)
    assert Tuning(device).fastest("shear.cl", "some", LABELS, run) == "first"
    assert log == ["first"]
