"""Point images of a light-field microscope: one for each plane and place of a voxel in a lenslet.

The lenslet lattice repeats, so that a volume with v x v voxels a lenslet has v^2 point images in
each plane (Broxton et al. 2013, section 3.1). Mirror images of the square lattice, x -> -x,
y -> -y and x <-> y, leave about v^2/8 of them to be simulated and stored. Each plane is cut to the
lenslets that hold its light.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from clplen.cameras import geometry
from clplen.cameras.microscope import Microscope
from clplen.cameras.scene import PointSources
from clplen.compute.lines import smooth_length
from clplen.files import PathLike
from clplen.microscopy import psffile
from clplen.microscopy.images import PointImages, unique_phases
from clplen.wave.average import Progress
from clplen.wave.lenslets import MicrolensArray

Vector = np.ndarray[Any, Any]
Store = Literal["float32", "float16"]

# The window samples the pupil: with these margins an image departs from that of a window three
# times as wide by 1e-3 to 3e-3 of its peak, and half as wide by 1e-2.
MARGIN = 12  # lenslets that are simulated around the geometrical blur
LEAST = 35  # lenslets across that are simulated


def point_images(
    camera: Microscope,
    planes: Sequence[float] | Vector,
    *,
    voxels_per_lenslet: int = 5,
    cut: float = 2e-3,
    store: Store = "float32",
    path: PathLike | None = None,
    progress: Progress | None = None,
) -> PointImages:
    """The point images of a microscope, simulated or read from a file.

    Voxel (sy, sx) of a lenslet lies at ((s - (v - 1)/2) p/(v M)) from the point that the lenslet's
    centre images. A lenslet has a whole number of pixels: a frame with another lattice, turned or
    with a fractional pitch, is rectified first, once for each frame, because point images that
    differ from lenslet to lenslet would be as many as there are lenslets.

    Parameters
    ----------
    camera : Microscope
        Square lattice, not turned, a whole number of pixels a lenslet. Its count of lenslets does
        not matter.
    planes : sequence of float
        z in metres from the native plane, farther positive; any, all different.
    voxels_per_lenslet : int
        v, along an axis; from 1 on.
    cut : float
        Share of a voxel's light that may be left out beyond the lenslets that are kept.
    store : {"float32", "float16"}
        float16 halves the memory and is right to 5e-4 of a value, or 3e-8 of the plane's largest.
    path : path-like, optional
        An HDF5 file: read if it is there and fits, else written.
    progress : callable, optional
        Called as ``progress(done, total)`` after each plane.

    Returns
    -------
    PointImages

    Raises
    ------
    ValueError
        For a lattice that is not square or turned, a fractional number of pixels, equal or
        infinite planes, a share outside 0 to 0.5, or a file of other parameters.
    FormatError
        If the file is damaged.
    DeviceError
        If the fields do not fit the device.
    """
    z = _checked(camera, planes, voxels_per_lenslet, cut, store)
    parameters = described(camera, z, voxels_per_lenslet, cut, store)
    if path is not None:
        found = psffile.read_if_there(path, parameters)
        if found is not None:
            return found
    stored, scales = [], []
    for number, images in enumerate(_simulated(camera, z, voxels_per_lenslet, cut)):
        values, scale = _packed(images, store)
        stored.append(values)
        scales.append(scale)
        if progress is not None:
            progress(number + 1, len(z))
    n = round(camera.pixels_per_lenslet)
    made = PointImages(
        parameters, z, voxels_per_lenslet, n, tuple(stored), np.array(scales, np.float64)
    )
    if path is not None:
        psffile.write(path, made)
    return made


def described(
    camera: Microscope, planes: Vector, voxels: int, cut: float, store: str
) -> dict[str, Any]:
    """Everything that point images depend on, by the names of the camera."""
    mla = camera.mla
    return {
        "magnification": camera.magnification,
        "na": camera.na,
        "medium_index": camera.medium_index,
        "wavelength": camera.wavelength,
        "cover": None if camera.cover is None else asdict(camera.cover),
        "lenslet_pitch": mla.pitch,
        "lenslet_focal_length": mla.f,
        "lenslet_diameter": mla.diameter,
        "lenslet_fill": mla.fill,
        "pixels_per_lenslet": round(camera.pixels_per_lenslet),
        "voxels_per_lenslet": voxels,
        "planes": tuple(float(one) for one in planes),
        "cut": float(cut),
        "store": store,
        "precision": camera.device.precision,
    }


def _checked(camera: Any, planes: Any, voxels: Any, cut: float, store: str) -> Vector:
    """The planes as numbers, after the checks."""
    if not isinstance(camera, Microscope):
        raise TypeError(f"Point images are of a Microscope, not of {type(camera).__name__}.")
    if camera.mla.lattice != "square" or camera.mla.rotation != 0:
        raise ValueError(
            f"Point images repeat on a square lattice along the axes, not on one that is "
            f"{camera.mla.lattice} and turned by {camera.mla.rotation:g} rad: rectify the frame."
        )
    if abs(camera.pixels_per_lenslet - round(camera.pixels_per_lenslet)) > 1e-9:
        raise ValueError(
            f"A lenslet has {camera.pixels_per_lenslet:g} pixels: rectify the frame to a whole "
            f"number, such as {math.ceil(camera.pixels_per_lenslet)}."
        )
    z = np.asarray(planes, np.float64)
    if z.ndim != 1 or z.size == 0 or not np.isfinite(z).all() or np.unique(z).size != z.size:
        raise ValueError(f"planes are different finite numbers of metres, not {planes!r}.")
    if isinstance(voxels, bool) or voxels != int(voxels) or voxels < 1:
        raise ValueError(f"voxels_per_lenslet is a whole number from 1 on, not {voxels!r}.")
    if not 0 < cut < 0.5:
        raise ValueError(f"cut is a share of the light between 0 and 0.5, not {cut!r}.")
    if store not in ("float32", "float16"):
        raise ValueError(f"store is 'float32' or 'float16', not {store!r}.")
    return z


def _simulated(camera: Microscope, planes: Vector, voxels: int, cut: float) -> Iterator[Vector]:
    """The different images of each plane, float64, cut to their light."""
    phases = unique_phases(voxels)
    places = (np.array(phases) - (voxels - 1) / 2) / voxels * camera.mla.pitch
    for z in planes:
        across = _lenslets_across(camera, float(z))
        whole = _with_lenslets(camera, across)
        positions = [(x / camera.magnification, y / camera.magnification, z) for y, x in places]
        images = _energies(whole, PointSources(positions))
        yield _cut(_symmetric(images, phases, voxels), round(camera.pixels_per_lenslet), cut)


def _lenslets_across(camera: Microscope, z: float) -> int:
    """Odd number of lenslets of a window that holds the light of a plane, quick to transform."""
    blur = camera.objective.blur(z) / camera.mla.pitch
    count = max(LEAST, 2 * (math.ceil(blur) + MARGIN) + 1)
    while smooth_length(count) != count:
        count += 2
    return count


def _with_lenslets(camera: Microscope, count: int) -> Microscope:
    """The same optics before another number of lenslets, centred."""
    mla = MicrolensArray(
        camera.mla.pitch, camera.mla.f, count=count, fill=camera.mla.fill,  # type: ignore[arg-type]
        diameter=camera.mla.diameter,
    )  # fmt: skip
    grid = geometry.sensor_grid(mla, camera.pixels_per_lenslet)
    return replace(camera, mla=mla, grid=grid)


def _energies(camera: Microscope, points: PointSources) -> Vector:
    """Energy on the pixels of each point alone, shape (points, ny, nx), float64."""
    step, out = camera.batch(camera.grid), []
    for start in range(0, len(points), step):
        some = PointSources(points.positions[start : start + step])
        fields = camera.sensor_fields(some, camera.grid)
        out.append(fields.intensity().to_numpy().astype(np.float64))
    return np.concatenate(out)


def _symmetric(images: Vector, phases: list[tuple[int, int]], voxels: int) -> Vector:
    """Images of voxels on a mirror line, made equal to their own mirror image to the last bit."""
    middle = (voxels - 1) / 2
    for image, (a, b) in zip(images, phases, strict=True):
        if a == middle:
            image[:] = (image + image[::-1]) / 2
        if b == middle:
            image[:] = (image + image[:, ::-1]) / 2
        if a == b:
            image[:] = (image + image.T) / 2
    return images


def _cut(images: Vector, n: int, cut: float) -> Vector:
    """The fewest lenslets about the middle one that leave out no more than a share of any image."""
    across = images.shape[1] // n
    middle = across // 2
    cells = images.reshape(len(images), across, n, across, n).sum(axis=(2, 4))
    for r in range(middle + 1):
        inside = cells[:, middle - r : middle + r + 1, middle - r : middle + r + 1]
        if (inside.sum(axis=(1, 2)) >= 1 - cut).all():
            ends = slice((middle - r) * n, (middle + r + 1) * n)
            return images[:, ends, ends]
    return images


def _packed(images: Vector, store: str) -> tuple[Vector, float]:
    """Images as they are stored, and their scale."""
    if store == "float32":
        return np.ascontiguousarray(images, np.float32), 1.0
    scale = float(images.max())
    return np.ascontiguousarray(images / scale, np.float16), scale
