"""Point images of a light-field microscope: one for each plane and place of a voxel in a lenslet.

The lenslet lattice repeats, so that a volume with v x v voxels a lenslet has v^2 point images in
each plane (Broxton et al. 2013, section 3.1). Mirror images of the square lattice, x -> -x,
y -> -y and x <-> y, leave about v^2/8 of them to be simulated and stored. Each plane is cut to the
lenslets that hold its light. Hexagonal arrays and those of several kinds of lenslets repeat in
cells of some lenslets (cells.py). A pupil with aberrations has fewer mirrors, or none.
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

# The window samples the pupil: with these margins an image departs from that of a window three
# times as wide by 1e-3 to 3e-3 of its peak (up to 6e-3 with apodisation -1/2), and half as wide by
# 1e-2.
MARGIN = 12  # lenslets that are simulated around the geometrical blur
LEAST = 35  # lenslets across that are simulated
_LOOKED_AT = 64  # planes by which the room for all of them is told


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

    Voxel (sy, sx) of a lenslet lies at ((s - (v - 1)/2) p/(v M)) from the point that the lenslet's
    centre images. A lenslet has a whole number of pixels. A frame whose lattice is turned or has a
    fractional pitch is rectified first (`preparation`), or these images are brought onto its pixels
    (`FrameProjector`), because images that differ from lenslet to lenslet would be as many as there
    are lenslets.

    A hexagonal array, or one of several focal lengths, repeats in cells of some lenslets
    (`PointImages.cell`), which are then what a lenslet is of a square array. The sensor lies in the
    first focal length.

    A pixel of the camera has the intensity at its centre. Where the sensor's own pixels are too
    large for that, the camera is given pixels that sample the light, b times finer, and ``binning``
    adds up those of a pixel of the sensor, which integrates over its area.

    Parameters
    ----------
    camera : Microscope
        Thin lenslets on a lattice that is not turned and not moved, a whole number of pixels a
        lenslet. Its count of lenslets does not matter.
    planes : sequence of float
        Their z in metres from the native plane, farther positive, rising: plane 0 is the nearest to
        the objective.
    voxels_per_lenslet : int
        Number v along an axis, from 1 on.
    binning : int
        Number b: the sensor has pixels of b x b of the camera's, pixels_per_lenslet/b of them a
        lenslet.
    sensor_pixels : float, optional
        Pixels of the sensor a lenslet, over whose area its pixels integrate; it may be fractional.
        The images' own pixels are then finer, some 1.5 to 2 times, for `FrameProjector`. None: they
        are those of the sensor.
    cut : float
        Share of a voxel's light on the sensor that may be left out beyond the lenslets that are
        kept.
    store : {"float32", "float16"}
        float16 halves the memory and is right to 5e-4 of a value, or 3e-8 of the plane's largest.
    path : path-like, optional
        An HDF5 file: read if it is there and fits, else written.
    progress : callable, optional
        Called as ``progress(done, total)`` after each batch of images, of all that are simulated.
    notes : dict, optional
        `PointImages.notes`, kept with those that are simulated.

    Returns
    -------
    PointImages
        Of every plane and voxel of a lenslet.

    Raises
    ------
    ValueError
        For a lattice that is turned or moved, lenslets that are not thin, a number of pixels that
        is fractional or not divided by ``binning``, fewer pixels than ``sensor_pixels``, planes
        that do not rise or are infinite or more than 0.1 m away, a share outside 0 to 0.5, or a
        file of other parameters.
    TypeError
        If the camera is no microscope, or planes are no real numbers.
    FormatError
        If the file is damaged.
    OSError
        If the file cannot be written, or the disk has no room for it: found out before anything is
        simulated, but for the exact size.
    DeviceError
        If the fields of the farthest plane do not fit the device.
    MemoryError
        If the images of all planes, and the file that is made of them, do not fit the free memory.

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
    parameters = described(
        camera, z, voxels_per_lenslet, binning, cut, store, sensor_pixels=sensor_pixels
    )
    found = point_image_files.read_matching(path, parameters)
    if isinstance(found, PointImages):
        return found
    cell = _cell(camera, voxels_per_lenslet, binning)
    _check_memory(camera, z, cell, binning)
    _check_room(camera, z, cell, cut, store, path)
    stored, scales = [], []
    for one in _simulated(camera, z, cell, binning, sensor_pixels, cut, progress):
        values, scale = _packed(one, store)
        stored.append(values)
        scales.append(scale)
    camera.device.free_spare()  # fields are larger than anything that is made of the images
    n = round(camera.pixels_per_lenslet) // binning
    made = PointImages(
        parameters, z, voxels_per_lenslet, n, tuple(stored), np.array(scales, np.float64),
        dict(notes or {}),
    )  # fmt: skip
    if path is not None:
        point_image_files.write_point_images(path, made)
    return made


def _cell(camera: Microscope, voxels: int, binning: int) -> Cell:
    """What repeats of the camera's array."""
    mla, n = camera.mla, round(camera.pixels_per_lenslet) // binning
    cell = cell_of(mla.lattice, len(mla.focal_lengths), voxels=voxels, pixels=n)
    return cell if camera.pupil is None else cell.behind(camera.pupil.orders)


def lenslets_across(camera: Microscope, z: float) -> int:
    """Lenslets along an axis that the image of a point covers, by rays."""
    return 2 * math.ceil(camera.objective.blur(z) / camera.mla.pitch) + 1


def described(
    camera: Microscope,
    planes: Vector,
    voxels: int,
    binning: int,
    cut: float,
    store: str,
    *,
    sensor_pixels: float | None = None,
) -> dict[str, Any]:
    """Everything that point images depend on, by the names of the camera."""
    mla = camera.mla
    of_lattice: dict[str, Any] = {}
    if mla.lattice != "square" or len(mla.focal_lengths) > 1:
        of_lattice = {"lattice": mla.lattice, "lenslet_focal_lengths": mla.focal_lengths}
    if sensor_pixels is not None:
        of_lattice["sensor_pixels"] = float(sensor_pixels)
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
        "planes": tuple(float(one) for one in planes),
        "cut": float(cut),
        "store": store,
        "precision": camera.device.precision,
        **of_lattice,
    }


def objective_parameters(camera: ObjectiveCamera) -> dict[str, Any]:
    """What point images depend on of the objective, by the names of the camera."""
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
    """The planes as numbers, after the checks of `point_images`."""
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    if camera.pixels is not None:
        raise ValueError(
            "Point images sum the intensities in the middles of pixels, and this camera's pixels "
            "integrate: leave pixels= out, give pixels that sample the light, and binning="
        )
    _check_lattice(camera)
    binning = positive_integer(binning, "binning")
    if round(camera.pixels_per_lenslet) % binning:
        raise ValueError(
            f"A lenslet has {camera.pixels_per_lenslet:g} pixels, which are not divided into "
            f"pixels of the sensor of {binning} x {binning}: give the camera a multiple of them."
        )
    n = round(camera.pixels_per_lenslet) // binning
    if sensor_pixels is not None and not (is_finite(sensor_pixels) and 1 <= sensor_pixels <= n):
        raise ValueError(
            f"sensor_pixels are those of a lenslet, from 1 to the {n} of the point images, which "
            f"are no coarser, not {sensor_pixels!r}."
        )
    z = rising_planes(planes)
    positive_integer(voxels, "voxels_per_lenslet")
    check_cut(cut)
    if store not in ("float32", "float16"):
        raise ValueError(f"store is 'float32' or 'float16', not {store!r}.")
    return z


def rising_planes(planes: Any) -> Vector:
    """Return z of planes in metres, float64; refuse those that do not rise."""
    z = real_array(planes, "planes", np.float64)
    if z.ndim != 1 or z.size == 0 or not np.isfinite(z).all() or np.unique(z).size != z.size:
        raise ValueError(f"planes are different finite numbers of metres, not {planes!r}.")
    check_positions(z)
    if (np.diff(z) < 0).any():
        raise ValueError(
            "planes rise, so that plane 0 is the nearest to the objective: give sorted(planes)."
        )
    return z


def check_cut(cut: Any) -> None:
    """Refuse what is no share of light that may be left out."""
    if not (is_finite(cut) and 0 < cut < 0.5):
        raise ValueError(f"cut is a share of the light between 0 and 0.5, not {cut!r}.")


def _check_lattice(camera: Microscope) -> None:
    """Refuse lenslets that do not repeat on the pixels."""
    mla = camera.mla
    if mla.rotation != 0 or mla.offset != (0, 0):
        raise ValueError(
            f"Point images are those of an array along the axes, not of one that is turned by "
            f"{mla.rotation:g} rad and moved by (y, x) = ({mla.offset[0]:g}, {mla.offset[1]:g}) m: "
            "rectify the frame, or use FrameProjector with its lattice, and give the camera an "
            "array without them."
        )
    if not mla.is_thin:
        raise ValueError(
            "Point images are those of thin lenslets: give an array of focal lengths, without "
            "surface, map and clear gaps."
        )
    if abs(camera.pixels_per_lenslet - round(camera.pixels_per_lenslet)) > 1e-9:
        raise ValueError(
            f"A lenslet has {camera.pixels_per_lenslet:g} pixels: rectify the frame to a whole "
            f"number, such as {math.ceil(camera.pixels_per_lenslet)}."
        )


def _check_memory(camera: Microscope, planes: Vector, cell: Cell, binning: int) -> None:
    """Refuse the plane whose window is the largest, before any is simulated."""
    z = float(planes[camera.objective.blur(planes).argmax()])
    pixels = math.prod(_window(camera, z, cell)) * math.prod(cell.pixels)
    images = cell.count
    camera.device.require_memory(
        4 * pixels * binning**2 * camera.device.complex.itemsize
        + 2 * images * pixels * np.dtype(float).itemsize,
        f"The plane at z = {z * 1e6:g} um",
    )


def _check_room(
    camera: Microscope, planes: Vector, cell: Cell, cut: float, store: Store, path: PathLike | None
) -> None:
    """Refuse more images than fit host or disk; a file is made in memory first."""
    images = cell.count
    least = images * np.dtype(store).itemsize * _pixels(camera, planes, cell, cut)
    file = 0 if path is None else point_image_files.DENSEST[store] * least
    free = free_memory()
    if least + file > free:
        raise MemoryError(
            f"{images} images of each of {len(planes)} planes take at least {least + file:,.0f} "
            f"bytes, of which {free:,} are free: take fewer planes or voxels"
        )
    if path is not None:
        check_space(path, int(file))


def _pixels(camera: Microscope, planes: Vector, cell: Cell, cut: float) -> float:
    """Pixels of one image of each plane together, by the rays of all but ``cut`` of the light.

    Diffraction and the places of voxels make images wider.
    """
    s = np.linspace(-1, 1, 101) * camera.na
    rays = np.hypot(s[:, None], s)
    inside = rays <= camera.na
    along = np.maximum(abs(s)[:, None], abs(s))[inside] / np.maximum(rays[inside], 1e-9)
    rays = rays[inside]
    light = (1 - (rays / camera.medium_index) ** 2) ** camera.apodisation
    some = planes[np.unique(np.linspace(0, len(planes) - 1, _LOOKED_AT).astype(int))]
    farthest = []
    for z in some:
        reach = along * np.abs(camera.objective.landing(rays, z))
        order = reach.argsort()
        found = np.cumsum(light[order])
        farthest.append(reach[order][np.searchsorted(found, (1 - cut) * found[-1])])
    reach = np.interp(planes, some, farthest) / camera.mla.pitch
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
    """The different images of each plane, float64, cut to their light."""
    phases, pitch = cell.phases(), camera.mla.pitch
    voxels, size = np.array(cell.voxels), np.array(cell.size)
    places = (np.array(phases) - (voxels - 1) / 2) / voxels * (size * pitch)
    for number, z in enumerate(planes):
        whole = _with_cells(camera, _window(camera, float(z), cell), cell, binning)
        box = None if sensor_pixels is None else pitch / sensor_pixels
        positions = [(x / camera.magnification, y / camera.magnification, z) for y, x in places]
        batches = []
        for some in _energies(whole, PointSources(positions), binning, box):
            batches.append(some)
            if progress is not None:
                done = number * len(phases) + sum(map(len, batches))
                progress(done, len(planes) * len(phases))
        images = np.concatenate(batches)
        rows, columns = light_in(_symmetric(images, phases, cell), cell, cut)
        yield images[:, rows, columns]


def _window(camera: Microscope, z: float, cell: Cell) -> Pair:
    """Odd numbers of cells of a window that holds the light of a plane, quick to transform."""
    lenslets = max(LEAST, lenslets_across(camera, z) + 2 * MARGIN)
    rows, columns = (_odd_and_quick(lenslets / size) for size in cell.size)
    return rows, columns


def _odd_and_quick(least: float) -> int:
    """The next odd number without large prime factors."""
    count = math.ceil(least - 1e-9)
    count += 1 - count % 2
    while smooth_length(count) != count:
        count += 2
    return count


def _with_cells(camera: Microscope, count: Pair, cell: Cell, binning: int) -> Microscope:
    """The same optics before another number of cells, centred on a lenslet of the first kind."""
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
    """An array that covers so many cells, with a lenslet of the first kind on the axis."""
    rows, columns = (k * n for k, n in zip(count, cell.lenslets, strict=True))
    if cell.lenslets != (1, 1):
        rows = 4 * math.ceil((rows + 1) / 4) + 1  # the middle row is an even one
        columns = columns + 2 + (columns + 1) % 2
    while True:
        made = array_of(mla, (rows, columns))
        if made.types()[rows // 2, columns // 2] == 0:
            return made
        columns += 2


def array_of(mla: MicrolensArray, count: int | Pair) -> MicrolensArray:
    """An array of so many of the same lenslets, along the axes and centred."""
    return MicrolensArray(
        mla.pitch, mla.focal_lengths, count=count, fill=mla.fill,  # type: ignore[arg-type]
        lattice=mla.lattice, diameter=mla.diameter,  # type: ignore[arg-type]
    )  # fmt: skip


def _energies(
    camera: Microscope, points: PointSources, binning: int, box: float | None
) -> Iterator[Vector]:
    """Energy on b x b pixels of some points after others, (some, ny/b, nx/b), float64.

    With ``box`` it is the mean over pixels of that side in metres, about the same centres.
    """
    for some in camera.batches(points, camera.grid):
        fine = camera.sensor_fields(some, camera.grid).intensity().to_numpy()
        if box is None:
            yield binned(fine, binning)
            continue
        for axis in (1, 2):
            fine = _averaged(fine, axis, binning, box / camera.grid.pitch[axis - 1])
        yield fine


def binned(pictures: Vector, binning: int) -> Vector:
    """Sums of b x b pixels of pictures (n, ny, nx), float64."""
    count, ny, nx = pictures.shape
    cells = pictures.reshape(count, ny // binning, binning, nx // binning, binning)
    return np.asarray(cells.sum(axis=(2, 4), dtype=np.float64))


def _averaged(values: Vector, axis: int, binning: int, width: float) -> Vector:
    """Every b-th mean over ``width`` samples of a periodic axis, times b; float64.

    Means of the Fourier series through the samples, exact where they sample the intensity.
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
    """Images of voxels on a mirror line, made equal to their own mirror image to the last bit."""
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
    """Return rows and columns of the fewest cells that hold all but ``cut`` of any image.

    The share is of what is on the sensor: opaque places between lenslets leave out more.
    """
    (ny, nx), (height, width) = cell.pixels, cell.size
    rows, columns = images.shape[1] // ny, images.shape[2] // nx
    cells = images.reshape(len(images), rows, ny, columns, nx).sum(axis=(2, 4))
    least = (1 - cut) * cells.sum(axis=(1, 2))
    for lenslets in range(max(rows, columns) * max(cell.lenslets)):
        ry, rx = (math.ceil((lenslets + 0.5) / size - 0.5 - 1e-9) for size in (height, width))
        if 2 * ry + 1 >= rows and 2 * rx + 1 >= columns:
            break
        top, left = max(rows // 2 - ry, 0), max(columns // 2 - rx, 0)
        inside = cells[:, top : rows - top, left : columns - left]
        if (inside.sum(axis=(1, 2)) >= least).all():
            return slice(top * ny, (rows - top) * ny), slice(left * nx, (columns - left) * nx)
    return slice(None), slice(None)


def _packed(images: Vector, store: str) -> tuple[Vector, float]:
    """Images as they are stored, and their scale."""
    if store == "float32":
        return np.ascontiguousarray(images, np.float32), 1.0
    scale = float(images.max())
    return np.ascontiguousarray(images / scale, np.float16), scale
