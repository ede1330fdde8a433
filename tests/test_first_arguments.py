"""What functions work on: an array is taken where it makes sense, anything else is one sentence."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import objects
import pytest
from public_names import public_functions

import clplen
from clplen.compute.device import Device

L = objects.samples(5, 5, 32, 32)
# Further arguments of the functions of a light field, and what their results have in numbers.
FLAT = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
FLAT[:4, 4] = -FLAT.diagonal()[:4] * (2, 2, 15.5, 15.5)
INTRINSICS = clplen.lightfield.Intrinsics(FLAT, np.full(5, 0.01), (5, 5, 32, 32))
OF_LIGHTFIELDS: dict[str, dict[str, Any]] = {
    "check_light_field": {},
    "shift_views": {"steps": np.zeros((5, 5, 2))},
    "all_in_focus": {"disparities": [-1, 0, 1]},
    "depth_map": {"disparities": [-1, 0, 1], "cue": "energy"},
    "estimate_alpha": {"method": "slope"},
    "focal_stack": {"disparities": [-1, 0, 1]},
    "fourier_stack": {"disparities": [-1, 0, 1]},
    "hyperfan": {"low": -0.5, "high": 0.5},
    "phase_space": {"y": 3, "v": 1},
    "rectify_views": {"intrinsics": INTRINSICS},
    "refocus": {"disparity": 0.5},
    "view_between": {"v": 1, "u": 2.5, "disparity": 0.5},
    "views_between": {"viewpoints": [(1, 2.5)], "disparity": 0.5},
}
WAVE = {"wavelength": objects.LAM, "device": "cpu"}
OTHERS: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
    "annular_aperture": ((3e-6,), {"inner": 1e-6}),
    "aperture": ((3e-6,), {}),
    "axicon": ((0.01,), {}),
    "check_pupil": ((None,), {}),
    "compare": ((), {}),
    "correct_aberrations": (({4: 1e-7},), {}),
    "find_corners": (((3, 4),), {"device": "cpu"}),
    "focused_depth": ((), {}),
    "focused_maps": ((None,), {}),
    "focused_stack": ((), {"ms": [0.1, 0.2]}),
    "fourier_point_images": (([1e-5],), {}),
    "gaussian_beam": ((1e-5,), WAVE),
    "gaussian_beam_gradient": ((1e-5,), {}),
    "grating": ((4e-6,), {}),
    "lattice_of": ((), {}),
    "measure_point_images": ((np.zeros((1, 9, 9)), [0.0]), {}),
    "measured_degree": (([(0, 0)],), {}),
    "phase_plate": (({4: 0.1},), {"diameter": 5e-6}),
    "plane_wave": ((), WAVE),
    "point_images": (([1e-5],), {}),
    "point_m": ((), {}),
    "intensity_gradient": ((np.ones((8, 8)),), {}),
    "polar_gradient": ((None,), {}),
    "polygonal_aperture": (([(0, 0), (0, 1e-6), (1e-6, 0)],), {}),
    "propagate": ((1e-4,), {}),
    "propagate_wavelengths": ((1e-4, [5e-7]), {}),
    "raw_preparation": ((), {"white": np.ones((64, 64)), "device": "cpu"}),
    "rectangular_aperture": ((3e-6,), {}),
    "render_focused": ((), {}),
    "sampling_of": ((), {}),
    "sampling_table": ((), {}),
    "seam": ((), {}),
    "sharpness_curve": ((), {}),
    "siemens_star": ((5,), {"diameter": 1e-5}),
    "spherical_wave": ((1e-3,), WAVE),
    "spherical_wave_gradient": ((1e-3,), {}),
    "stack_tiles": ((), {"disparities": [0], "device": "cpu"}),
    "thin_lens": ((0.1,), {}),
    "thin_lens_gradient": ((None, 0.1), {}),
    "tilt": (((0.0, 0.01),), {}),
    "tilt_gradient": ((None, (0.0, 0.01)), {}),
    "transparency": ((np.ones((8, 8)),), {}),
    "usaf1951": ((), {"groups": [0]}),
}
WRONG = {
    "None": None,
    "a path": "l.h5",
    "a list": [1, 2],
    "an object": object(),
    "a class": clplen.LightField,
    "a number": 3,
    "a flat array": np.ones((8, 8), np.float32),
    "complex": np.ones((3, 3, 8, 8), np.complex64),
    "words": np.array([["a"]]),
}


FUNCTIONS = {
    name.rpartition(".")[2]: value
    for name, value in public_functions().items()
    if name.partition(".")[0] not in ("batch", "io", "plot")
}
OF_PYTHON = re.compile(r"has no attribute(?! 'mla')|object is not|unhashable|argument|\n")
REFUSALS = (TypeError, ValueError, clplen.ClplenError)


def call(name: str, first: Any) -> Any:
    words, named = OTHERS.get(name, ((), OF_LIGHTFIELDS.get(name, {})))
    return FUNCTIONS[name](first, *words, **named)


def refusal(name: str, first: Any) -> str | None:
    """The sentence of a call that is refused; None if it is not."""
    try:
        call(name, first)
    except REFUSALS as error:
        return str(error)
    return None


def test_an_array_is_a_light_field_on_the_default_device(
    monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    for name in OF_LIGHTFIELDS:
        wanted = call(name, clplen.LightField.from_array(L, device=device))
        found = call(name, L)
        assert getattr(found, "device", device) is device, name
        if hasattr(wanted, "to_numpy"):
            np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted), err_msg=name)
        elif hasattr(wanted, "disparity"):
            assert found.disparity == wanted.disparity, name


class Foreign:
    """An array of another library, as NumPy sees it."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return L if dtype is None else L.astype(dtype)


def test_arrays_of_other_libraries_are_taken(device: Device) -> None:
    wanted = clplen.refocus(clplen.LightField.from_array(L, device=device), disparity=0.5)
    for array in (Foreign(), Device.open().upload(L)):
        found = clplen.refocus(array, disparity=0.5).to_numpy()
        np.testing.assert_allclose(found, wanted.to_numpy(), rtol=1e-5)


def test_anything_else_is_refused_in_one_sentence() -> None:
    """Functions of light fields name what gives one."""
    said = {
        (name, kind): refusal(name, wrong)
        for name in (*OF_LIGHTFIELDS, *OTHERS)
        for kind, wrong in WRONG.items()
    }
    assert [of for of, words in said.items() if words is None or OF_PYTHON.search(words)] == []
    remedy = "(LightField.from_array, read_lightfield)"
    kinds = ("None", "a path", "a list", "a number")
    pairs = [(name, kind) for name in OF_LIGHTFIELDS for kind in kinds]
    assert [of for of in pairs if remedy not in (said[of] or "")] == []


def test_other_results_are_taken_or_refused_in_one_sentence(device: Device) -> None:
    for part in ("DepthMap", "Field", "FocalStack", "Image", "LightField", "RawImage"):
        made = objects.EXAMPLES[part](device)
        for name in (*OF_LIGHTFIELDS, *OTHERS):
            words = refusal(name, made) or ""
            assert not OF_PYTHON.search(words), (name, part, words)
