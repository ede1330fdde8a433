"""Names that programs outside the package use keep working: each is called as they call it."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clplen
from clplen import Device

LAM = 532e-9
MLA = clplen.MicrolensArray(150e-6, 10e-3, count=25, fill="full")
RNG = np.random.default_rng(7)
VIEWS = RNG.random((3, 5, 23, 31), np.float32)
CAMERA: dict[str, Any] = {
    "focal_length": 0.12,
    "mla": MLA,
    "wavelength": LAM,
    "pixels_per_lenslet": 30,
}


@pytest.fixture(autouse=True)
def _no_deprecation() -> Any:
    """None of these names warns that it will go."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        yield


def test_device(device: Device) -> None:
    assert any(found.place == device.place for found in Device.all())
    assert isinstance(Device.open(device.place, precision="single"), Device)
    assert device.name in repr(device)
    assert isinstance(device.is_cpu, bool)
    assert isinstance(device.has_fp64, bool)
    assert device.memory_bytes > 0


def test_errors() -> None:
    for error in (
        clplen.DeviceError,
        clplen.KernelBuildError,
        clplen.SamplingError,
        clplen.ShapeError,
        clplen.FormatError,
    ):
        assert issubclass(error, clplen.ClplenError)
    assert issubclass(clplen.SamplingWarning, UserWarning)


def test_grid_and_field(device: Device) -> None:
    grid = clplen.Grid((6, 8), (2e-6, 3e-6), origin=(1e-6, 0))
    assert grid.shape == (6, 8)
    assert grid.pitch == (2e-6, 3e-6)
    assert clplen.Grid((6, 8), 2e-6).pitch == (2e-6, 2e-6)
    assert grid.origin == (1e-6, 0)
    assert [len(x) for x in (grid.x, grid.y, grid.fx, grid.fy)] == [8, 6, 8, 6]
    assert grid.y[3] == pytest.approx(1e-6)
    values = RNG.random((2, 6, 8)).astype(np.complex64)
    field = clplen.Field.from_array(values, grid, wavelength=LAM, device=device)
    assert np.array_equal(field.to_numpy(), values)
    assert (field.grid, field.wavelength, field.device.place) == (grid, LAM, device.place)
    assert isinstance(field.intensity(), clplen.Image)
    one = clplen.Field.from_array(values[0], grid, wavelength=LAM, device=device)
    assert one.power() == pytest.approx(float((abs(values[0]) ** 2).sum()) * 6e-12, rel=1e-5)


METHODS = (
    "auto", "as", "blas", "cblas", "fresnel-tf", "fresnel-ir", "fresnel-1fft",
    "fresnel-multistep", "rs",
)  # fmt: skip


def test_propagate(device: Device) -> None:
    for method in METHODS:
        grid = clplen.Grid((64, 48), 5e-6)
        r2 = grid.y[:, None] ** 2 + grid.x**2
        values = np.exp(-r2 / (40e-6) ** 2).astype(np.complex64)
        field = clplen.Field.from_array(values, grid, wavelength=LAM, device=device)
        z = 3e-3 if method in ("fresnel-ir", "fresnel-1fft", "rs") else 1e-3
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", clplen.SamplingWarning)
            result = clplen.propagate(field, z, method=method, pad=2)
        assert result.power() == pytest.approx(field.power(), rel=0.02)
        if method == "auto":
            out = clplen.propagate(field, z, out_grid=clplen.Grid((32, 32), 5e-6))
            assert out.grid.shape == (32, 32)


def test_propagator(device: Device) -> None:
    grid = clplen.Grid((64, 48), 5e-6)
    plan = clplen.Propagator(grid, 1e-3, wavelength=LAM, method="auto", pad=2, device=device)
    field = clplen.Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    assert isinstance(plan(field), clplen.Field)
    assert plan.method in METHODS
    assert plan.why
    assert plan.report
    assert plan.energy(field)


def test_elements(device: Device) -> None:
    grid = clplen.Grid((128, 120), 5e-6)
    field = clplen.Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    clplen.thin_lens(field, 0.1)
    clplen.thin_lens(field, 0.1, diameter=3e-4, aliasing="raise")
    clplen.thin_lens(field, f=0.1, aliasing="allow")
    assert clplen.aperture(field, 3e-4).power() < field.power()
    clplen.phase_plate(field, {4: 1e-7}, diameter=3e-4)


def test_microlens_array(device: Device) -> None:
    mla = clplen.MicrolensArray(
        150e-6, f=10e-3, count=(3, 4), lattice="square", fill="circular", diameter=None,
        offset=(1e-6, 0), rotation=0.01,
    )  # fmt: skip
    assert mla.f == 10e-3
    for lattice in ("square", "hexagonal"):
        for fill in ("circular", "full"):
            mla = clplen.MicrolensArray(150e-6, 10e-3, count=3, lattice=lattice, fill=fill)
            grid = clplen.Grid((90, 96), 5e-6)
            ones = np.ones(grid.shape)
            field = clplen.Field.from_array(ones, grid, wavelength=LAM, device=device)
            assert mla.apply(field).grid == grid


def test_coherence(device: Device) -> None:
    grid = clplen.Grid((32, 32), 5e-6)
    snapshots = clplen.Coherence().snapshots(grid, wavelength=LAM, device=device)
    assert next(iter(snapshots)).power() == pytest.approx((32 * 5e-6) ** 2, rel=1e-4)


def test_cameras(device: Device) -> None:
    scene = clplen.PointSources([(0, 0, -0.02)], diameter=0.0, power=1.0)
    first = clplen.PlenopticCamera.type1(
        **CAMERA, device=device, object_distance=None, image_distance=None, aperture_diameter=None,
        field_lens=False,
    )  # fmt: skip
    second = clplen.PlenopticCamera.type2(**CAMERA, device=device, m=0.25, match="pupil")
    third = clplen.PlenopticCamera.microscope(
        magnification=20, na=0.5, mla=clplen.MicrolensArray(125e-6, 2.5e-3, count=5, fill="full"),
        wavelength=525e-9, pixels_per_lenslet=25, device=device, medium_index=1.0, tube_lens=0.2,
    )  # fmt: skip
    names = "aperture_diameter object_distance image_distance pixel_pitch grid mla wavelength"
    for camera, kind in ((first, "standard"), (second, "focused"), (third, "microscope")):
        assert all(hasattr(camera, name) for name in names.split())
        assert camera.describe()
        assert isinstance(camera, clplen.PlenopticCamera)
        assert camera.kind == kind
    assert first.dz(first.alpha(-0.02)) == pytest.approx(-0.02)
    assert second.dz(second.alpha(0.02)) == pytest.approx(0.02)
    assert all(hasattr(second, name) for name in ("a", "b", "m", "patch_size"))
    raw = first.expose(scene, coherence=None)
    assert isinstance(raw, clplen.RawImage)
    assert raw.to_numpy().dtype == np.float32
    lf = clplen.LightField.from_raw(raw, decode="calibrated")
    assert lf.to_numpy().shape == (30, 30, 25, 25)
    assert lf.camera is first
    assert lf.raw is raw
    for method in ("compensated", "energy"):
        found = clplen.estimate_alpha(lf, method=method, window=11, c_max=0.3)
        assert {"alpha", "z", "in_focus", "uncertainty", "curve"} <= set(dir(found))


def test_light_field(device: Device) -> None:
    spacing = (-1e-3, -1e-3, 1e-5, 1e-5)
    lf = clplen.LightField.from_array(VIEWS, device=device, spacing=spacing)
    assert np.array_equal(lf.to_numpy(), VIEWS)
    assert lf.spacing == spacing
    assert lf.view(1, 2.5).to_numpy().shape == (23, 31)
    assert lf.epi(y=3, v=1).to_numpy().shape == (5, 31)
    assert lf.epi(x=3, u=1).to_numpy().shape == (3, 23)
    assert lf.render(aperture=0.5, viewpoint=(1, 2)).to_numpy().shape == (23, 31)


def test_refocus_stack_and_depth(device: Device) -> None:
    lf = clplen.LightField.from_array(VIEWS, device=device)
    assert isinstance(clplen.refocus(lf, disparity=0.5), clplen.Image)
    spaced = clplen.LightField.from_array(VIEWS, device=device, spacing=(-1e-3, -1e-3, 1e-5, 1e-5))
    clplen.refocus(spaced, alpha=0.999, rescale=False)
    stack = clplen.focal_stack(lf, disparities=[-1, 0, 1], aperture=None)
    assert stack.to_numpy().shape == (3, 23, 31)
    assert list(stack.disparities) == [-1, 0, 1]
    assert len(clplen.focal_stack(spaced, alphas=[0.999, 1.0]).alphas) == 2
    for cue in ("energy", "correspondence", "structure-tensor", "combined"):
        depth = clplen.depth_map(lf, disparities=[-1, 0, 1], cue=cue)
        for name in ("disparity", "alpha", "z", "confidence"):
            assert hasattr(depth, name)
    assert clplen.depth_map(stack, cue="energy").disparity.shape == (23, 31)


def test_files(device: Device, tmp_path: Path) -> None:
    lf = clplen.LightField.from_array(VIEWS, device=device)
    path = tmp_path / "field.h5"
    clplen.io.write_lightfield(path, lf)
    again = clplen.read_lightfield(
        path, device=device, pattern=None, views=None, flip_v=False, flip_u=False, swap_uv=False,
        order=None, white=None, dark=None, grid=None, allow_missing=False,
    )  # fmt: skip
    assert np.array_equal(again.to_numpy(), VIEWS)
    assert np.array_equal(clplen.read_lightfield(path).to_numpy(), VIEWS)
