"""Numbers of other tools: against the shift that each tool's own rule gives the outermost views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from clplen.lightfield import conventions
from clplen.lightfield.model.light_field import LightField

D = np.array([-0.7, -0.2, 0.0, 0.15, 0.6])
KAPPA = 0.8
HCI = {
    "baseline": 0.05,
    "focal_length": 0.1,
    "focus": 9.35,
    "sensor_size": 0.035,
    "pixels": 512,
}
OPTIONS = {
    "plenpy": {"views": 7},
    "lftoolbox": {"views": 7},
    "ng": {"kappa": KAPPA},
    "virtual_depth": {"pitch": 19.2},
}


def test_there_and_back():
    tools = "plenpy lftoolbox plenoptomos ng lightfieldlab epi_slope virtual_depth"
    for tool in tools.split():
        forth, back = (getattr(conventions, f"{way}_{tool}") for way in ("to", "from"))
        d = D[D != 0] if tool == "virtual_depth" else D
        options = OPTIONS.get(tool, {})
        np.testing.assert_allclose(back(forth(d, **options), **options), d, rtol=1e-13, atol=1e-15)
        assert not np.allclose(forth(d, **options), d)


def test_plenopticam_has_whole_numbers():
    np.testing.assert_array_equal(conventions.to_plenopticam([-1.7, 0.2, 2.4]), [-2, 0, 2])
    np.testing.assert_array_equal(conventions.from_plenopticam([-2, 1]), [-2, 1])


@pytest.mark.parametrize("views", [7, 10])
def test_slopes_that_span_n_steps(views):
    """linspace(-.5, .5, N) N times the slope is the shift of a view (LFFiltShiftSum.m, plenpy)."""
    offsets = np.linspace(-0.5, 0.5, views) * views
    steps = np.arange(views) - (views - 1) / 2
    slope = conventions.to_plenpy(0.6, views=views)
    np.testing.assert_allclose(slope * offsets, 0.6 * steps, atol=1e-14)
    slope = conventions.to_lftoolbox(0.6, views=views)
    np.testing.assert_allclose(slope * offsets, -0.6 * steps, atol=1e-14)


def test_alpha_of_a_light_field_is_the_inverse_of_ng(device):
    spacing = (-120e-6, -120e-6, 150e-6, 150e-6)
    lf = LightField.from_array(np.ones((2, 2, 3, 3)), device=device, spacing=spacing)
    ours = lf.alpha(D)
    np.testing.assert_allclose(1 / conventions.to_ng(D, kappa=KAPPA), ours, rtol=1e-13)


@dataclass(frozen=True)
class ThinLens:
    """alpha = F (1/f - 1/z), thesis eq. 3.6."""

    focal_length: float
    image_distance: float

    def alpha(self, z):
        return self.image_distance * (1 / self.focal_length - 1 / np.asarray(z))


def test_distances_by_the_lens_law(device):
    """(A3) against alpha of a lens, and the numbers of section 1.5."""
    options = {"kappa": KAPPA, "image_distance": 0.24, "focus": 0.24}
    z = np.array([0.14, 0.19, 0.24, 0.29, 0.49])
    lens = ThinLens(0.12, 0.24)
    spacing = (-120e-6, -120e-6, 150e-6, 150e-6)
    lf = LightField.from_array(np.ones((2, 2, 3, 3)), device=device, spacing=spacing)
    d = conventions.disparity_of_distance(z, **options)
    np.testing.assert_allclose(d, lf.disparity(lens.alpha(z)), atol=1e-13)
    assert d[1] == pytest.approx(0.21053, abs=1e-5)
    assert d[3] == pytest.approx(-0.13793, abs=1e-5)
    np.testing.assert_allclose(conventions.distance_of_disparity(d, **options), z, rtol=1e-13)
    far = conventions.disparity_of_distance(np.inf, **options)
    assert far == pytest.approx(-KAPPA)
    assert conventions.distance_of_disparity(far, **options) == np.inf
    assert conventions.distance_of_disparity(far - 0.1, **options) == np.inf


def test_the_metric_form_of_hci_is_a3():
    """A lens of image distance f, a view step of b and a pixel s/W: the same to 1e-4 and better."""
    z = np.linspace(6, 20, 15)
    f, b, w, s, z0 = 100.0, 50.0, 512, 35.0, 9350.0  # as the benchmark writes it, in mm
    printed = (b * f * w / (1000 * z) - b * f * w / z0) / s
    found = conventions.hci_disparity(z, **HCI)
    np.testing.assert_allclose(found, printed, atol=1e-12)
    kappa = HCI["baseline"] / (HCI["sensor_size"] / HCI["pixels"])
    lens = ThinLens(1 / (1 / HCI["focal_length"] + 1 / HCI["focus"]), HCI["focal_length"])
    np.testing.assert_allclose(found, kappa * (1 - lens.alpha(z)), atol=1e-4)
    np.testing.assert_allclose(conventions.hci_distance(found, **HCI), z, rtol=1e-12)


def test_what_has_no_answer_is_refused():
    for call, said in (
        (lambda: conventions.to_plenpy(1, views=1), "at least 2 along an axis"),
        (lambda: conventions.to_plenoptomos([-0.5, -1]), r"1 \+ d must be positive"),
        (lambda: conventions.to_ng(0.8, kappa=0.8), "1 - d/kappa must be positive"),
        (lambda: conventions.from_ng(1, kappa=-1), "kappa must be positive"),
        (lambda: conventions.to_virtual_depth(0, pitch=10), "shift must be finite and other"),
        (lambda: conventions.hci_distance(1, **HCI | {"pixels": 0}), "pixels must be positive"),
    ):
        with pytest.raises(ValueError, match=said):
            call()
