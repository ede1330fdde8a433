"""Kernel files: launched with the arguments they declare, without double literals, described."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
import pytest

from clplen import (
    Coherence,
    Field,
    Grid,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Propagator,
    RawImage,
    SamplingWarning,
    Spectrum,
    SurfaceScene,
    aperture,
    decode_raw,
    depth_map,
    focal_stack,
    propagate,
    refocus,
    thin_lens,
)
from clplen.bench import ceilings
from clplen.cameras import ExposureOperator, PixelArray, Plane, TextureOperator
from clplen.cameras.optics.camera_aberrations import Aberrations, LensletScatter
from clplen.cameras.scenes.scene_sources import PicturePlane
from clplen.compute.device import Device
from clplen.lightfield import (
    DecodeOperator,
    Lattice,
    LensletGrid,
    RawWarp,
    StackOperator,
    ViewWarp,
)
from clplen.lightfield.arrays.stored_samples import extremes
from clplen.lightfield.depth.depth_maps import sharpness_curve
from clplen.lightfield.focus_and_depth import all_in_focus
from clplen.lightfield.focused.focused_depth import focused_depth
from clplen.lightfield.focused.focused_rendering import render_focused
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.refocusing.fourier_slice import fourier_stack
from clplen.lightfield.refocusing.hyperfan_filter import hyperfan
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector
from clplen.selftest.basics import built_in_values
from clplen.wave import (
    LensletMap,
    LensletSurface,
    RandomPhaseMask,
    Space,
    thin_lens_gradient,
)
from clplen.wave.coherence.abbe import abbe_image
from clplen.wave.coherence.extended_source import ExtendedSource
from clplen.wave.elements.beams import spherical_wave
from clplen.wave.field.adjoints import intensity_gradient
from clplen.wave.field.transmission import multiply_sphere
from clplen.wave.propagation.transfer_function import impulse_response
from clplen.wave.systems.components import Stop
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.pupil_filter import Pupil

TESTS = Path(__file__).parent
FOLDER = TESTS.parent / "kernels"
SOURCES = {file.name: file.read_text() for file in sorted(FOLDER.rglob("*.cl"))}
FILES = list(SOURCES)
WAVELENGTH = 532e-9

COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
KERNEL = re.compile(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(([^)]*)\)")
POINT = r"(?<![\w.])(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?(?!\w)"
EXPONENT = r"(?<![\w.])\d+[eE][+-]?\d+(?!\w)"
CONSTANT = r"\bM_(?:\w(?!_F\b))+\b(?<!_F)"
DOUBLE_LITERAL = re.compile(f"{POINT}|{EXPONENT}|{CONSTANT}")
DOUBLE_BRANCH = re.compile(r"#ifdef DOUBLE\n.*?#(?:else|endif)", re.DOTALL)


def code(source: str) -> str:
    """A source without its comments."""
    return COMMENT.sub(" ", source)


def opening(source: str) -> str:
    """The comment that a file opens with, empty if there is none."""
    match = COMMENT.match(source)
    return match[0] if match else ""


def declared(source: str) -> dict[str, list[str]]:
    """Kernels of a file with the names of their arguments."""
    return {
        name: [argument.split()[-1].lstrip("*") for argument in arguments.split(",")]
        for name, arguments in KERNEL.findall(code(source))
    }


def home(file: str, kernel: str) -> str:
    """The file that declares a kernel: that of its program, or one that this includes."""
    files = [file, *re.findall(r'#include "(.+)"', SOURCES[file])]
    return next(one for one in files if kernel in declared(SOURCES[one]))


KERNELS = {(file, name) for file, source in SOURCES.items() for name in declared(source)}


# What is launched, against what is declared


@dataclass(frozen=True)
class Launch:
    """One launch of one kernel: how its build was specialised and what it was given."""

    file: str
    kernel: cl.Kernel
    defines: dict[str, Any]
    args: tuple[Any, ...]

    @property
    def name(self) -> tuple[str, str]:
        kernel = self.kernel.function_name
        return (home(self.file, kernel), kernel)


def dtype_of(type_name: str, double: bool) -> tuple[np.dtype, int]:
    """NumPy's dtype and the vector length of a type of OpenCL C or of common.cl."""
    scalar, width = re.fullmatch(r"([a-z]+?)(\d*)\*?", type_name.replace("cplx", "real2")).groups()
    names = {"int": "i4", "uint": "u4", "long": "i8", "uchar": "u1", "ushort": "u2"}
    names |= {"half": "f2", "float": "f4", "double": "f8"}
    names["real"] = "f8" if double else "f4"
    return np.dtype(names[scalar]), int(width or 1)


def fits(type_name: str, is_local: bool, arg: Any, double: bool) -> bool:
    """Whether an argument is what a kernel of one precision declares."""
    if is_local or isinstance(arg, cl.LocalMemory):
        return is_local and isinstance(arg, cl.LocalMemory)
    if type_name.endswith("*") != isinstance(arg, cla.Array):
        return False
    dtype, width = dtype_of(type_name, double)
    if not isinstance(arg, cla.Array | np.generic | np.ndarray):
        return False
    if width == 2 and arg.dtype.kind == "c":
        return arg.dtype == np.dtype(f"c{2 * dtype.itemsize}")
    vectors = width == 1 or (arg.ndim > 0 and arg.shape[-1] == width)
    is_one = isinstance(arg, cla.Array) or arg.size == width
    return arg.dtype == dtype and vectors and is_one


def complaints(launch: Launch) -> list[str]:
    """What an OpenCL compiler would say of a launch if it saw both sides."""
    kernel, info = launch.kernel, cl.kernel_arg_info
    if kernel.num_args != len(launch.args):
        return [f"{launch.name} takes {kernel.num_args} arguments, not {len(launch.args)}"]
    found = []
    for i, arg in enumerate(launch.args):
        name, type_name = (kernel.get_arg_info(i, what) for what in (info.NAME, info.TYPE_NAME))
        qualifier = kernel.get_arg_info(i, info.ADDRESS_QUALIFIER)
        is_local = qualifier == cl.kernel_arg_address_qualifier.LOCAL
        if not fits(type_name, is_local, arg, "DOUBLE" in launch.defines):
            given = f"{type(arg).__name__} {getattr(arg, 'dtype', '')}{getattr(arg, 'shape', '')}"
            found.append(f"{launch.name} declares {type_name} {name} and is given {given}")
    return found


def waves(device: Device) -> None:
    """Every kernel of the wave tower, in the device's precision."""
    grid = Grid((16, 24), (10e-6, 12e-6))
    values = np.random.default_rng(1).standard_normal((2, *grid.shape))
    field = Field.from_array(values, grid, wavelength=WAVELENGTH, device=device)
    propagate(field, 5e-3).power()
    propagate(field, 1.0, method="one-step", out_grid=Grid((20, 18), 2e-4)).power()
    for phase in ("tables", "fp64", "twofloat"):
        if phase == "tables" or device.precision == "single":
            plan = Propagator(grid, 1e-3, wavelength=WAVELENGTH, device=device, phase=phase)
            plan(field)
            plan.energy(field)
            multiply_sphere(field, -0.1, phase=phase)
            impulse_response(grid.shape, grid.pitch, 1e-3, WAVELENGTH, device, phase)
    thin_lens(field, 0.1, diameter=150e-6).intensity()
    spherical_wave(grid, 0.1, wavelength=WAVELENGTH, device=device)
    for shape in ("circular", "square"):
        aperture(field, 120e-6, shape=shape)
    surface = LensletSurface(4e-3, 1.5, aspheric=(1e3,))
    measured = LensletMap(np.zeros((5, 7)), pitch=20e-6, glass=1.5)
    for lattice, fill, gap in (("square", "circular", "clear"), ("hexagonal", "full", "opaque")):
        lay = {"lattice": lattice, "fill": fill, "gap": gap}
        MicrolensArray(75e-6, count=2, surface=surface, map=measured, **lay).apply(field)
    bad = Aberrations(lenslets={4: 20e-9}, scatter=LensletScatter(focal_length=0.1))
    for lattice in ("square", "hexagonal"):
        for fill in ("circular", "full"):
            array = MicrolensArray(80e-6, 10e-3, count=2, lattice=lattice, fill=fill)
            array.gradient(field, array.apply(field))
        array = MicrolensArray(80e-6, 10e-3, count=2, lattice=lattice)
        bad.lenslet_errors(array).phase(array, grid, WAVELENGTH, device)
        bad.lenslet_errors(array).gradient(array, field, field)
    thin_lens_gradient(field, field, 0.1)
    system = OpticalSystem([Space(1e-4, method="as"), Stop(5e-5)])
    image, pullback = system.vjp(field, parameters=[0])
    pullback(intensity_gradient(image, np.ones(image.shape)))
    coherent(device)


def coherent(device: Device) -> None:
    """Every kernel of partially coherent light."""
    grid = Grid((16, 24), (10e-6, 12e-6))
    clear = Field.from_array(np.ones(grid.shape), grid, wavelength=WAVELENGTH, device=device)
    for kernel in ("square", "gaussian"):
        mask = RandomPhaseMask((40e-6, 48e-6), kernel=kernel, kind="phase")
        Coherence(mask).average(Space(1e-3), clear, snapshots=2)
    ExtendedSource(1e-3, 0.3).field(grid, wavelength=WAVELENGTH, device=device, seed=1, index=2)
    two = Spectrum.lines([500e-9, 600e-9], [1, 2])
    Coherence(mask, two).average(Space(1e-3), clear, snapshots=2)
    H, S = Pupil(1e-3, 0.1).transfer(grid, WAVELENGTH), np.full(grid.shape, 1 / 384)
    for route in ("points", "lags"):
        abbe_image(clear, H, S, route=route)


def exposed(device: Device, lattice: str) -> RawImage:
    """What a small camera records of two points."""
    mla = MicrolensArray(150e-6, 10e-3, count=9, lattice=lattice)
    camera = PlenopticCamera.type1(
        focal_length=0.03, mla=mla, wavelength=WAVELENGTH, pixels_per_lenslet=12, device=device
    )
    points = PointSources([(0, 0, 0), (2e-4, 0, 5e-3)], diameter=1e-5)
    differentiated(camera, points)
    return camera.expose(points)


def differentiated(camera: Any, points: PointSources) -> None:
    """Every kernel of the adjoint of an exposure, and of its gradients."""
    bent = camera.with_aberrations(Aberrations(main_lens_field={4: (1e-6, 0)}))
    integrating = replace(bent, pixels=PixelArray())
    for one, scene in ((integrating, points), (camera, PointSources((0, 0, 0)))):
        operator = ExposureOperator(one, scene, method="points")
        energies = np.ones(operator.in_shape)
        image = operator.forward(energies)
        operator.adjoint(image)
        operator.gradient(energies, image)
        next(operator.lenslet_fields(energies, image))
        operator.jacobian(energies, by="lenslets")


def windowed(device: Device) -> None:
    """What small cameras record of a point by windows of its own, with pixels that integrate."""
    for lens, fill in (("thin", "full"), ("corrected", "circular")):
        mla = MicrolensArray(150e-6, 10e-3, count=5, fill=fill)
        camera = PlenopticCamera.type1(
            focal_length=0.03, mla=mla, wavelength=WAVELENGTH, pixels_per_lenslet=6,
            aperture_diameter=4e-3, lens_model=lens, pixels=PixelArray(), device=device,
            aberrations=Aberrations(main_lens={5: 1e-8}),
        )  # fmt: skip
        camera.expose(PointSources((0, 0, 0)))


def pictured(device: Device) -> None:
    """What a small camera records of a picture that shines, by the route of patterns."""
    mla = MicrolensArray(150e-6, 10e-3, count=9)
    camera = PlenopticCamera.type1(
        focal_length=0.03,
        mla=mla,
        wavelength=WAVELENGTH,
        pixels_per_lenslet=6,
        aperture_diameter=0.2e-3,
        device=device,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # the pixels are few
        camera.expose(PicturePlane([[1, 2], [0, 1]], 1e-4), method="isoplanatic")


def rendered(lf: LightField) -> None:
    """Every kernel that makes pictures of views along rays, on finer grids and by spectra."""
    for statistic in ("mean", "median", "max", "variance"):
        lf.flatten(statistic, disparity=0.4, mask=np.ones(lf.shape[:4], bool))
    lf.view(0.5, 0.5, disparity=np.zeros(lf.shape[2:4]))
    for more in ({"upsample": 2}, {"interpolation": "fourier"}, {"interpolation": "cubic"}):
        refocus(lf, disparity=0.3, **more)
    lf.flatten("min", interpolation="nearest")
    hyperfan(lf, 0.0, 0.3)
    stack = fourier_stack(lf, disparities=[0.0, 0.3])
    all_in_focus(stack)
    all_in_focus(stack, depth=np.full(lf.shape[2:4], 0.1))


def views(device: Device) -> None:
    """Every kernel that works on views, for every type of sample."""
    random = np.random.default_rng(2)
    for dtype in (np.uint8, np.uint16, np.float32):
        samples = random.integers(1, 200, (3, 2, 20, 18, 3)).astype(dtype)
        lf = LightField.from_array(samples, device=device)
        lf.epi(y=2, v=1)
        lf.render(aperture=2)
        stack = focal_stack(lf, disparities=[-0.4, 0.3, 1])
        depth_map(stack)
        for cue in ("correspondence", "structure-tensor", "combined"):
            depth_map(lf, disparities=[-0.4, 0.3, 1], cue=cue)
        sharpness_curve(stack)
        extremes(lf.data, device)
        spaced = LightField.from_array(samples, device=device, spacing=(2, 2, 1, 1))
        for interpolation in ("linear", "cubic"):
            spaced.resample("point-angle", image_distance=9.0, interpolation=interpolation)
    rendered(lf)


def captured(device: Device) -> None:
    """Every kernel that decodes the raw frame of a real camera."""
    frame = np.random.default_rng(3).random((30, 36))
    lattice = Lattice("square", (14.3, 15.1), (6.2, 0.1), (-0.1, 6.1))
    for bayer in (None, "GRBG"):
        decode_raw(frame, lattice, device=device, white=frame + 1, bayer=bayer)
        decode_raw(frame, lattice, device=device, white=frame + 1, bayer=bayer, demosaic="after")


def focused(device: Device) -> None:
    """Every kernel that renders and compares the sub-images of a focused camera."""
    frame = np.random.default_rng(4).random((50, 52, 3), np.float32)
    lattice = Lattice("square", (24.3, 25.1), (12.2, 0.1), (-0.1, 12.1), frame.shape[:2])
    grid = lattice.grid(lattice.views())
    types = tuple(LensType((0, 12.1 * k), (3 + k, 4 + k), ((12.2, 0.1), (0, 24.2))) for k in (0, 1))
    for data, kinds in ((frame, types), (frame[..., 0], ())):
        values = device.upload(np.ascontiguousarray(data))
        raw = RawImage(values, device, np.nan, grid, grid, lattice=lattice, lens_types=kinds)
        render_focused(raw, method="basic", m=0.3, interpolation="linear")
        render_focused(raw, m=0.3, white=frame[..., 1])
        depth = focused_depth(raw, ms=(0.1, 0.4))
        render_focused(raw, method="depth", m=0.3, depth=replace(depth, sure=0.0))
        point_m(raw)


def microscopic(device: Device) -> None:
    """Every kernel that projects volumes to frames of a microscope and back."""
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, pixels_per_lenslet=15,
        mla=MicrolensArray(100e-6, 2.5e-3, count=3, fill="full"), device=device,
    )  # fmt: skip
    images = point_images(camera, [0.0, 1e-7], voxels_per_lenslet=2, cut=0.2)
    memory = Projector(images, (2, 3), device=device).nbytes // 2
    projector = Projector(images, (2, 3), device=device, memory=memory)  # one plane at a time
    projector.backward(projector.forward(np.ones(projector.volume_shape, np.float32)))
    small = point_images(camera, [1e-7], voxels_per_lenslet=1, cut=0.2)
    for prior in ("tv", "gaussian", "time"):
        deconvolve(np.ones((2, 75, 75)), Projector(small, (5, 5), device=device), iterations=2,
                   accelerate=True, prior=prior)  # fmt: skip


def adjoints(device: Device) -> None:
    """Every kernel of the adjoints of light fields."""
    lf = LightField.from_array(np.ones((2, 3, 9, 20, 3)), device=device, spacing=(2, 2, 1, 1))
    planes = StackOperator(lf, disparities=[-0.4, 0.3], rescale=True)
    planes.adjoint(planes.forward(lf))
    turned = LensletGrid((3, 4), (3, 2), (6.2, 5.1), (7.1, 0.3), (-0.2, 8.1), 0.5)
    for grid in (turned, LensletGrid((3, 4), (3, 2), (6.2, 5.1), (7.1, 0.0), (0.0, 8.1))):
        raw = RawImage(device.zeros((30, 36), np.float32), device, np.nan, grid, grid)
        DecodeOperator(raw).adjoint(np.ones(grid.shape))
    model = ViewWarp((2, 3, 9, 7), device=device)
    model.vjp(np.ones((9, 7)), np.zeros((9, 7)), model.forward(np.ones((9, 7)), np.zeros((9, 7))))
    raw = RawImage(device.zeros((30, 36), np.float32), device, np.nan, turned, turned)
    pixels, flat = RawWarp(raw), np.ones((3, 4))
    pixels.vjp(flat, flat, pixels.forward(flat, flat))


def work(device: Device) -> None:
    """A small workload that reaches every kernel of one mapping, through public functions."""
    ceilings.multiply_add(device, rounds=3).run()
    built_in_values(device)
    waves(device)
    raw = exposed(device, "hexagonal")
    pictured(device)
    windowed(device)
    if device.precision == "single":
        for one in (raw, exposed(device, "square")):
            refocus(LightField.from_raw(one), alpha=0.9, rescale=True)
        captured(device)
        focused(device)
        microscopic(device)
        views(device)
        adjoints(device)
        scene = SurfaceScene(Plane(0.5))
        scene.light_field((2, 3), (6, 9), device=device)
        raw.camera.expose(scene, model="rays")
        textures = TextureOperator(raw.camera, scene)
        textures.adjoint(np.ones(textures.out_shape))


@pytest.fixture(scope="module")
def launches(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Launch]]:
    """Every launch of the workload, an item a row and an item a sample, in each precision."""
    found: list[Launch] = []
    built: dict[int, tuple[str, dict[str, Any], cl.Kernel]] = {}
    kernel, launch = Device.kernel, Device.launch

    def noting(self: Device, file: str, name: str, **defines: Any) -> cl.Kernel:
        one = kernel(self, file, name, **defines)
        built[id(one)] = (file, defines, one)
        return one

    def recording(self: Device, one: cl.Kernel, size: Any, *args: Any, **more: Any) -> None:
        file, defines, _ = built[id(one)]
        found.append(Launch(file, one, defines, args))
        launch(self, one, size, *args, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Device, "kernel", noting)
        patch.setattr(Device, "launch", recording)
        for precision, rows in (("single", True), ("single", False), ("double", True)):
            if precision == "double" and not device.has_fp64:
                continue
            fresh = Device(device.cl_device, precision=precision)
            fresh.rows = rows
            # Programs out of a cache of binaries have forgotten their arguments.
            fresh.context.cache_dir = str(tmp_path_factory.mktemp("cache"))
            work(fresh)
            fresh.finish()
        yield found


@pytest.mark.thorough
def test_the_workload_reaches_every_kernel(launches: list[Launch]) -> None:
    assert {launch.name for launch in launches} == KERNELS


@pytest.mark.thorough
def test_launchers_give_what_kernels_declare(launches: list[Launch]) -> None:
    assert [words for launch in launches for words in complaints(launch)] == []


@pytest.mark.thorough
def test_every_switch_is_described(launches: list[Launch]) -> None:
    given = {(launch.file, define) for launch in launches for define in launch.defines}
    shared = {"ROWS", "DOUBLE"}  # by common.cl
    silent = {
        (file, define)
        for file, define in given
        if define not in shared and f"-D{define}" not in opening(SOURCES[file])
    }
    assert silent == set()


@pytest.mark.parametrize(
    ("type_name", "arg", "double"),
    [
        ("float", np.float32(1), False),
        ("real", np.float64(1), True),
        ("int", np.int32(1), False),
        ("long", np.int64(1), False),
        ("real2", np.zeros(2, np.float32), False),
        ("cplx", np.zeros(2, np.float64), True),
        ("cplx", np.complex64(1), False),
    ],
)
def test_a_right_scalar_is_accepted(type_name: str, arg: Any, double: bool) -> None:
    assert fits(type_name, False, arg, double)
    assert not fits(type_name + "*", False, arg, double)
    assert not fits(type_name, True, arg, double)


@pytest.mark.parametrize(
    ("type_name", "arg", "double"),
    [
        ("float", np.float64(1), False),
        ("float", np.int32(1), False),
        ("float", 1.0, False),
        ("int", 1, False),
        ("int", np.int64(1), False),
        ("int", np.uint32(1), False),
        ("real", np.float32(1), True),
        ("real2", np.zeros(3, np.float32), False),
        ("real2", np.zeros((3, 2), np.float32), False),
        ("cplx", np.complex128(1), False),
        ("float", cl.LocalMemory(4), False),
    ],
)
def test_a_wrong_scalar_is_found(type_name: str, arg: Any, double: bool) -> None:
    assert not fits(type_name, False, arg, double)


def test_arrays_are_judged_by_their_samples(device: Device) -> None:
    pairs, field = (device.zeros((3, 2), np.float32), device.zeros((3, 2), np.complex64))
    assert fits("float*", False, pairs, False)
    assert fits("real2*", False, pairs, False)
    assert fits("cplx*", False, field, False)
    assert not fits("float*", True, pairs, False)
    assert not fits("float4*", False, pairs, False)
    assert not fits("int*", False, pairs, False)
    assert not fits("cplx*", False, field, True)
    assert not fits("float*", False, field, False)
    assert not fits("float", False, pairs, False)


def test_a_wrong_launch_is_found(device: Device, tmp_path: Path) -> None:
    fresh = Device(device.cl_device)
    fresh.context.cache_dir = str(tmp_path)
    kernel = fresh.kernel("intensity.cl", "intensity")
    out, u = fresh.zeros((3, 5), np.float32), fresh.zeros((3, 5), np.complex64)
    sizes = (np.int32(3), np.int32(5))

    def judged(*args: Any, **defines: Any) -> list[str]:
        return complaints(Launch("intensity.cl", kernel, defines, args))

    assert judged(out, u, *sizes) == []
    assert "takes 4 arguments, not 3" in judged(u, *sizes)[0]
    assert len(judged(u, out, *sizes)) == 2
    assert judged(out, u, np.int64(3), sizes[1]) == [
        "('intensity.cl', 'intensity') declares int ny and is given int64 int64()"
    ]
    assert (
        "declares cplx* u and is given Array complex64(3, 5)"
        in judged(out, u, *sizes, DOUBLE=True)[1]
    )


# What the files say


@pytest.mark.parametrize("literal", ["1.0", "1.", ".5", "2.5e-3", "1e5", "3E+2", "M_PI", "M_SQRT2"])
def test_a_planted_double_literal_is_found(literal: str) -> None:
    for text in (f"x = {literal};", f"f({literal}, 1)", f"a*{literal}+b"):
        assert DOUBLE_LITERAL.findall(text) == [literal]


@pytest.mark.parametrize(
    "text",
    [
        "1.0f",
        ".5f",
        "2.5e-3f",
        "1e5f",
        "M_PI_F",
        "v.s0",
        "a[1].x",
        "float4 x1e5",
        "0x1e5",
        "3",
        "1f",
    ],
)
def test_other_text_is_no_double_literal(text: str) -> None:
    assert DOUBLE_LITERAL.findall(f"y = {text};") == []


def shortcomings(file: str, tests: str) -> Iterator[str]:
    """Yield what a kernel file lacks, given the text of the tests of kernels."""
    comment, text, kernels = opening(SOURCES[file]), code(SOURCES[file]), declared(SOURCES[file])
    for literal in DOUBLE_LITERAL.findall(DOUBLE_BRANCH.sub(" ", text)):
        yield f"double literal {literal}"
    for word in re.findall(r"\bnative_\w+|\bhalf_\w+\(|fast-relaxed-math", text):
        yield f"inaccurate arithmetic {word}"
    if len(comment.splitlines()) < 3:
        yield "no comment that says what it computes"
    if kernels and "=" not in comment:
        yield "no equation"
    if kernels and not re.search(r"FOR_X|\bitem\b", comment):
        yield "no mapping of work-items"
    switches = set(re.findall(r"#\s*(?:ifdef|ifndef)\s+(\w+)|defined\((\w+)\)", text))
    for switch in {name for pair in switches for name in pair if name}:
        if not switch.startswith("CLPLEN_") and f"-D{switch}" not in comment:
            yield f"no description of -D{switch}"
    if kernels and re.search(r"\b(?:real|cplx)\b", text) and "-DDOUBLE" not in comment:
        yield "no description of -DDOUBLE"
    included = any(f'#include "{file}"' in source for source in SOURCES.values())
    if file not in tests and (kernels or not included):
        yield "no test in tests/kernels"


def test_kernel_files_keep_the_rules() -> None:
    tests = "".join(test.read_text() for test in TESTS.glob("kernels/test_*.py"))
    assert [f"{file}: {words}" for file in FILES for words in shortcomings(file, tests)] == []


def test_a_planted_fault_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    source = "kernel void one(global float *x) { x[0] = native_sin(1.0); }\n#ifdef TWO\n#endif\n"
    monkeypatch.setitem(SOURCES, "planted.cl", source)
    assert list(shortcomings("planted.cl", "")) == [
        "double literal 1.0",
        "inaccurate arithmetic native_sin",
        "no comment that says what it computes",
        "no equation",
        "no mapping of work-items",
        "no description of -DTWO",
        "no test in tests/kernels",
    ]


# The table


def rows() -> list[list[str]]:
    """Cells of the table in kernels/README.md, below its head."""
    lines = (FOLDER / "README.md").read_text().splitlines()
    table = [line for line in lines if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table]


def ticked(cell: str) -> list[str]:
    """What stands between backticks."""
    return re.findall(r"`([^`]+)`", cell)


def test_the_table_has_a_row_for_every_kernel_and_every_header() -> None:
    listed = [(ticked(row[0])[0], *ticked(row[1])) for row in rows()]
    headers = {(file,) for file, source in SOURCES.items() if not declared(source)}
    assert sorted(listed) == sorted(KERNELS | headers)
    assert {len(row) for row in rows()} == {6}


def test_the_table_names_the_arguments_in_order() -> None:
    for file, kernel, _, _, arguments, _ in rows():
        if ticked(kernel):
            expected = declared(SOURCES[ticked(file)[0]])[ticked(kernel)[0]]
            assert arguments.strip("`").split(", ") == expected, kernel


def test_the_table_names_switches_of_the_file() -> None:
    for file, _, _, switches, _, _ in rows():
        text = "\n".join(SOURCES[name] for name in (ticked(file)[0], "common.cl"))
        for switch in ticked(switches):
            assert switch.split("=")[0].removeprefix("-D") in text, (file, switch)


def test_the_table_names_tests_that_exist() -> None:
    for file, kernel, _, _, _, tests in rows():
        assert ticked(tests), file
        for name in ticked(tests):
            assert (TESTS / "kernels" / name).is_file(), name
            assert ticked(file)[0] in (TESTS / "kernels" / name).read_text() or not ticked(kernel)
