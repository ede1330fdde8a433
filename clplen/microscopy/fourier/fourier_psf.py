"""Point images of a Fourier light-field microscope, lenslet by lenslet.

A lenslet's share of the pupil makes, to the relay's and the lenslet's paraxial order,

    E(x) = 1/(lam s) int P(c + v) exp(i pi v^2 (1/s - 1/f)/lam) exp(-2 pi i (x - c) v/(lam s)) dv

on the sensor: a Fourier transform at any places, here a product of matrices (Soummer et al. 2007,
"Fast computation of Lyot-style coronagraph propagation", section 2.1). Images of different lenslets
add as energies. Where they meet they interfere, but the fringes move with the point: over a voxel
of the lateral resolution they average out, and no shift-invariant image can hold them.
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

CUT = 0.02
LEAST = 128  # samples across a lenslet
ROOM = 1.25  # times the samples that the window needs
MOST = 2048  # samples across a lenslet


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

    Voxels lie in a pixel of a sub-image, pixel/M_T wide in the specimen, or b x b of them.

    Parameters
    ----------
    camera : FourierMicroscope
        As `PlenopticCamera.fourier_microscope` makes it.
    planes : sequence of float
        Their z in metres from the focal plane, farther positive, rising: plane 0 is the nearest to
        the objective.
    voxels_per_pixel : int
        b, along an axis, from 1 on.
    cut : float
        Share of the light of a sub-image that may be left out around its point image. Rims of
        lenslets scatter widely: a hundredth of the light lies far from the point.
    path : path-like, optional
        An HDF5 file: read if it is there and fits, else written.
    progress : callable, optional
        Called as ``progress(done, total)`` after each plane.

    Returns
    -------
    FourierPointImages
        Of all lenslets with light.

    Raises
    ------
    ValueError
        For planes that do not rise, are infinite or more than 0.1 m away, a number out of range, or
        a file of other parameters.
    TypeError
        If the camera is no Fourier microscope, or planes are no real numbers.
    SamplingError
        If a plane lies so far that its light does not reach the sub-images.
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
    >>> f"{images.kept(0):.1%} of the light of a point is kept"
    '78.9% of the light of a point is kept'
    """
    z = checked_planes(camera, planes)
    b = positive_integer(voxels_per_pixel, "voxels_per_pixel")
    check_cut(cut)
    parameters = described(camera, z, b) | {"cut": float(cut), "source": "simulated"}
    found = read_matching(path, parameters)
    if isinstance(found, FourierPointImages):
        return found
    centres = centres_of(camera)
    _check_memory(camera, len(z), b, len(centres))
    stored, corners = [], []
    for number, (images, corner) in enumerate(_simulated(camera, z, b, cut)):
        stored.append(images)
        corners.append(corner)
        if progress is not None:
            progress(number + 1, len(z))
    camera.device.free_spare()  # fields are larger than anything that is made of the images
    made = FourierPointImages(
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
        write_point_images(path, made)
    return made


def checked_planes(camera: Any, planes: Any) -> Vector:
    """Planes as numbers, after a look at the camera too."""
    require(FourierMicroscope, camera, "camera", "PlenopticCamera.fourier_microscope")
    return rising_planes(planes)


def described(camera: FourierMicroscope, planes: Vector, voxels: int) -> dict[str, Any]:
    """Everything that point images depend on, by the names of the camera."""
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
        "planes": [float(one) for one in planes],
    }


def centres_of(camera: FourierMicroscope) -> Vector:
    """(y, x) in pixels of the sub-images with light, float64, shape (lenslets, 2)."""
    places = camera.lenslets.positions[camera.lit >= LIT]
    middle = (np.array(camera.grid.shape) - 1) / 2
    return np.asarray(places / camera.pixel_pitch + middle)


def _check_memory(camera: FourierMicroscope, planes: int, b: int, lenslets: int) -> None:
    """Refuse more images than fit the memory, taken to be as wide as a sub-image."""
    across = camera.sub_image / camera.pixel_pitch + 1
    one = 4 * lenslets * b**2 * across**2
    if 2 * one > free_memory():
        raise MemoryError(
            f"The {lenslets} images of a plane take up to {one:,.0f} bytes, of which "
            f"{free_memory():,} are free: take a smaller field stop, or fewer voxels of a pixel."
        )


def _simulated(
    camera: FourierMicroscope, planes: Vector, b: int, cut: float
) -> Iterator[tuple[Vector, Vector]]:
    """Images and corners of each plane."""
    chosen = np.flatnonzero(camera.lit >= LIT)
    for z in planes:
        far = camera.displacement(float(z))[chosen]
        reach = float(np.abs(far).max())
        if not reach <= camera.sub_image:
            raise SamplingError(
                f"Images of the plane at z = {z * 1e6:g} um lie up to {reach:.3g} m from the "
                f"middle of sub-images of {camera.sub_image:.3g} m: take nearer planes, or a wider "
                "field stop."
            )
        yield _cut(*_plane(camera, float(z), chosen, far, b), cut)


def _plane(
    camera: FourierMicroscope, z: float, chosen: Vector, far: Vector, b: int
) -> tuple[Vector, Vector]:
    """Images of one plane as wide as a sub-image, and their corners."""
    pitch, band = camera.pixel_pitch, camera.wavelength * camera.sensor_distance
    half = math.ceil(camera.sub_image / (2 * pitch))
    size = 2 * half + 1
    width = 2 * camera.lenslets.reach
    reach = float(np.abs(far).max()) + camera.sub_image / 2
    count = max(LEAST, math.ceil(ROOM * 2 * reach * width / band))
    if count > MOST:
        raise SamplingError(
            f"The plane at z = {z * 1e6:g} um needs {count} samples across a lenslet, at most "
            f"{MOST}: take nearer planes, or a smaller field stop."
        )
    centres = centres_of(camera)
    corners = np.rint(centres + far / pitch).astype(np.int64) - half
    places, weights = leggauss(2 + math.ceil(1.5 * pitch * width / band))
    shifts = (np.arange(b) - (b - 1) / 2) / b
    images = np.empty((b * b, len(chosen), size, size), np.float32)
    scale = pitch**2 / (band**2 * energy_of(camera))
    for number, lenslet in enumerate(chosen):
        v, field = patch(camera, z, int(lenslet), count)
        first = corners[number] - centres[number]  # (y, x) from the sub-image's middle
        pixel = np.arange(size)[:, None] + places / 2
        turned = [
            [phasor(np.outer((first[axis] + pixel - shift).ravel(), -v * pitch / band))
             for shift in shifts]
            for axis in (0, 1)
        ]  # fmt: skip
        for phase, (sy, sx) in enumerate(np.ndindex(b, b)):
            light = np.abs(turned[0][sy] @ field @ turned[1][sx].T) ** 2
            light = light.reshape(size, len(places), size, len(places))
            images[phase, number] = scale * np.einsum(
                "iakb,a,b->ik", light, weights / 2, weights / 2, optimize=True
            )
    return images, corners


def patch(camera: FourierMicroscope, z: float, lenslet: int, count: int) -> tuple[Vector, Vector]:
    """Field behind a lenslet, times the area of a sample, about its centre."""
    layout = camera.lenslets
    step = 2 * layout.reach / count
    v = (np.arange(count) - (count - 1) / 2) * step
    y, x = layout.positions[lenslet]
    bend = 1 / camera.sensor_distance - 1 / layout.focal_lengths[lenslet]
    thin = phasor(v**2 * bend / (2 * camera.wavelength))
    field = camera.pupil(y + v, x + v, z) * layout.coverage(v, v, step) * step**2
    return v, field * thin[:, None] * thin


def energy_of(camera: FourierMicroscope) -> float:
    """Integral of cos(theta)^(2 e) over the conjugate pupil, in square metres."""
    per = (camera.magnification / (camera.relay * camera.medium_index)) ** 2
    rim = 1 - (camera.na / camera.medium_index) ** 2  # cos^2 there
    power = camera.apodisation + 1
    whole = -math.log(rim) if power == 0 else (1 - rim**power) / power
    return math.pi * whole / per


def _cut(images: Vector, corners: Vector, cut: float) -> tuple[Vector, Vector]:
    """The smallest squares about the middle that hold all but ``cut`` of each image."""
    size = images.shape[-1]
    half = size // 2
    t = np.abs(np.arange(size) - half)
    ring = np.maximum(t[:, None], t).ravel()
    flat = images.reshape(-1, size * size)
    held = np.array([np.cumsum(np.bincount(ring, one, half + 1)) for one in flat])
    enough = (held >= (1 - cut) * held[:, -1:]).all(axis=0)
    radius = int(enough.argmax())
    inside = slice(half - radius, half + radius + 1)
    return np.ascontiguousarray(images[..., inside, inside]), corners + half - radius
