"""local_window.cl: the light of points about their chief rays, beside plain float64 formulae."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera
from clplen.cameras import Aberrations, PixelArray
from clplen.cameras.optics.local_window import LocalWindows, WindowShape
from clplen.compute.device import Device
from clplen.wave.elements.rims import RIM, RIM_STEPS, rim_weights

LAM = 500e-9
PLACES = np.array([(3e-3, -5e-3, 0.0), (2e-3, 1e-3, -0.4), (0.0, 0.0, 0.3)])
SHAPE = WindowShape(5, 0.25e-6, 42, 840, 135, 3, (0.2, 0.4))


def windows(device: Device, lens: str = "corrected", **change: Any) -> LocalWindows:
    mla = MicrolensArray(10e-6, 40e-6, count=(29, 31), lattice="hexagonal")
    camera = PlenopticCamera.type1(
        focal_length=10e-3, object_distance=1.0, aperture_diameter=2.5e-3, mla=mla, wavelength=LAM,
        pixels=PixelArray(pitch=1.25e-6), lens_model=lens, device=device, **change,
    )  # fmt: skip
    return LocalWindows.of(camera.optics, SHAPE, PLACES, 5e-6)


def ray(w: LocalWindows, n: int, v: Any, u: Any) -> tuple[Any, Any]:
    """(direction from chief ray and curvature, path) of rays from (v, u) in the pupil."""
    y0, x0 = w.positions[n, 1], w.positions[n, 0]
    z, z2 = 1.0 + w.positions[n, 2], w.optics.array_distance
    q = 1 / 10e-3 - 1 / z
    t = np.stack([-y0 / z - q * v, -x0 / z - q * u])
    t0 = np.array([-y0 / z, -x0 / z]).reshape(2, *[1] * np.ndim(v))
    a, a0 = np.sqrt(1 + (t**2).sum(0)), np.sqrt(1 + (t0**2).sum(0))
    xi = np.stack([v, u]) * (1 - z2 * q)
    h = w.numbers[n, [4, 5, 5, 6]].reshape(2, 2)
    curved = np.tensordot(h, xi, 1)
    s = t / a - t0 / a0 - curved
    path = -(1 / q - z2) * (a - a0) - (t / a * xi).sum(0) + (xi * curved).sum(0) / 2
    return s, path


@pytest.mark.parametrize(
    ("lens", "bent"),
    [
        ("corrected", True),
        ("thin", False),
        pytest.param("corrected", False, marks=pytest.mark.thorough),
        pytest.param("thin", True, marks=pytest.mark.thorough),
    ],
)
def test_spectra(device: Device, lens: str, bent: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    terms = {5: 40e-9, 8: -30e-9, 11: 25e-9}
    made = windows(device, lens, aberrations=Aberrations(main_lens=terms if bent else {}))
    seen: list[Any] = []
    monkeypatch.setattr(
        "clplen.cameras.optics.local_window.run", lambda data, *rest: seen.append(data) or [data]
    )
    made.array_fields()
    got = device.download(seen[0])
    sampled = (np.arange(SHAPE.pupil) - SHAPE.pupil // 2) * made.step
    sy, sx = np.meshgrid(sampled, sampled, indexing="ij")
    share = SHAPE.samples / SHAPE.period
    rim = rim_weights(np.sqrt(0.5) * share, 1 - share / 2)
    for n in range(len(PLACES)):
        uv = -made.optics.array_distance * np.stack([sy, sx])
        for _ in range(6):  # Newton's method with differences
            s, path = ray(made, n, *uv)
            dv, du = (ray(made, n, uv[0] + a, uv[1] + b)[0] - s for a, b in ((1e-9, 0), (0, 1e-9)))
            dv, du = dv / 1e-9, du / 1e-9
            det = dv[0] * du[1] - du[0] * dv[1]
            off = s - np.stack([sy, sx])
            step = [du[1] * off[0] - du[0] * off[1], dv[0] * off[1] - dv[1] * off[0]]
            uv = uv - np.stack(step) / det
        s, path = ray(made, n, *uv)
        z = 1.0 + PLACES[n, 2]
        foot = np.hypot(uv[0] - PLACES[n, 1], uv[1] - PLACES[n, 0])
        turns = path / LAM + sy * made.numbers[n, 9] + sx * made.numbers[n, 10]
        a2 = [((PLACES[n, 1::-1] / z)[:, None, None] + (1 / 10e-3 - 1 / z) * uv) ** 2]
        a2.append((PLACES[n, 1::-1] / z)[:, None, None] ** 2 + 0 * uv)
        slope, middle = (np.sqrt(1 + one.sum(0)) for one in a2)
        amplitude = np.sqrt(made.numbers[n, 11] / np.abs(det))
        if lens == "corrected":
            amplitude = amplitude * (middle / slope) ** 1.5
        else:
            q = 1 / 10e-3 - 1 / z
            thin = np.hypot(foot, z) - (uv**2).sum(0) / (2 * 10e-3) + slope / q
            turns = turns + (thin - np.hypot(np.hypot(*PLACES[n, :2]), z) - middle / q) / LAM
        from scipy.special import j1

        v = np.maximum(np.pi * 5e-6 * foot / (LAM * z), 1e-12)
        amplitude = amplitude * 2 * j1(v) / v
        if bent:
            turns = turns + made.optics.main_lens_path(0.0, 0.0, *uv / 1.25e-3)[0] / LAM
        inside = (1.25e-3 - np.hypot(*uv)) / (made.step / np.sqrt(np.abs(det)))
        weight = np.interp(inside, np.arange(len(rim)) / RIM_STEPS - RIM, rim)
        expected = weight * amplitude * np.exp(2j * np.pi * turns)
        assert np.abs(got[n] - expected).max() <= 3e-4 * np.abs(expected).max()


def test_behind_and_onward(device: Device) -> None:
    made = windows(device)
    generator = np.random.default_rng(7)
    n = SHAPE.samples
    field = generator.normal(size=(3, n, n, 2)) @ (1, 1j)
    behind = made.behind_array(device.upload(field.astype(device.complex)))
    got_behind = device.download(behind).copy()
    got = device.download(made.sensor_spectra(behind))
    index = (np.arange(n) - n // 2) * SHAPE.pitch
    carried = made.off_band
    for k in range(3):
        numbers = made.numbers[k]
        y, x = (index + numbers[12])[:, None], (index + numbers[13])[None]
        bend = numbers[4] * y**2 / 2 + numbers[5] * y * x + numbers[6] * x**2 / 2
        from clplen.wave.field.field import Grid

        grid = Grid((n, n), SHAPE.pitch, origin=made._origin(made.centres[k]))
        array = device.download(made.optics.array_transmission(grid, rim=SHAPE.rim))
        expected = field[k] * np.exp(2j * np.pi * bend / LAM) * array
        assert np.abs(got_behind[k] - expected).max() <= 1e-5 * np.abs(expected).max()
        bins = np.fft.fftfreq(n, 1 / n)
        total = [bins + off for off in carried[k]]
        rest = [t - n * np.rint(t / n) - off for t, off in zip(total, carried[k], strict=True)]
        step = LAM / (n * SHAPE.pitch)
        s = np.add.outer((rest[0] * step + made.carriers[k, 0]) ** 2,
                         (rest[1] * step + made.carriers[k, 1]) ** 2)  # fmt: skip
        cosine = np.sqrt(1 - (made.carriers[k] ** 2).sum())
        turns = 40e-6 / LAM * (np.sqrt(np.maximum(1 - s, 0)) - cosine)
        turns = turns + np.add.outer(rest[0] * made.shifts[k, 0], rest[1] * made.shifts[k, 1]) / n
        expected = np.fft.fft2(expected) * np.exp(2j * np.pi * turns) * (s < 1)
        assert np.abs(got[k] - expected).max() <= 3e-4 * np.abs(expected).max()
