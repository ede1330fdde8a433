"""Cache folders that take files, also where the user's do not, and kernels that are whole."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyopencl as cl
import pytest
from forcing import caches_in

from clplen.compute.drivers import environment
from clplen.compute.drivers.environment import cache_dir, ensure_cache, kernel_cache
from clplen.errors import DeviceError

RUN = """
import clplen
device = clplen.Device.open("pocl")
field = clplen.wave.plane_wave(clplen.wave.Grid((12, 20), 1e-5), wavelength=5e-7, device=device)
assert abs(abs(field.to_numpy()).sum() - 240) < 1e-3
print("ran")
"""

try:
    has_pocl = any(p.name == "Portable Computing Language" for p in cl.get_platforms())
except cl.LogicError:
    has_pocl = False
needs_pocl = pytest.mark.skipif(not has_pocl, reason="no PoCL")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder that no test before has looked at, in the environment."""
    monkeypatch.setattr(environment, "_tested", set())
    monkeypatch.setattr(environment, "_temporary", [])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "not" / "there" / "yet"))
    monkeypatch.setenv("POCL_CACHE_DIR", "")
    return tmp_path / "not" / "there" / "yet"


def run(environment: dict[str, str], **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", RUN]
    return subprocess.run(command, env=environment, capture_output=True, text=True, **options)


@pytest.mark.usefixtures("home")
def test_a_writable_cache_is_left_alone(home: Path) -> None:
    ensure_cache()
    assert cache_dir() == home / "clplen"
    assert os.environ["POCL_CACHE_DIR"] == str(home / "pocl" / "kcache")


def test_a_folder_of_the_user_for_kernels_is_left_alone(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "theirs é"))
    ensure_cache()
    assert kernel_cache() == tmp_path / "theirs é"
    assert cache_dir() == home / "clplen"


def _file(home: Path, _: pytest.MonkeyPatch) -> None:
    home.parent.mkdir(parents=True)
    home.touch()


def _full(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage, there = shutil.disk_usage, home.parents[2]
    few = SimpleNamespace(free=3_000_000)
    inside = lambda path: there in Path(path).parents  # noqa: E731
    monkeypatch.setattr(shutil, "disk_usage", lambda path: few if inside(path) else usage(path))


def _quota(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, there = tempfile.TemporaryFile, home.parents[2]

    def refuse(dir: Path) -> object:
        if there in Path(dir).parents:
            raise OSError(122, "Disk quota exceeded")
        return make(dir=dir)

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)


def _noexec(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = home.parents[2]
    flag = lambda path: os.ST_NOEXEC if there in Path(path).parents else 0  # noqa: E731
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_flag=flag(path)))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10**9))


@pytest.mark.skipif(not hasattr(os, "ST_NOEXEC"), reason="statvfs of Linux")
@pytest.mark.parametrize(
    ("obstruct", "reason"),
    [
        (_file, "File exists"),
        (_full, "3.0 MB are free"),
        (_quota, "quota"),
        (_noexec, "forbids to execute"),
    ],
)
def test_a_folder_that_takes_no_kernels_is_replaced_with_one_sentence(
    home: Path,
    monkeypatch: pytest.MonkeyPatch,
    obstruct: Callable[[Path, pytest.MonkeyPatch], None],
    reason: str,
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    obstruct(home, monkeypatch)
    with pytest.warns(RuntimeWarning, match=reason) as warned:
        ensure_cache()
    ensure_cache()
    assert len(warned) == 1
    folder = Path(os.environ["XDG_CACHE_HOME"])
    assert str(folder) in str(warned[0].message)
    assert kernel_cache() == folder / "pocl" / "kcache"
    assert kernel_cache().is_dir()
    assert home not in folder.parents
    environment._remove(folder, os.getpid() + 1)
    assert folder.is_dir(), "a forked process removed it"
    environment._remove(folder, os.getpid())
    assert not folder.exists()


def test_a_folder_for_kernels_alone_is_replaced(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POCL_CACHE_DIR", os.path.join(os.devnull, "none"))
    with pytest.warns(RuntimeWarning, match="null/none cannot be used"):
        ensure_cache()
    assert cache_dir() == home / "clplen"
    assert kernel_cache().is_dir()


@pytest.mark.usefixtures("home")
def test_a_user_without_a_home_gets_a_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as for an unknown user
    monkeypatch.chdir(tmp_path)
    with pytest.warns(RuntimeWarning, match="no home folder"):
        assert cache_dir().is_absolute()
    ensure_cache()
    assert kernel_cache().is_dir()
    assert os.environ["XDG_CACHE_HOME"] == str(cache_dir().parent)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_became_full_is_an_error_before_a_kernel_is_built(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ensure_cache()
    environment.require_room("PoCL")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10**6))
    with pytest.raises(DeviceError, match=r"PoCL cannot store kernels in .* \(1.0 MB are free"):
        environment.require_room("PoCL")


# Kernels that are whole

BITCODE = b"BC\xc0\xde" + b"".join(
    (1 | kind << 2 | 3 << 10).to_bytes(4, "little")
    + words.to_bytes(4, "little")
    + b"\7" * 4 * words
    for kind, words in ((13, 5), (8, 1100), (23, 31))
)


# A library of 64 bits as ``ld`` writes it: its table of sections is at the end.
ELF = bytearray(b"\x7fELF\x02" + b"\7" * 9000)
ELF[40:48] = (len(ELF) - 128).to_bytes(8, "little")
ELF[58:62] = bytes([64, 0, 2, 0])


@pytest.mark.parametrize("name", ["x.so", "program.bc"])
def test_what_is_not_whole_is_removed(home: Path, name: str) -> None:
    whole = bytes(ELF) if name == "x.so" else BITCODE
    half, size = len(whole) // 2, len(whole)
    damaged = [
        b"",
        b"BC",
        b"hello",
        whole[:64],
        whole[:100],
        whole[:half],
        whole[: size - 60 - size % 4],
        bytes(size),
        whole[:half] + bytes(size - half),
        bytes(half) + whole[half:],
        b"\xa5" * size,
    ]
    folder = home / "pocl" / "kcache" / "AB" / "C"
    for number, content in enumerate([whole, *damaged]):
        place = folder / f"{number}" / name
        place.parent.mkdir(parents=True)
        place.write_bytes(content)
    (folder / "folder" / name).mkdir(parents=True)
    written = folder / "tempfile_written.so"  # by another process, at this moment
    written.write_bytes(b"half")
    ensure_cache()
    assert sorted(folder.rglob(name)) == [folder / "0" / name]
    assert written.exists()


@needs_pocl
def test_damaged_kernels_are_compiled_again(tmp_path: Path) -> None:
    assert run(caches_in(tmp_path)).stdout == "ran\n"
    kernels = [*tmp_path.rglob("*.so")]
    assert kernels
    for file in kernels:
        os.truncate(file, file.stat().st_size // 2)
    for file in tmp_path.rglob("program.bc"):
        os.truncate(file, file.stat().st_size // 3)
    for file in tmp_path.rglob("*.sqlite"):
        file.write_bytes(b"no database" * 999)
    done = run(caches_in(tmp_path))
    assert done.stdout == "ran\n", done.stderr


@needs_pocl
def test_a_limit_of_files_is_an_error_and_no_abort(tmp_path: Path) -> None:
    import resource

    limit = (10_000, 10_000)
    done = run(
        caches_in(tmp_path), preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    )
    assert done.returncode == 1, done.stderr
    assert "DeviceError: PoCL cannot store kernels in" in done.stderr
    assert "File too large" in done.stderr
