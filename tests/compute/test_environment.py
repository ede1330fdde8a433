"""Intel's runtime from pip is shown to the OpenCL loader, and nothing else is disturbed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from forcing import caches_in

from clplen.compute.drivers import environment

SHOW = """
import os
from clplen.compute.drivers.environment import expose_intel_runtime
expose_intel_runtime()
print(os.environ.get("OCL_ICD_VENDORS"))
import pyopencl as cl
print([p.name for p in cl.get_platforms()])
"""

needs_intel = pytest.mark.skipif(
    environment._intel_library() is None, reason="Intel's runtime is not installed"
)


def show(environment: dict[str, str]) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", SHOW], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A made-up machine: one vendor folder and one library of Intel's in a Python environment."""
    for variable in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"):
        monkeypatch.setenv(variable, "")  # what a test sets is taken back after it
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    library = tmp_path / "env/lib/libintelocl.so"
    library.parent.mkdir(parents=True)
    library.touch()
    vendors = tmp_path / "vendors"
    vendors.mkdir()
    monkeypatch.setattr(environment, "VENDOR_FOLDERS", (vendors, tmp_path / "none"))
    monkeypatch.setattr(environment, "_intel_library", lambda: library)
    return tmp_path


def drivers() -> set[str]:
    """The libraries that the folder in ``OCL_ICD_VENDORS`` names."""
    return {file.read_text().strip() for file in Path(os.environ["OCL_ICD_VENDORS"]).glob("*.icd")}


@needs_intel
@pytest.mark.parametrize("cache", [None, "/proc/none"])
def test_pocl_and_intel_show_up_in_one_process(tmp_path: Path, cache: str | None) -> None:
    environment = caches_in(tmp_path)
    environment.pop("OCL_ICD_VENDORS", None)
    folder, platforms = show(environment | ({"XDG_CACHE_HOME": cache} if cache else {}))
    assert "Intel(R) OpenCL" in platforms
    assert "Portable Computing Language" in platforms
    assert folder.startswith(str(tmp_path)) == (cache is None)
    assert Path(folder).is_dir() == (cache is None), "a temporary folder stayed behind"


@needs_intel
def test_vendors_set_by_the_user_are_kept(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    folder, platforms = show(caches_in(tmp_path) | {"OCL_ICD_VENDORS": str(theirs)})
    assert folder == str(theirs)
    assert "Intel(R) OpenCL" not in platforms
    assert list(tmp_path.glob("clplen*")) == []


def test_the_systems_drivers_stay_visible(machine: Path) -> None:
    (machine / "vendors/nvidia.icd").write_text("libnvidia-opencl.so.1\n")
    (machine / "vendors/dead.icd").write_text("/builder/lib/libintelocl.so\n")
    environment.expose_intel_runtime()
    assert drivers() == {str(machine / "env/lib/libintelocl.so"), "libnvidia-opencl.so.1"}


def test_the_folder_is_made_once_and_follows_the_system(machine: Path) -> None:
    environment.expose_intel_runtime()
    first = os.environ.pop("OCL_ICD_VENDORS")
    environment.expose_intel_runtime()
    assert os.environ.pop("OCL_ICD_VENDORS") == first
    (machine / "vendors/new.icd").write_text("libnew.so\n")
    environment.expose_intel_runtime()
    assert "libnew.so" in drivers()
    assert len(list((machine / "cache/clplen").iterdir())) == 2


def test_nothing_is_touched_where_the_user_or_the_system_chose(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = machine / "oneapi/libintelocl.so.2025.1"
    theirs.parent.mkdir()
    theirs.touch()
    before = dict(os.environ)
    for variable in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"):
        with monkeypatch.context() as patch:
            patch.setenv(variable, "/theirs")
            environment.expose_intel_runtime()
            assert os.environ == before | {variable: "/theirs"}
    with monkeypatch.context() as patch:
        patch.setattr(environment, "_intel_library", lambda: None)
        environment.expose_intel_runtime()
    (machine / "vendors/intel.icd").write_text(f"{theirs}\n")
    environment.expose_intel_runtime()
    assert os.environ == before
    assert not (machine / "cache").exists()
