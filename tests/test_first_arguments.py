"""What functions work on: an array is taken where it makes sense, anything else is one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
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
    "stream_all_in_focus": ((), {"device": "cpu"}),
    "stream_depth": ((), {"device": "cpu"}),
    "stream_stack": ((), {"disparities": [0], "device": "cpu"}),
    "thin_lens": ((0.1,), {}),
    "thin_lens_gradient": ((None, 0.1), {}),
    "tilt": (((0.0, 0.01),), {}),
    "tilt_gradient": ((None, (0.0, 0.01)), {}),
    "transparency": ((np.ones((8, 8)),), {}),
    "usaf1951": ((), {"groups": [0]}),
}
# These take arrays of numbers, paths, whole numbers or lengths first.
PLAIN = {
    "annulus",
    "bricks",
    "calibrate",
    "cell_energies",
    "checker",
    "circular_mtf",
    "coherent_edge",
    "disc",
    "gaussian",
    "half_plane",
    "hann",
    "hot_pixels",
    "incoherent_edge",
    "kaiser",
    "noise",
    "noll",
    "osa",
    "otf",
    "picture",
    "pixel_mtf",
    "polygon",
    "read_fourier_point_images",
    "read_point_images",
    "read_camera",
    "read_raw",
    "rectangle",
    "regular_polygon",
    "score",
    "square_mtf",
    "square_lattice",
    "stripes",
    "suitable_binning",
    "uniform",
    "usaf1951_elements",
    "wavefront_rms",
    "view",
    "write_lightfield",
    "write_fourier_point_images",
    "write_point_images",
    "write_raw",
    "zernike",
    "crosstalk",
    "decode_raw",
    "deconvolve",
    "demosaic",
    "estimate_lattice",
    "find_beads",
    "find_points",
    "find_regions",
    "fit_pupil",
    "fit_pupil_patches",
    "imaging_system",
    "match_points",
    "metric_depth",
    "open_lightfield",
    "plane_through",
    "preparation",
    "read_lightfield",
    "rectify",
    "sample_scenes",
    "slanted_edge",
    "sphere_labels",
    "speckle_contrast",
    "strehl_of_rms",
    "track_points",
    "traces",
    "wavefront_strehl",
}
# These do not look at what they are given (a camera, a field, a grid, a projector), or not before
# they are iterated over.
UNCHECKED = {
    "type1_sampling",
    "type2_sampling",
    "focus_ratio_of_disparity",
    "abbe_image",
    "binning_error",
    "camera_crosstalk",
    "camera_psf",
    "deconvolve_series",
    "corrected",
    "degenerate_planes",
    "depth_scan",
    "focus_ratio",
    "incoherent_image",
    "rolling_minimum",
    "pitch_sentence",
    "scene_energy",
    "sharpness",
    "suitable_planes",
    "wavefront",
    "view_cameras",
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


# All public functions by their name alone, but for those of topics that take files, jobs or
# results of other calls only, and figures, whose arguments their own tests check.
FUNCTIONS = {
    name.rpartition(".")[2]: value
    for name, value in public_functions().items()
    if name.partition(".")[0] not in ("batch", "io", "plot")
}


def call(name: str, first: Any) -> Any:
    words, named = OTHERS.get(name, ((), OF_LIGHTFIELDS.get(name, {})))
    return FUNCTIONS[name](first, *words, **named)


def test_every_public_function_is_in_one_of_the_lists() -> None:
    assert set(FUNCTIONS) == {*OF_LIGHTFIELDS, *OTHERS, *PLAIN, *UNCHECKED}


@pytest.mark.parametrize("name", sorted(OF_LIGHTFIELDS))
def test_an_array_is_a_light_field_on_the_default_device(
    name: str, monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    wanted = call(name, clplen.LightField.from_array(L, device=device))
    found = call(name, L)
    if hasattr(wanted, "device"):
        assert found.device is device
    if hasattr(wanted, "to_numpy"):
        np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted))
    elif hasattr(wanted, "disparity"):
        assert found.disparity == wanted.disparity


class Foreign:
    """An array of another library, as NumPy sees it."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return L if dtype is None else L.astype(dtype)


def test_arrays_of_other_libraries_are_taken(device: Device) -> None:
    wanted = clplen.refocus(clplen.LightField.from_array(L, device=device), disparity=0.5)
    for array in (Foreign(), Device.open().upload(L)):
        found = clplen.refocus(array, disparity=0.5).to_numpy()
        np.testing.assert_allclose(found, wanted.to_numpy(), rtol=1e-5)


@pytest.mark.parametrize("name", sorted({*OF_LIGHTFIELDS, *OTHERS}))
@pytest.mark.parametrize("wrong", WRONG)
def test_anything_else_is_one_sentence(name: str, wrong: str) -> None:
    with pytest.raises((TypeError, ValueError, clplen.ShapeError)) as error:
        call(name, WRONG[wrong])
    words = str(error.value)
    assert "\n" not in words
    assert not re.search(r"has no attribute(?! 'mla')|object is not|unhashable|argument", words)


@pytest.mark.parametrize("name", sorted(OF_LIGHTFIELDS))
@pytest.mark.parametrize("wrong", ["None", "a path", "a list", "a number"])
def test_functions_of_light_fields_name_from_array(name: str, wrong: str) -> None:
    with pytest.raises(TypeError, match=r"LightField\.from_array and read_lightfield give it"):
        call(name, WRONG[wrong])


PARTS: dict[str, Callable[[Device], Any]] = {
    name: objects.EXAMPLES[name]
    for name in ("DepthMap", "Field", "FocalStack", "Image", "LightField", "RawImage")
}


@pytest.mark.parametrize("name", sorted({*OF_LIGHTFIELDS, *OTHERS}))
@pytest.mark.parametrize("part", PARTS)
def test_other_results_are_taken_or_refused_in_one_sentence(
    name: str, part: str, device: Device
) -> None:
    try:
        call(name, PARTS[part](device))
    except (TypeError, ValueError, clplen.ClplenError) as error:
        assert not re.search(  # noqa: PT017 - several kinds, or none
            r"has no attribute(?! 'mla')|object is not|argument", str(error)
        )
