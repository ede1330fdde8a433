"""Arrays of other libraries at public entrances: taken as they are, or refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import objects
import pytest
from setups_microscope import any_projector

import clplen
from clplen.checks import host_array
from clplen.compute.device import Device
from clplen.errors import SamplingWarning
from clplen.lightfield import DepthMap
from clplen.microscopy.frames.outliers import hot_pixels

Maker = Callable[[np.ndarray], Any]


class ByDLPack:
    """An array of which DLPack alone is known."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self.shape, self.ndim, self.dtype = values.shape, values.ndim, values.dtype

    def __dlpack__(self, **options: Any) -> Any:
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.values.__dlpack_device__()


class ByInterface:
    """An array of which the memory alone is known."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self.__array_interface__ = values.__array_interface__


class OnCUDA(ByDLPack):
    """An array in the memory of a GPU, as CuPy has them."""

    __cuda_array_interface__: dict[str, Any] = {}  # noqa: RUF012

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("Implicit conversion to a NumPy array is not allowed.")

    def __dlpack_device__(self) -> tuple[int, int]:
        return (2, 0)


def by_torch(values: np.ndarray) -> Any:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    return torch.from_numpy(values)


def by_jax(values: np.ndarray) -> Any:
    jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    return jax.numpy.asarray(values)


def by_xarray(values: np.ndarray) -> Any:
    return pytest.importorskip("xarray", reason="xarray: pip install xarray").DataArray(values)


MAKERS: dict[str, Maker] = {
    "DLPack": ByDLPack,
    "interface": ByInterface,
    "JAX": by_jax,
    "PyTorch": by_torch,
    "xarray": by_xarray,
}
GRID = clplen.Grid((32, 24), 10e-6)
COMPLEX = (objects.samples(32, 24) + 1j * objects.samples(32, 24)).astype(np.complex64)
ENTRANCES: dict[str, tuple[np.ndarray, Callable[[Any, Device], Any]]] = {
    "Field": (
        COMPLEX,
        lambda a, device: clplen.Field.from_array(a, GRID, wavelength=5e-7, device=device),
    ),
    "LightField": (
        objects.samples(3, 3, 32, 32),
        lambda a, device: clplen.LightField.from_array(a, device=device),
    ),
    "focal_stack": (
        objects.samples(3, 3, 32, 32),
        lambda a, device: clplen.focal_stack(a, disparities=[-1, 0, 1], device=device),
    ),
    "Projector.forward": (
        objects.samples(2, 6, 10),
        lambda a, device: any_projector(device).forward(a),
    ),
    "Projector.backward": (
        objects.samples(9, 15),
        lambda a, device: any_projector(device).backward(a),
    ),
    "deconvolve": (
        1 + objects.samples(15, 15),
        lambda a, device: clplen.deconvolve(a, any_projector(device, (5, 5)), iterations=2).volume,
    ),
    "phase of transparency": (
        objects.samples(32, 24),
        lambda a, device: clplen.wave.transparency(
            clplen.Field.from_array(COMPLEX, GRID, wavelength=5e-7, device=device), phase=a
        ),
    ),
    "Texture": (objects.samples(32, 24), lambda a, device: clplen.cameras.Texture(a)),
    "render": (
        objects.samples(3, 3),
        lambda a, device: objects.lightfield(device).render(aperture=a),
    ),
}


@pytest.mark.parametrize("library", MAKERS)
def test_entrances_take_arrays_of_a_library(library: str, device: Device) -> None:
    for values, function in ENTRANCES.values():
        found = function(MAKERS[library](values), device)
        np.testing.assert_array_equal(np.asarray(found), np.asarray(function(values, device)))


@pytest.mark.parametrize("name", ENTRANCES)
def test_an_entrance_refuses_arrays_of_a_gpu_and_masked_samples(name: str, device: Device) -> None:
    values, function = ENTRANCES[name]
    with pytest.raises(TypeError, match=r"in host memory, got .* on device 0 .*cupy\.asnumpy"):
        function(OnCUDA(values), device)
    if name not in ("LightField", "focal_stack"):  # they have weights
        with pytest.raises(ValueError, match=r"must have no masked samples, got 1 of [\d,]+: repl"):
            function(masked_at(values, (0,) * values.ndim), device)
    function(np.ma.array(values), device)


def test_entrances_refuse_to_drop_gradients(device: Device) -> None:
    for values, function in ENTRANCES.values():
        x = by_torch(values).requires_grad_()
        with pytest.raises(TypeError, match=r"with requires_grad, .* pass tensor\.detach\(\)"):
            function(x, device)


def test_a_conjugate_tensor_is_taken(device: Device) -> None:
    x = by_torch(COMPLEX).conj()
    assert x.is_conj()
    field = clplen.Field.from_array(x, GRID, wavelength=5e-7, device=device)
    np.testing.assert_array_equal(field.to_numpy(), COMPLEX.conj())


def test_types_that_numpy_lacks_and_other_devices_of_torch() -> None:
    torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    with pytest.raises(TypeError, match=r"A frame must be .* got torch\.bfloat16 .*convert it"):
        host_array(torch.ones(3, dtype=torch.bfloat16), "A frame")
    with pytest.raises(TypeError, match=r"A frame must be .* got torch\.float32 .*convert it"):
        host_array(torch.ones(3, 3).to_sparse(), "A frame")
    with pytest.raises(TypeError, match=r"on meta: copy it first"):
        host_array(torch.ones(3, device="meta"), "A frame")
    half = host_array(torch.ones(3, dtype=torch.float16), "A frame")
    assert half.dtype == np.float16


def test_types_that_numpy_lacks_of_jax() -> None:
    jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    with pytest.raises(TypeError, match=r"A frame has dtype bfloat16, .* not support: convert"):
        host_array(jax.numpy.ones(3, jax.numpy.bfloat16), "A frame")


def test_rows_of_unequal_lengths_are_no_array() -> None:
    with pytest.raises(TypeError, match=r"^A frame must not have rows of unequal"):
        host_array([[1, 2], [3]], "A frame")


@pytest.mark.parametrize("library", ["DLPack", "interface", "JAX", "PyTorch"])
def test_the_host_makes_no_copy(library: str) -> None:
    values = objects.samples(64, 64)
    foreign = MAKERS[library](values)
    found = host_array(foreign, "A frame")
    address = foreign.unsafe_buffer_pointer() if library == "JAX" else values.ctypes.data
    assert found.ctypes.data == address


@pytest.mark.parametrize(  # small, and in a buffer of the pool
    ("library", "size"), [("DLPack", 32), ("PyTorch", 1024)]
)
def test_one_copy_goes_to_the_device_and_one_comes_back(
    library: str, size: int, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = objects.samples(size, size).astype(device.complex)
    uploaded: list[int] = []
    downloads: list[tuple[int, ...]] = []
    upload, download = Device.upload, Device.download
    monkeypatch.setattr(
        Device, "upload", lambda d, a: (uploaded.append(a.ctypes.data), upload(d, a))[1]
    )
    grid = clplen.Grid((size, size), 10e-6)
    field = clplen.Field.from_array(MAKERS[library](values), grid, wavelength=5e-7, device=device)
    assert uploaded == [values.ctypes.data]
    monkeypatch.setattr(
        Device, "download", lambda d, a: (downloads.append(a.shape), download(d, a))[1]
    )
    np.testing.assert_array_equal(field.to_numpy(), values)
    assert downloads == [(size, size)]


@pytest.mark.parametrize("library", ["JAX", "PyTorch"])
def test_libraries_take_results(library: str, device: Device) -> None:
    if library == "PyTorch":
        torch = pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
        take = torch.from_dlpack
    else:
        jax = pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
        take = jax.numpy.asarray
    for name in ("DepthMap", "Field", "FocalStack", "Image", "LightField"):
        one = objects.EXAMPLES[name](device)
        np.testing.assert_array_equal(np.asarray(take(one)), one.to_numpy())


# Masks of numpy.ma

VIEWS = objects.samples(3, 4, 17, 23)


def masked_at(values: np.ndarray, *places: tuple[Any, ...]) -> Any:
    """A copy in which values at some places are absurd and masked."""
    found = np.ma.array(values.copy(), mask=np.zeros(values.shape, bool))
    for place in places:
        found[place] = 1e6
        found[place] = np.ma.masked
    return found


class ReadMasked:
    """What gives masked arrays when it is read, as variables of netCDF4 do."""

    def __init__(self, values: Any) -> None:
        self.values, self.shape, self.dtype = values, values.shape, values.dtype

    def __array__(self, *_: Any, **__: Any) -> Any:
        return self.values

    def __getitem__(self, place: Any) -> Any:
        return self.values[place]


REFUSING: dict[str, Callable[[Any, Device], Any]] = {
    "disparities": lambda m, d: clplen.focal_stack(VIEWS, disparities=m[0, 0, 0, :3], device=d),
    "planes": lambda m, d: clplen.depth_map(VIEWS, disparities=m[0, 0, 0], device=d),
    "alphas": lambda m, d: clplen.focal_stack(VIEWS, alphas=m[0, 0, 0, :3], device=d),
    "surface": lambda m, d: clplen.refocus(VIEWS, disparity=m[0, 0], device=d),
    "known depth": lambda m, d: clplen.all_in_focus(VIEWS, depth=m[0, 0], device=d),
    "positions": lambda m, d: clplen.LightField.from_array(VIEWS, positions=m[..., 0, :2]),
    "mask": lambda m, d: clplen.LightField.from_array(VIEWS).flatten("median", mask=m),
    "frame of lenslets": lambda m, d: clplen.estimate_lattice(np.ma.concatenate(2 * [m[0, 0]])),
    "places": lambda m, d: clplen.PointSources(m[0, 0, :, :3] * 1e-6),
    "powers": lambda m, d: clplen.PointSources(VIEWS[0, 0, :, :3] * 1e-6, power=m[0, 0, :, 0]),
    "picture plane": lambda m, d: clplen.PicturePlane(m[0, 0], 1e-3),
    "edge": lambda m, d: clplen.analysis.slanted_edge(m[0, 0], pitch=1e-6),
    "spectrum": lambda m, d: clplen.Spectrum.lines(m[0, 0, 0, :3], VIEWS[0, 0, 0, :3]),
    "volume": lambda m, d: clplen.io.write_volume("v.tif", m[0], planes=range(4), voxel=(1, 1)),
    "frame": lambda m, d: hot_pixels(m[0, 0], (1.0, 1.0), objects.LATTICE),
    "picture": lambda m, d: clplen.plot.picture(m[0, 0]),
    "list": lambda m, d: clplen.cameras.Texture([list(m[0, 0]), list(m[0, 0])]),
    "netCDF": lambda m, d: clplen.cameras.Texture(ReadMasked(m[0, 0])),
    "stored": lambda m, d: clplen.StoredLightField.from_array(ReadMasked(m)).load(d),
    "array in a file": lambda m, d: clplen.io.write_npy("a.npy", m),
}


def test_public_functions_refuse_masked_samples(device: Device) -> None:
    for call in REFUSING.values():
        with pytest.raises(ValueError, match="must have no masked samples"):
            call(masked_at(VIEWS, (0, 0, 0, 0)), device)


def test_a_view_with_masked_samples_has_no_weight(device: Device) -> None:
    masked = masked_at(VIEWS, (1, 2), (2, 0, 3, 4))
    masked.data[1, 2] = np.nan
    expected = np.ones((3, 4))
    expected[[1, 2], [2, 0]] = 0
    own = objects.samples(3, 4) + 0.1
    for given in (masked, [list(row) for row in masked], ReadMasked(masked)):
        with pytest.warns(SamplingWarning, match="1 of 12 views have both masked and valid"):
            lf = clplen.LightField.from_array(given, device=device)
        np.testing.assert_array_equal(lf.weights, expected)
        for picture in (clplen.refocus(lf, disparity=0.0), lf.render()):
            assert np.asarray(picture).max() < 1
        assert np.isfinite(lf.to_numpy()).all()
    with pytest.warns(SamplingWarning):
        stored = clplen.StoredLightField.from_array(masked, weights=own)
    np.testing.assert_array_equal(stored.weights, np.float32(own * expected))
    np.testing.assert_array_equal(stored.to_numpy(), lf.to_numpy())
    whole = clplen.LightField.from_array(masked_at(VIEWS, (1, 2)), device=device)
    assert whole.weights.sum() == 11
    assert clplen.LightField.from_array(np.ma.array(VIEWS), device=device).weights.all()
    with pytest.raises(ValueError, match="must have a view without masked samples"):
        clplen.LightField.from_array(masked_at(VIEWS, np.s_[:, :, 5, 5]), device=device)


def test_masked_weights_are_zero_and_masked_maps_unknown() -> None:
    weights = masked_at(np.ones((3, 4), np.float32), (0, 1))
    assert clplen.LightField.from_array(VIEWS, weights=weights).weights[0, 1] == 0
    truth = np.linspace(-1, 1, 17 * 23).reshape(17, 23)
    depth = DepthMap(*4 * [masked_at(truth, (0, 1))])
    assert np.flatnonzero(np.isnan(depth.confidence)).tolist() == [1]
    scores = clplen.analysis.score(truth, masked_at(truth + 0.01, (8, 9)), border=2)
    assert scores.mse == pytest.approx(0.01, rel=1e-6)  # 100 (0.01 px)^2: 1e6 does not count
    points, _ = clplen.io.points_of(masked_at(truth, (0, 1)))
    assert np.flatnonzero(np.isnan(points[:, 2])).tolist() == [1]
    phase = np.random.default_rng(3).normal(size=(5, 7))
    weight = np.ones((5, 7))
    weight[2, 3] = 0
    found = clplen.analysis.wavefront_rms(masked_at(phase, (2, 3)))
    assert found == pytest.approx(clplen.analysis.wavefront_rms(phase, weight=weight))


# Arrays in place of light fields, pictures and depth maps

PICTURE = VIEWS[0, 0]
FORMS: dict[str, Maker] = {
    "NumPy": np.asarray,
    "list": np.ndarray.tolist,
    "memoryview": memoryview,
    "F order": np.asfortranarray,
    "DLPack": ByDLPack,
    "interface": ByInterface,
}
TAKING: dict[str, tuple[np.ndarray, Callable[[Any], Any]]] = {
    "HDF5": (VIEWS, lambda a: clplen.write_lightfield("views.h5", a)),
    "folder": (VIEWS, lambda a: clplen.write_lightfield("views", a)),
    "write_views": (VIEWS, lambda a: clplen.io.write_views("hci", a, pattern="hci")),
    "write_mosaic": (VIEWS, lambda a: clplen.io.write_mosaic("mosaic.tif", a)),
    "write_html": (PICTURE, lambda a: clplen.io.write_html("page.html", VIEWS, depth=a)),
    "refocus": (VIEWS, lambda a: clplen.refocus(a, disparity=0.5)),
    "suitable_planes": (VIEWS, clplen.lightfield.suitable_planes),
    "StoredLightField": (VIEWS, clplen.StoredLightField.from_light_field),
    "plot.views": (VIEWS, clplen.plot.views),
    "plot.epi": (VIEWS, clplen.plot.epi),
    "plot.picture": (PICTURE, clplen.plot.picture),
    "plot.refocused": (PICTURE, lambda a: clplen.plot.refocused([a, a], ["a", "b"])),
    "write_image": (PICTURE, lambda a: clplen.io.write_image("image.tif", a)),
    "write_picture": (PICTURE, lambda a: clplen.io.write_picture("picture.tif", a)),
    "write_pfm": (PICTURE, lambda a: clplen.io.write_pfm("a.pfm", a)),
    "plot.depth": (PICTURE, clplen.plot.depth),
    "write_depth": (PICTURE, lambda a: clplen.io.write_depth("depth.ome.tif", a)),
    "points_of": (PICTURE, clplen.io.points_of),
    "surface": (PICTURE, lambda a: clplen.refocus(VIEWS, disparity=a)),
}


@pytest.mark.parametrize("name", TAKING)
def test_a_public_function_takes_arrays(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All take arrays by one function, `host_array`; some take every form."""
    values, function = TAKING[name]
    forms = FORMS if name in ("refocus", "surface", "write_image") else ("list", "DLPack")
    for n, form in enumerate(forms):
        folder = tmp_path / str(n)
        folder.mkdir()
        monkeypatch.chdir(folder)
        function(FORMS[form](values))
