"""Kernel sources are found and expanded, built once, and refused with the place of the error."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import clplen
from clplen.compute import launcher
from clplen.compute.device import Device
from clplen.compute.drivers import program
from clplen.errors import KernelBuildError

KERNELS = Path(__file__).parents[2] / "kernels"
OUTER = """/* a comment */
#include "common.cl"
#include "inner.cl"
__kernel void twice(__global float *a, const int n)
{
    FOR_X(x, n)
        a[x] = scaled(a[x]) * FACTOR;
}
"""
INNER = """#ifndef INNER
#define INNER

#include "common.cl"
inline float scaled(float value)
{
    return 2.0f * value;
}
#endif
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A kernel folder of one's own, its name with a space, empty but for common.cl."""
    own = tmp_path / "my kernels"
    (own / "common").mkdir(parents=True)
    shutil.copy(KERNELS / "common" / "common.cl", own / "common")
    monkeypatch.setattr(program, "_FOLDERS", (tmp_path / "none", own))
    program.kernel_source.cache_clear()
    yield own
    program.kernel_source.cache_clear()


@pytest.fixture
def fresh(device: Device) -> Device:
    """The same device without any kernel."""
    return Device(device.cl_device)


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / "common" / f"{name}.cl").write_text(text)


def test_the_kernels_of_a_checkout_are_found() -> None:
    package = Path(clplen.__file__).resolve().parent
    assert program.kernel_folder() in (package / "kernels", package.parent / "kernels")
    assert program.kernel_path("shear.cl") == program.kernel_folder() / "lightfield" / "shear.cl"


def test_missing_kernels_say_where_they_were_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program, "_FOLDERS", (tmp_path / "first", tmp_path / "second"))
    with pytest.raises(KernelBuildError) as error:
        program.kernel_folder()
    assert f"missing from {tmp_path / 'first'} and {tmp_path / 'second'}; reinstall" in str(
        error.value
    )


def test_includes_are_expanded_once_with_their_lines(folder: Path) -> None:
    write(folder, outer=OUTER, inner=INNER)
    lines = program.kernel_source("outer.cl").splitlines()
    assert "#include" not in "\n".join(lines)
    markers = [line for line in lines if line.startswith("#line")]
    assert markers == [
        '#line 1 "outer.cl"',
        '#line 1 "common.cl"',
        '#line 3 "outer.cl"',
        '#line 1 "inner.cl"',
        '#line 4 "outer.cl"',
    ]
    # Every line counted from the last marker is the line of its file.
    file, number, seen = "", 0, 0
    for line in lines:
        if line.startswith("#line"):
            file, number = line.split('"')[1], int(line.split()[1])
            continue
        original = (folder / "common" / file).read_text().splitlines()[number - 1]
        assert line == original or (line == "" and original == '#include "common.cl"')
        number, seen = number + 1, seen + 1
    assert (
        seen
        == sum(
            len((folder / "common" / f).read_text().splitlines())
            for f in ("outer.cl", "inner.cl", "common.cl")
        )
        - 2
    )


def test_an_unknown_file_or_include_is_named(folder: Path) -> None:
    write(folder, outer='#include "absent.cl"\n')
    for name, missing in (("outer.cl", "absent.cl"), ("nowhere.cl", "nowhere.cl")):
        with pytest.raises(KernelBuildError, match=f"No kernel file '{missing}' in .*my kernels"):
            program.kernel_source(name)


def test_defines_specialise_and_builds_are_kept(
    folder: Path, fresh: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(folder, outer=OUTER, inner=INNER)
    built = []

    def build(*args: object) -> object:
        built.append(args[2])
        return program.build_program(*args)

    monkeypatch.setattr(launcher, "build_program", build)
    values = np.arange(1, 8, dtype=np.float32)
    for factor in ("3.0f", "5.0f", "3.0f"):
        array = fresh.upload(values)
        kernel = fresh.kernel("outer.cl", "twice", FACTOR=factor)
        fresh.launch_rows(kernel, (1, 7), array, np.int32(7))
        np.testing.assert_array_equal(
            fresh.download(array), 2 * values * np.float32(factor.rstrip("f"))
        )
    rows = {"ROWS": True} if fresh.rows else {}
    assert built == [{"FACTOR": "3.0f", **rows}, {"FACTOR": "5.0f", **rows}]
    assert fresh.kernel("outer.cl", "twice", FACTOR="5.0f") is not kernel
    assert fresh.kernel("outer.cl", "twice", FACTOR="3.0f") is kernel


def test_two_kernels_of_a_file_share_a_build(
    fresh: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = fresh.kernel("intensity.cl", "intensity")
    monkeypatch.setattr(launcher, "build_program", lambda *_: pytest.fail("built again"))
    assert fresh.kernel("intensity.cl", "row_power").function_name == "row_power"
    assert fresh.kernel("intensity.cl", "intensity") is first


def test_a_failed_build_carries_numbered_source_and_log(folder: Path, fresh: Device) -> None:
    write(folder, outer=OUTER, inner=INNER.replace("return", "retrun"))
    with pytest.raises(KernelBuildError) as error:
        fresh.kernel("outer.cl", "twice", FACTOR=2)
    first, *_ = str(error.value).splitlines()
    assert first.startswith(f"The kernel file 'outer.cl' does not build on {fresh.name}")
    assert "-DFACTOR=2" in first
    numbered = error.value.source.splitlines()
    source = program.kernel_source("outer.cl").splitlines()
    assert len(numbered) == len(source)
    for number, (line, original) in enumerate(zip(numbered, source, strict=True), start=1):
        assert line.rstrip() == f"{number:{len(str(len(source)))}d}  {original}".rstrip()
    assert "error" in error.value.log
    for part in (error.value.source, error.value.log):
        assert part in str(error.value)
    # A failure is not kept: the mended file builds.
    write(folder, inner=INNER)
    program.kernel_source.cache_clear()
    assert fresh.kernel("outer.cl", "twice", FACTOR=2).function_name == "twice"


def test_a_kernel_without_its_switch_is_refused(fresh: Device) -> None:
    with pytest.raises(KernelBuildError, match="choose PHASE_TABLES, PHASE_FP64 or PHASE_TWOFLOAT"):
        fresh.kernel("transfer.cl", "transfer")
