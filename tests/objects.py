"""One small example of every public class, for tests of what all of them share."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import clplen
from clplen.analysis.cameras.camera_psf import DepthTransfer
from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.depth_scan import DepthErrors
from clplen.analysis.cameras.imaging import Rendered
from clplen.batch.jobs.spec import StackTable
from clplen.batch.jobs.tables import InputTable
from clplen.batch.jobs.task import Report
from clplen.batch.running.estimate import JobEstimate
from clplen.cameras.exposure.exposure_jacobian import ExposureJacobian
from clplen.cameras.exposure.point_gradients import ExposureGradient
from clplen.compute.device import Device
from clplen.io.results.stored_volumes import StoredFile
from clplen.lightfield.focused.focused_picture import PictureGrid
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import Exposure
from clplen.lightfield.stacks import StackTiles
from clplen.lightfield.streaming.tile_plan import Tile
from clplen.microscopy.fourier.bead_stack import BeadCalibration
from clplen.microscopy.frames.prepare import Prepared
from clplen.microscopy.frames.raw_frames import RawPreparation
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pupil.even_light import EvenLight
from clplen.wave.coherence.abbe import AbbeImage

LAM = 5e-7
GRID = clplen.Grid((8, 8), 1e-6)
MLA = clplen.MicrolensArray(150e-6, 10e-3, count=5, fill="full")
CAMERA: dict[str, Any] = {
    "focal_length": 0.12,
    "mla": MLA,
    "wavelength": LAM,
    "pixels_per_lenslet": 30,
    "aperture_diameter": 5e-4,  # as much as 5 lenslets hold
}
MICROSCOPE: dict[str, Any] = {
    "magnification": 20,
    "na": 0.5,
    "mla": clplen.MicrolensArray(125e-6, 2.5e-3, count=3, fill="full"),
    "wavelength": 525e-9,
    "pixels_per_lenslet": 25,
}
EVEN_LIGHT: dict[str, Any] = {
    "magnification": 20.0, "na": 0.5, "medium_index": 1.0, "wavelength": 525e-9,
    "apodisation": 0.5, "lenslet_pitch": 125e-6, "lenslet_focal_length": 2.5e-3,
    "lenslet_diameter": 125e-6, "lenslet_fill": "full", "binning": 1,
}  # fmt: skip
SPACING = (-1e-3, -1e-3, 1e-5, 1e-5)
PICTURE = PictureGrid((0.0, 0.0), 1.0, (9, 9))
FOURIER: dict[str, Any] = {
    "magnification": 20,
    "na": 0.3,
    "mla": clplen.MicrolensArray(500e-6, 12e-3, count=3),
    "wavelength": 525e-9,
    "relay": 0.05,
    "pixel_pitch": 20e-6,
}
JOB: dict[str, Any] = {
    "output": "out",
    "inputs": [{"files": ["*.h5"]}],
    "stack": {"disparities": [-1, 0, 1]},
}
LATTICE = Lattice("square", (10.0, 10.0), (10.0, 0.0), (0.0, 10.0), (41, 41))


def samples(*shape: int) -> np.ndarray[Any, Any]:
    """Values from 0 to 1, none like its neighbours."""
    return np.random.default_rng(1).random(shape, np.float32)


def system() -> Any:
    """A short distance and a weak lens."""
    return clplen.OpticalSystem([clplen.wave.Space(1e-4), clplen.wave.Lens(0.1)])


def point_images() -> PointImages:
    """Of two planes, three voxels and three pixels a lenslet."""
    stored = tuple(samples(3, 9, 9) for _ in range(2))
    parameters = {"lenslet_pitch": 125e-6, "magnification": 20.0}
    return PointImages(parameters, np.array([-1e-5, 1e-5]), 3, 3, stored, np.ones(2))


def frame_projector(device: Device) -> clplen.microscopy.FrameProjector:
    """Onto 14 x 15 pixels of a turned lattice."""
    lattice = clplen.lightfield.Lattice("square", (7.0, 6.0), (3.0, 0.1), (-0.1, 3.0), (14, 15))
    return clplen.microscopy.FrameProjector(point_images(), lattice, device=device)


def fourier_images() -> clplen.microscopy.FourierPointImages:
    """Of a plane, two lenslets and 9 x 12 pixels."""
    corners = np.array([[[3, 2], [3, 7]]], np.int32)
    centres = np.array([[4.0, 3.0], [4.0, 8.0]])
    return clplen.microscopy.FourierPointImages(
        {}, np.zeros(1), 1, 1e-6, (9, 12), centres, 3.0, (samples(1, 2, 3, 3),), corners
    )


def camera(device: Device) -> Any:
    """A standard camera of 5 x 5 lenslets."""
    return clplen.PlenopticCamera.type1(**CAMERA, device=device)


def focused(device: Device) -> Any:
    """A focused camera of 5 x 5 lenslets."""
    return clplen.PlenopticCamera.type2(**CAMERA, device=device, m=0.25)


def deconvolver(device: Device) -> Any:
    settings = clplen.microscopy.DeconvolutionSettings()
    return clplen.microscopy.Deconvolver(point_images(), settings, device=device, force=True)


def raw(device: Device) -> clplen.RawImage:
    """What the standard camera sees of a point."""
    return _raw(device)


@lru_cache
def _raw(device: Device) -> clplen.RawImage:
    return camera(device).expose(clplen.PointSources([(0.0, 0.0, 0.0)]))


def lightfield(device: Device) -> clplen.LightField:
    """3 x 3 views with a spacing."""
    return clplen.LightField.from_array(samples(3, 3, 32, 32), device=device, spacing=SPACING)


def field(device: Device) -> clplen.Field:
    return clplen.wave.plane_wave(GRID, wavelength=LAM, device=device)


def psf() -> clplen.analysis.PSF:
    y, x = np.mgrid[-16:17, -16:17] * 1e-6
    return clplen.analysis.PSF(np.exp(-(x**2 + y**2) / 2e-11), 1e-6)


def edge() -> Any:
    y, x = np.mgrid[0:64, 0:64]
    return clplen.analysis.slanted_edge(1 / (1 + np.exp(-(x - 32 - 0.1 * y))), pitch=1e-6)


def depth() -> clplen.DepthMap:
    return clplen.DepthMap(*(samples(16, 16) for _ in range(4)))


def intrinsics() -> clplen.lightfield.Intrinsics:
    H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    H[:4, 4] = -H.diagonal()[:4] * (2, 2, 15.5, 15.5)
    return clplen.lightfield.Intrinsics(H, np.full(5, 0.01), (5, 5, 32, 32), rms=0.02)


def stored_volumes() -> clplen.io.StoredVolumes:
    """Two times of 3 x 9 x 9 voxels, in a file that is not there."""
    file = StoredFile(Path("a.npy"), {"t": 2, "z": 3}, (9, 9), None, (1e-6, 1e-6), None)
    return clplen.io.StoredVolumes((file,), None, (1e-6, 1e-6))


def texture() -> clplen.cameras.Texture:
    return clplen.cameras.Texture(samples(16, 16))


def stream(device: Device) -> StackTiles:
    stored = clplen.StoredLightField.from_array(samples(3, 3, 32, 32))
    return clplen.lightfield.stack_tiles(stored, disparities=[0, 1], device=device)


EXAMPLES: dict[str, Callable[[Device], Any]] = {
    "OTF": lambda _: clplen.analysis.OTF.of(psf()),
    "PSF": lambda _: psf(),
    "OPDMaps": lambda _: clplen.cameras.OPDMaps(np.zeros((1, 1, 9, 9)), fields=[(0, 0)]),
    "Aberrations": lambda _: clplen.cameras.Aberrations(main_lens={4: 1e-7}, lenslets={4: 1e-7}),
    "AlphaEstimate": lambda device: clplen.estimate_alpha(lightfield(device), method="energy"),
    "Coherence": lambda _: clplen.Coherence(
        clplen.wave.RandomPhaseMask(66e-6), clplen.Spectrum.gaussian(550e-9, 30e-9)
    ),
    "CoherencePlan": lambda _: clplen.wave.CoherencePlan(
        clplen.Coherence(clplen.wave.RandomPhaseMask(66e-6)),
        50,
        5.0,
        1.0,
        (3, 3),
        1e-5,
        0.1,
        1,
        0.2,
    ),
    "Comparison": lambda device: Comparison((), ("sampling",)),
    "ConvergingLight": lambda _: clplen.wave.ConvergingLight(0.1),
    "CoverGlass": lambda _: clplen.cameras.CoverGlass(150e-6),
    "Curve": lambda _: edge().mtf,
    "DeconvolutionResult": lambda _: clplen.microscopy.DeconvolutionResult(
        samples(2, 9, 9), samples(3), 3, (0.0,)
    ),
    "DecodeOperator": lambda device: clplen.lightfield.DecodeOperator(raw(device)),
    "DepthMap": lambda _: depth(),
    "Device": lambda device: device,
    "Element": lambda _: clplen.wave.Element(abs, "any"),
    "ExtendedSource": lambda _: clplen.wave.ExtendedSource(1e-3, 0.1, picture=samples(64, 64)),
    "Field": field,
    "FocalStack": lambda device: clplen.focal_stack(lightfield(device), disparities=[-1, 0, 1]),
    "FocusedGeometry": lambda device: clplen.lightfield.FocusedGeometry.of(
        focused(device).expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    ),
    "FocusedMaps": lambda _: clplen.lightfield.FocusedMaps(
        PICTURE, samples(9, 9), samples(9, 9), samples(9, 9)
    ),
    "Glass": lambda _: clplen.wave.Glass.named("N-BK7"),
    "Grid": lambda _: GRID,
    "Image": lambda device: lightfield(device).view(1, 1),
    "IncoherentLight": lambda _: clplen.wave.IncoherentLight(),
    "Lattice": lambda _: LATTICE,
    "Lens": lambda _: clplen.wave.Lens(0.1),
    "LensletMap": lambda _: clplen.wave.LensletMap(1e-6 * samples(9, 8), pitch=2e-5, glass=1.5),
    "LensletSurface": lambda _: clplen.wave.LensletSurface(2.9e-4, "N-BK7", aspheric=(1e7,)),
    "Intrinsics": lambda _: intrinsics(),
    "LensletGrid": lambda device: raw(device).sub_images,
    "LensletScatter": lambda _: clplen.cameras.LensletScatter(0.01),
    "Levels": lambda _: clplen.lightfield.Levels(64.0, 1023.0, 10),
    "LightField": lightfield,
    "MeanIntensity": lambda device: clplen.propagate(
        field(device),
        1e-4,
        coherence=clplen.Coherence(clplen.wave.IncoherentLight()),
        snapshots=4,
    ),
    "ColorFilterArray": lambda _: clplen.cameras.ColorFilterArray.quad_bayer("GBRG"),
    "QuiltLayout": lambda _: clplen.io.QuiltLayout(8, 6, (3360, 3360), 0.75),
    "ViewCameras": lambda device: clplen.lightfield.view_cameras(
        clplen.LightField.from_array(samples(3, 5, 24, 32), device=device),
        baseline=1e-3,
        focal_length=0.05,
        pixel_pitch=1e-5,
    ),
    "ExposureGradient": lambda _: ExposureGradient(np.ones(2), np.eye(2, 3)),
    "ExposureJacobian": lambda _: ExposureJacobian(np.ones((2, 3)), np.ones((1, 2, 3))),
    "ExposureOperator": lambda device: clplen.cameras.ExposureOperator(
        camera(device), clplen.PointSources((0.0, 0.0, 0.0))
    ),
    "TextureOperator": lambda device: clplen.cameras.TextureOperator(
        camera(device), clplen.SurfaceScene(clplen.cameras.Plane(0.1, texture=texture()))
    ),
    "PixelArray": lambda _: clplen.cameras.PixelArray(pitch=1.4e-6, fill_factor=0.8),
    "MicrolensArray": lambda _: MLA,
    "BeadCalibration": lambda _: BeadCalibration(
        fourier_images(), 1e-6, np.zeros((1, 2)), np.zeros(1), 0.01
    ),
    "FourierMicroscope": lambda device: clplen.PlenopticCamera.fourier_microscope(
        **FOURIER, device=device
    ),
    "FourierPointImages": lambda _: fourier_images(),
    "FourierProjector": lambda device: clplen.microscopy.FourierProjector(
        fourier_images(), (3, 3), device=device
    ),
    "LensletLayout": lambda _: clplen.cameras.LensletLayout([(0, 0)], 0.01, diameter=1e-3),
    "Microscope": lambda device: clplen.PlenopticCamera.microscope(**MICROSCOPE, device=device),
    "OpticalSystem": lambda _: clplen.OpticalSystem(
        [clplen.wave.Space(0.1), clplen.wave.Lens(0.05), clplen.wave.Pupil(3e-3, 0.1)]
    ),
    "PhasePlate": lambda _: clplen.wave.PhasePlate(samples(9, 8), pitch=2e-5),
    "ZernikePlate": lambda _: clplen.wave.ZernikePlate({4: 5e-8}, diameter=2e-4),
    "PhaseSpace": lambda device: clplen.lightfield.phase_space(lightfield(device), y=3, v=1),
    "Occluder": lambda _: clplen.cameras.Occluder(np.eye(5), 1e-3),
    "PicturePlane": lambda _: clplen.PicturePlane(samples(64, 64), 1e-3),
    "Plane": lambda _: clplen.cameras.Plane(0.5, texture=texture()),
    "PlenopticCamera": camera,
    "PointImages": lambda _: point_images(),
    "PointSources": lambda _: clplen.PointSources(np.zeros((100, 3))),
    "Points": lambda _: clplen.microscopy.Points(
        samples(50, 3), samples(50), samples(50), samples(50, 3)
    ),
    "PupilAberration": lambda _: clplen.cameras.PupilAberration({6: 3e-8, 11: -4e-8}),
    "PupilFit": lambda _: clplen.microscopy.PupilFit(
        clplen.cameras.PupilAberration({6: 3e-8}), (6,), samples(1), samples(1), samples(2), 1.0
    ),
    "Projector": lambda device: clplen.Projector(point_images(), (3, 3), device=device),
    "Propagator": lambda device: clplen.Propagator(GRID, 1e-4, wavelength=LAM, device=device),
    "Pupil": lambda _: clplen.wave.Pupil(3e-3, 0.1),
    "RandomPhaseMask": lambda _: clplen.wave.RandomPhaseMask(66e-6),
    "RawImage": raw,
    "RawWarp": lambda device: clplen.lightfield.RawWarp(raw(device)),
    "RenderOperator": lambda device: clplen.lightfield.RenderOperator(lightfield(device)),
    "Sampling": lambda device: clplen.analysis.sampling_of(camera(device)),
    "Sensor": lambda _: clplen.Sensor(1e4, shot_noise=True),
    "SlantedEdge": lambda _: edge(),
    "Space": lambda _: clplen.wave.Space(0.1),
    "Spectrum": lambda _: clplen.Spectrum.mercury(),
    "Sphere": lambda _: clplen.cameras.Sphere(
        (0.0, 0.0), 3.0, disparity=0.5, height=0.5, texture=texture()
    ),
    "StackOperator": lambda device: clplen.lightfield.StackOperator(
        lightfield(device), disparities=[0, 0.5]
    ),
    "StackTiles": stream,
    "Stop": lambda _: clplen.wave.Stop(1e-3),
    "StoredLightField": lambda _: clplen.StoredLightField.from_array(samples(3, 3, 32, 32)),
    "StoredVolumes": lambda _: stored_volumes(),
    "StreamPlan": lambda device: stream(device).plan,
    "SurfaceScene": lambda _: clplen.SurfaceScene([clplen.cameras.Plane(0.5, texture=texture())]),
    "Texture": lambda _: texture(),
    "Truth": lambda _: clplen.cameras.Truth(
        samples(9, 9), samples(9, 9), np.zeros((9, 9), np.int32), {"all": np.ones((9, 9), bool)}
    ),
    "TwoPoints": lambda _: clplen.analysis.TwoPoints.incoherent(psf(), axis=1),
    "ViewWarp": lambda device: clplen.lightfield.ViewWarp(lightfield(device)),
}
EXAMPLES |= {
    "MeanPullback": lambda device: clplen.Coherence().vjp(system(), field(device))[1],
    "SystemGradient": lambda device: system().vjp(field(device))[1](field(device)),
    "SystemOperator": lambda device: system().operator(GRID, wavelength=LAM, device=device),
    "SystemPullback": lambda device: system().vjp(field(device), parameters=[1])[1],
    "AbbeImage": lambda device: AbbeImage(EXAMPLES["Image"](device), 3, 0.1),
    "Bars": lambda _: clplen.cameras.Bars((0.0, 0.0), 9.0, count=3, period=2.0, width=1.0),
    "DeconvolutionSettings": lambda _: clplen.microscopy.DeconvolutionSettings(),
    "Deconvolver": deconvolver,
    "DepthErrors": lambda _: DepthErrors(samples(9), samples(9), ("",) * 9),
    "DepthTransfer": lambda _: DepthTransfer(samples(2), (edge().mtf, None), ("", "no light")),
    "Description": lambda device: camera(device).describe(),
    "Distortion": lambda _: clplen.io.Distortion("radial", "poly", (0.1, 0.2), (0.0, 0.0)),
    "Ellipse": lambda _: clplen.cameras.Ellipse((0.0, 0.0), (3.0, 2.0)),
    "Energy": lambda _: clplen.wave.Energy(0.9, 0.8, 0.1, 0.1),
    "Exposure": lambda _: Exposure("fields", ((1, (64, 64)),), 1e-6),
    "FocusType": lambda _: clplen.io.FocusType((0.0, 0.0), (1.0, 2.0)),
    "FocusedDepth": lambda device: clplen.lightfield.FocusedDepth(
        EXAMPLES["FocusedGeometry"](device), *(samples(5, 5) for _ in range(4))
    ),
    "FocusedImage": lambda device: clplen.lightfield.FocusedImage(
        device.upload(samples(9, 9)),
        device,
        PICTURE,
        0.25,
        EXAMPLES["FocusedGeometry"](device),
        0.25,
    ),
    "FocusedStack": lambda device: clplen.lightfield.FocusedStack(
        device.upload(samples(2, 9, 9)),
        device,
        PICTURE,
        samples(2),
        EXAMPLES["FocusedGeometry"](device),
        samples(2),
        samples(2),
    ),
    "HciParameters": lambda _: clplen.io.HciParameters(focal_length_mm=100.0, scene="cotton"),
    "InputTable": lambda _: InputTable(files=["*.h5"]),
    "Job": lambda _: clplen.batch.Job(**JOB),
    "JobEstimate": lambda _: JobEstimate([], 0, 0, 0.0, 0.0, 0.0, ""),
    "LensType": lambda device: clplen.lightfield.LensType(
        (0.0, 0.0), (1.0, 2.0), ((1.0, 0.0), (0.0, 1.0))
    ),
    "LensletErrors": lambda _: clplen.wave.LensletErrors(
        {(2, -2): 1e-7}, 2e-4, 0.01 + 1e-4 * samples(5, 5), *(1e-6 * samples(5, 5, 2),) * 2
    ),
    "EvenLight": lambda _: EvenLight(EVEN_LIGHT),
    "FrameProjector": lambda device: frame_projector(device),
    "LightFieldReport": lambda device: clplen.lightfield.check_light_field(lightfield(device)),
    "Measured": lambda device: Measured("one", camera(device), EXAMPLES["Sampling"](device)),
    "Objective": lambda _: clplen.cameras.Objective(20.0, 0.5, 1.0, LAM),
    "PictureGrid": lambda _: PICTURE,
    "PlanReport": lambda device: EXAMPLES["Propagator"](device).report,
    "Plenoptic1": camera,
    "Plenoptic2": focused,
    "Polygon": lambda _: clplen.cameras.Polygon([(0.0, 0.0), (0.0, 2.0), (2.0, 0.0)]),
    "Preparation": lambda device: clplen.microscopy.preparation(10, device=device),
    "Prepared": lambda _: Prepared(samples(9, 9), samples(9, 9), 0, 0),
    "PupilCheck": lambda _: clplen.microscopy.PupilCheck(
        0.1, 1e-3, 0.475, 0.5, 4e-3, samples(9, 9), samples(9, 9)
    ),
    "RawPreparation": lambda device: RawPreparation(
        3, device, None, None, None, None, projector=frame_projector(device)
    ),
    "Regions": lambda _: clplen.microscopy.Regions(
        np.zeros((3, 9, 9), np.int32), samples(5, 3), *(samples(5) for _ in range(4)), 0.5
    ),
    "Rays": lambda device: clplen.plot.rays_through(EXAMPLES["OpticalSystem"](device)),
    "RaytrixCalibration": lambda _: clplen.io.RaytrixCalibration(
        (0.0, 0.0), 20.0, (1.0, 0.0), (0.5, 0.87)
    ),
    "Rendered": lambda _: Rendered(samples(9, 9), (1e-6, 1e-6)),
    "Report": lambda _: Report("a", "done", "0" * 64, 0.0),
    "SampleScene": lambda _: next(iter(clplen.cameras.sample_scenes(shape=(32, 32)))),
    "Scores": lambda _: clplen.analysis.Scores(81, *map(float, range(8))),
    "SpectralDistribution": lambda _: clplen.wave.SpectralDistribution.illuminant("D65"),
    "SpectralSamples": lambda _: clplen.Spectrum.gaussian(550e-9, 30e-9).sample(5),
    "Spot": lambda _: clplen.cameras.Spot((0.0, 0.0), 2.0),
    "SpotFit": lambda _: clplen.lightfield.SpotFit(0.25, 0.0, (0.0, 0.0), 9, 0.1),
    "StackTable": lambda _: StackTable(disparities=[-1, 0, 1]),
    "Summary": lambda _: clplen.batch.Summary(3, 1, {"a": "no file"}),
    "Traces": lambda _: clplen.microscopy.Traces(
        np.arange(1, 4), *(samples(3, 50) for _ in range(4))
    ),
    "Tracks": lambda _: clplen.microscopy.Tracks(
        np.zeros(50, int), np.arange(50), samples(50, 3), samples(50), samples(50), "m"
    ),
    "Table": lambda _: clplen.analysis.Table(("camera", "pixels"), (("one", 3),)),
    "TargetElement": lambda _: clplen.wave.usaf1951_elements(groups=[0])[0],
    "Tile": lambda _: Tile(*(slice(0, 9),) * 4),
    "WaveOptics": lambda device: camera(device).optics,
}
EXAMPLES |= {
    name: partial(lambda kind, _: kind("one sentence"), getattr(clplen, name))
    for name in clplen.__all__
    if name.endswith(("Error", "Warning"))
}
