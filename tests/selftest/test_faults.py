"""Every row of the self-test can fail: a fault in each kernel file, and in the rest, is found."""

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
from clplen.selftest.runner import CHECKS, run_checks

pytestmark = pytest.mark.thorough

FOLDER = Path(__file__).parents[2] / "kernels"
KERNELS = sorted(file.name for file in FOLDER.rglob("*.cl"))
# A sign, an axis, a tap or a factor of each file: what stands there, and what is put in its place.
FAULTS = {
    "abbe.cl": ("const int x = i + first[b].y;", "const int x = i + first[b].x;"),
    "adjoint.cl": ("2 * w[row + x] * u[row + x]", "w[row + x] * u[row + x]"),
    "allinfocus.cl": ("(1.0f - t) * first + t * next", "t * first + (1.0f - t) * next"),
    "along_rays.cl": ("w[0] = 1.0f - t;", "w[0] = 1.0f + t;"),
    "aperture.cl": ("-ys[y], R, hx", "-ys[y] + hy, R, hx"),
    "bell.cl": ("0.125f", "0.25f"),
    "builtins.cl": ("KEEP_ALL(store, fmin(a, b))", "KEEP_ALL(store, fmax(a, b))"),
    "ceiling.cl": ("* (vec)(m) + x", "* (vec)(m) - x"),
    "coherence.cl": ("d0 + off", "d0 - off"),
    "colour_fit.cl": ("myxx += wxx * ty;", "myxx += wyy * ty;"),
    "colours.cl": ("sum += in", "sum -= in"),
    "combined.cl": ('#include "matching.cl"', '#include "multiply.cl"'),
    "common.cl": ("a.x * b.y + a.y * b.x", "a.x * b.y - a.y * b.x"),
    "coverage.cl": ("R * R - t * t", "R * R + t * t"),
    "decode.cl": ("wy.s1 * along(raw + (size_t)y.s1 * nx, x, wx) +", ""),
    "decode_adjoint.cl": ("raw[at + b] += w * from[b]", "raw[at + b] -= w * from[b]"),
    "detail.cl": ("sum += d[c] * d[c];", "sum += d[c];"),
    "devignette.cl": ("fmax(white[at + x], least)", "fmin(white[at + x], least)"),
    "finite.cl": ("== EXPONENT", "!= EXPONENT"),
    "focused.cl": ("w[1] = (1.5f * t - 2.5f)", "w[1] = (1.5f * t + 2.5f)"),
    "focused_depth.cl": ("ratio -= clamp(", "ratio += clamp("),
    "focused_render.cl": ("float2 d = ratio * (", "float2 d = -ratio * ("),
    "fourier.cl": ("a.x * b.y + a.y * b.x", "a.x * b.y - a.y * b.x"),
    "fit_rows.cl": ("wst += row_wt * down", "wst -= row_wt * down"),
    "gather_rows.cl": ("sum[q] * share[v]", "sum[q]"),
    "hyperfan.cl": ("exp(-nearest *", "exp(-2 * nearest *"),
    "intensity.cl": ("u.x * u.x + u.y * u.y", "u.x * u.x - u.y * u.y"),
    "lags.cl": ("(cplx)(v.x, -v.y)", "v"),
    "lanes.cl": ("return ((__global const loose16 *)from)->v;",
                 "return 2 * ((__global const loose16 *)from)->v;"),
    "lanes_complex.cl": ("re * tr - im * ti", "re * tr + im * ti"),
    "lattice.cl": ("my = r / wx, mx = r % wx", "my = r % wx, mx = r / wx"),
    "lattice_spectra.cl": ("to[0] = p.x + p.z;", "to[0] = p.x - p.z;"),
    "lattice_transform.cl": ("plus(im[j] * w.x, re[j], (vec)(w.y))", "im[j] * w.x"),
    "lens_types.cl": ("column - (row >> 1) + TYPE_STEP * row", "column + TYPE_STEP * row"),
    "lenslet_errors.cl": ("e.y * l.a + e.z * l.b", "e.y * l.b + e.z * l.a"),
    "lenslet_gradient.cl": ("change.y -= (right", "change.y += (right"),
    "lenslet_moments.cl": ("value *= l.a;", "value *= l.b;"),
    "lenslet_sums.cl": ("const real term = line[k] - lost[k];", "const real term = -line[k];"),
    "transmission_gradient.cl": ("(cplx)(v.x, -v.y)", "v"),
    "disc_pattern.cl": ("2 * rise)))", "30 * rise)))"),
    "local_window.cl": ("by * uy + bx * ux", "by * uy - bx * ux"),
    "pixels.cl": ("v.x * v.x + v.y * v.y", "v.x * v.x - v.y * v.y"),
    "rim_weights.cl": ("(inside + RIM)", "(inside + RIM / 2)"),
    "lenslet_coverage.cl": ("l.b - i * ROW_HEIGHT", "l.b + i * ROW_HEIGHT"),
    "lenslets.cl": ("cis_turns(-turns[", "cis_turns(turns["),
    "made_lenslets.cl": ("turns = shape[2] - (", "turns = shape[2] + ("),
    "magnify.cl": ("a * (1.0f - part) + b * part", "b * (1.0f - part) + a * part"),
    "masks.cl": ("a < TAPS;", "a < TAPS - 1;"),
    "match_rows.cl": ("a += (vec)(w[g]) * more[0]", "a += more[0] * more[0]"),
    "matching.cl": ("fabs(value[x * CHANNELS + c] -", "fabs(value[x * CHANNELS + c] +"),
    "moments.cl": ("w * l * l", "w * l"),
    "multiply.cl": ("t[same + x]", "t[same + nx - 1 - x]"),
    "nearest_lenslet.cl": ("(row & 1) * (real)0.5f", "(row & 1) * (real)0.25f"),
    "normal_rows.cl": ("sum[4] += pulled", "sum[4] -= pulled"),
    "objective.cl": ("cmul(t, shift[x])", "t"),
    "parametrise.cl": ("part(linear_v[y], a) * part(linear_u[x], b)",
                       "part(linear_v[y], b) * part(linear_u[x], a)"),
    "patterns.cl": ("sum[row + x] += cmul(", "sum[row + x] -= cmul("),
    "peaks.cl": ("s0 * h1 - s1 * h0", "s0 * h1 + s1 * h0"),
    "philox.cl": ("i < 10", "i < 9"),
    "plane_waves.cl": ("c_im[i][j] += im * c", "c_im[i][j] -= im * c"),
    "projector.cl": ("plus(sum[i][3], m, a3)", "plus(sum[i][3], m, a2)"),
    "rays.cl": ("sample.z - sample.x * blur.x", "sample.z + sample.x * blur.x"),
    "refine.cl": ("terms[4] += w *", "terms[4] -= w *"),
    "richardson_lucy.cl": ("* E[row + x] + b[row + x]", "* E[row + x] - b[row + x]"),
    "scene.cl": ("view / U - middle_v", "view % U - middle_v"),
    "separable.cl": ("cmul(in[row + x], cmul(t, tx[x]))", "cmul(in[row + x], tx[x])"),
    "separated.cl": ("w[0] * load_local", "w[1] * load_local"),
    "shear.cl": ("const int r = t - down[v * planes + p];",
                 "const int r = t - down[v * planes + p] + 1;"),
    "shear_adjoint.cl": ("row >= 1 && row <= ny ? blend[at]", "row > 1 && row <= ny ? blend[at]"),
    "shear_norm.cl": ("above ? 1.0f - blend : below", "above ? blend : below"),
    "shear_rows.cl": ("next = (vec)(taps[k].y)", "next = (vec)(taps[k].x)"),
    "sheared.cl": ("a + rows.across * (b - a)", "a + rows.across * (a - b)"),
    "sieve.cl": ("reflected(y + s, ny)", "reflected(y, ny)"),
    "smooth.cl": ("w += radius + LINES - 1", "w += radius + LINES - 2"),
    "sommerfeld.cl": ("(cplx)(near, -1)", "(cplx)(near, 1)"),
    "source.cl": ("fabs(xs[x]) - hx < R", "fabs(xs[x]) - hx < R / 2"),
    "source_images.cl": ("keep(dy * (turned", "keep(dx * (turned"),
    "spectral_filter.cl": ("re = re.sfedcba9876543210;", ""),
    "spans.cl": ("p <= span.y", "p < span.y"),
    "sphere.cl": ("tr *= fading;", "tr *= per_z;"),
    "statistics.cl": ("before * share", "before * share * share"),
    "stored.cl": ("vload_half(i, from)", "(2 * vload_half(i, from))"),
    "strips.cl": ("(vec)(taps.z) * load_own(from + 2", "(vec)(taps.z) * load_own(from + 1"),
    "support.cl": ("from[x] * there[x]", "there[x]"),
    "surfaces.cl": ("s[GY] * ray.y + s[GX] * ray.x", "s[GX] * ray.y + s[GY] * ray.x"),
    "tensor.cl": ("b.smooth - a.smooth", "a.smooth - b.smooth"),
    "time_variation.cl": ("(own - last)", "(own + last)"),
    "total_variation.cl": ("* own - other", "* own + other"),
    "transfer_slope.cl": ("-k * turns", "k * turns"),
    "transfer.cl": ("tr * ci + ti * cr", "tr * ci - ti * cr"),
    "twofloat.cl": ("const real q = s / d;", "const real q = s;"),
    "upright.cl": ("+ wd * d[x]", ""),
    "upsample.cl": ("base * (a ? ty.w : ty.z)", "base * (a ? ty.z : ty.w)"),
    "valley_rows.cl": ("(s0 * h1 - s1 * h0)", "(s0 * h1 + s1 * h0)"),
    "vectors.cl": ("(ivec)(0x7fffffff)", "(ivec)(0x7f7fffff)"),
    "view_detail.cl": ("rint(value) + MIDDLE", "MIDDLE - rint(value)"),
    "views.cl": ("low = fmin(low", "low = fmax(low"),
    "warp.cl": ("step.x * slope_y + step.y * slope_x", "step.y * slope_y + step.x * slope_x"),
    "window.cl": ("from_y = y + shift_y", "from_y = y - shift_y"),
}  # fmt: skip


def results_of(device: Device, *names: str) -> dict[str, Any]:
    return {result.name: result for result in run_checks(device, names=names)}


@pytest.fixture
def fresh() -> Device:
    """The device that is taken when none is named, nothing built yet, an item a row."""
    usual = Device.open()
    device = Device(usual.cl_device, place=usual.place)
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


def test_every_kernel_file_has_a_check_and_a_fault() -> None:
    checked = {file for check in CHECKS for file in check.files}
    assert checked == set(KERNELS)
    assert sorted(FAULTS) == KERNELS


def test_checks_have_names_of_their_own() -> None:
    names = [check.name for check in CHECKS]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r".{1,47}", check.compared) for check in CHECKS)
    assert all(len(name) <= 19 for name in names)


@pytest.mark.nightly
@pytest.mark.parametrize("file", KERNELS)
def test_a_fault_in_a_kernel_file_is_found(file: str, kernels: Path, fresh: Device) -> None:
    right, wrong = FAULTS[file]
    source = program.kernel_path(file).read_text()
    assert right in source
    program.kernel_path(file).write_text(source.replace(right, wrong))
    names = [check.name for check in CHECKS if file in check.files]
    every = (run_checks(fresh, names=[name])[0] for name in names)
    failed = next(result for result in every if result.failed)
    assert failed.reason


def test_a_kernel_that_does_not_build_is_a_row(kernels: Path, fresh: Device) -> None:
    program.kernel_path("window.cl").write_text("this is no kernel")
    found = results_of(fresh, "window", "multiply")
    assert found["window"].failed
    assert "window.cl" in found["window"].reason
    assert "error:" in found["window"].reason
    assert "\n" not in found["window"].reason
    assert found["multiply"].status == "ok"


def test_a_fault_of_double_precision_is_found(
    kernels: Path, fresh: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not fresh.has_fp64:
        assert results_of(fresh, "double precision")["double precision"].status == "left out"
        return
    text = program.kernel_path("common.cl").read_text()
    program.kernel_path("common.cl").write_text(text.replace("TWO_PI (2 * M_PI)", "TWO_PI (2 * M_PI_F)"))
    precise = Device(fresh.cl_device, precision="double", place=fresh.place)
    monkeypatch.setattr(Device, "open", staticmethod(lambda *_, **__: precise))
    result = results_of(fresh, "double precision")["double precision"]
    assert result.failed
    assert 1e-11 < result.error < 1e-5


def test_a_fault_of_propagation_is_found(kernels: Path, fresh: Device) -> None:
    right, wrong = FAULTS["transfer.cl"]
    text = program.kernel_path("transfer.cl").read_text()
    program.kernel_path("transfer.cl").write_text(text.replace(right, wrong))
    assert results_of(fresh, "propagation")["propagation"].failed


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


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_result_that_is_not_finite_is_wrong(bad: float) -> None:
    from clplen.selftest.check import Check, run_check

    check = Check("", "", lambda _: [(np.ones(3), np.array([1, bad, 1]))], 1e9)
    result = run_check(check, None)  # type: ignore[arg-type]
    assert result.failed
    assert result.reason == "1 of 3 values are NaN or infinite"


@pytest.mark.parametrize(
    ("pairs", "reason"),
    [
        ([], "nothing was compared"),
        ([(np.ones(3), np.ones(4))], "a result of shape (4,) instead of (3,)"),
        ([(np.ones(3), np.ones(3) + 1e-3)], "wrong values"),
    ],
)
def test_what_cannot_be_right_is_wrong(pairs: Any, reason: str) -> None:
    from clplen.selftest.check import Check, run_check

    result = run_check(Check("", "", lambda _: pairs, 1e-4), None)  # type: ignore[arg-type]
    assert result.failed
    assert result.reason == reason
