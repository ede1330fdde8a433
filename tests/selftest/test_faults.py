"""Rows of the self-test can fail: a fault in each family of kernels, and in the rest, is found."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.compute.drivers import program
from clplen.compute.fft import routes
from clplen.compute.memory import Memory
from clplen.selftest.check import Check, run_check
from clplen.selftest.runner import CHECKS, run_checks

pytestmark = pytest.mark.thorough

FOLDER = Path(__file__).parents[2] / "kernels"
# A sign, an axis, a tap or a factor of a kernel of each check, and its replacement.
FAULTS = {
    "finite.cl": ("== EXPONENT", "!= EXPONENT"),
    "intensity.cl": ("u.x * u.x + u.y * u.y", "u.x * u.x - u.y * u.y"),
    "transfer.cl": ("tr * ci + ti * cr", "tr * ci - ti * cr"),
    "twofloat.cl": ("const real q = s / d;", "const real q = s;"),
    "adjoint.cl": ("2 * w[row + x] * u[row + x]", "w[row + x] * u[row + x]"),
    "sommerfeld.cl": ("(cplx)(near, -1)", "(cplx)(near, 1)"),
    "window.cl": ("from_y = y + shift_y", "from_y = y - shift_y"),
    "aperture.cl": ("-ys[y], R, hx", "-ys[y] + hy, R, hx"),
    "lenslets.cl": ("cis_turns(-turns[", "cis_turns(turns["),
    "source.cl": ("fabs(xs[x]) - hx < R", "fabs(xs[x]) - hx < R / 2"),
    "abbe.cl": ("const int x = i + first[b].y;", "const int x = i + first[b].x;"),
    "masks.cl": ("a < TAPS;", "a < TAPS - 1;"),
    "scene.cl": ("view / U - middle_v", "view % U - middle_v"),
    "views.cl": ("low = fmin(low", "low = fmax(low"),
    "shear.cl": ("const int r = t - down[v * planes + p];",
                 "const int r = t - down[v * planes + p] + 1;"),
    "along_rays.cl": ("w[0] = 1.0f - t;", "w[0] = 1.0f + t;"),
    "fourier.cl": ("a.x * b.y + a.y * b.x", "a.x * b.y - a.y * b.x"),
    "allinfocus.cl": ("(1.0f - t) * first + t * next", "t * first + (1.0f - t) * next"),
    "warp.cl": ("turn_y * slope_y + turn_x", "turn_x * slope_y + turn_y"),
    "smooth.cl": ("w += radius + LINES - 1", "w += radius + LINES - 2"),
    "peaks.cl": ("s0 * h1 - s1 * h0", "s0 * h1 + s1 * h0"),
    "moments.cl": ("w * l * l", "w * l"),
    "tensor.cl": ("b.smooth - a.smooth", "a.smooth - b.smooth"),
    "match_rows.cl": ("a += (vec)(w[g]) * more[0]", "a += more[0] * more[0]"),
    "decode.cl": ("wy.s1 * along(raw + (size_t)y.s1 * nx, x, wx) +", ""),
    "devignette.cl": ("fmax(white[at + x], least)", "fmin(white[at + x], least)"),
    "focused_render.cl": ("float2 d = ratio * (", "float2 d = -ratio * ("),
    "projector.cl": ("plus(sum[i][3], m, a3)", "plus(sum[i][3], m, a2)"),
    "richardson_lucy.cl": ("* E[row + x] + b[row + x]", "* E[row + x] - b[row + x]"),
    "builtins.cl": ("KEEP_ALL(store, fmin(a, b))", "KEEP_ALL(store, fmax(a, b))"),
}  # fmt: skip


def results_of(device: Device, *names: str) -> dict[str, Any]:
    return {result.name: result for result in run_checks(device, names=names)}


@pytest.fixture
def fresh() -> Device:
    """The device that is taken when none is named, nothing built yet, an item a row."""
    usual = Device.open()
    device = Device(usual.cl_device, selector=usual.place)
    device.rows = True
    return device


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the kernels that is built in their place."""
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(program, "_FOLDERS", (tmp_path,))
    program.kernel_source.cache_clear()
    yield tmp_path
    program.kernel_source.cache_clear()


def test_every_check_of_kernels_has_a_fault() -> None:
    for check in CHECKS:
        assert all(program.kernel_path(file) for file in check.files)
        assert not check.files or set(check.files) & set(FAULTS), check.name


def test_checks_have_names_of_their_own() -> None:
    names = [check.name for check in CHECKS]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r".{1,47}", check.compared) for check in CHECKS)
    assert all(len(name) <= 19 for name in names)


@pytest.mark.nightly
@pytest.mark.parametrize("file", FAULTS)
def test_a_fault_in_a_kernel_file_is_found(file: str, kernels: Path, fresh: Device) -> None:
    right, wrong = FAULTS[file]
    source = program.kernel_path(file).read_text()
    assert right in source
    program.kernel_path(file).write_text(source.replace(right, wrong))
    names = [check.name for check in CHECKS if file in check.files]
    assert any(result.failed and result.reason for result in run_checks(fresh, names=names))


def test_a_kernel_that_does_not_build_is_a_row(kernels: Path, fresh: Device) -> None:
    program.kernel_path("smooth.cl").write_text("this is no kernel")
    found = results_of(fresh, "smooth", "finite")
    assert found["smooth"].failed
    assert "smooth.cl" in found["smooth"].reason
    assert "error:" in found["smooth"].reason
    assert "\n" not in found["smooth"].reason
    assert found["finite"].status == "ok"


def test_a_fault_of_double_precision_is_found(
    kernels: Path, fresh: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not fresh.has_fp64:
        assert results_of(fresh, "double precision")["double precision"].status == "left out"
        return
    common = program.kernel_path("common.cl")
    common.write_text(common.read_text().replace("TWO_PI (2 * M_PI)", "TWO_PI (2 * M_PI_F)"))
    precise = Device(fresh.cl_device, precision="double", selector=fresh.place)
    monkeypatch.setattr(Device, "open", staticmethod(lambda *_, **__: precise))
    result = results_of(fresh, "double precision")["double precision"]
    assert result.failed
    assert 1e-11 < result.error < 1e-5


def test_a_fault_of_transforms_is_found(fresh: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    def turned(values: Any, out: Any, axes: Any, forward: bool, threads: int) -> None:
        plain = routes._scipy
        plain(values, out, axes, not forward, threads)

    def wrong_vkfft(array: Any, device: Device, axes: Any, forward: bool) -> None:
        pass

    for name in ("ducc0", "scipy"):
        monkeypatch.setitem(routes._HOST, name, turned)
    monkeypatch.setattr(routes, "_vkfft", wrong_vkfft)
    names = [check.name for check in CHECKS if check.name.startswith("FFT")]
    found = run_checks(fresh, names=names)
    assert {result.status for result in found} <= {"FAILED", "left out"}
    assert any(result.failed for result in found)


def test_faults_of_memory_are_found(fresh: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("memory, large", "memory, transfers", "memory, mapped")
    assert {r.status for r in results_of(fresh, *names).values()} == {"ok"}
    copy, upload = Memory.copy_into, Memory.upload

    def beside(self: Memory, target: Any, source: Any, offset: int) -> None:
        copy(self, target, source, max(offset - 1, 0))

    def damaged(self: Memory, values: Any) -> Any:
        return upload(self, np.where(np.arange(values.size) == 7, 0, values.ravel())
                      .astype(values.dtype).reshape(values.shape))  # fmt: skip

    monkeypatch.setattr(Memory, "copy_into", beside)
    found = results_of(fresh, *names)
    assert found["memory, large"].failed
    assert found["memory, transfers"].failed
    monkeypatch.setattr(Memory, "upload", damaged)
    assert results_of(fresh, *names)["memory, mapped"].failed


def test_too_little_memory_is_a_row(fresh: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(self: Memory, shape: Any, dtype: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(Memory, "empty", none_left)
    assert results_of(fresh, "memory, large")["memory, large"].reason == "MemoryError"


@pytest.mark.parametrize(
    ("pairs", "reason"),
    [
        ([], "nothing was compared"),
        ([(np.ones(3), np.ones(4))], "a result of shape (4,) instead of (3,)"),
        ([(np.ones(3), np.ones(3) + 1e-3)], "wrong values"),
        ([(np.ones(3), np.array([1, np.nan, 1]))], "1 of 3 values are NaN or infinite"),
    ],
)
def test_what_cannot_be_right_is_wrong(pairs: Any, reason: str) -> None:
    result = run_check(Check("", "", lambda _: pairs, 1e-4), None)  # type: ignore[arg-type]
    assert result.failed
    assert result.reason == reason
