"""Spatial and angular samples of plenoptic cameras against the numbers of their geometry."""

from __future__ import annotations

from dataclasses import asdict
from types import SimpleNamespace

import pytest

from clplen.analysis.cameras.sampling import (
    Sampling,
    sampling_of,
    sampling_table,
    type1_sampling,
    type2_sampling,
)
from clplen.wave.elements.lenslets import MicrolensArray

TYPE1 = {
    "lenslets": 101,
    "pitch": 150e-6,
    "diameter": 150e-6,
    "focal_length": 0.010,
    "pixel_pitch": 5e-6,
    "wavelength": 532e-9,
    "image_distance": 0.240,
    "aperture_diameter": 3.6e-3,
}
TYPE2 = {
    "lenslets": 101,
    "pitch": 150e-6,
    "diameter": 150e-6,
    "a": 0.018,
    "b": 0.0036,
    "pixel_pitch": 5e-6,
    "wavelength": 532e-9,
}


def test_the_standard_camera() -> None:
    got = type1_sampling(**TYPE1)
    assert (got.kind, got.spatial_samples) == ("1.0", 101)
    assert got.spatial_share == pytest.approx(1 / 30)
    assert got.views == pytest.approx(30)
    assert got.spatial_pitch == 150e-6
    assert got.angular_step == pytest.approx(5e-4)  # dx/f_mu
    assert got.angular_range == pytest.approx(0.015)
    assert got.independent_views == pytest.approx(4.229, abs=1e-3)
    assert got.nyquist == pytest.approx(1 / 300e-6)
    assert got.diffraction_cutoff == pytest.approx(3.6e-3 / (532e-9 * 0.24))
    assert got.cutoff == got.nyquist
    coarse = type1_sampling(**(TYPE1 | {"pixel_pitch": 75e-6}))
    assert coarse.independent_views == pytest.approx(2)  # as many as there are pixels


def test_the_focused_camera() -> None:
    got = type2_sampling(**TYPE2)
    assert (got.kind, got.spatial_samples) == ("2.0", pytest.approx(606))
    assert got.spatial_share == pytest.approx(0.2)
    assert got.spatial_pitch == pytest.approx(25e-6)  # dx/m
    assert got.views == got.independent_views == pytest.approx(5)
    assert got.angular_step == pytest.approx(150e-6 / 0.018)
    assert got.angular_range == pytest.approx(150e-6 / 0.0036)
    assert got.angular_range / got.angular_step == pytest.approx(got.views)
    assert got.nyquist == pytest.approx(20.0e3)
    assert got.diffraction_cutoff == pytest.approx(15.66e3, rel=1e-3)
    assert got.cutoff == got.diffraction_cutoff
    galilean = type2_sampling(**(TYPE2 | {"a": -0.018}))
    assert asdict(galilean) == asdict(got)


def camera(**more: object) -> SimpleNamespace:
    mla = MicrolensArray(150e-6, 0.010, count=(61, 101), lattice="hexagonal", fill="full")
    return SimpleNamespace(mla=mla, pixel_pitch=5e-6, wavelength=532e-9, **more)


def test_cameras_are_told_apart() -> None:
    first = camera(kind="standard", image_distance=0.240, aperture_diameter=3.6e-3)
    assert sampling_of(first) == type1_sampling(**TYPE1)
    row = 150e-6 * 3**0.5 / 2
    along_y = sampling_of(first, axis=0)
    assert along_y.spatial_samples == 61
    assert along_y.spatial_pitch == pytest.approx(row)
    assert along_y.angular_range == pytest.approx(row / 0.010)


def test_a_focused_camera_s_main_lens_and_sensor_count() -> None:
    # A hexagonal array's sensor is half a lenslet wider than a row.
    main_lens = {"image_distance": 0.240, "aperture_diameter": 4.8e-3}
    given = {"kind": "focused", "a": -0.018, "b": 0.0036} | main_lens
    along_x, along_y = (
        sampling_of(camera(grid=SimpleNamespace(shape=(1601, 3045)), **given), axis=axis)
        for axis in (1, 0)
    )
    assert along_x == type2_sampling(**(TYPE2 | {"a": -0.018}), cone=0.02, pixels=3045)
    assert along_x.spatial_samples == pytest.approx(0.2 * 3045)
    assert along_y.spatial_samples == pytest.approx(0.2 * 1601)
    assert along_x.views == along_x.independent_views == pytest.approx(2.4)  # D abs(a)/(F p)
    assert along_x.angular_range == pytest.approx(0.02)  # D/F
    for one in (along_x, along_y):
        assert one.angular_range / one.angular_step == pytest.approx(one.views)
    narrow = type2_sampling(**(TYPE2 | {"diameter": 100e-6}))
    assert narrow.angular_step == pytest.approx(150e-6 / 0.018)  # lenslets are still a pitch apart
    assert narrow.diffraction_cutoff == pytest.approx(100e-6 / (532e-9 * 0.018))


def test_the_table_has_a_column_for_each_camera() -> None:
    table = sampling_table({"1.0": type1_sampling(**TYPE1), "focused": type2_sampling(**TYPE2)})
    rows = [line.split("  ") for line in table.split("\n")]
    words = {cells[0]: [c.strip() for c in cells[1:] if c.strip()] for cells in rows}
    assert words["places along the axis"] == ["101", "606"]
    assert words["pitch of places"] == ["150", "25", "um"]
    assert words["Nyquist frequency"] == ["3.333", "20", "cycles/mm"]
    assert words["independent views"] == ["4.229", "5"]
    assert len(rows) == 11


def test_numbers_must_be_positive() -> None:
    for name in TYPE1:
        if name != "diameter":
            with pytest.raises(ValueError, match=f"{name} must be positive"):
                type1_sampling(**(TYPE1 | {name: -1.0}))


def test_bad_input_is_told() -> None:
    with pytest.raises(ValueError, match="a must be finite and not 0"):
        type2_sampling(**(TYPE2 | {"a": 0.0}))
    with pytest.raises(ValueError, match="cone must be positive"):
        type2_sampling(**TYPE2, cone=-0.1)
    with pytest.raises(ValueError, match="at most the pitch"):
        type2_sampling(**(TYPE2 | {"diameter": 151e-6}))
    with pytest.raises(TypeError, match="plenoptic camera, got Sampling"):
        sampling_of(Sampling(**asdict(type2_sampling(**TYPE2))))
    with pytest.raises(TypeError, match="aperture_diameter"):
        sampling_of(camera(kind="standard", image_distance=0.240))
    with pytest.raises(ValueError, match="axis must be 0"):
        sampling_of(camera(), axis=2)
    with pytest.raises(ValueError, match="at least one camera"):
        sampling_table({})
