"""What a comparison says of its numbers: reasons only where they make such numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from clplen.analysis.cameras.camera_psf import DepthTransfer, line_curve
from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.crosstalk import camera_crosstalk
from clplen.analysis.cameras.depth_scan import DepthErrors
from clplen.analysis.cameras.sampling import sampling_of
from clplen.analysis.point.psf import PSF
from clplen.analysis.report.summary import criteria, judge, report
from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.optics.camera_aberrations import Aberrations
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.wave.elements.lenslets import MicrolensArray

LAM = 532e-9


def focused(device: Device, **more: float) -> Plenoptic2:
    """m = .2, f_mu = 3 mm, lenslets of 150 um: a = 18 mm, lam a/d = 64 um."""
    return PlenopticCamera.type2(
        focal_length=0.015, object_distance=0.060, m=0.2, wavelength=LAM, pixels_per_lenslet=30,
        mla=MicrolensArray(150e-6, 3e-3, count=9, fill="full", **more),
        aperture_diameter=0.8e-3, device=device,
    )  # fmt: skip


def gaussian(width: float, pitch: float) -> PSF:
    x = (np.arange(101) - 50) * pitch
    line = np.exp(-((x / width) ** 2))
    return PSF(np.outer(line, line), pitch)


@pytest.mark.thorough
def test_reasons_are_given_where_they_make_the_numbers(device: Device) -> None:
    camera = focused(device)  # 4/(pi^2 N) = 3.4 %
    coma = camera.with_aberrations(Aberrations(main_lens={8: LAM / 5}, sensor_shift=2e-6))
    dz = np.array([-1e-3, 0.0, 1e-3])
    curves = [line_curve(np.exp(-((np.arange(99) - 49) ** 2) / w), 10e-6) for w in (2, 8, 9)]
    depth = DepthErrors(dz, np.full((3, 1), 1e-4), ("", "", ""))
    sharp = Measured("sharp", camera, sampling_of(camera), gaussian(32e-6, 6e-6), 0.035,
                     DepthTransfer(dz, tuple(curves), ("",) * 3), depth)  # fmt: skip
    blurred = replace(sharp, name="blurred", psf=gaussian(80e-6, 12e-6), crosstalk=0.08,
                      depth=replace(depth, errors=2 * depth.errors))  # fmt: skip
    names = ("mtf", "two-points", "energy", "strehl", "crosstalk", "transfer", "depth")

    def said(*cameras: Measured) -> dict[str, str]:
        return {c.name: judge(c, cameras) for c in criteria(Comparison(cameras, names))}

    widths = ("usable MTF50", "two-point limit", "Strehl ratio")
    plain = said(sharp, blurred)
    for name in widths:
        assert "`sharp`: limited by diffraction by a lenslet, 63.8" in plain[name]
        assert "`blurred`:" not in plain[name]
    assert "radius" not in plain["radius of 80 % of the light"].split("`sharp`: ")[-1]
    assert "`sharp`: the tails of a lenslet's diffraction" in plain["crosstalk"]
    assert "`blurred`:" not in plain["crosstalk"]
    error = "rms depth error where all measure"
    assert "measured by" not in plain[error]  # the same words for two numbers say nothing
    told = said(sharp, replace(blurred, camera=coma))
    words = "aberrations: wavefront of main lens 0.106 um, sensor shift 2 um"
    for name in (*widths, "crosstalk"):
        assert f"`blurred`: worse than diffraction and samples alone make it; {words}" in told[name]
    assert f"in addition {words}" in told[error]
    assert "`sharp`: measured by the pitch of spots" in told[error]
    text = report(Comparison((sharp, blurred), names))
    assert "best focus of `sharp`, `blurred` is at the end of the depths scanned" in text
    failed = DepthErrors(dz, np.full((3, 1), math.nan), ("near", "far", "far"))
    range_ = said(replace(sharp, depth=failed))["depths measured"]
    assert "not at dz = -1, 0, 1 mm (at the first: near)" in range_
    inner = DepthTransfer(dz, (curves[1], curves[0], curves[2]), ("",) * 3)
    assert not inner.best_at_end
    assert DepthTransfer(dz, tuple(curves[::-1]), ("",) * 3).best_at_end
    assert "at the end of" not in report(Comparison((replace(sharp, transfer=inner),), names))


def test_pixels_on_two_cells_are_named(device: Device) -> None:
    """Even light on 5.4 x 5.4 pixels: a fractional count alone adds to crosstalk."""
    mla = MicrolensArray(60e-6, 187e-6, count=9, fill="full")
    fractional, whole = (
        PlenopticCamera.type1(focal_length=0.05, mla=mla, wavelength=550e-9, object_distance=0.5,
                              aperture_diameter=0.05 / 2.8, pixels_per_lenslet=n, device=device)
        for n in (5.4, 5)
    )  # fmt: skip
    measured = [
        Measured(name, camera, sampling_of(camera), crosstalk=camera_crosstalk(camera))
        for name, camera in (("fractional", fractional), ("whole", whole))
    ]
    np.testing.assert_allclose([m.crosstalk for m in measured], (0.041, 0.010), atol=0.002)
    (criterion,) = criteria(Comparison(tuple(measured), ("crosstalk",)))
    sentence = judge(criterion, measured)
    assert "`fractional`: includes the light of pixels on two cells, at 5.4 pixels" in sentence
    assert "`whole`: includes" not in sentence
