"""Point images of a light-field microscope, one per plane and voxel position in a lenslet.

The lenslet lattice is periodic: a volume with v x v voxels per lenslet has v^2 point images in each
plane (Broxton et al. 2013, section 3.1). By the mirror symmetries of the square lattice, x -> -x,
y -> -y and x <-> y, about v^2/8 of them are simulated and stored. Each plane is cropped to the
lenslets that contain its light. The unit cells of hexagonal arrays, and of arrays with several
kinds of lenslets, are larger (cells.py). Aberrations of the pupil break some or all mirrors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.objective import check_positions
from clplen.cameras.optics.objective_camera import ObjectiveCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.checks import is_finite, positive_integer, real_array, require
from clplen.compute.fft.lines import smooth_length
from clplen.compute.memory import free_memory
from clplen.files import PathLike, check_space
from clplen.microscopy.model import point_image_files
from clplen.microscopy.model.cells import Cell, Pair, cell_of
from clplen.microscopy.model.images import PointImages
from clplen.progress import notebook_bar
from clplen.wave.coherence.averaging import Progress
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid

Vector = np.ndarray[Any, Any]
Store = Literal["float32", "float16"]

# The window width samples the pupil. Compared with a window three times as wide, these margins
# change an image by 1e-3 to 3e-3 of its peak (6e-3 with apodisation -1/2), half of them by 1e-2.
MARGIN_LENSLETS = 12  # simulated around the geometrical blur
MIN_LENSLETS = 35  # simulated across
_MAX_SAMPLED_PLANES = 64  # planes whose sizes are interpolated to estimate the memory


@notebook_bar("point images")
def point_images(
    camera: Microscope,
    planes: Sequence[float] | Vector,
    *,
    voxels_per_lenslet: int = 5,
    binning: int = 1,
    sensor_pixels: float | None = None,
    cut: float = 2e-3,
    store: Store = "float32",
    path: PathLike | None = None,
    progress: Progress | None = None,
    notes: dict[str, float] | None = None,
) -> PointImages:
    """Simulate the point images of a microscope, or read them from a file.

    Voxel (sy, sx) of a lenslet is ((s - (v - 1)/2) p/(v M)) away from the point conjugate to the
    lenslet's centre. The number of pixels per lenslet is an integer, because the images would
    otherwise differ from lenslet to lenslet. For a frame with a rotated lattice or a fractional
    pitch, rectify the frame (`preparation`), or interpolate the images to its pixels
    (`FrameProjector`).

    A hexagonal array, or an array of several focal lengths, repeats in cells of several lenslets
    (`PointImages.cell`), which replace the lenslets of a square array. The sensor is in the focal
    plane of the first focal length.

    A pixel of the camera samples the intensity at its centre. If the pixels of the sensor are too
    large for this, give the camera pixels that are b times finer. ``binning`` then sums b x b of
    them, as a pixel of the sensor integrates over its area.

    Parameters
    ----------
    camera : Microscope
        Camera with thin lenslets on a lattice without rotation and offset, and an integer number of
        pixels per lenslet. Its number of lenslets does not matter.
    planes : sequence of float
        z of the planes in metres from the native plane, farther positive, rising: plane 0 is the
        nearest to the objective.
    voxels_per_lenslet : int
        Number v of voxels per lenslet along an axis, at least 1.
    binning : int
        Number b of camera pixels along a side of a sensor pixel; a lenslet has
        pixels_per_lenslet/b sensor pixels.
    sensor_pixels : float, optional
        Number of sensor pixels per lenslet, possibly fractional, over whose area the images
        integrate. The pixels of the images are then 1.5 to 2 times finer, for `FrameProjector`.
        None: they are the pixels of the sensor.
    cut : float
        Share of a voxel's light on the sensor that may be lost by cropping.
    store : {"float32", "float16"}
        Type of the stored images. float16 halves the memory, with errors of 5e-4 of a value or 3e-8
        of the plane's maximum.
    path : path-like, optional
        HDF5 file; read if it exists and matches, else written.
    progress : callable, optional
        Callback ``progress(done, total)`` in images, called after each batch of them.
    notes : dict, optional
        `PointImages.notes` of simulated images.

    Returns
    -------
    PointImages
        Point images of every plane and voxel of a lenslet.

    Raises
    ------
    ValueError
        If the lattice is rotated or offset, lenslets are not thin, the number of pixels is
        fractional, not a multiple of ``binning`` or less than ``sensor_pixels``, planes do not
        rise, are infinite or more than 0.1 m away, a share is outside 0 to 0.5, or the file has
        other parameters.
    TypeError
        If the camera is not a microscope, or planes are not real numbers.
    FormatError
        If the file is damaged.
    OSError
        If the file cannot be written, or the disk is full; checked before the simulation, up to the
        exact size.
    DeviceError
        If the fields of the farthest plane do not fit the device.
    MemoryError
        If the images of all planes, and their file, do not fit the free memory.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> images
    <PointImages of 2 planes, 3 x 3 voxels and 11 x 11 pixels a lenslet, ... MiB>
    >>> f"voxels of {images.side * 1e6:.0f} um"
    'voxels of 2 um'
    """
    z = checked_planes(
        camera, planes, voxels_per_lenslet, binning, cut, store, sensor_pixels=sensor_pixels
    )
    voxels_per_lenslet, binning = int(voxels_per_lenslet), int(binning)
    parameters = parameters_of(
        camera, z, voxels_per_lenslet, binning, cut, store, sensor_pixels=sensor_pixels
    )
    saved = point_image_files.read_matching(path, parameters)
    if isinstance(saved, PointImages):
        return saved
    cell = _cell(camera, voxels_per_lenslet, binning)
    _check_memory(camera, z, cell, binning)
    _check_space(camera, z, cell, cut, store, path)
    stored, scales = [], []
    for images in _simulated(camera, z, cell, binning, sensor_pixels, cut, progress):
        values, scale = _packed(images, store)
        stored.append(values)
        scales.append(scale)
    camera.device.free_spare()  # fields take more memory than all later uses of the images
    n = round(camera.pixels_per_lenslet) // binning
    result = PointImages(
        parameters, z, voxels_per_lenslet, n, tuple(stored), np.array(scales, np.float64),
        dict(notes or {}),
    )  # fmt: skip
    if path is not None:
        point_image_files.write_point_images(path, result)
    return result


def _cell(camera: Microscope, voxels: int, binning: int) -> Cell:
    """Return the unit cell of the camera's array."""
    mla, n = camera.mla, round(camera.pixels_per_lenslet) // binning
    cell = cell_of(mla.lattice, len(mla.focal_lengths), voxels=voxels, pixels=n)
    return cell if camera.pupil is None else cell.with_aberrations(camera.pupil.orders)


def lenslets_across(camera: Microscope, z: float) -> int:
    """Return the number of lenslets across the geometrical blur of a point."""
    return 2 * math.ceil(camera.objective.blur(z) / camera.mla.pitch) + 1


def parameters_of(
    camera: Microscope,
    planes: Vector,
    voxels: int,
    binning: int,
    cut: float,
    store: str,
    *,
    sensor_pixels: float | None = None,
) -> dict[str, Any]:
    """Return all parameters that determine the point images, by their names in the camera."""
    mla = camera.mla
    lattice: dict[str, Any] = {}
    if mla.lattice != "square" or len(mla.focal_lengths) > 1:
        lattice = {"lattice": mla.lattice, "lenslet_focal_lengths": mla.focal_lengths}
    if sensor_pixels is not None:
        lattice["sensor_pixels"] = float(sensor_pixels)
    return {
        **objective_parameters(camera),
        "pupil": None if camera.pupil is None else {str(j): c for j, c in camera.pupil.terms},
        "lenslet_pitch": mla.pitch,
        "lenslet_focal_length": mla.focal_length,
        "lenslet_diameter": mla.diameter,
        "lenslet_fill": mla.fill,
        "pixels_per_lenslet": round(camera.pixels_per_lenslet) // binning,
        "binning": int(binning),
        "voxels_per_lenslet": voxels,
        "planes": tuple(float(z) for z in planes),
        "cut": float(cut),
        "store": store,
        "precision": camera.device.precision,
        **lattice,
    }


def objective_parameters(camera: ObjectiveCamera) -> dict[str, Any]:
    """Return the parameters of the objective that determine the point images."""
    return {
        "magnification": camera.magnification,
        "na": camera.na,
        "medium_index": camera.medium_index,
        "wavelength": camera.wavelength,
        "cover": None if camera.cover is None else asdict(camera.cover),
        "apodisation": camera.apodisation,
    }


def checked_planes(
    camera: Any,
    planes: Any,
    voxels: Any,
    binning: Any,
    cut: float,
    store: str,
    *,
    sensor_pixels: Any = None,
) -> Vector:
    """Check the arguments of `point_images`; return z of the planes in metres."""
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    if camera.pixels is not None:
        raise ValueError(
            "Point images need a camera whose pixels sample the intensity at their centres, got "
            "integrating pixels: leave out pixels=, give finer pixels, and sum them by binning="
        )
    _check_lattice(camera)
    binning = positive_integer(binning, "binning")
    if round(camera.pixels_per_lenslet) % binning:
        raise ValueError(
            f"pixels_per_lenslet must be a multiple of binning = {binning}, got "
            f"{camera.pixels_per_lenslet:g}."
        )
    n = round(camera.pixels_per_lenslet) // binning
    if sensor_pixels is not None and not (is_finite(sensor_pixels) and 1 <= sensor_pixels <= n):
        raise ValueError(
            f"sensor_pixels must be from 1 to the {n} pixels per lenslet of the point images, got "
            f"{sensor_pixels!r}."
        )
    z = rising_planes(planes)
    positive_integer(voxels, "voxels_per_lenslet")
    check_cut(cut)
    if store not in ("float32", "float16"):
        raise ValueError(f"store must be 'float32' or 'float16', got {store!r}.")
    return z


def rising_planes(planes: Any) -> Vector:
    """Return z of the planes in metres, float64; raise ValueError unless they rise."""
    z = real_array(planes, "planes", np.float64)
    if z.ndim != 1 or z.size == 0 or not np.isfinite(z).all() or np.unique(z).size != z.size:
        raise ValueError(f"planes must be different finite numbers in metres, got {planes!r}.")
    check_positions(z)
    if (np.diff(z) < 0).any():
        raise ValueError(
            "planes must rise, with plane 0 nearest to the objective: give sorted(planes)."
        )
    return z


def check_cut(cut: Any) -> None:
    """Raise ValueError unless ``cut`` is a share of light that may be cropped."""
    if not (is_finite(cut) and 0 < cut < 0.5):
        raise ValueError(f"cut must be a share of the light between 0 and 0.5, got {cut!r}.")


def _check_lattice(camera: Microscope) -> None:
    """Raise ValueError if the lenslets are not periodic on the pixels."""
    mla = camera.mla
    if mla.rotation != 0 or mla.offset != (0, 0):
        raise ValueError(
            f"Point images need an array without rotation and offset, got {mla.rotation:g} rad and "
            f"(y, x) = ({mla.offset[0]:g}, {mla.offset[1]:g}) m: rectify the frame, or use "
            "FrameProjector with its lattice, and give the camera an array without them."
        )
    if not mla.is_thin:
        raise ValueError(
            "Point images need thin lenslets: give an array of focal lengths, without surface, map "
            "and clear gaps."
        )
    if abs(camera.pixels_per_lenslet - round(camera.pixels_per_lenslet)) > 1e-9:
        raise ValueError(
            f"pixels_per_lenslet must be an integer, got {camera.pixels_per_lenslet:g}: rectify "
            f"the frame to an integer, such as {math.ceil(camera.pixels_per_lenslet)}."
        )


def _check_memory(camera: Microscope, planes: Vector, cell: Cell, binning: int) -> None:
    """Raise DeviceError if the plane with the largest window does not fit the device."""
    z = float(planes[camera.objective.blur(planes).argmax()])
    pixels = math.prod(_window(camera, z, cell)) * math.prod(cell.pixels)
    images = cell.count
    camera.device.require_memory(
        4 * pixels * binning**2 * camera.device.complex.itemsize
        + 2 * images * pixels * np.dtype(float).itemsize,
        f"The plane at z = {z * 1e6:g} um",
    )


def _check_space(
    camera: Microscope, planes: Vector, cell: Cell, cut: float, store: Store, path: PathLike | None
) -> None:
    """Raise an error if the images do not fit host or disk; files are built in memory first."""
    images = cell.count
    nbytes = images * np.dtype(store).itemsize * _pixels(camera, planes, cell, cut)
    file = 0 if path is None else point_image_files.MIN_COMPRESSION[store] * nbytes
    free = free_memory()
    if nbytes + file > free:
        raise MemoryError(
            f"{images} images of each of {len(planes)} planes need at least {nbytes + file:,.0f} "
            f"bytes of memory, {free:,} are free: take fewer planes or voxels"
        )
    if path is not None:
        check_space(path, int(file))


def _pixels(camera: Microscope, planes: Vector, cell: Cell, cut: float) -> float:
    """Estimate the pixels of an image per plane, summed over planes, by rays.

    It is a lower bound: diffraction and the positions of voxels widen the images.
    """
    s = np.linspace(-1, 1, 101) * camera.na
    rays = np.hypot(s[:, None], s)
    inside = rays <= camera.na
    along = np.maximum(abs(s)[:, None], abs(s))[inside] / np.maximum(rays[inside], 1e-9)
    rays = rays[inside]
    light = (1 - (rays / camera.medium_index) ** 2) ** camera.apodisation
    count = _MAX_SAMPLED_PLANES
    sampled = planes[np.unique(np.linspace(0, len(planes) - 1, count).astype(int))]
    radii = []
    for z in sampled:
        reach = along * np.abs(camera.objective.landing(rays, z))
        order = reach.argsort()
        encircled = np.cumsum(light[order])
        radii.append(reach[order][np.searchsorted(encircled, (1 - cut) * encircled[-1])])
    reach = np.interp(planes, sampled, radii) / camera.mla.pitch
    height, width = (2 * np.floor(reach / size) + 1 for size in cell.size)
    return float((height * width).sum()) * math.prod(cell.pixels)


def _simulated(
    camera: Microscope,
    planes: Vector,
    cell: Cell,
    binning: int,
    sensor_pixels: float | None,
    cut: float,
    progress: Progress | None,
) -> Iterator[Vector]:
    """Yield the different images of each plane, float64, cropped to their light."""
    phases, pitch = cell.phases(), camera.mla.pitch
    voxels, size = np.array(cell.voxels), np.array(cell.size)
    offsets = (np.array(phases) - (voxels - 1) / 2) / voxels * (size * pitch)
    for number, z in enumerate(planes):
        window = _with_cells(camera, _window(camera, float(z), cell), cell, binning)
        box = None if sensor_pixels is None else pitch / sensor_pixels
        positions = [(x / camera.magnification, y / camera.magnification, z) for y, x in offsets]
        batches = []
        for energies in _energies(window, PointSources(positions), binning, box):
            batches.append(energies)
            if progress is not None:
                done = number * len(phases) + sum(map(len, batches))
                progress(done, len(planes) * len(phases))
        images = np.concatenate(batches)
        rows, columns = light_in(_symmetric(images, phases, cell), cell, cut)
        yield images[:, rows, columns]


def _window(camera: Microscope, z: float, cell: Cell) -> Pair:
    """Return the odd numbers of cells of a window for a plane, suited to fast transforms."""
    lenslets = max(MIN_LENSLETS, lenslets_across(camera, z) + 2 * MARGIN_LENSLETS)
    rows, columns = (_odd_smooth_length(lenslets / size) for size in cell.size)
    return rows, columns


def _odd_smooth_length(minimum: float) -> int:
    """Return the next odd number without large prime factors."""
    count = math.ceil(minimum - 1e-9)
    count += 1 - count % 2
    while smooth_length(count) != count:
        count += 2
    return count


def _with_cells(camera: Microscope, count: Pair, cell: Cell, binning: int) -> Microscope:
    """Return the camera with another number of cells, centred on a lenslet of the first kind."""
    n, step = np.array(count) * cell.pixels * binning, np.array(cell.size) * camera.mla.pitch
    pitch = step / (np.array(cell.pixels) * binning)
    origin = np.where(n % 2 == 0, pitch / 2, 0.0)
    grid = Grid(
        (int(n[0]), int(n[1])),
        (float(pitch[0]), float(pitch[1])),
        origin=(float(origin[0]), float(origin[1])),
    )
    return replace(camera, mla=_centred(camera.mla, count, cell), grid=grid)


def _centred(mla: MicrolensArray, count: Pair, cell: Cell) -> MicrolensArray:
    """Return an array of ``count`` cells with a lenslet of the first kind on the axis."""
    rows, columns = (k * n for k, n in zip(count, cell.lenslets, strict=True))
    if cell.lenslets != (1, 1):
        rows = 4 * math.ceil((rows + 1) / 4) + 1  # the middle row is an even one
        columns = columns + 2 + (columns + 1) % 2
    while True:
        array = array_of(mla, (rows, columns))
        if array.types()[rows // 2, columns // 2] == 0:
            return array
        columns += 2


def array_of(mla: MicrolensArray, count: int | Pair) -> MicrolensArray:
    """Return a centred array of ``count`` such lenslets, without rotation and offset."""
    return MicrolensArray(
        mla.pitch, mla.focal_lengths, count=count, fill=mla.fill,  # type: ignore[arg-type]
        lattice=mla.lattice, diameter=mla.diameter,  # type: ignore[arg-type]
    )  # fmt: skip


def _energies(
    camera: Microscope, points: PointSources, binning: int, box: float | None
) -> Iterator[Vector]:
    """Yield the energies of batches of points, binned b x b, (batch, ny/b, nx/b), float64.

    With ``box`` they are means over pixels of that side in metres, with unchanged centres.
    """
    for batch in camera.batches(points, camera.grid):
        fine = camera.sensor_fields(batch, camera.grid).intensity().to_numpy()
        if box is None:
            yield binned(fine, binning)
            continue
        for axis in (1, 2):
            fine = _averaged(fine, axis, binning, box / camera.grid.pitch[axis - 1])
        yield fine


def binned(pictures: Vector, binning: int) -> Vector:
    """Sum b x b pixels of pictures (n, ny, nx), float64."""
    count, ny, nx = pictures.shape
    cells = pictures.reshape(count, ny // binning, binning, nx // binning, binning)
    return np.asarray(cells.sum(axis=(2, 4), dtype=np.float64))


def _averaged(values: Vector, axis: int, binning: int, width: float) -> Vector:
    """Average a periodic axis over ``width`` samples; return every b-th mean times b, float64.

    The Fourier series through the samples is averaged: exact if they resolve the intensity.
    """
    n = values.shape[axis]
    f = np.fft.rfftfreq(n)
    factors = binning * np.sinc(f * width) * np.exp(2j * np.pi * f * (binning - 1) / 2)
    shape = [1, 1, 1]
    shape[axis] = len(f)
    spectra = np.fft.rfft(values, axis=axis) * factors.reshape(shape)
    every = [slice(None)] * 3
    every[axis] = slice(None, None, binning)
    return np.asarray(np.fft.irfft(spectra, n, axis=axis)[tuple(every)])


def _symmetric(images: Vector, phases: list[Pair], cell: Cell) -> Vector:
    """Make images of voxels on mirror lines exactly symmetric, in place."""
    (vy, vx) = cell.voxels
    for image, (a, b) in zip(images, phases, strict=True):
        if cell.mirror_y and a == (vy - 1) / 2:
            image[:] = (image + image[::-1]) / 2
        if cell.mirror_x and b == (vx - 1) / 2:
            image[:] = (image + image[:, ::-1]) / 2
        if cell.transposed and a == b:
            image[:] = (image + image.T) / 2
    return images


def light_in(images: Vector, cell: Cell, cut: float) -> tuple[slice, slice]:
    """Return the rows and columns of the smallest window that loses at most ``cut`` of any image.

    The share refers to the light on the sensor, without losses between lenslets.
    """
    (ny, nx), (height, width) = cell.pixels, cell.size
    rows, columns = images.shape[1] // ny, images.shape[2] // nx
    cells = images.reshape(len(images), rows, ny, columns, nx).sum(axis=(2, 4))
    minimum = (1 - cut) * cells.sum(axis=(1, 2))
    for lenslets in range(max(rows, columns) * max(cell.lenslets)):
        ry, rx = (math.ceil((lenslets + 0.5) / size - 0.5 - 1e-9) for size in (height, width))
        if 2 * ry + 1 >= rows and 2 * rx + 1 >= columns:
            break
        top, left = max(rows // 2 - ry, 0), max(columns // 2 - rx, 0)
        inside = cells[:, top : rows - top, left : columns - left]
        if (inside.sum(axis=(1, 2)) >= minimum).all():
            return slice(top * ny, (rows - top) * ny), slice(left * nx, (columns - left) * nx)
    return slice(None), slice(None)


def _packed(images: Vector, store: str) -> tuple[Vector, float]:
    """Return images in the stored type, and their scale."""
    if store == "float32":
        return np.ascontiguousarray(images, np.float32), 1.0
    scale = float(images.max())
    return np.ascontiguousarray(images / scale, np.float16), scale
