"""Wheel and sdist hold the kernels and find them."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough  # builds a wheel; CI installs one

ROOT = Path(__file__).parents[1]
FIND = (
    "import clplen; from clplen.compute.drivers.program import kernel_folder; "
    "print(kernel_folder())"
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist of this tree."""
    folder = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "build",
            "--wheel",
            "--sdist",
            "--no-isolation",
            "--outdir",
            str(folder),
            str(ROOT),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> dict[str, bytes]:
    """The wheel's files."""
    (file,) = built.glob("*.whl")
    assert file.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def sdist(built: Path) -> dict[str, bytes]:
    """The sdist's files, without its leading folder."""
    (file,) = built.glob("*.tar.gz")
    with tarfile.open(file) as archive:
        return {
            member.name.partition("/")[2]: archive.extractfile(member).read()
            for member in archive.getmembers()
            if member.isfile()
        }


def kernels(files: dict[str, bytes], folder: str) -> dict[str, bytes]:
    """The kernels among files, by name."""
    return {
        name.removeprefix(folder): content
        for name, content in files.items()
        if name.startswith(folder) and name.endswith(".cl")
    }


def tree(pattern: str) -> dict[str, bytes]:
    """Files of this tree."""
    return {file.relative_to(ROOT).as_posix(): file.read_bytes() for file in ROOT.glob(pattern)}


def test_the_wheel_holds_every_kernel_as_it_is(wheel: dict[str, bytes]) -> None:
    expected = kernels(tree("kernels/**/*.cl"), "kernels/")
    assert "common/common.cl" in expected
    assert kernels(wheel, "clplen/kernels/") == expected


def test_the_sdist_holds_every_kernel_as_it_is(sdist: dict[str, bytes]) -> None:
    assert kernels(sdist, "kernels/") == kernels(tree("kernels/**/*.cl"), "kernels/")


def test_the_wheel_holds_every_module_its_types_and_nothing_else(wheel: dict[str, bytes]) -> None:
    modules = {name for name in wheel if not name.startswith("clplen/kernels/")}
    modules = {name for name in modules if ".dist-info/" not in name}
    viewer = set(tree("clplen/viewer/page/*.*"))
    assert len(viewer) > 15
    code = {*tree("clplen/**/*.py"), *tree("clplen/**/*.pyi"), "clplen/py.typed"}
    assert modules == code | viewer
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel)


def test_the_sdist_holds_what_builds_and_tests_it(sdist: dict[str, bytes]) -> None:
    needed = tree("tests/**/*.py") | tree("clplen/**/*.py") | tree("*.toml") | tree("*.md")
    assert needed.keys() <= sdist.keys()


@pytest.mark.parametrize(("archive", "folder"), [("wheel", "clplen/kernels"), ("sdist", "kernels")])
def test_the_kernels_are_found_where_it_is_unpacked(
    request: pytest.FixtureRequest, tmp_path: Path, archive: str, folder: str
) -> None:
    for name, content in request.getfixturevalue(archive).items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    others = [path for path in sys.path if path and not (Path(path) / "clplen").is_dir()]
    done = subprocess.run(
        [sys.executable, "-c", FIND],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *others])},
        check=False,
    )
    assert done.stdout.strip() == str(tmp_path / folder), done.stderr
