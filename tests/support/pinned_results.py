"""Cases of `pinned.py`: what every topic computes, on small, odd and rectangular inputs."""

from __future__ import annotations

import io
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pinned import parts, pinned
from scipy.io import savemat

import clplen
from clplen import analysis, batch, cameras, lightfield, microscopy, plot, wave
from clplen import io as files
from clplen.cameras.camera_base import scene_energy
from clplen.io.displays.quilt import DISPLAYS
from clplen.io.raw.raw_files import is_raw_file
from clplen.io.results.volume_files import is_volume
from clplen.io.store.digest import digest
from clplen.microscopy.frames.outliers import hot_pixels
from clplen.microscopy.frames.sharpness import sharpness
from clplen.microscopy.model.binning import binning_error, suitable_binning
from clplen.microscopy.pupil.even_light import EvenLight
from clplen.plot import base, scale_bars
from clplen.wave.elements import lens as lens_module

LAM = 532e-9
CELL = (4.5e-5, 6.2e-5)  # of a mask of random phase; whole numbers of them fit GRID
GRID = clplen.Grid((45, 62), (9e-6, 8e-6), origin=(1e-6, -2e-6))
FINE = clplen.Grid((81, 96), (4e-6, 4.5e-6))
SPACING = (-1e-3, -1.2e-3, 10e-6, 12e-6)


def samples(*shape: int, seed: int = 1) -> np.ndarray:
    """Values from 0 to 1, none like its neighbours."""
    return np.random.default_rng(seed).random(shape, np.float32)


def lit(grid: clplen.Grid = GRID) -> clplen.Field:
    """Smooth light that is like none of its mirror images."""
    y, x = grid.y[:, None], grid.x
    amplitude = np.exp(-((y - 2e-5) ** 2) / 1e-8 - (x + 1e-5) ** 2 / 2e-8)
    return clplen.Field.from_array(
        amplitude * np.exp(1j * (3e3 * y + 1e8 * x * y)), grid, wavelength=LAM
    )


# Waves: beams, apertures, elements


@pinned()
def beams():
    return {
        "plane": wave.plane_wave(GRID, wavelength=LAM, direction=(0.002, -0.01)),
        "spherical": wave.spherical_wave(GRID, 0.1, wavelength=LAM, source=(1e-5, 2e-5)),
        "converging": wave.spherical_wave(GRID, -0.07, wavelength=LAM),
        "gaussian": wave.gaussian_beam(GRID, 9e-5, wavelength=LAM, z=0.02, centre=(1e-5, 0)),
        "tilt": wave.tilt(lit(), (0.001, 0.004)),
    }


@pinned()
def beam_gradients():
    return {
        "gaussian": wave.gaussian_beam_gradient(lit(), 9e-5, z=0.02, direction=(0.0, 1e-3)),
        "spherical": wave.spherical_wave_gradient(lit(), 0.1, source=(1e-5, 2e-5)),
        "tilt": wave.tilt_gradient(lit(), wave.tilt(lit(), (1e-3, 0)), (1e-3, 0)),
        "lens": wave.thin_lens_gradient(lit(), wave.tilt(lit(), (1e-3, 0)), 0.1, diameter=3e-4),
        "polar": wave.polar_gradient(lit(), wave.tilt(lit(), (1e-3, 0))),
        "intensity": wave.intensity_gradient(lit(), samples(*GRID.shape)),
    }


@pinned(area={"edges": "area"}, samples={"edges": "samples"})
def apertures(edges):
    one = wave.plane_wave(GRID, wavelength=LAM)
    corners = [(-1e-4, -1.5e-4), (-1e-4, 2e-4), (1.2e-4, 0.1e-4)]
    return {
        "circular": clplen.aperture(one, 2.5e-4, centre=(1e-5, 2e-5), edges=edges),
        "square": clplen.aperture(one, 2.1e-4, shape="square", edges=edges),
        "ring": wave.annular_aperture(one, 3e-4, inner=1.1e-4, edges=edges),
        "rectangle": wave.rectangular_aperture(one, (1e-4, 3e-4), rotation=0.3, edges=edges),
        "polygon": wave.polygonal_aperture(one, corners, edges=edges),
        "stop": wave.Stop(2e-4, centre=(0.0, 3e-5), edges=edges).apply(lit()),
    }


@pinned(
    paraxial={"form": "paraxial", "diameter": 3e-4},
    stigmatic={"form": "stigmatic", "diameter": None},
)
def lenses(form, diameter):
    lens = wave.Lens(0.11, diameter=diameter, form=form)
    return {
        "thin": clplen.thin_lens(lit(), -0.15, diameter=diameter, form=form),
        "part": lens.apply(lit()),
        "adjoint": lens.adjoint(lit()),
        "pullback": lens.pullback(lit(), wave.tilt(lit(), (1e-3, 0))),
        "words": [lens.describe(), lens.label],
        "converging": wave.ConvergingLight(0.2).apply(lit()),
    }


@pinned(binary={"kind": "binary"}, sinusoidal={"kind": "sinusoidal"}, blazed={"kind": "blazed"})
def gratings(kind):
    return {
        "grating": wave.grating(lit(), 7e-5, kind=kind, orientation=0.4, offset=1e-5),
        "axicon": wave.axicon(lit(), 0.004, centre=(1e-5, 0.0)),
    }


@pinned(
    noll={"indexing": "noll", "terms": {4: 3e-8, 7: -2e-8}},
    osa={"indexing": "osa", "terms": {3: 3e-8}},
)
def phase_plates(indexing, terms):
    plate = wave.ZernikePlate(terms, diameter=3.5e-4, indexing=indexing)
    return {
        "behind": clplen.phase_plate(lit(), terms, diameter=3e-4, indexing=indexing),
        "gradient": plate.gradient(lit(), wave.tilt(lit(), (1e-3, 0))),
        "words": plate.describe(),
    }


@pinned()
def zernike():
    rho, theta = samples(7, 9), 6 * samples(7, 9, seed=2)
    path, inside = wave.wavefront(GRID, {wave.noll(6): 2e-8, (3, -1): 1e-8}, diameter=3e-4)
    return {
        "values": [wave.zernike(n, m, rho, theta) for n, m in ((0, 0), (3, 1), (5, -3))],
        "orders": [[wave.noll(j), wave.osa(j)] for j in range(1, 22)],
        "path": path,
        "inside": np.asarray(inside, float),
    }


@pinned()
def transparencies():
    plate = wave.PhasePlate(samples(11, 14), amplitude=samples(11, 14, seed=2), pitch=2e-5)
    return {
        "transparency": wave.transparency(lit(), samples(5, 7), phase=samples(5, 7), pitch=4e-5),
        "plate": plate.apply(lit()),
        "gradient": plate.gradient(lit(), lit()),
        "star": wave.siemens_star(GRID, 9, diameter=3e-4, centre=(1e-5, 0.0)),
        "target": wave.usaf1951(GRID, groups=[4, 5], invert=True),
        "bars": [one.bars for one in wave.usaf1951_elements([4])],
    }


@pinned(
    square={"lattice": "square", "fill": "circular", "focal_length": 3e-3},
    hexagonal={"lattice": "hexagonal", "fill": "full", "focal_length": 4e-3},
    kinds={"lattice": "hexagonal", "fill": "circular", "focal_length": [3e-3, 3.5e-3, 4e-3]},
)
def microlens_array(**words):
    mla = clplen.MicrolensArray(9e-5, count=(4, 5), offset=(5e-6, -8e-6), rotation=0.1, **words)
    return {
        "behind": mla.apply(lit()),
        "adjoint": mla.adjoint(lit()),
        "gradient": mla.gradient(lit(), wave.tilt(lit(), (1e-3, 0))),
        "centres": mla.centres(),
        "transmission": mla.transmission(GRID, LAM).get(),
        "words": repr(mla),
    }


@pinned()
def lenslet_shapes():
    surface = wave.LensletSurface(0.9e-3, "N-BK7", conic=-0.5, aspheric=[1e3])
    r = 6e-6 * (np.arange(19) - 9)
    sag = (r[:, None] ** 2 + 1.1 * r**2) / 2e-3
    shape = wave.LensletMap(sag, pitch=6e-6, glass="N-BK7", complete=True)
    mla = clplen.MicrolensArray(6e-5, surface=surface, count=(3, 4))
    scatter = cameras.LensletScatter(0.01, tilt=1e-4, position=1e-6, seed=3)
    errors = cameras.Aberrations(lenslets={11: 2e-8}, scatter=scatter).lenslet_errors(mla)
    return {
        "surface": mla.apply(lit(FINE)),
        "map": clplen.MicrolensArray(1e-4, 1.9e-3, count=(3, 4), map=shape).apply(lit(FINE)),
        "sag": [surface.sag(r), surface.slope(r), surface.focal_length(), surface.index(LAM)],
        "errors": [errors.tilt, errors.position, errors.phase(mla, FINE, LAM).get()],
        "draws": scatter.draw((3, 4)),
    }


@pinned()
def lens_sampling():
    found = lens_module.lens_sampling(GRID, 0.1, wavelength=LAM, diameter=3e-4, arriving=0.3)
    small = lens_module.lenslet_sampling(
        1e-4, 3e-3, samples=4e-6, wavelength=LAM, diameter=1e-2, z=0.2
    )
    return {"lens": vars_of(found), "lenslet": vars_of(small)}


def vars_of(thing: Any) -> dict[str, Any]:
    """Numbers, texts and arrays among the public attributes of an object."""
    kinds = (int, float, str, tuple, np.ndarray, type(None))
    found = {name: getattr(thing, name) for name in dir(thing) if name[0] != "_"}
    return {name: value for name, value in found.items() if isinstance(value, kinds)}


# Waves: propagation and systems

WIDE = clplen.Grid((40, 51), (7e-6, 11e-6), origin=(3e-5, -2e-5))


@pinned(
    auto={"z": 0.01},
    several={"z": [2e-3, 5e-3, 0.03]},
    back={"z": -4e-3, "method": "as"},
    blas={"z": 0.02, "method": "blas", "pad": 3},
    cblas={"z": 0.02, "method": "cblas"},
    rs={"z": 0.05, "method": "rs"},
    one_step={"z": 0.3, "method": "one-step"},
    tf={"z": 0.01, "method": "fresnel-tf", "pad": 1},
    ir={"z": 0.04, "method": "fresnel-ir"},
    fft={"z": 0.2, "method": "fresnel-1fft"},
    multistep={"z": 0.05, "method": "fresnel-multistep"},
    elsewhere={"z": 0.02, "out_grid": WIDE},
    lens={"z": 0.1, "lens": 0.1, "method": "fresnel-1fft"},
)
def propagate(z, **words):
    found = clplen.propagate(lit(), z, **words)
    return {"field": found, "pitch": found.grid.pitch, "origin": found.grid.origin}


@pinned(near={"z": 3e-3, "method": "auto"}, far={"z": 0.2, "method": "one-step"})
def propagator(z, method):
    plan = clplen.Propagator(GRID, z, wavelength=LAM, method=method)
    there = plan(lit())
    return {
        "there": there,
        "back": plan.adjoint(there),
        "slope": plan.distance_slope(lit()),
        "energy": vars_of(plan.energy(lit())) if method == "auto" else None,
        "report": vars_of(plan.report),
        "matrix": plan.as_linear_operator() @ lit().to_numpy().ravel(),
    }


@pinned()
def propagate_wavelengths():
    return wave.propagate_wavelengths(lit(), [0.01, 0.02], [450e-9, 600e-9])


@pinned(
    free={"parts": [0.01, wave.Lens(0.05, diameter=3e-4), wave.Space(0.02, method="blas")]},
    array={"parts": [wave.Stop(3e-4), clplen.MicrolensArray(9e-5, 3e-3, count=4), 3e-3]},
    any={"parts": [wave.Element(lambda one: wave.tilt(one, (0, 2e-3)), "prism"), 0.01]},
)
def optical_system(parts):
    system = clplen.OpticalSystem(parts)
    found = {"image": system(lit()), "words": str(system)}
    found["trace"] = [[z, field] for z, _, field in system.trace(lit())]
    if parts[-1] != 0.01:
        image, pullback = system.vjp(lit(), parameters=[len(parts) - 1])
        gradient = pullback(wave.intensity_gradient(image, samples(*image.shape)))
        found |= {"adjoint": system.adjoint(lit()), "gradient": gradient.field}
        found["parameters"] = gradient.parameters
        operator = system.operator(GRID, wavelength=LAM)
        found["matrix"] = operator.as_linear_operator() @ lit().to_numpy().ravel()
    return found


@pinned(one={"magnification": 1.0}, koehler={"magnification": 2.0, "koehler": True})
def imaging_system(**words):
    system = wave.imaging_system(0.05, diameter=4e-4, aliasing="allow", **words)
    return {"image": system(lit()), "words": str(system)}


@pinned(circular={"shape": "circular"}, square={"shape": "square"})
def pupils(shape):
    pupil = wave.Pupil(4e-3, 0.1, shape=shape)
    transfer = pupil.transfer(GRID, LAM)
    edge = np.linspace(-1.5, 2, 15)
    return {
        "behind": pupil.apply(lit()),
        "transfer": transfer,
        "incoherent": wave.incoherent_image(lit(), transfer),
        "otf": wave.otf(np.linspace(0, 1.2, 9), shape=shape),
        "edges": [wave.coherent_edge(edge), wave.incoherent_edge(edge, shape=shape)],
        "cutoff": wave.Pupil.of_cutoff(2e4, LAM, shape=shape).cutoff(LAM),
    }


# Waves: coherence and spectra

MODELS = {
    "square": wave.RandomPhaseMask(CELL),
    "gaussian": wave.RandomPhaseMask(CELL, kernel="gaussian", jitter=False),
    "source": wave.ExtendedSource(1e-3, 0.1),
    "picture": wave.ExtendedSource(1e-3, 0.1, picture=samples(16, 16), points=50),
    "incoherent": wave.IncoherentLight(),
}


@pinned(**{name: {"model": model} for name, model in MODELS.items()})
def coherence(model):
    still = isinstance(model, wave.RandomPhaseMask) and not model.jitter
    light = clplen.Coherence(model, clplen.Spectrum.gaussian(LAM, 2e-8), wavelengths=2, seed=3)
    mean = light.average(wave.Pupil(4e-3, 0.1), lit(), snapshots=6)
    fields = list(light.snapshots(GRID, wavelength=LAM, count=3))
    lags = np.linspace(0, 5e-5, 6)
    return {
        "snapshots": fields,
        "mean": mean,
        **parts(mean, "standard_error snapshots convergence method relative_error"),
        "degree": np.asarray(model.degree(0.0, lags, wavelength=LAM)),
        "power": model.power_spectrum(GRID, wavelength=LAM) if not still else None,
        "measured": wave.measured_degree(fields, [0, 1, 3], axis="x"),
        "contrast": wave.speckle_contrast(fields[0].intensity()),
        "lines": light.lines(LAM),
        "words": repr(light),
    }


@pinned()
def coherence_gradient():
    light = clplen.Coherence(wave.RandomPhaseMask(CELL), seed=2)
    system = clplen.OpticalSystem([5e-3, wave.Lens(0.1), 4e-3])
    image, pullback = light.vjp(system, lit(), snapshots=4, parameters=[0])
    gradient = pullback(samples(*GRID.shape))
    return {"image": image, "field": gradient.field, "parameters": gradient.parameters}


@pinned()
def coherence_checkpoint():
    """A mean that is taken up again is the mean of one run."""
    light, system = clplen.Coherence(wave.RandomPhaseMask(CELL)), clplen.OpticalSystem([5e-3])
    light.average(system, lit(), snapshots=3, checkpoint="kept.npz")
    taken_up = light.average(system, lit(), snapshots=8, checkpoint="kept.npz")
    Path("kept.npz").unlink()  # holds what the code is like
    return {"whole": light.average(system, lit(), snapshots=8), "taken up": taken_up}


@pinned()
def coherence_plan():
    mask = wave.Pupil(5e-3, 0.1)
    plan = clplen.Coherence.plan(mask, grid=GRID, wavelength=LAM, snr=10)
    return {**vars_of(plan), "words": repr(plan)}


@pinned(whole={"tolerance": 0.0}, part={"tolerance": 0.02})
def abbe_image(tolerance):
    pupil = wave.Pupil(4e-3, 0.1).transfer(GRID, LAM)
    source = wave.RandomPhaseMask(CELL).power_spectrum(GRID, wavelength=LAM)
    return list(wave.abbe_image(lit(), pupil, source, tolerance=tolerance))


@pinned()
def propagate_partial_coherence():
    light = clplen.Coherence(wave.RandomPhaseMask(CELL), clplen.Spectrum.mercury(), seed=1)
    found = clplen.propagate(lit(), 5e-3, coherence=light, snapshots=5)
    return {"mean": found, "error": found.standard_error}


@pinned(
    gaussian={"shape": clplen.Spectrum.gaussian(LAM, 3e-8)},
    rectangular={"shape": clplen.Spectrum.rectangular(LAM, 3e-8)},
    lines={"shape": clplen.Spectrum.lines([5e-7, 6e-7], [1, 2], fwhm=1e-9)},
    table={"shape": clplen.Spectrum.tabulated([5e-7, 5.2e-7, 6e-7], [0, 3, 1])},
    led={"shape": clplen.Spectrum.white_led()},
    mercury={"shape": clplen.Spectrum.mercury(fwhm=2e-9)},
)
def spectrum(shape):
    found = shape.sample(5)
    nu = 299792458 / np.linspace(4.5e-7, 6.5e-7, 9)
    return {
        "samples": [found.wavelengths, found.weights, found.gamma(np.linspace(0, 1e-13, 5))],
        "density": shape.density(nu),
        "degree": shape.degree(np.linspace(0, 3e-5, 7)),
        "numbers": [shape.centre, shape.coherence_length(), shape.error(5, 1e-5)],
        "needed": shape.needed(1e-5),
        "words": repr(shape),
    }


@pinned()
def spectral_distribution():
    kind, at = wave.SpectralDistribution, np.linspace(4e-7, 7e-7, 7)
    curves = {name: kind.illuminant(name) for name in ("A", "D65", "E")}
    curves |= {"black": kind.blackbody(3200.0), "band": kind.gaussian(LAM, 4e-8, 0.7)}
    curves["product"] = curves["D65"] * curves["band"]
    Path("lamp.csv").write_text("nm,power\n400,1\n550,3\n700,2\n")
    curves["read"] = kind.read("lamp.csv")
    return {name: [one(at), one.integral] for name, one in curves.items()}


@pinned()
def glasses():
    at = np.linspace(4.6e-7, 9e-7, 6)
    names = wave.Glass.names()
    return {
        "names": "\n".join(names),
        "index": [wave.Glass.named(name).index(at) for name in names[::7]],
        "dispersion": wave.Glass.named("N-BK7").dispersion(at),
    }


# Light fields


@lru_cache
def scene() -> tuple[clplen.LightField, cameras.Truth]:
    """Two planes and a ball, 5 x 7 views of 36 x 44 pixels, with their depth."""
    back = cameras.Plane(-0.5, (0.0, 0.01), texture=cameras.noise(1, 64))
    front = cameras.Plane(0.8, outline=cameras.Ellipse((4, -6), (7, 9)), texture=cameras.checker(5))
    ball = cameras.Sphere((-8, 12), 8, disparity=0.0, height=0.6, texture=cameras.noise(2, 64))
    return clplen.SurfaceScene([back, front, ball]).light_field((5, 7), (36, 44), noise=0.01)


@lru_cache
def metric() -> clplen.LightField:
    """The same with the lengths of a camera, in colour, as 8 bits."""
    grey = scene()[0].to_numpy()[:, 1:6]
    colour = np.stack([grey, 0.7 * grey, grey[::-1] * 0.5], axis=-1)
    return clplen.LightField.from_array(
        np.uint8(200 * np.clip(colour, 0, 1)), spacing=SPACING, camera=standard()
    )


LIGHT_FIELDS = {"grey": lambda: scene()[0], "colour": metric}
BOTH = {name: {"lf": lf} for name, lf in LIGHT_FIELDS.items()}


@pinned(**BOTH)
def light_field(lf):
    lf = lf()
    return {
        "samples": lf,
        "weights": lf.weights,
        "view": lf.view(1.5, 2.25, disparity=0.3),
        "nearest": lf.view(1, 2.4, interpolation="nearest"),
        "epis": [lf.epi(y=9, v=2), lf.epi(x=5, u=3)],
        "render": [lf.render(), lf.render(aperture=3, viewpoint=(1, 2)), lf.render(total=True)],
        "flatten": [lf.flatten(kind, disparity=0.4) for kind in ("median", "variance", "max")],
        "words": repr(lf),
    }


@pinned(**BOTH)
def refocus(lf):
    lf = lf()
    tilted = lightfield.plane_through([(0, 0, -0.5), (0, 31, 1.0), (31, 0, 0.0)], (36, 44))
    return {
        "near": clplen.refocus(lf, disparity=0.8),
        "tilted": clplen.refocus(lf, disparity=tilted),
        "cubic": clplen.refocus(lf, disparity=-0.3, interpolation="cubic"),
        "fourier": clplen.refocus(lf, disparity=0.3, interpolation="fourier"),
        "fine": clplen.refocus(lf, disparity=0.3, upsample=2),
        "alpha": clplen.refocus(lf, alpha=0.93, rescale=True) if lf.spacing else None,
    }


@pinned(**BOTH)
def focal_stack(lf):
    lf = lf()
    found = clplen.focal_stack(lf, disparities=[-1, -0.3, 0.4, 2], aperture=3)
    planes = lightfield.suitable_planes(lf, count=7)
    return {
        "stack": found,
        **parts(found, "disparities alphas"),
        "planes": planes,
        "default": clplen.focal_stack(lf, **planes, interpolation="cubic"),
        "sharpness": lightfield.sharpness_curve(found),
        "words": repr(found),
    }


CUES = ("combined", "correspondence", "structure-tensor", "energy")


@pinned(**{f"{name} {cue}": {"lf": lf, "cue": cue} for name, lf in LIGHT_FIELDS.items()
           for cue in CUES})  # fmt: skip
def depth_map(lf, cue):
    found = clplen.depth_map(lf(), disparities=np.linspace(-1, 1, 9), cue=cue)
    return {**parts(found, "disparity alpha z confidence"), "words": repr(found)}


@pinned(**BOTH)
def depth_map_default(lf):
    return parts(clplen.depth_map(lf()), "disparity alpha z confidence")


@pinned(**BOTH)
def depth_map_of_a_stack(lf):
    stack = clplen.focal_stack(lf(), disparities=np.linspace(-1, 1, 9))
    return parts(clplen.depth_map(stack), "disparity alpha z confidence")


@pinned(**BOTH)
def all_in_focus(lf):
    lf = lf()
    truth = scene()[1].disparity
    return {
        "default": clplen.all_in_focus(lf),
        "planes": clplen.all_in_focus(lf, disparities=np.linspace(-1, 1, 5)),
        "depth": clplen.all_in_focus(lf, depth=truth),
        "stack": clplen.all_in_focus(clplen.focal_stack(lf, disparities=np.linspace(-1, 1, 9))),
    }


@pinned(**BOTH)
def stored_light_field(lf):
    """In parts, by a memory that asks for several tiles."""
    stored = clplen.StoredLightField.from_light_field(lf())
    words = {"disparities": np.linspace(-1, 1, 5), "memory": 2**21}
    depth = clplen.depth_map(stored, **words)
    return {
        "part": stored.read(np.s_[1:4, 0:3, 5:20, 3:30]),
        "stack": clplen.focal_stack(stored, **words),
        "depth": parts(depth, "disparity confidence"),
        "sharp": clplen.all_in_focus(stored, **words),
        "words": repr(stored),
    }


@lru_cache
def large(colour: bool) -> clplen.StoredLightField:
    """A slanted wall on 3 x 4 views that are cut into several tiles where memory is short."""
    wall = cameras.Plane(0.3, (0.002, 0.003), texture=cameras.noise(3, 256))
    lf, _ = clplen.SurfaceScene(wall).light_field((3, 4), (180, 210))
    grey = np.uint8(200 * np.clip(lf.to_numpy(), 0, 1))
    values = np.stack([grey, grey // 2, 255 - grey], axis=-1) if colour else lf.to_numpy()
    return clplen.StoredLightField.from_array(values)


@pinned(grey={"colour": False}, colour={"colour": True})
def streamed(colour):
    stored, planes = large(colour), np.linspace(-1, 1, 5)
    tiles = lightfield.stack_tiles(stored, disparities=planes, memory=7 * 2**17)
    files.write_stack("stack.tif", tiles)
    depth = clplen.depth_map(stored, disparities=planes, cue="energy", memory=3 * 2**20)
    return {
        "depth": parts(depth, "disparity confidence"),
        "sharp": clplen.all_in_focus(stored, disparities=planes, memory=5 * 2**19).to_numpy(),
        "tiles": [[one.rows.stop, one.columns.stop] for one in tiles.plan.tiles],
    }


@pinned(**BOTH)
def other_refocusing(lf):
    lf = lf()
    return {
        "fourier": lightfield.fourier_stack(lf, disparities=[-0.5, 0.7]),
        "hyperfan": lightfield.hyperfan(lf, -0.4, 0.5),
        "shifted": lightfield.shift_views(lf, samples(*lf.shape[:2], 2)),
        "between": lightfield.view_between(lf, 1.5, 2.3, 0.4),
        "along": list(lightfield.views_between(lf, [(1, 1), (2, 2.5)], scene()[1].disparity)),
        "resampled": lf.resample("point-angle", views=(4, 5)) if lf.spacing else None,
    }


@pinned()
def apertures_of_views():
    views = (5, 7)
    corners = [(-1.2, -1.2), (-1.0, 1.4), (1.2, 0)]
    return {
        "annulus": lightfield.annulus(views, 0.8, (2.0, 2.5)),
        "disc": lightfield.disc(views, 1.3, centre=(1.5, 3.2)),
        "gaussian": lightfield.gaussian(views, (1.0, 1.5)),
        "half": lightfield.half_plane(views, 0.4),
        "hann": lightfield.hann(views, 2.5),
        "kaiser": lightfield.kaiser(views, 2.2, 5.0),
        "polygon": lightfield.polygon(views, corners),
        "hexagon": lightfield.regular_polygon(views, 6, 2.2, angle=0.2),
    }


@pinned(points={"dz": 6e-3, "method": "compensated"}, energy={"dz": -8e-3, "method": "energy"},
        slope={"dz": 6e-3, "method": "slope"})  # fmt: skip
def estimate_alpha(dz, method):
    camera = standard(31, "full", pixels_per_lenslet=9)
    raw = camera.expose(clplen.PointSources((0, 0, dz)), model="rays")
    found = clplen.estimate_alpha(clplen.LightField.from_raw(raw), method=method, window=15)
    return {**vars_of(found), "curve": list(found.curve), "words": repr(found)}


@pinned(**BOTH)
def check_light_field(lf):
    swapped = np.swapaxes(lf().to_numpy(), 0, 1)[:, ::-1].copy()
    found = lightfield.check_light_field(clplen.LightField.from_array(swapped), farthest=1.5)
    return {**vars_of(found), "sentence": found.sentence()}


@pinned(**BOTH)
def light_field_operators(lf):
    lf = lf()
    lf = lf if lf.to_numpy().ndim == 4 else lf.shape[:4]
    render = lightfield.RenderOperator(lf, viewpoint=(1, 2.5))
    stack = lightfield.StackOperator(lf, disparities=[-0.5, 0.7], aperture=3)
    warp = lightfield.ViewWarp(lf)
    picture, disparity = samples(36, 44), samples(36, 44, seed=2) - 0.5
    views = warp.forward(picture, disparity)
    return {
        "render": [render.forward(views), render.adjoint(picture)],
        "stack": [stack.forward(views), stack.adjoint(samples(*stack.out_shape))],
        "warp": [views, *warp.vjp(picture, disparity, views)],
    }


@pinned(**BOTH)
def phase_space(lf):
    found = lightfield.phase_space(lf(), y=9, v=2), lightfield.phase_space(lf(), x=9, u=3)
    return [parts(one, "values axes units direction position theta") for one in found]


@pinned()
def metric_depth():
    lengths = {"baseline": 1e-3, "focal_length": 0.05, "pixel_pitch": 1e-5}
    seen = lightfield.view_cameras(scene()[0], **lengths, focus_distance=2.0)
    return {
        "z": lightfield.metric_depth([1.0, 2.0, -1.0], **lengths, focus_distance=3.0),
        "cameras": vars_of(seen),
        "points": [seen.project([(0.1, 0.2, 1.0)]), seen.points(scene()[1].disparity)],
        "distance": seen.distance([5.0, 0.5]),
        "focus": [
            [lightfield.focus_ratio(scope(), z) for z in (-2e-5, 0.0, 1e-5)],
            lightfield.focus_ratio_of_disparity(scope(), 0.1),
        ],
    }


# Calibration


@lru_cache
def known() -> lightfield.Intrinsics:
    """A camera of 3 x 3 views with distortion."""
    H = np.diag([4e-3, 4.4e-3, 4.5e-3, 4.7e-3, 1.0])
    H[2, 0], H[3, 1] = -5e-3, -5.5e-3
    H[:4, 4] = -(H[:4, :4] @ (1, 1, 47.5, 36.5))
    return lightfield.Intrinsics(H, [0, 0, -0.25, 0.1, 0], (3, 3, 74, 96))


def board(tilt: float, distance: float) -> np.ndarray:
    """4 x 5 corners of a board of 25 mm that is held aslant, as `known` sees it."""
    j, i, l, k = np.indices((3, 3, 74, 96))  # noqa: E741
    s, t, u, v = np.moveaxis(known().rays(i, j, k, l), -1, 0)
    across = np.array([np.cos(tilt), 0.3 * np.sin(tilt), np.sin(tilt)])
    down = np.cross(np.cross(across, [0, 1.0, 0.2]), across)
    across, down = across / np.linalg.norm(across), down / np.linalg.norm(down)
    n = np.cross(across, down)
    z = (n[2] * distance - n[0] * s - n[1] * t) / (n[0] * u + n[1] * v + n[2])
    seen = np.stack([s + z * u, t + z * v, z - distance], axis=-1)
    row, column = (seen @ one / 0.025 for one in (down, across))
    edges = 6 * np.sin(np.pi * (row + 0.5)) * np.sin(np.pi * column)
    inside = (abs(row) < 2.5) & (abs(column) < 3)
    return np.float32(np.where(inside, 0.5 + np.clip(edges, -0.4, 0.4), 0.9))


def rough(found: dict[str, Any]) -> dict[str, Any]:
    """Six digits of numbers whose last ones depend on where arrays lie in memory."""
    return {
        name: np.vectorize(lambda one: float(f"{one:.6g}"))(value) if np.size(value) else value
        for name, value in found.items()
        if isinstance(value, np.ndarray | float)
    }


@pinned()
def calibrate():
    boards = [board(tilt, z) for tilt, z in ((-0.5, 0.4), (0.4, 0.5), (0.1, 0.45), (0.7, 0.5))]
    found = lightfield.calibrate(boards, (4, 5), 0.025)
    files.write_intrinsics("camera.json", found)
    return {
        "found": rough(vars_of(found)),
        "corners": lightfield.find_corners(boards[0], (4, 5)),
        "rectified": lightfield.rectify_views(samples(3, 3, 74, 96), known()),
        "project": known().project([(0.01, 0.02, 1.0)]),
        "depth": [known().disparity([0.5, 1.0]), known().depth([0.5, 0.1])],
        "read": rough(vars_of(files.read_intrinsics("camera.json"))),
        "words": repr(known()),
    }


def white_frame(pitch: float, shape: tuple[int, int], turn: float = 0.0, hexagonal: bool = False):
    """Counts of a white frame whose lenslets lie on a turned lattice."""
    y, x = np.indices(shape) - 3.3
    y, x = y * np.cos(turn) + x * np.sin(turn), x * np.cos(turn) - y * np.sin(turn)
    if hexagonal:
        angles = np.arange(3) * np.pi / 3 + np.pi / 2
        k = 2 * np.pi / (pitch * np.sqrt(3) / 2)
        waves = [np.cos(k * (y * np.sin(a) + x * np.cos(a))) for a in angles]
        return np.round(900 * (sum(waves) + 1.6) / 4.6)
    wave_y, wave_x = (1 + np.cos(2 * np.pi * one / pitch) for one in (y, x))
    return np.round(1000 * wave_y * wave_x)


@pinned(
    square={"pitch": 9.7, "turn": 0.01, "hexagonal": False},
    hexagonal={"pitch": 11.3, "turn": 0.0, "hexagonal": True},
)
def decode_raw(pitch, turn, hexagonal):
    white = white_frame(pitch, (104, 131), turn, hexagonal)
    raw = white * samples(*white.shape) + 3
    lattice = clplen.estimate_lattice(white)
    lattice.save("lattice.json")
    grey = clplen.decode_raw(raw, lattice, white=white, dark=np.full_like(white, 2))
    found = {
        "lattice": vars_of(lattice),
        "centres": lattice.centres(),
        "grey": grey,
        "spacing": grey.spacing,
        "undivided": clplen.decode_raw(raw, lattice, views=(5, 6)),
        "read": vars_of(files.read_lattice("lattice.json", white.shape)),
    }
    for way in ("within", "after", "before"):
        found[way] = clplen.decode_raw(
            np.uint16(raw), lattice, white=white, bayer="GRBG", demosaic=way
        )
    return found


# Cameras


@lru_cache
def standard(count: Any = 9, fill: str = "circular", **words: Any) -> Any:
    words = {"pixels_per_lenslet": 15, "aperture_diameter": 1.6e-3} | words
    mla = clplen.MicrolensArray(150e-6, 10e-3, count=count, fill=fill)
    return clplen.PlenopticCamera.type1(focal_length=0.12, mla=mla, wavelength=LAM, **words)


@lru_cache
def focused(m: float = 0.25, focal_length: Any = 3e-3) -> Any:
    lattice = "square" if focal_length == 3e-3 else "hexagonal"
    mla = clplen.MicrolensArray(150e-6, focal_length, count=(9, 11), fill="full", lattice=lattice)
    return clplen.PlenopticCamera.type2(
        focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=16, m=m
    )


def scope(pixels: float = 11, **words: Any) -> Any:
    mla = clplen.MicrolensArray(60e-6, 1.5e-3, count=words.pop("count", 5), fill="full")
    return clplen.PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=pixels, mla=mla, **words
    )


@lru_cache
def fourier_scope() -> Any:
    return clplen.PlenopticCamera.fourier_microscope(
        magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
        mla=clplen.MicrolensArray(500e-6, 12e-3, count=3),
    )  # fmt: skip


BAYER = cameras.ColorFilterArray.bayer("GRBG")
CAMERAS = {
    "standard": standard,
    "corrected": lambda: standard((5, 8), "square", lens_model="corrected", field_lens=True),
    "aberrated": lambda: standard(7, "full", aberrations=cameras.Aberrations(
        main_lens={6: 5e-8}, main_lens_field={7: (2e-5, 0.0)}, sensor_shift=5e-5,
        lenslets={4: 2e-8}, scatter=cameras.LensletScatter(0.01, tilt=1e-4, seed=1),
        lenslet_circle=2.2e-4)),
    "pixels": lambda: standard(7, "full", pixels_per_lenslet=None, pixels=cameras.PixelArray(
        pitch=9.3e-6, fill_factor=0.7, offset=(4e-6, -7e-6), rotation=0.02)),
    "filters": lambda: standard(7, "full", pixels=cameras.PixelArray(filters=BAYER)),
    "focused": focused,
    "galilean": lambda: focused(-0.3),
    "kinds": lambda: focused(0.25, (3e-3, 3.2e-3, 3.5e-3)),
    "microscope": lambda: scope(),
    "cover": lambda: scope(11.6, cover=cameras.CoverGlass(1.5e-4), pupil={6: 4e-8}),
    "fourier": fourier_scope,
}  # fmt: skip
SMALL = ("microscope", "cover", "fourier")  # their scenes are micrometres wide


@pinned(**{name: {"name": name} for name in CAMERAS})
def expose(name):
    camera = CAMERAS[name]()
    unit = 1e-6 if name in SMALL else 5e-5
    points = clplen.PointSources([(3 * unit, -2 * unit, 0), (-5 * unit, unit, 10 * unit)],
                                 power=[1.0, 0.4], diameter=unit / 10)  # fmt: skip
    raw = camera.expose(points)
    found = {"waves": raw, "words": str(camera.describe()), "repr": repr(raw)}
    if name != "fourier":
        found |= {"lattice": vars_of(raw.cells), "spacing": raw.spacing}
    if name not in (*SMALL, "filters"):
        found["rays"] = camera.expose(points, model="rays")
        found["energy"] = scene_energy(camera, points)
        found["alpha"] = [camera.alpha(one) for one in (-1e-3, 2e-3)]
    return found


@pinned(standard={"camera": standard}, focused={"camera": focused})
def expose_scenes(camera):
    camera = camera()
    wall = cameras.Plane(0.2, texture=cameras.noise(1, 16))
    picture = clplen.PicturePlane(samples(5, 7), 1e-3, z=1e-3)
    screen = cameras.Occluder(np.eye(3), 2e-3, z=-5e-3)
    light = clplen.Coherence(spectrum=clplen.Spectrum.gaussian(LAM, 2e-8), wavelengths=2)
    points = clplen.PointSources([(1e-4, 0, 1e-3)])
    return {
        "surfaces": camera.expose(clplen.SurfaceScene(wall), model="rays"),
        "picture": camera.expose(picture),
        "occluded": camera.expose([points, screen]),
        "spectrum": camera.expose(points, coherence=light),
        "edges": screen.edges(),
    }


@pinned(grey={"filters": False}, colour={"filters": True})
def sensor(filters):
    camera = CAMERAS["filters" if filters else "standard"]()
    raw = camera.expose(clplen.PointSources([(1e-4, 0, 1e-3)]))
    found = {}
    for name, words in {
        "noise": {"shot_noise": True, "read_noise": 2.0, "seed": 3},
        "levels": {"full_well": 2e4, "bit_depth": 10, "black_level": 64.0, "prnu": 0.02},
        "dark": {"dark_current": 50.0, "exposure_time": 0.1, "read_noise": 1.0},
    }.items():
        taken = clplen.Sensor(exposure=1e6, **words).record(raw)
        found[name] = {"counts": taken, "levels": str(taken.levels), "above": taken.above_black()}
    if filters:
        found["demosaiced"] = lightfield.demosaic(raw)
        found["white balance"] = BAYER.white_balance(wave.SpectralDistribution.illuminant("A"))
    return found


@pinned(plane={"light": {}}, mask={"light": {"spatial": wave.RandomPhaseMask(5e-5)}})
def expose_slide(light):
    camera = standard(7, pixels_per_lenslet=30, aperture_diameter=5e-4)
    slide = clplen.PicturePlane(samples(9, 8), 5e-4, mode="transmission")
    return camera.expose(slide, coherence=clplen.Coherence(**light), snapshots=3)


@pinned(standard={"camera": "standard"}, turned={"camera": "pixels"})
def light_field_from_raw(camera):
    camera = CAMERAS[camera]()
    raw = camera.expose(clplen.PointSources([(1e-4, 0, 1e-3)]), model="rays")
    lf = clplen.LightField.from_raw(raw)
    operator = lightfield.DecodeOperator(raw)
    warp = lightfield.RawWarp(raw)
    picture, disparity = samples(*warp.picture_shape), np.full(warp.picture_shape, 0.3)
    return {
        "samples": lf,
        "spacing": lf.spacing,
        "operator": [operator.forward(raw), operator.adjoint(samples(*operator.out_shape))],
        "warp": [warp.forward(picture, disparity), *warp.vjp(picture, disparity, raw.to_numpy())],
    }


@pinned(points={"what": "points"}, picture={"what": "picture"})
def exposure_operator(what):
    camera = standard(5, pixels_per_lenslet=30, aperture_diameter=5e-4)
    points = clplen.PointSources([(0, 0, 0), (2e-4, 0, -5e-3)])
    scene = points if what == "points" else clplen.PicturePlane(samples(2, 3), 4e-4)
    operator = cameras.ExposureOperator(camera, scene, method="points")
    values = samples(*operator.in_shape) + 0.1
    image = operator.forward(values)
    found = {"image": image, "adjoint": operator.adjoint(image)}
    if what == "points":
        gradient = operator.gradient(values, image)
        jacobian = operator.jacobian(values, by=("values", "positions", "sensor", "lenslets"))
        found |= {"gradient": parts(gradient, "values positions"), "words": repr(operator)}
        found |= {"jacobian": parts(jacobian, "image values positions lenslets sensor")}
        found |= {"lenslets": operator.lenslet_gradient(values, image)}
    return found


@pinned()
def texture_operator():
    wall = cameras.Plane(0.1, texture=cameras.noise(1, 8))
    operator = cameras.TextureOperator(standard(5), clplen.SurfaceScene(wall))
    raw = operator.forward(wall.texture.samples)
    return {"raw": raw, "adjoint": operator.adjoint(raw)}


@pinned()
def correct_aberrations():
    lf = clplen.LightField.from_array(samples(3, 5, 9, 9), spacing=SPACING, camera=standard())
    return cameras.correct_aberrations(lf, {2: 5e-7, 6: 1e-7})


@pinned()
def opd_maps():
    v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    bowl = 1e-7 * (v**2 + u**2)
    paths = [[bowl, bowl + 5e-8 * v**3]]
    maps = cameras.OPDMaps(paths, fields=[(0, 0), (2e-3, 0)], symmetric=True)
    files.write_opd_maps("lens.h5", maps)
    at = {"v": [0, 0.5, 0.9], "u": 0.1}
    return {
        "path": maps.path(1e-3, 5e-4, LAM, **at),
        "slopes": maps.slopes(1e-3, 5e-4, LAM, **at),
        "rms": maps.rms(LAM),
        "read": files.read_opd_maps("lens.h5").path(1e-3, 5e-4, LAM, **at),
    }


@pinned()
def objectives():
    s = np.linspace(0, 0.19, 5)
    glass, lens = cameras.CoverGlass(1.5e-4), cameras.Objective(20, 0.5, 1.0, 525e-9)
    pupil = cameras.PupilAberration({6: 3e-8, 11: -4e-8})
    kind = cameras.PupilAberration
    grid = clplen.Grid((21, 25), 8e-6)
    return {
        "cover": [glass.path(s, 1.0), glass.slope(s, 1.0)],
        "objective": [lens.blur(np.array([0.0, 1e-5])), lens.landing(s, 1e-5), lens.cutoff],
        "pupil": [lens.pupil(grid, 1e-5), pupil.path(s, 3 * s), pupil.steepest],
        "mismatch": repr(kind.from_index_mismatch(1e-5, 1.33, na=0.9, medium_index=1.0)),
        "tilted": repr(kind.from_tilted_cover(0.02, na=0.5, medium_index=1.0)),
        "field": lens.fields(clplen.PointSources([(1e-6, 2e-6, 1e-5)]), grid),
    }


@pinned()
def lenslet_layout():
    angles = np.arange(6) * np.pi / 3 + 0.1
    ring = 1e-3 * np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    layout = cameras.LensletLayout([(0, 0), *ring], 30e-3, diameter=0.9e-3)
    y, x = np.linspace(-1.5e-3, 1.5e-3, 31), np.linspace(-1.4e-3, 1.5e-3, 33)
    return {
        "transmission": layout.transmission(y, x, 525e-9),
        "coverage": layout.coverage(y, x, 1e-4),
        "spacing": layout.spacing,
        "of an array": repr(cameras.LensletLayout.of(clplen.MicrolensArray(1e-3, 0.03, count=3))),
    }


@pinned()
def textures():
    made = {
        "bricks": cameras.bricks(1, size=(20, 50), colour=True),
        "checker": cameras.checker(16),
        "noise": cameras.noise(1, 64, contrast=0.1),
        "picture": cameras.picture(np.uint8(255 * samples(12, 16)), scale=1.5),
        "stripes": cameras.stripes(8, angle=True),
        "uniform": cameras.uniform((1.0, 0.5, 0.0)),
    }
    return {name: one.samples for name, one in made.items()}


@pinned()
def outlines():
    bars = cameras.Bars((1, 2), 16, count=3, period=8, width=4, angle=0.3)
    frame = cameras.Polygon([(-8, -8), (-8, 8), (8, 8), (8, -8)], [(-4, -4), (-4, 4), (4, 4)])
    box = cameras.rectangle((0, 10), (8, 16), angle=0.2)
    lamp = cameras.Spot((3, 5), 2, disparity=3)
    surfaces = [cameras.Plane(-0.5, (0.01, 0), shade=(0.01, 0.0), spots=[lamp])]
    surfaces += [cameras.Plane(0.5 + n, outline=one) for n, one in enumerate((bars, frame, box))]
    lf, truth = clplen.SurfaceScene(surfaces).light_field((1, 3), (41, 37))
    return {"lf": lf, **parts(truth, "disparity z surface"), "masks": truth.masks}


@pinned()
def sample_scenes():
    found = {}
    for sample in cameras.sample_scenes(2, (32, 40)):
        lf, truth = sample.scene.light_field((1, 3), (32, 40), noise=sample.noise, seed=1)
        found[sample.name] = {"views": lf, "disparity": truth.disparity}
    return found


# Focused cameras


@lru_cache
def focused_raw(m: float) -> clplen.RawImage:
    wall = cameras.Plane(-0.5, (0.002, 0.0), texture=cameras.noise(1))
    return focused(m).expose(clplen.SurfaceScene(wall), model="rays")


@pinned(coarse={"m": 0.25}, fine={"m": 0.3})
def focused_rendering(m):
    raw = focused_raw(m)
    depth = lightfield.focused_depth(raw)
    maps = lightfield.focused_maps(raw, depth)
    stack = lightfield.focused_stack(raw, ms=[0.8 * m, m], aperture=0.7)
    pictures = {
        "blended": clplen.render_focused(raw),
        "basic": clplen.render_focused(raw, method="basic", m=m, view=(1.0, -0.5)),
        "depth": clplen.render_focused(raw, method="depth", depth=depth),
    }
    found = {name: [one, one.m, one.ratio, *one.positions()] for name, one in pictures.items()}
    geometry = lightfield.FocusedGeometry.of(raw)
    files.write_focused("picture.tif", pictures["basic"])
    files.write_focused("stack.ome.tif", stack)
    files.write_focused_depth("m.h5", depth, maps)
    return found | {
        "stack": [stack, stack.ms, stack.alphas, stack.zs],
        "depth": parts(depth, "m confidence uncertainty z"),
        "maps": parts(maps, "m z confidence"),
        "geometry": [geometry.ratio(m), geometry.patch(m), geometry.shape, geometry.cell],
        "seam": lightfield.seam(pictures["basic"]),
        "words": [repr(geometry), repr(pictures["basic"])],
    }


@pinned()
def point_m():
    mla = clplen.MicrolensArray(150e-6, 3e-3, count=21, fill="full")
    camera = clplen.PlenopticCamera.type2(
        focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=16, m=0.2
    )
    raw = camera.expose(clplen.PointSources((1e-4, 0, 1e-3)), model="rays")
    return vars_of(lightfield.point_m(raw))


# Analysis


@lru_cache
def spot(shape: tuple[int, int] = (41, 33)) -> analysis.PSF:
    y, x = np.indices(shape) - np.reshape(shape, (2, 1, 1)) // 2
    values = np.exp(-((x - 0.4) ** 2) / 9 - y**2 / 16) + 0.1 * np.exp(-((x - y) ** 2) / 40)
    return analysis.PSF(values, (1e-6, 1.2e-6))


@lru_cache
def macro() -> Any:
    mla = clplen.MicrolensArray(100e-6, 2e-3, count=7)
    return clplen.PlenopticCamera.type1(
        focal_length=15e-3, object_distance=30e-3, wavelength=LAM, mla=mla, pixels_per_lenslet=19
    )


@pinned(across={"axis": 1}, along={"axis": 0})
def point_spread(axis):
    psf, otf = spot(), analysis.OTF.of(spot(), pad=3)
    mtf = otf.mtf(axis)
    two = analysis.TwoPoints.incoherent(psf, axis=axis)
    coherent = analysis.TwoPoints.coherent(
        np.sqrt(psf.values), pitch=psf.pitch, axis=axis, phase=1.0
    )
    return {
        "numbers": [psf.fwhm(axis), psf.centroid(), psf.radius(0.8), psf.peak, psf.pitch],
        "energy": [psf.encircled_energy([2e-6, 6e-6]), psf.ensquared_energy([3e-6, 8e-6])],
        "profile": [*psf.profile(axis, oversampling=2), *psf.line_spread(axis)],
        "cut": psf.cut((0.0, 1e-6), (15, 13)).values,
        "otf": otf.values,
        "mtf": [mtf.frequency, mtf.value, mtf.at(0.5), mtf.cutoff(), mtf.contrast(5e4)],
        "two": [two.contrast([4e-6, 9e-6]), two.rayleigh(), two.sparrow()],
        "coherent": coherent.contrast([4e-6, 9e-6]),
        "strehl": psf.strehl(analysis.PSF(psf.values * 1.1, psf.pitch)),
        "words": repr(psf),
    }


@pinned()
def closed_forms():
    f = np.linspace(0, 2e5, 9)
    v, u = np.mgrid[-1:1:21j, -1:1:23j]
    phase, inside = 2 * v**2 + u**3, v**2 + u**2 <= 1
    return {
        "circular": analysis.circular_mtf(f, wavelength=LAM, distance=0.1, width=10e-3),
        "square": analysis.square_mtf(f, wavelength=LAM, distance=0.1, width=10e-3),
        "pixel": analysis.pixel_mtf(f, width=5e-6),
        "strehl": [analysis.strehl_of_rms(0.4), analysis.wavefront_strehl(phase, weight=inside)],
        "rms": analysis.wavefront_rms(phase, weight=inside),
        "slit": analysis.SLIT,
        "standard": vars_of(
            analysis.type1_sampling(
                lenslets=100,
                pitch=100e-6,
                diameter=90e-6,
                focal_length=2e-3,
                pixel_pitch=5e-6,
                wavelength=LAM,
                image_distance=30e-3,
                aperture_diameter=1.5e-3,
            )
        ),
        "focused": vars_of(
            analysis.type2_sampling(
                lenslets=100,
                pitch=100e-6,
                diameter=90e-6,
                a=10e-3,
                b=2.5e-3,
                pixel_pitch=5e-6,
                wavelength=LAM,
            )
        ),
    }


@pinned(x={"turned": False}, y={"turned": True})
def slanted_edge(turned):
    y, x = np.indices((38, 45))
    picture = 1 / (1 + np.exp((19 + 0.12 * y - x) / 0.6)) + 0.01 * samples(38, 45)
    found = analysis.slanted_edge(picture.T if turned else picture, pitch=(5e-6, 6e-6))
    return {**parts(found, "axis angle residual distance spread"), "mtf": found.mtf.value}


@pinned(standard={"camera": macro}, focused={"camera": focused})
def camera_analysis(camera):
    camera = camera()
    raw = camera.expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    psf = analysis.camera_psf(camera, positions=3)
    found = analysis.compare({"a": camera}, only=["sampling", "crosstalk", "psf"], quick=True)
    analysis.Table(("a", "b"), (("x", 1.5), ("y", float("nan")))).write("table.csv")
    return {
        "psf": [psf.values, psf.pitch],
        "crosstalk": [
            analysis.camera_crosstalk(camera),
            analysis.crosstalk(raw.to_numpy(), raw.cells),
            analysis.cell_energies(raw.to_numpy(), raw.cells),
        ],
        "sampling": vars_of(analysis.sampling_of(camera)),
        "table": analysis.sampling_table({"a": analysis.sampling_of(camera)}),
        "compared": [found["a"].crosstalk, found["a"].fwhm(), found["a"].two_point_limit()],
        "report": plot.comparison(found),
    }


@pinned()
def depth_scan():
    transfer, errors = analysis.depth_scan(macro(), [0.0, 3e-3], positions=1)
    return {
        "transfer": [transfer.mtf50, transfer.best, transfer.notes],
        "errors": [errors.errors, errors.rms, errors.notes],
    }


@pinned(whole={"border": 4}, masked={"border": 0, "where": True})
def score(border, where=False):
    truth = scene()[1]
    result = truth.disparity + 0.1 * samples(36, 44)
    result[3:7, 5:9] = np.nan
    words = {"where": truth.disparity > 0, "masks": truth.masks} if where else {}
    found = analysis.score(result, truth, border=border, **words)
    return {**vars_of(found), "words": str(found)}


# Microscopy

PLANES = [-40e-6, 10e-6, 50e-6]


@lru_cache
def point_images(pixels: float = 11, **words: Any) -> microscopy.PointImages:
    return clplen.point_images(scope(pixels), PLANES, voxels_per_lenslet=3, cut=0.02, **words)


@lru_cache
def fourier_images() -> microscopy.FourierPointImages:
    return microscopy.fourier_point_images(fourier_scope(), [-2e-5, 0.0, 2e-5])


@lru_cache
def projector(kind: str) -> Any:
    if kind == "lenslets":
        return clplen.Projector(point_images(), (5, 6))
    if kind == "fourier":
        return microscopy.FourierProjector(fourier_images(), (31, 33))
    images = clplen.point_images(
        scope(11), PLANES[:2], voxels_per_lenslet=2, sensor_pixels=7.5, cut=0.05
    )
    lattice = lightfield.Lattice("square", (30.0, 31.0), (7.4, 0.5), (-0.5, 7.4), shape=(60, 64))
    return microscopy.FrameProjector(images, lattice)


PROJECTORS = {kind: {"kind": kind} for kind in ("lenslets", "frame", "fourier")}


def volume_of(made: Any) -> np.ndarray:
    """A few points of unlike brightness."""
    volume = np.zeros(made.volume_shape, np.float32)
    nz, ny, nx = volume.shape
    volume[0, ny // 2, nx // 3] = 900
    volume[-1, ny // 3, nx // 2 + 1] = 500
    volume[nz // 2, ny // 2 + 1, nx // 2] = 300
    return volume


@pinned(**PROJECTORS)
def project(kind):
    made = projector(kind)
    frame = made.forward(volume_of(made))
    return {
        "frame": frame,
        "adjoint": made.adjoint(frame),
        "backward": made.backward(frame + 1),
        "image": made.images.image(1, (0, 0)),
        "words": [repr(made), repr(made.images)],
    }


DECONVOLUTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "accelerated": {"accelerate": True, "background": 2.0},
    "tv": {"prior": "tv", "strength": 2.0},
    "noise": {"residual": "noise", "variance": 1.5},
    "gaussian": {"prior": "gaussian"},
}


@pinned(**{f"{kind} {how}": {"kind": kind, "words": words} for kind in PROJECTORS
           for how, words in DECONVOLUTIONS.items() if (kind, how) != ("fourier", "gaussian")
           })  # fmt: skip
def deconvolve(kind, words):
    made = projector(kind)
    mean = made.forward(volume_of(made)) + 2
    frame = np.random.default_rng(2).poisson(mean).astype(np.float32)
    found = clplen.deconvolve(frame, made, iterations=6, **words)
    return parts(found, "volume residuals iterations degenerate planes voxel")


@pinned(
    apart={"batch": 1},
    together={"batch": 2, "prior": "time"},
    previous={"batch": 1, "start": "previous"},
    decayed={"batch": 1, "start": "decayed", "rolling": 2},
    limited={"batch": 1, "start": "limited", "motion": 1e-5},
)
def deconvolve_series(**words):
    made = projector("lenslets")
    volumes = np.stack([np.roll(volume_of(made), t, axis=2) for t in range(3)])
    found = microscopy.deconvolve_series(made.forward(volumes) + 1, made, iterations=5, **words)
    return [[one.volume, one.residuals] for one in found]


@pinned()
def degenerate_planes():
    images = clplen.point_images(scope(), [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    return clplen.Projector(images, (5, 5)).degenerate


@pinned()
def point_image_files():

    microscopy.write_point_images("images.h5", point_images())
    microscopy.write_point_images("fourier.h5", fourier_images())
    again = microscopy.read_point_images("images.h5")
    fourier = microscopy.read_point_images("fourier.h5")
    half = point_images(store="float16")
    return {
        "lenslets": [again.image(0, (1, 2)), again.captured_share(0), again.side, again.planes],
        "fourier": [fourier.image(1, (0, 0)), fourier.captured_share(1), fourier.centres],
        "half": half.image(0, (1, 2)),
        "binned": clplen.point_images(scope(22), PLANES[:1], binning=2).image(0, (2, 2)),
        "error": binning_error(scope(22), [0.0, 50e-6], 2),
        "suitable": suitable_binning(1.4, 63, 0.52, 125, 2800, 8.3),
        "sharpness": sharpness(point_images()),
        "lattice": vars_of(microscopy.lattice_of(scope())),
    }


def microscope_white() -> np.ndarray:
    """A white frame of the microscope of `scope` on another pitch and angle."""
    lattice = microscopy.square_lattice(11.2, (150, 163), rotation=0.005)
    return 1e4 * EvenLight(point_images().parameters).frame(lattice, 0.19, 0.5)


@pinned()
def preparations():
    from clplen.microscopy.series.series import rolling_minimum

    white = microscope_white()
    frame = np.float32(white * samples(*white.shape))
    frame[40, 50] = 1e6
    prepare = microscopy.preparation(11, white=white, dark=np.full_like(white, 3))
    found, check = prepare(frame), microscopy.check_pupil(point_images(), prepare)
    raw = microscopy.raw_preparation(
        clplen.point_images(scope(12), PLANES[2:], sensor_pixels=11.2, cut=0.05), white=white
    )
    return {
        "counts": [found.counts, found.white],
        "numbers": parts(found, "negative left_out deep size hot masked doubtful"),
        "lattice": vars_of(prepare.lattice),
        "pupil": [*parts(check, "misfit noise na apodisation left").values(), check.sentence()],
        "corrected": microscopy.corrected(prepare, check).sensitivity,
        "raw": [raw(frame).counts, raw.sensitivity],
        "rectified": microscopy.rectify(frame, prepare.lattice, pixels=11),
        "hot": hot_pixels(frame, sharpness(point_images()), prepare.lattice),
        "rolling": [low for _, low in rolling_minimum([frame, 2 * frame, frame / 2], 2)],
    }


@pinned()
def deconvolver():
    white = microscope_white()
    files.write_picture("white.tif", np.uint16(white))
    how = microscopy.DeconvolutionSettings(iterations=4, background=1.0, radiometric=True)
    made = microscopy.Deconvolver(point_images(), how, white="white.tif")
    frame = made.prepared(np.float32(white * samples(*white.shape)))
    found = made(frame)
    return {
        "frame": frame.counts,
        "volume": found.volume,
        "words": [made.checks(), made.diagnose(frame, found), made.voxel_grid()],
    }


@lru_cache
def movie() -> list[np.ndarray]:
    """Five volumes with beads that move, and one that flashes."""
    z, y, x = np.indices((9, 32, 37))
    found = []
    for t in range(5):
        bead = np.exp(-((z - 4.3) ** 2 + (y - 8.4 - t) ** 2 + (x - 12.2) ** 2) / 3)
        other = np.exp(-((z - 3) ** 2 + (y - 20) ** 2 + (x - 25.5 + 0.5 * t) ** 2) / 5)
        found.append(100 * bead + (60 + 40 * (t == 3)) * other + samples(*z.shape, seed=t))
    return found


AXES = (2e-6 * (np.arange(9) - 4), 0.5e-6 * np.arange(32), 0.6e-6 * np.arange(37))


@pinned(voxels={"axes": None}, metres={"axes": AXES})
def objects(axes):
    volumes, unit = movie(), "m" if axes else "voxel"
    points = [microscopy.find_points(volume, axes=axes) for volume in volumes]
    regions = microscopy.find_regions(volumes[0], axes=axes, snr=4)
    tracks = microscopy.track_points(points, step=1e-6 if axes else 2, motion="straight", unit=unit)
    ring = (1e-6, 3e-6) if axes else (3, 5)
    found = microscopy.traces(volumes, regions, window=3, ring=ring, axes=axes)
    for name, one in {"points": points[0], "regions": regions, "tracks": tracks}.items():
        one.to_csv(f"{name}.csv", unit=unit) if name != "tracks" else one.to_csv("tracks.csv")
    found.to_csv("traces.csv")
    return {
        "points": parts(points[0], "positions peaks snr widths"),
        "regions": parts(regions, "labels positions volumes means peaks snr threshold"),
        "tracks": [tracks.napari(), tracks.ids, repr(tracks)],
        "traces": parts(found, "regions means surround baseline dff"),
        "matched": microscopy.match_points(
            points[0].positions, points[1].positions, tolerance=(1e-6,) * 3 if axes else (2,) * 3
        ),
        "read": vars_of(microscopy.Points.from_csv("points.csv")) if axes else None,
        "spheres": microscopy.sphere_labels([(2e-6, 5e-6, 6e-6)], 2e-6, AXES),
    }


@pinned()
def pupil_fits():
    from clplen.microscopy.pupil.bead_pupil import find_beads
    from clplen.microscopy.pupil.volume_pupil import Observed

    where = [(6e-6, -5e-6, 50e-6)]
    camera, bent = scope(count=7), scope(count=7, pupil={6: 4e-8})
    frame = bent.expose(clplen.PointSources(where, power=1e5)).to_numpy()
    found = microscopy.fit_pupil(frame, camera, beads=where, terms=(5, 6))
    planes = np.array([25, 50, 75]) * 1e-6
    patches = microscopy.fit_pupil_patches(
        frame + 1, camera, (1, 1), planes=[50e-6], terms=[6], iterations=2, steps=1
    )
    return {
        "beads": parts(found, "terms coefficients errors residuals chi2 positions energies"),
        "found": find_beads(
            camera, Observed(frame, np.ones_like(frame), 0 * frame, 1.0), planes, voxels=3,
            binning=1, cut=5e-3,
        ),
        "patches": [[one.coefficients for one in row] for row in patches],
    }


@pinned()
def measure_point_images():
    z = np.array([-15e-6, 0, 15e-6])
    beads = [fourier_scope().expose(clplen.PointSources((0, 0, one + 2e-6))) for one in z]
    found = microscopy.measure_point_images(fourier_scope(), np.stack(beads), z)
    names = "offset positions depths error"
    return {"image": found.images.image(1, (0, 0)), **parts(found, names)}


# Files: each writer with its reader


@pinned(**BOTH)
def light_field_files(lf):
    lf = lf()
    found = {}
    for name in ("a.h5", "a.zarr", "a"):
        clplen.write_lightfield(name, lf)
        with clplen.open_lightfield(name) as stored:
            again = clplen.read_lightfield(name)
            found[name] = [again, again.spacing, again.weights, stored.to_numpy()]
    return found


@pinned()
def light_fields_of_others():
    """MATLAB and an archive of views, as other programs write them."""
    values = np.uint8(255 * samples(3, 5, 14, 17, 3))
    savemat("a.mat", {"LF": values, "about": "a name"})
    with zipfile.ZipFile("a.zip", "w") as file:
        for n, view in enumerate(values.reshape(15, 14, 17, 3)):
            picture = io.BytesIO()
            Image.fromarray(view).save(picture, "png")
            file.writestr(f"input_Cam{n:03d}.png", picture.getvalue())
    read = clplen.read_lightfield
    found = {
        "matlab": read("a.mat"),
        "zip": read("a.zip", views=(3, 5), flip_v=True),
        "lawnmower": read("a.zip", views=(3, 5), order="lawnmower"),
        "names": read("a.zip", views=(3, 5), pattern="input_Cam{i}.png", srgb=True),
    }
    for name in ("a.mat", "a.zip"):
        Path(name).unlink()  # they hold when they were made
    return found


@pinned(**BOTH)
def view_files(lf):
    eight = np.uint8(200 * np.clip(lf().to_numpy() / lf().to_numpy().max(), 0, 1))
    lf = clplen.LightField.from_array(eight)
    files.write_views("views", lf)
    files.write_views("hci", lf, pattern="hci")
    files.write_mosaic("mosaic.png", lf, order="vyux")
    files.write_mosaic("lenses.tif", lf, order="yvxu")
    views = lf.shape[:2]
    return {
        "views": clplen.read_lightfield("views", flip_u=True),
        "hci": clplen.read_lightfield("hci", views=views, swap_uv=views[0] == views[1]),
        "mosaic": clplen.read_lightfield("mosaic.png", views=views, order="vyux"),
        "lenses": clplen.read_lightfield("lenses.tif", views=views, order="yvxu", srgb=True),
        "names": [path.name for path in sorted(Path("views").iterdir())],
    }


@pinned(
    png={"name": "a.png", "kind": np.uint16},
    tif={"name": "a.tif", "kind": np.float32},
    npy={"name": "a.npy", "kind": np.float64},
    pfm={"name": "a.pfm", "kind": np.float32},
)
def picture_files(name, kind):
    values = np.asarray(200 * samples(19, 26), kind)
    if name == "a.npy":
        files.write_npy(name, values)
        return files.read_npy(name), digest(name)
    if name == "a.pfm":
        files.write_pfm(name, values)
        return files.read_pfm(name), files.read_disparity(name, shape=values.shape)
    files.write_picture(name, values, description="noise", dpi=300)
    frame, filters = files.read_frame(name)
    return files.read_picture(name), frame, filters


@pinned(**BOTH)
def stack_files(lf):
    lf = lf()
    stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 1])
    depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 5))
    for name in ("stack.ome.tif", "stack.ome.zarr"):
        files.write_stack(name, stack)
    for name in ("depth.ome.tif", "depth.pfm", "depth.ome.zarr"):
        files.write_depth(name, depth)
    files.write_image("sharp.tif", lf.render(), spacing=lf.spacing, description="all")
    again = files.read_stack("stack.ome.zarr")
    return {
        "stack": [files.read_stack("stack.ome.tif"), again, again.disparities, again.alphas],
        "depth": vars_of(files.read_depth("depth.ome.tif")),
        "image": files.read_image("sharp.tif"),
    }


@pinned(tiff={"name": "volume.ome.tif"}, zarr={"name": "volume.ome.zarr"})
def volume_files(name):
    planes = np.array([-3e-6, 0.0, 2e-6])
    words = {"planes": planes, "voxel": (5e-7, 6e-7), "description": {"residual": 0.5}}
    files.write_volume(name, samples(3, 14, 17), **words)
    series = files.open_volumes([name])
    return {
        "read": files.read_volume(name),
        "series": [series[0], series.planes, series.voxel, repr(series)],
        "kind": is_volume(name),
    }


@pinned()
def truth_files():
    truth = scene()[1]
    files.write_truth("truth.h5", truth)
    hci = files.HciParameters(
        focal_length_mm=100.0, sensor_size_mm=35.0, baseline_mm=45.0, focus_distance_m=8.0,
        image_resolution_x_px=512, image_resolution_y_px=512,
    )  # fmt: skip
    files.write_parameters("parameters.cfg", hci)
    again = files.read_scene_truth("truth.h5")
    return {
        "truth": parts(again, "disparity z surface masks"),
        "disparity": files.read_truth("truth.h5"),
        "masks": again.masks,
        "hci": [vars_of(files.read_parameters("parameters.cfg")), hci.disparity([7.0, 9.0])],
    }


@pinned(standard={"name": "standard"}, filters={"name": "filters"}, kinds={"name": "kinds"})
def raw_files(name):
    raw = CAMERAS[name]().expose(clplen.PointSources((1e-4, 0, 1e-3)))
    clplen.write_raw("raw.h5", raw)
    again = clplen.read_raw("raw.h5")
    return {
        "raw": again,
        "camera": str(again.camera.describe()),
        "lattice": vars_of(again.cells),
        "kind": [is_raw_file("raw.h5"), is_raw_file("none.h5")],
    }


@pinned()
def raytrix_files():
    far = files.FocusType(offset=(0.0, 0.0), depth_range=(3.8, 100.0))
    bent = files.Distortion("radial", "Brown", (-0.00145, 0.000735), offset=(0.0, 0.0))
    one = files.RaytrixCalibration(
        offset=(0.5, -1.25), diameter=23.0, lens_base_x=(1.0, 0.0), lens_base_y=(0.5, 0.866),
        distortion=bent, lens_types=(far,),
    )  # fmt: skip
    files.write_raytrix("camera.xml", one)
    files.write_picture("camera.png", np.uint8(255 * samples(120, 150)))
    raw = clplen.read_raw("camera.xml", image="camera.png")
    return {
        "same": files.read_raytrix("camera.xml") == one,
        "lattice": vars_of(one.lattice((120, 150))),
        "origin": one.origin((120, 150)),
        "raw": [raw, repr(raw)],
    }


@pinned()
def zemax_files():
    v, u = np.meshgrid(np.linspace(1, -1, 17), np.linspace(-1, 1, 17), indexing="ij")
    waves = np.where(np.hypot(v, u) <= 1, 0.5 * (v**2 + u**2) + 0.1 * v, 0)
    head = "0.5500 um at 0.0000, 0.0000 (deg)\nPupil grid size: 17 by 17"
    np.savetxt("map.txt", waves, header=head, comments="")
    maps = files.read_zemax_opd(["map.txt"], fields=[(0, 0)])
    return maps.path(0, 0, 550e-9, v=[0, 0.3], u=0.5)


@pinned()
def point_files():
    lengths = {"baseline": 5e-3, "focal_length": 20e-3, "pixel_pitch": 10e-6}
    disparity = scene()[1].disparity + 2
    points, comment = files.points_of(disparity, **lengths)
    colours = np.uint8(255 * samples(len(points), 3))
    files.write_ply("points.ply", points, colours, comment=comment)
    files.write_glb("points.glb", points, colours)
    seen = lightfield.view_cameras(scene()[0], **lengths)
    pictures = np.uint8(255 * np.clip(scene()[0].to_numpy(), 0, 1))
    files.write_colmap("colmap", pictures, seen, points=points, colours=colours)
    files.write_nerf("nerf", pictures, seen)
    return {"points": points, "comment": comment, "read": files.read_ply("points.ply")}


@pinned()
def display_files():
    left, right = (np.uint8(255 * samples(12, 17, 3, seed=n)) for n in (1, 2))
    views = [np.uint8(255 * samples(9, 24, seed=n)) for n in range(5)]
    layout = files.QuiltLayout(3, 2, (80, 96), 0.8)
    tiles = [np.full(layout.tile, 40 * n, np.uint8) for n in range(layout.views)]
    made = files.write_quilt("grey.png", tiles, layout)
    files.write_animation("fade.gif", views, seconds=0.5)
    return {
        "anaglyphs": [files.anaglyph(left, right, colours=c) for c in ("dubois", "colour", "grey")],
        "interlaced": files.interlace(views, 5.3, centre=2.5),
        "across": files.interlace(views, 6, lenses="horizontal"),
        "pitch": files.lens_pitch(60, 720, distance=0.4, thickness=6e-4),
        "test": files.pitch_test(60, 150, 0.04, bands=3),
        "name": made.name,
        "displays": sorted(DISPLAYS),
    }


@pinned()
def pages():
    lf, truth = scene()
    files.write_html("scene.html", {"scene": lf, "mean": lf.render().to_numpy()}, quality=80)
    files.write_html("depth.html", truth.disparity, title="Depth")
    return [len(Path(name).read_bytes()) for name in ("scene.html", "depth.html")]


# Figures


@pinned()
def figures_of_light_fields():
    lf = metric()
    found = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    images = [clplen.refocus(lf, disparity=d) for d in (-1.0, 1.0)]
    plot.save(plot.views(lf), "views.svg")
    return {
        "views": plot.views(scene()[0], max_views=3, scale="root"),
        "picture": plot.picture(lf.view(1, 1), title="a view"),
        "refocused": plot.refocused(images, ["far", "near"]),
        "montage": plot.montage(clplen.focal_stack(scene()[0], disparities=[-1, 0, 1])),
        "epi": plot.epi(lightfield.phase_space(scene()[0], y=16, v=2), title="one"),
        "phase space": plot.phase_space(scene_with_spacing(), rows=[8, 16], labels=["a", "b"]),
        "depth": plot.depth(found, title="d"),
        "truth": plot.truth(scene()[1]),
        "size": plot.rendered(base.new_figure(2.0, 1.5), dpi=50).shape,
    }


@pinned()
def figures_of_waves():
    optics = clplen.OpticalSystem([0.24, wave.Lens(0.12, diameter=3.6e-3), 0.24])
    rays = plot.rays_through(optics, height=1e-3)
    axes = base.new_figure(4.0, 3.0).add_subplot()
    axes.imshow(np.eye(16), extent=(0, 40, 40, 0))
    norm = base.norm_of(np.array([[0.0, 2.0], [4.0, 8.0]]), "log", decades=2)
    return {
        "intensity": plot.intensity(lit(), scale="log", title="I"),
        "phase": plot.phase(lit()),
        "system": plot.system(optics, height=1e-3),
        "rays": [rays.axial, rays.oblique, [[one.z, one.height] for one in rays.images]],
        "trace": list(plot.trace(optics, 1e-3, [-0.005, 0.0, 0.005])),
        "psf": plot.psf(spot()),
        "modulation": plot.modulation(analysis.OTF.of(spot())),
        "curve": plot.curve(analysis.OTF.of(spot()).mtf(1), title="mtf"),
        "bar": [plot.scale_bar(axes, 1e-6), scale_bars.round_length(90e-6), axes.figure],
        "shown": base.for_display(np.array([[0.0, 2.0], [4.0, 8.0]]), norm),
        "coordinates": [base.coordinates(5, 150e-6), base.centred((20, 40), 0.25)],
    }


@pinned()
def figures_of_cameras():
    raw = standard().expose(clplen.PointSources([(0.0, 1e-4, 0.0)]))
    estimate = clplen.estimate_alpha(scene_with_spacing(), method="energy")
    maps = lightfield.focused_maps(focused_raw(0.25), lightfield.focused_depth(focused_raw(0.25)))
    points = {"energy": [(-5e-3, 0.97), (5e-3, 1.02)]}
    return {
        "raw": plot.raw_image(raw, details={"point": (0.0, 0.0)}),
        "alpha": plot.alpha_curve(standard(), points, reach=10e-3),
        "energy": plot.energy_curves({"energy": [("0 mm", estimate, 1.0)]}),
        "focused": plot.focused_depth(maps),
        "magnification": plot.magnification(maps.m, maps.confidence),
    }


def scene_with_spacing() -> clplen.LightField:
    return clplen.LightField.from_array(scene()[0].to_numpy(), spacing=SPACING)


@pinned()
def figures_of_volumes():
    voxel = (2e-6, 0.5e-6, 0.6e-6)
    found = microscopy.DeconvolutionResult(
        movie()[0], np.ones(3), 3, (), planes=AXES[0], voxel=voxel[1:]
    )
    tracks = microscopy.track_points(
        [microscopy.find_points(one, axes=AXES) for one in movie()], step=1e-6, unit="m"
    )
    return {
        "volume": plot.volume(found, title="beads"),
        "projection": plot.maximum_projection(np.stack(movie()), voxel=voxel, axis="x"),
        "views": plot.orthogonal_views(movie()[2], voxel=voxel, tracks=tracks, frame=2),
    }


# Jobs


@pinned(
    inputs={"job": {
        "inputs": {"files": "*.npy"}, "stack": {"disparities": "-1:1:3"}, "all_in_focus": {},
        "depth": {"cue": "energy", "disparities": [-1, 0, 1]}, "views": {"at": [[1, 0.5]]},
        "formats": ["ome-tiff", "ome-zarr"], "light_field": {}}},
    scenes={"job": {
        "scenes": {"kind": ["bars", "slant"], "shape": [24, 33], "views": [3, 5], "noise": 0.01},
        "depth": {}, "raw": {}}},
)  # fmt: skip
def run_job(job):
    np.save("a.npy", samples(3, 5, 16, 19))
    np.save("b.npy", np.uint8(255 * samples(3, 3, 14, 16, 3)))
    made = batch.Job(output="out", **job)
    estimate = batch.estimate_job(made, sample=False)
    summary = batch.run_job(made)
    return {
        "estimate": [estimate.todo, [one.name for one in estimate.lines]],
        "summary": [summary.done, summary.failed, summary.is_good],
        "status": [
            [getattr(item, "name", item), *words]
            for item, *words in batch.status_of(made, verify=True)
        ],
        "contents": made.contents(),
    }
