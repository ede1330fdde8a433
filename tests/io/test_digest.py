"""Digests and sizes of files and folders."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from clplen.io.store import digest as module
from clplen.io.store.digest import digest, size_of


def test_a_file_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    content = bytes(range(256)) * 5 + b"x"
    (tmp_path / "a").write_bytes(content)
    monkeypatch.setattr(module, "_BLOCK_BYTES", 100)
    assert digest(tmp_path / "a") == hashlib.sha256(content).hexdigest()
    assert digest(tmp_path / "a", algorithm="md5") == hashlib.md5(content).hexdigest()
    assert size_of(tmp_path / "a") == 1281
    (tmp_path / "empty").touch()
    assert digest(tmp_path / "empty") == hashlib.sha256().hexdigest()
    assert size_of(tmp_path / "empty") == 0


def test_a_folder_by_sorted_names(tmp_path: Path):
    # By bytes "a-b" lies before "a/b" before "aa", and hidden files count.
    files = {"a/b": b"one", "aa": b"two", "a-b": b"three", ".zattrs": b"{}", "a/é": b""}
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    lines = b"".join(
        name.encode() + b"\0" + hashlib.sha256(files[name]).hexdigest().encode() + b"\n"
        for name in (".zattrs", "a-b", "a/b", "a/é", "aa")
    )
    (tmp_path / "empty").mkdir()
    assert digest(tmp_path) == hashlib.sha256(lines).hexdigest()
    assert size_of(tmp_path) == 13


def test_what_there_is_not(tmp_path: Path):
    for ask in (digest, size_of):
        with pytest.raises(FileNotFoundError, match=r"no file or folder .*nowhere\.$"):
            ask(tmp_path / "nowhere")
    (tmp_path / "a").touch()
    for name in ("sha0", "shake_128"):
        with pytest.raises(ValueError, match=f"got '{name}'"):
            digest(tmp_path / "a", algorithm=name)
