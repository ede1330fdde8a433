"""Point images of a Fourier light-field microscope, lenslet by lenslet.

In the paraxial order of relay and lenslet, a lenslet at c in the pupil P gives the field

    E(x) = 1/(lam s) int P(c + v) exp(i pi v^2 (1/s - 1/f)/lam) exp(-2 pi i (x - c) v/(lam s)) dv

on the sensor: a Fourier transform at arbitrary points, evaluated as a product of matrices (Soummer
et al. 2007, "Fast computation of Lyot-style coronagraph propagation", section 2.1). Images of
different lenslets add as energies. Overlapping images interfere, but the fringes move with the
point: they average out over a voxel of the lateral resolution.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from clplen.cameras.fourier_microscope import MIN_LIT_FRACTION as LIT
from clplen.cameras.fourier_microscope import FourierMicroscope
from clplen.checks import positive_integer, require
from clplen.compute.memory import free_memory
from clplen.errors import SamplingError
from clplen.files import PathLike
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.point_image_files import read_matching, write_point_images
from clplen.microscopy.model.psf import check_cut, objective_parameters, rising_planes
from clplen.progress import notebook_bar
from clplen.wave.coherence.averaging import Progress
from clplen.wave.field.transmission import phasor

Vector = np.ndarray[Any, Any]

CUT = 0.02  # default share of the light that may be cropped
MIN_SAMPLES = 128  # across a lenslet
OVERSAMPLING = 1.25  # samples over the number that the window needs by the sampling theorem
MAX_SAMPLES = 2048  # across a lenslet; larger fields take too much memory and time


@notebook_bar("point images")
def fourier_point_images(
    camera: FourierMicroscope,
    planes: Sequence[float] | Vector,
    *,
    voxels_per_pixel: int = 1,
    cut: float = CUT,
    path: PathLike | None = None,
    progress: Progress | None = None,
) -> FourierPointImages:
    """Simulate the point images of a Fourier microscope, or read them from a file.

    A pixel of a sub-image contains b x b voxels; it is pixel/M_T wide in the specimen.

    Parameters
    ----------
    camera : FourierMicroscope
        Camera from `PlenopticCamera.fourier_microscope`.
    planes : sequence of float
        z of the planes in metres from the focal plane, farther positive, rising: plane 0 is the
        nearest to the objective.
    voxels_per_pixel : int
        Number b of voxels per pixel along an axis, at least 1.
    cut : float
        Share of the light of a sub-image that may be cropped around its point image. Lenslet rims
        scatter widely: a hundredth of the light lies far from the point.
    path : path-like, optional
        HDF5 file; read if it exists and matches, else written.
    progress : callable, optional
        Callback ``progress(done, total)``, called after each plane.

    Returns
    -------
    FourierPointImages
        Point images of all illuminated lenslets.

    Raises
    ------
    ValueError
        If planes do not rise, are infinite or more than 0.1 m away, a number is out of range, or
        the file has other parameters.
    TypeError
        If the camera is not a Fourier microscope, or planes are not real numbers.
    SamplingError
        If a plane is so far away that its light misses the sub-images.
    FormatError
        If the file is damaged.
    MemoryError
        If the images do not fit the free memory.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> f"{images.captured_share(0):.1%} of the light of a point is captured"
    '78.9% of the light of a point is captured'
    """
    z = checked_planes(camera, planes)
    b = positive_integer(voxels_per_pixel, "voxels_per_pixel")
    check_cut(cut)
    parameters = parameters_of(camera, z, b) | {"cut": float(cut), "source": "simulated"}
    saved = read_matching(path, parameters)
    if isinstance(saved, FourierPointImages):
        return saved
    centres = centres_of(camera)
    _check_memory(camera, len(z), b, len(centres))
    stored, corners = [], []
    for number, (images, corner) in enumerate(_simulated(camera, z, b, cut)):
        stored.append(images)
        corners.append(corner)
        if progress is not None:
            progress(number + 1, len(z))
    camera.device.free_spare()  # fields take more memory than all later uses of the images
    result = FourierPointImages(
        parameters,
        z,
        b,
        camera.side / b,
        camera.grid.shape,
        centres,
        camera.sub_image / (2 * camera.pixel_pitch),
        tuple(stored),
        np.array(corners, np.int32),
    )
    if path is not None:
        write_point_images(path, result)
    return result


def checked_planes(camera: Any, planes: Any) -> Vector:
    """Check the camera and the planes; return z in metres."""
    require(FourierMicroscope, camera, "camera", "PlenopticCamera.fourier_microscope")
    return rising_planes(planes)


def parameters_of(camera: FourierMicroscope, planes: Vector, voxels: int) -> dict[str, Any]:
    """Return all parameters that determine the point images, by their names in the camera."""
    layout = camera.lenslets
    return {
        "kind": camera.kind,
        **objective_parameters(camera),
        "relay": camera.relay,
        "field_stop": camera.field_stop,
        "sensor_distance": camera.sensor_distance,
        "lenslet_positions": layout.positions.tolist(),
        "lenslet_focal_lengths": layout.focal_lengths.tolist(),
        "lenslet_diameter": layout.diameter,
        "lenslet_fill": layout.fill,
        "lenslet_rotation": layout.rotation,
        "pixel_pitch": camera.pixel_pitch,
        "sensor": list(camera.grid.shape),
        "voxels_per_pixel": voxels,
        "planes": [float(z) for z in planes],
    }


def centres_of(camera: FourierMicroscope) -> Vector:
    """Return the centres (y, x) of the illuminated sub-images in pixels, shape (lenslets, 2)."""
    positions = camera.lenslets.positions[camera.lit >= LIT]
    middle = (np.array(camera.grid.shape) - 1) / 2
    return np.asarray(positions / camera.pixel_pitch + middle)


def _check_memory(camera: FourierMicroscope, planes: int, b: int, lenslets: int) -> None:
    """Raise MemoryError if the images of a plane, each as wide as a sub-image, do not fit."""
    across = camera.sub_image / camera.pixel_pitch + 1
    nbytes = 4 * lenslets * b**2 * across**2
    if 2 * nbytes > free_memory():
        raise MemoryError(
            f"The {lenslets} images of a plane take up to {nbytes:,.0f} bytes, but only "
            f"{free_memory():,} are free: take a smaller field stop, or fewer voxels per pixel."
        )


def _simulated(
    camera: FourierMicroscope, planes: Vector, b: int, cut: float
) -> Iterator[tuple[Vector, Vector]]:
    """Yield the images and the corners of each plane."""
    lit = np.flatnonzero(camera.lit >= LIT)
    for z in planes:
        displacements = camera.displacement(float(z))[lit]
        reach = float(np.abs(displacements).max())
        if not reach <= camera.sub_image:
            raise SamplingError(
                f"Images of the plane at z = {z * 1e6:g} um are up to {reach:.3g} m from the "
                f"centres of sub-images of {camera.sub_image:.3g} m: take nearer planes, or a "
                "wider field stop."
            )
        yield _cropped(*_plane(camera, float(z), lit, displacements, b), cut)


def _plane(
    camera: FourierMicroscope, z: float, lit: Vector, displacements: Vector, b: int
) -> tuple[Vector, Vector]:
    """Simulate the images of a plane, as wide as a sub-image; return them and their corners."""
    pitch, band = camera.pixel_pitch, camera.wavelength * camera.sensor_distance
    half = math.ceil(camera.sub_image / (2 * pitch))
    size = 2 * half + 1
    width = 2 * camera.lenslets.reach
    reach = float(np.abs(displacements).max()) + camera.sub_image / 2
    count = max(MIN_SAMPLES, math.ceil(OVERSAMPLING * 2 * reach * width / band))
    if count > MAX_SAMPLES:
        raise SamplingError(
            f"The plane at z = {z * 1e6:g} um needs {count} samples across a lenslet, at most "
            f"{MAX_SAMPLES} are supported: take nearer planes, or a smaller field stop."
        )
    centres = centres_of(camera)
    corners = np.rint(centres + displacements / pitch).astype(np.int64) - half
    nodes, weights = leggauss(2 + math.ceil(1.5 * pitch * width / band))
    shifts = (np.arange(b) - (b - 1) / 2) / b
    images = np.empty((b * b, len(lit), size, size), np.float32)
    scale = pitch**2 / (band**2 * energy_of(camera))
    for number, lenslet in enumerate(lit):
        v, field = patch(camera, z, int(lenslet), count)
        first = corners[number] - centres[number]  # (y, x) from the centre of the sub-image
        pixel = np.arange(size)[:, None] + nodes / 2
        phases = [
            [phasor(np.outer((first[axis] + pixel - shift).ravel(), -v * pitch / band))
             for shift in shifts]
            for axis in (0, 1)
        ]  # fmt: skip
        for phase, (sy, sx) in enumerate(np.ndindex(b, b)):
            light = np.abs(phases[0][sy] @ field @ phases[1][sx].T) ** 2
            light = light.reshape(size, len(nodes), size, len(nodes))
            images[phase, number] = scale * np.einsum(
                "iakb,a,b->ik", light, weights / 2, weights / 2, optimize=True
            )
    return images, corners


def patch(camera: FourierMicroscope, z: float, lenslet: int, count: int) -> tuple[Vector, Vector]:
    """Return coordinates about a lenslet's centre, and the field behind it times a cell area."""
    layout = camera.lenslets
    step = 2 * layout.reach / count
    v = (np.arange(count) - (count - 1) / 2) * step
    y, x = layout.positions[lenslet]
    bend = 1 / camera.sensor_distance - 1 / layout.focal_lengths[lenslet]
    thin = phasor(v**2 * bend / (2 * camera.wavelength))
    field = camera.pupil(y + v, x + v, z) * layout.coverage(v, v, step) * step**2
    return v, field * thin[:, None] * thin


def energy_of(camera: FourierMicroscope) -> float:
    """Integrate cos(theta)^(2 e) over the conjugate pupil, in square metres."""
    per = (camera.magnification / (camera.relay * camera.medium_index)) ** 2
    rim = 1 - (camera.na / camera.medium_index) ** 2  # cos^2(theta) at the rim
    power = camera.apodisation + 1
    integral = -math.log(rim) if power == 0 else (1 - rim**power) / power
    return math.pi * integral / per


def _cropped(images: Vector, corners: Vector, cut: float) -> tuple[Vector, Vector]:
    """Crop images to the smallest central squares that lose at most ``cut`` of any image."""
    size = images.shape[-1]
    half = size // 2
    t = np.abs(np.arange(size) - half)
    ring = np.maximum(t[:, None], t).ravel()
    flat = images.reshape(-1, size * size)
    encircled = np.array([np.cumsum(np.bincount(ring, image, half + 1)) for image in flat])
    is_enough = (encircled >= (1 - cut) * encircled[:, -1:]).all(axis=0)
    radius = int(is_enough.argmax())
    inside = slice(half - radius, half + radius + 1)
    return np.ascontiguousarray(images[..., inside, inside]), corners + half - radius
