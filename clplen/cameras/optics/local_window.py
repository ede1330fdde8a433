"""Windows of single points: the light about a chief ray, from the pupil through the array.

A point is imaged at X on the array with a blur D abs(1 - beta) and rings of diffraction around it.
Its window holds these and a few more lenslets. The direction of the chief ray is included
analytically, so that a window off the axis needs no finer samples than a window on it. The field is
the integral over the pupil of kernels/cameras/local_window.cl. It is exact for small angles
(Fresnel; Goodman 2005, section 4.2) and at the image (Debye and Wolf; Stamnes 1986, chapter 12), by
stationary phase between. From the array to the sensor the angular spectrum is exact.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.wave_optics import WaveOptics, disc_table
from clplen.cameras.scenes.occluders import shadows
from clplen.compute.device import Device
from clplen.compute.fft.blocks import lanes_defines, run
from clplen.compute.fft.lines import Line, Separable, smooth_length
from clplen.wave.elements.rims import RIM, rim_weights
from clplen.wave.field.field import Grid

Values = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]

PERIOD_WINDOWS = 1.7  # period of the sum over the pupil, in windows
MAX_BATCH_BYTES = 2**26  # maximum bytes of windows that pass the camera together
ORDERS = 18.0  # diffraction orders of a lenslet's rim that samples resolve
TRANSITION = 0.18  # width of the rims' filter, in cycles a sample
BAND = 0.8  # fraction of the samples' band that these orders fill
RINGS = 20  # Airy radii of light around the geometrical blur
SAMPLED_RINGS = 30  # Airy radii for windows with the sensor's samples
NUMBERS = 18  # numbers of a point in kernels/cameras/local_window.cl
TABLE_SAMPLES = 163  # samples across the tables of a wavefront and of shadows
TABLE_REACH = 1.25  # half side of these tables in radii of the pupil, as in the kernel


@dataclass(frozen=True)
class WindowShape:
    """Sizes of windows that are computed together."""

    finer: int  # samples a pixel along each axis
    pitch: float  # pitch of the samples in metres: pixel pitch over ``finer``
    samples: int  # samples of the window along each axis, even
    period: int  # period of the integral over the pupil, in samples
    pupil: int  # samples of direction across the pupil
    guard: int  # samples at the rim of the window that light from outside may reach
    rim: tuple[float, float] | None  # filter of the lenslets, see `MicrolensArray.transmission`

    @property
    def sizes(self) -> tuple[float, ...]:
        """Sort key that groups windows of equal shape."""
        filters = self.rim or (0.0, 0.0)
        return (self.samples, self.period, self.pupil, self.finer, self.guard, *filters)

    def nbytes(self, device: Device) -> int:
        """Return bytes of one window: fields, the array, and the integral over the pupil."""
        samples = 4 * self.samples**2 + self.pupil**2 + self.pupil * self.samples
        return samples * device.complex.itemsize

    def batch(self, device: Device) -> int:
        """Return the number of windows that are computed together."""
        return max(1, MAX_BATCH_BYTES // self.nbytes(device))


def slope_about_carrier(optics: WaveOptics, beta: float) -> float:
    """Return the steepest slope behind the array relative to the chief ray, in radians."""
    slope = max(1.0, abs(beta)) * optics.lit_diameter / 2 / optics.array_distance
    slope += optics.mla.steepest_slope(optics.wavelength)
    return slope + optics.main_slope() + optics.aberrations.lenslet_slope(optics.mla)


def finer(optics: WaveOptics, beta: float, *, orders: float = 0.0) -> int:
    """Return samples a pixel and axis that the light of a point needs about its chief ray."""
    slope = slope_about_carrier(optics, beta) + orders * optics.wavelength / optics.mla.diameter
    spare = 1 if orders == 0 else BAND
    return math.floor(2 * slope * optics.pixel_pitch / optics.wavelength / spare * (1 + 1e-9)) + 1


def window_shape(
    optics: WaveOptics,
    position: Values,
    diameter: float = 0.0,
    *,
    rings: float = RINGS,
    orders: float = ORDERS,
) -> WindowShape:
    """Return the window of a point at (x, y, dz) in metres."""
    beta = float(optics.array_alpha(position[2]))
    samples_per_pixel = finer(optics, beta, orders=orders)
    dx = optics.pixel_pitch / samples_per_pixel
    D, z2 = optics.lit_diameter, optics.array_distance
    blur = D / 2 * abs(1 - beta) + z2 * optics.main_slope()
    tilted = 1 + (np.abs(optics.on_array(position[None])).max() / z2) ** 2
    airy = 1.22 * optics.wavelength * z2 / D * tilted
    walk = abs(optics.sensor_distance) * slope_about_carrier(optics, beta)
    blur += abs(float(optics.array_scale(position[2]))) * diameter / 2
    half = blur * tilted + rings * airy + optics.mla.pitch + walk
    samples = 2 * smooth_length(math.ceil(half / dx))
    period = smooth_length(math.ceil(PERIOD_WINDOWS * samples))
    pupil = math.ceil(1.05 * D / z2 * tilted * period * dx / optics.wavelength) + 2 * RIM
    if pupil > period:  # a pupil that fills the band
        period, pupil = (smooth_length(pupil),) * 2
    rim = None
    if orders:
        # aliases of the rims' light that fall beside the band of the rays are filtered
        middle = 0.5 - slope_about_carrier(optics, beta) * dx / optics.wavelength
        rim = (middle - TRANSITION / 2, middle + TRANSITION / 2)
    return WindowShape(samples_per_pixel, dx, samples, period, pupil, math.ceil(walk / dx), rim)


def window_centres(optics: WaveOptics, shape: WindowShape, positions: Values) -> Counts:
    """Return `Windows.centres` of points (x, y, dz) in metres, shape (n, 3)."""
    z = optics.object_distance + positions[:, 2]
    images = -positions[:, 1::-1] / z[:, None] * optics.array_distance
    return np.rint((images - np.asarray(optics.grid.origin)) / shape.pitch).astype(np.int64)


class SensorOptics(Protocol):
    """Interface of a camera behind its main lens, for windows."""

    @property
    def device(self) -> Device: ...

    @property
    def wavelength(self) -> float: ...

    @property
    def grid(self) -> Grid: ...

    @property
    def pixels(self) -> PixelArray | None: ...

    @property
    def sensor_distance(self) -> float: ...

    def array_transmission(
        self, grid: Grid, *, rim: tuple[float, float] | None = None
    ) -> cla.Array: ...


@dataclass(frozen=True, eq=False)
class Region:
    """Transmission of a part of the array that contains windows of one shape."""

    shape: WindowShape
    first: Counts  # first sample (y, x) in the coordinates of `Windows.centres`, int64
    transmission: cla.Array  # complex, shape (ny, nx)

    @classmethod
    def of(cls, optics: SensorOptics, shape: WindowShape, centres: Counts) -> Region:
        """Compute the smallest region that contains windows with these centres, shape (n, 2)."""
        first, sizes = bounds(centres, shape.samples)
        y, x = np.asarray(optics.grid.origin) + (first + sizes // 2) * shape.pitch
        grid = Grid((int(sizes[0]), int(sizes[1])), shape.pitch, origin=(float(y), float(x)))
        return cls(shape, first, optics.array_transmission(grid, rim=shape.rim))

    def holds(self, shape: WindowShape, centres: Counts) -> bool:
        """Return True if the region contains windows of a shape completely."""
        first, sizes = bounds(centres, shape.samples)
        inside = (first >= self.first) & (first + sizes <= self.first + self.transmission.shape)
        return shape == self.shape and bool(inside.all())


def bounds(centres: Counts, samples: int) -> tuple[Counts, Counts]:
    """Return first sample (y, x) and size of the union of windows about centres, shape (n, 2)."""
    first = centres.min(axis=0) - samples // 2
    return first, centres.max(axis=0) - samples // 2 + samples - first


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of several points of equal shape, from the array to the sensor."""

    optics: SensorOptics
    shape: WindowShape
    numbers: Values  # numbers of each point for the kernels, shape (n, NUMBERS)
    # (y, x) of the windows' middle samples on the array, counted in samples from the middle pixel
    # of the sensor, int64, shape (n, 2)
    centres: np.ndarray[Any, np.dtype[np.int64]]
    carriers: Values  # direction cosines (y, x) behind the array of a chief ray, shape (n, 2)
    # bins (y, x) from the middle of each window's band to its carrier, shape (n, 2)
    off_band: Values
    # displacement (y, x) of the windows on the sensor, in samples, int64, shape (n, 2)
    shifts: np.ndarray[Any, np.dtype[np.int64]]
    # energy of each point's field in an infinite window, sum of abs(U)^2 over samples, shape (n,)
    energy: Values

    @abstractmethod
    def array_fields(self) -> cla.Array:
        """Compute fields on the array before its lenslets, without carrier and quadratic phase."""

    def behind_array(self, fields: cla.Array, region: Region | None = None) -> cla.Array:
        """Multiply fields by the lenslets in place; the carrier stays omitted."""
        optics, shape, device = self.optics, self.shape, self.optics.device
        n = shape.samples
        real = device.real.type
        if region is None:
            arrays = device.empty(fields.shape, device.complex)
            for number, centre in enumerate(self.centres):
                arrays[number] = Region.of(optics, shape, centre[None]).transmission
            corners = np.outer(n * np.arange(len(self.centres)), (1, 0))
        else:
            arrays = region.transmission
            corners = self.centres - n // 2 - region.first
        device.launch_rows(
            device.kernel("local_window.cl", "behind", **lanes_defines(device)),
            fields.shape,
            fields,
            device.upload(self.numbers.astype(device.real)),
            arrays,
            device.upload(corners.astype(np.int32)),
            np.int32(arrays.shape[-1]),
            real(shape.pitch),
            real(1 / optics.wavelength),
            np.int32(n),
            np.int32(n),
        )
        return fields

    def sensor_spectra(self, behind: cla.Array) -> cla.Array:
        """Compute spectra of the sensor fields about the windows' centres there, in place."""
        optics, shape, device = self.optics, self.shape, self.optics.device
        device.fft.forward(behind, device)
        rows, columns, middles = self._bins()
        real = device.real.type
        device.launch_rows(
            device.kernel("local_window.cl", "onward", **lanes_defines(device)),
            behind.shape,
            behind,
            *(device.upload(table.astype(device.real)) for table in (rows, columns, middles)),
            real(optics.sensor_distance / optics.wavelength),
            np.int32(shape.samples),
            np.int32(shape.samples),
        )
        return behind

    def _bins(self) -> tuple[Values, Values, Values]:
        """Return tables of kernel `onward`: rows and columns (points, samples, 2), and points."""
        n, s0 = self.shape.samples, self.carriers
        step = self.optics.wavelength / (n * self.shape.pitch)
        tables = []
        for axis in (0, 1):
            off = self.off_band[:, axis, None]
            index = np.arange(n) + off
            bins = index - n * np.rint(index / n) - off  # from the carrier
            s = bins * step
            turns = bins * self.shifts[:, axis, None] / n
            tables.append(np.stack([s * (s + 2 * s0[:, axis, None]), turns], axis=-1))
        squares = (s0**2).sum(axis=1)
        middles = np.stack([squares, np.sqrt(np.maximum(1 - squares, 0))], axis=-1)
        return tables[0], tables[1], middles

    def _origin(self, centre: Any) -> tuple[float, float]:
        y, x = np.asarray(self.optics.grid.origin) + np.asarray(centre) * self.shape.pitch
        return float(y), float(x)


@dataclass(frozen=True, eq=False)
class LocalWindows(Windows):
    """Windows of points before a main lens."""

    optics: WaveOptics
    positions: Values  # (x, y, dz) of the points in metres, shape (n, 3)
    diameter: float  # diameter of each point in metres

    @classmethod
    def of(
        cls, optics: WaveOptics, shape: WindowShape, positions: Values, diameter: float = 0.0
    ) -> LocalWindows:
        """Return the windows of points (x, y, dz), shape (n, 3), in metres."""
        z = optics.object_distance + positions[:, 2]
        z2, lam = optics.array_distance, optics.wavelength
        q = 1 / optics.focal_length - 1 / z
        t0 = -positions[:, 1::-1] / z[:, None]  # (y, x), the chief ray's slope
        a0 = np.sqrt(1 + (t0**2).sum(axis=1))
        s0 = t0 / a0[:, None]
        r0 = z2 * a0
        across = np.eye(2) - s0[:, :, None] * s0[:, None, :]
        at_rim = (a0**2 / (a0**2 + (optics.aperture_diameter / 2 / z2) ** 2)) ** 1.5
        bend = across * (at_rim / r0)[:, None, None]
        slopes = (q / a0)[:, None, None] * across + (1 - z2 * q)[:, None, None] * bend
        images, origin = t0 * z2, np.asarray(optics.grid.origin)
        centres = window_centres(optics, shape, positions)
        residual = origin + centres * shape.pitch - images
        lens = 1 / z2 if optics.field_lens else 0.0
        carriers = s0 - lens * images
        leaning = carriers / np.sqrt(1 - (carriers**2).sum(axis=1))[:, None]
        shifts = np.rint(optics.sensor_distance * leaning / shape.pitch).astype(np.int64)
        numbers = np.zeros((len(positions), NUMBERS))
        columns = (
            *t0.T, q, 1 - z2 * q, bend[:, 0, 0], bend[:, 0, 1], bend[:, 1, 1], 1 / z,
            np.full(len(z), math.pi * diameter / lam), *(residual / lam).T, np.linalg.det(slopes),
            *residual.T, np.full(len(z), lens),
        )  # fmt: skip
        for number, column in enumerate(columns):
            numbers[:, number] = column
        off_band = _off_band(optics, shape, carriers, 1 - numbers[:, 3])
        windows = cls(
            optics, shape, numbers, centres, carriers, off_band, shifts, np.ones(len(positions)),
            positions, diameter,
        )  # fmt: skip
        windows.numbers[:, 15:17] = windows._pupil_centres() * optics.aperture_diameter / 2
        windows.energy[:] = windows._energies()
        return windows

    @property
    def step(self) -> float:
        """Step of the direction cosines, lam over the period."""
        return self.optics.wavelength / (self.shape.period * self.shape.pitch)

    def array_fields(self) -> cla.Array:
        """Compute fields on the array before its lenslets, without carrier and quadratic phase."""
        optics, shape, device = self.optics, self.shape, self.optics.device
        count = len(self.positions)
        reach = optics.aperture_diameter / 2 + np.abs(self.positions[:, :2]).max()
        nearest = float((optics.object_distance + self.positions[:, 2]).min())
        table, per_step = disc_table(
            math.pi * self.diameter / optics.wavelength * 2 * reach / nearest, device
        )
        defines = lanes_defines(device) | ({"THIN": True} if optics.lens_model == "thin" else {})
        paths, size = np.zeros((1, 2)), 0
        if optics.aberrations.bends_main_lens:
            defines |= {"PATH": True}
            size = TABLE_SAMPLES
            paths = self._paths()
        shadow, shadow_size = np.zeros((1, 1, 1), complex), 0
        if self._is_shadowed():
            defines |= {"SHADOW": True}
            shadow, shadow_size = self._shadows(), TABLE_SAMPLES
        # the sum over directions repeats after the period; the corners of this window have
        # frequencies up to share/sqrt(2), the next period those from 1 - share/2 on
        share = shape.samples / shape.period
        rim = rim_weights(math.sqrt(0.5) * share, 1 - share / 2)
        pupil = device.empty((count, shape.pupil, shape.pupil), device.complex)
        real = device.real.type
        device.launch_rows(
            device.kernel("local_window.cl", "spectra", **defines),
            pupil.shape,
            pupil,
            device.upload(self.numbers.astype(device.real)),
            device.upload(table),
            np.int32(len(table) - 1),
            real(per_step),
            device.upload(rim.astype(device.real)),
            np.int32(len(rim)),
            device.upload(paths.astype(device.real)),
            np.int32(size),
            device.upload(shadow.astype(device.complex)),
            np.int32(shadow_size),
            real(optics.aperture_diameter / 2),
            real(optics.array_distance),
            real(self.step),
            real(1 / optics.wavelength),
            np.int32(shape.pupil),
            np.int32(shape.pupil),
        )
        line = _to_window(shape).astype(device.complex)
        return run(pupil, Separable.of((line, line)), [], [], device)[0]

    def _paths(self) -> Values:
        """Return (turns, transmission) of the main lens over the pupil's square, for each point."""
        optics = self.optics
        axis = np.linspace(-TABLE_REACH, TABLE_REACH, TABLE_SAMPLES)
        v, u = np.meshgrid(axis, axis, indexing="ij")
        beyond = np.maximum(np.hypot(v, u), 1)
        maps, tables = optics.aberrations.main_lens_opd, []
        images, centres = optics.image_of(self.positions), self._pupil_centres()
        for image, centre in zip(images, centres, strict=True):
            x, y = (float(value) for value in image)
            path, _ = optics.main_lens_path(y, x, v + centre[0], u + centre[1])
            passes = np.ones_like(path)
            if maps is not None:
                share, covered = maps.share_and_cover(
                    y, x, optics.wavelength, v / beyond, u / beyond, axis[1] - axis[0]
                )
                passes = share * covered**2
            tables.append(np.stack([path / optics.wavelength, passes], -1))
        return np.stack(tables)

    def _is_shadowed(self) -> bool:
        farthest = self.positions[:, 2].max()
        return any(screen.z < farthest for screen in self.optics.occluders)

    def _shadows(self) -> Any:
        """Return factors of the screens over the pupil's square, for each point."""
        optics = self.optics
        return shadows(
            optics.occluders,
            self.positions,
            object_distance=optics.object_distance,
            wavelength=optics.wavelength,
            axis=np.linspace(-TABLE_REACH, TABLE_REACH, TABLE_SAMPLES)
            * optics.aperture_diameter
            / 2,
        )

    def _pupil_centres(self) -> Values:
        """Return (v, u) of the centre of each point's pupil, in radii of the aperture."""
        maps, lam = self.optics.aberrations.main_lens_opd, self.optics.wavelength
        if maps is None:
            return np.zeros((len(self.positions), 2))
        images = self.optics.image_of(self.positions)
        return np.array([maps.pupil_centre(float(y), float(x), lam) for x, y in images])

    def _energies(self) -> Values:
        """Return the energy of the samples of the whole plane, sum |U|^2, scaled as by kernels."""
        optics, shape = self.optics, self.shape
        thin = optics.lens_model == "thin"
        radius, area = _disc_nodes()
        half = optics.aperture_diameter / 2
        u, rim = radius * half, _on_circle(half)
        lit, loss = math.pi * half**2, optics.rim_loss(shape.pitch)
        energies = []
        for numbers in self.numbers:
            t0, q, per_z, scale = numbers[:2], numbers[2], numbers[7], numbers[8]
            arguments = (t0, q, per_z, scale, thin)
            squares = _amplitudes(u + numbers[15:17], *arguments)
            mean = (squares * area).sum() / area.sum()
            at_rim = _amplitudes(rim + numbers[15:17], *arguments).mean()
            energies.append(lit * (mean - loss * at_rim))
        # sum |G|^2 over the samples of direction is int A^2 du J0/ds^2, and the inverse transform
        # divides by the samples of the period
        return np.asarray(energies) * self.numbers[:, 11] / (self.step * shape.period) ** 2


def _off_band(optics: WaveOptics, shape: WindowShape, carriers: Values, beta: Values) -> Values:
    """Return bins (y, x) from the middle of each window's band to its carrier.

    The band is centred on the carrier, or on the axis if the samples hold all light about it.
    """
    nyquist = optics.wavelength / (2 * shape.pitch)
    steepest = np.array([slope_about_carrier(optics, ratio) for ratio in beta])
    about_axis = (np.abs(carriers) + steepest[:, None] < nyquist).all(axis=1)
    bins = carriers * (shape.samples * shape.pitch / optics.wavelength)
    return np.where(about_axis[:, None], bins, 0.0)


def _disc_nodes(count: int = 48) -> tuple[Values, Values]:
    """Return positions (n, 2) on the unit disc and areas: Gauss in radius, equal angles."""
    x, w = np.polynomial.legendre.leggauss(count)
    r2, angle = (x + 1) / 2, 2 * np.pi * (np.arange(count) + 0.5) / count
    r = np.sqrt(r2)
    positions = np.stack([np.outer(r, np.sin(angle)), np.outer(r, np.cos(angle))], -1).reshape(
        -1, 2
    )
    areas = np.repeat(w / 2 * np.pi / count, count)
    return positions, areas


def _on_circle(radius: float, count: int = 64) -> Values:
    """Return positions (n, 2) on a circle."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.sin(angle), np.cos(angle)], -1)


def _amplitudes(u: Values, t0: Values, q: float, per_z: float, scale: float, thin: bool) -> Values:
    """Compute the squared amplitude in the pupil at positions u, as in kernel `spectra`."""
    from scipy import special  # a slow import

    slope = u * per_z + t0
    v = scale * np.hypot(*slope.T)
    disc = np.where(v > 0, 2 * special.j1(v) / np.where(v > 0, v, 1), 1.0)
    if thin:
        return np.asarray(disc**2)
    slope2 = ((t0 - q * u) ** 2).sum(axis=1)
    return np.asarray(disc**2 * ((1 + (t0**2).sum()) / (1 + slope2)) ** 1.5)


def _to_window(shape: WindowShape) -> Line:
    """Return the map from samples of direction about 0 to the window's samples about its middle."""
    n, m, length = shape.pupil, shape.samples, shape.period
    first = -(m // 2)
    i, k = np.arange(n), np.arange(m)
    pre = np.exp(2j * np.pi * ((i * first) % length) / length)
    post = np.exp(-2j * np.pi * (((n // 2) * (k + first)) % length) / length)
    return Line(n, m, length, "inverse", pre=pre, post=post)
