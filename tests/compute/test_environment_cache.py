"""A cache folder that can be written, also where the user's home cannot."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from clplen.compute.drivers.environment import cache_dir, ensure_cache


def test_a_writable_cache_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "not" / "there" / "yet"))
    ensure_cache()
    assert cache_dir() == tmp_path / "not" / "there" / "yet" / "clplen"


def test_a_read_only_home_gets_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: Path(path) != tmp_path and access(path, mode)
    )
    ensure_cache()
    folder = Path(os.environ["XDG_CACHE_HOME"])
    assert folder.is_dir()
    assert tmp_path not in folder.parents
    assert access(folder, os.W_OK)
