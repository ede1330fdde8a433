"""The manifest: kept across processes, versions, full disks and folders that vanish."""

from __future__ import annotations

import errno
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from clplen.batch.jobs.task import Report
from clplen.batch.running.manifest import NAME, Manifest
from clplen.errors import FormatError


def report(name: str, state: str = "done") -> Report:
    return Report(name, state, "p", 1.5, {"a": {"bytes": 1}}, {"o": {"bytes": 3}}, {"total": 0.25})


def test_reports_come_back(tmp_path: Path):
    with Manifest(tmp_path, create=True) as manifest:
        assert manifest.job is None
        manifest.job = {"output": "o"}
        manifest.put(report("a"), report("b", "failed"))
        manifest.put(report("b"))
    with Manifest(tmp_path) as manifest:
        assert manifest.job == {"output": "o"}
        assert manifest.states() == {"a": ("done", 1.5, ""), "b": ("done", 1.5, "")}
    rows = sqlite3.connect(tmp_path / NAME).execute("SELECT name, state, seconds FROM items")
    assert sorted(rows) == [("a", "done", 0.25), ("b", "done", 0.25)]


def test_names_that_are_not_utf8(tmp_path: Path):
    name = "a\udcffb"  # the byte FF of a file's name
    with Manifest(tmp_path, create=True) as manifest:
        manifest.put(replace(report(name, "failed"), error=f"{name} is no file."), report("a"))
        manifest.put(report(name))
    with Manifest(tmp_path) as manifest:
        assert manifest.states() == {name: ("done", 1.5, ""), "a": ("done", 1.5, "")}


def test_there_is_none(tmp_path: Path):
    with pytest.raises(FormatError, match=r"manifest .* does not exist: run the job first"):
        Manifest(tmp_path)


def test_one_that_is_being_made_is_left_alone(tmp_path: Path):
    """As the status of a job that has just begun may find it."""
    (tmp_path / NAME).touch()
    with pytest.raises(FormatError, match="is empty: run the job first"):
        Manifest(tmp_path)
    assert (tmp_path / NAME).stat().st_size == 0


def test_a_newer_version_is_refused(tmp_path: Path):
    Manifest(tmp_path, create=True).close()
    with sqlite3.connect(tmp_path / NAME) as file:
        file.execute("UPDATE meta SET value = '2' WHERE key = 'version'")
    with pytest.raises(FormatError, match=r"has version 2, .* up to 1: use a newer clplen"):
        Manifest(tmp_path, create=True)


def test_another_file_is_refused(tmp_path: Path):
    for content in (b"no database at all" * 100, b"SQLite format 3\0garbage" * 50):
        (tmp_path / NAME).write_bytes(content)
        with pytest.raises(FormatError, match="damaged or not a manifest"):
            Manifest(tmp_path, create=True)
        assert (tmp_path / NAME).read_bytes() == content


def test_another_database_is_refused(tmp_path: Path):
    with sqlite3.connect(tmp_path / NAME) as file:
        file.execute("CREATE TABLE other (x)")
    with pytest.raises(FormatError, match="not a manifest of clplen: move it away"):
        Manifest(tmp_path, create=True)


@pytest.mark.parametrize(
    "change",
    [
        "started = 'x'", "error = NULL", "error = x'ff00'",
        "error = 'x', started = 'never'",
    ],
)  # fmt: skip
def test_a_damaged_row_is_left_out(tmp_path: Path, change: str):
    with Manifest(tmp_path, create=True) as manifest:
        manifest.put(report("a"), report("b", "failed"))
    with sqlite3.connect(tmp_path / NAME) as file:
        file.execute(f"UPDATE items SET {change} WHERE name = 'b'")
    with Manifest(tmp_path) as manifest:
        assert manifest.states() == {"a": ("done", 1.5, "")}


def test_a_text_that_is_no_utf8_is_read(tmp_path: Path):
    with Manifest(tmp_path, create=True) as manifest:
        manifest.put(report("b", "failed"))
    with sqlite3.connect(tmp_path / NAME) as file:
        file.execute("UPDATE items SET error = CAST(x'61ff' AS TEXT)")
    with Manifest(tmp_path) as manifest:
        assert manifest.states()["b"].error == "a\N{REPLACEMENT CHARACTER}"


@pytest.mark.parametrize(
    "damage",
    [
        f"UPDATE meta SET value = '{'[' * 100_000}'",
        "UPDATE meta SET value = x'ff'",
        "DROP TABLE items; CREATE TABLE items (name TEXT)",
        "DROP TABLE items",
        "ALTER TABLE items RENAME TO others; CREATE VIEW items AS WITH RECURSIVE c(x) AS "
        "(SELECT 1 UNION ALL SELECT x + 1 FROM c) "
        "SELECT x AS name, x AS state, x AS started, x AS error FROM c",  # never ends
        "CREATE TRIGGER t AFTER INSERT ON items BEGIN DELETE FROM items; END",
    ],
    ids=["nested", "bytes", "columns", "table", "view", "trigger"],
)
def test_a_damaged_manifest_gets_one_sentence(tmp_path: Path, damage: str):
    Manifest(tmp_path, create=True).close()
    with sqlite3.connect(tmp_path / NAME) as file:
        file.executescript(damage)
    with (
        pytest.raises(FormatError, match=r"not a manifest of clplen.*: move it away"),
        Manifest(tmp_path) as manifest,
    ):
        manifest.states()


def test_a_full_disk_is_said(tmp_path: Path):
    with Manifest(tmp_path, create=True) as manifest:
        manifest.put(report("a"))
        pages = manifest._connection.execute("PRAGMA page_count").fetchone()[0]
        manifest._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(OSError, match="free space on the disk") as caught:
            manifest.put(*(report(f"item {i}") for i in range(1000)))
        assert caught.value.errno == errno.ENOSPC
        manifest._connection.execute("PRAGMA max_page_count = 100000")
        manifest.put(report("b"))
        assert manifest.states().keys() == {"a", "b"}


def test_a_folder_that_vanishes(tmp_path: Path):
    folder = tmp_path / "out"
    folder.mkdir()
    with Manifest(folder, create=True) as manifest:
        manifest.put(report("a"))
        assert manifest.is_there()
        shutil.rmtree(folder)
        assert not manifest.is_there()
        manifest.renew({"output": "o"})
        assert manifest.is_there()
        assert manifest.states() == {}
        assert manifest.job == {"output": "o"}
