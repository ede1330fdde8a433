"""An independent float64 simulation of a plenoptic 1.0 camera with square, full lenslets.

Point source -> analytic field on the main lens -> aperture and lens -> microlens array -> sensor.
Nothing here imports the package under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from reference_elements import circle_coverage, lens_phase
from reference_optics import Complex, Real, axis, propagate
from scipy.special import j1


@dataclass(frozen=True)
class Camera:
    """A plenoptic 1.0 camera, lengths in metres; the defaults are the thesis' system.

    The main lens (focal_length) images the object plane at object_distance onto the array at
    image_distance; f_mu is the lenslets' focal length and the distance to the sensor. The
    aperture is matched to the lenslets: pitch image_distance / f_mu.
    """

    focal_length: float = 0.120
    image_distance: float = 0.240
    pitch: float = 150e-6
    f_mu: float = 0.010
    count: tuple[int, int] = (101, 101)
    pixels_per_lenslet: int = 30
    wavelength: float = 532e-9
    source_diameter: float = 10e-6

    @property
    def object_distance(self) -> float:
        return 1 / (1 / self.focal_length - 1 / self.image_distance)

    @property
    def aperture_diameter(self) -> float:
        return self.pitch * self.image_distance / self.f_mu

    @property
    def pixel(self) -> float:
        return self.pitch / self.pixels_per_lenslet

    @property
    def shape(self) -> tuple[int, int]:
        return self.count[0] * self.pixels_per_lenslet, self.count[1] * self.pixels_per_lenslet

    @property
    def origin(self) -> tuple[float, float]:
        """Coordinate (y, x) of sample n//2: half a pixel on an even axis, so it is symmetric."""
        y, x = (0.0 if n % 2 else self.pixel / 2 for n in self.shape)
        return y, x

    def axes(self) -> tuple[Real, Real]:
        """Coordinates y and x of the sensor pixels."""
        (ny, nx), (oy, ox) = self.shape, self.origin
        return axis(ny, self.pixel, oy), axis(nx, self.pixel, ox)

    def alpha(self, dz: float) -> float:
        """F/F' of an object dz behind the focused plane: F (1/f - 1/(z_obj + dz))."""
        distance = self.object_distance + dz
        return self.image_distance * (1 / self.focal_length - 1 / distance)

    def image_position(self, x0: float, dz: float) -> float:
        """Where the chief ray of an object at x0 meets the array: -x0 F/(z_obj + dz)."""
        return -x0 * self.image_distance / (self.object_distance + dz)


def source_field(camera: Camera, x0: float, y0: float, dz: float) -> Complex:
    """Field of a uniform coherent disc at (x0, y0) on the main-lens plane.

    Exact spherical phase exp(ik(r - z)) from the disc's centre times its far-field pattern
    2 J1(v)/v, v = pi a rho/(lam z) (Goodman, section 4.4.2); a = 0 is a point.
    """
    y, x = camera.axes()
    z = camera.object_distance + dz
    rho2 = (y - y0)[:, None] ** 2 + (x - x0)[None, :] ** 2
    excess = rho2 / (np.sqrt(rho2 + z**2) + z)
    field = np.exp(2j * np.pi / camera.wavelength * excess)
    v = np.pi * camera.source_diameter * np.sqrt(rho2) / (camera.wavelength * z)
    field *= np.divide(2 * j1(v), v, out=np.ones_like(v), where=v > 0)
    return field


def array_phase(camera: Camera) -> Complex:
    """Transmission of the array: a lens about the centre of every lenslet, amplitude 1."""
    cell = np.arange(camera.pixels_per_lenslet) - (camera.pixels_per_lenslet - 1) / 2
    t = np.exp(-1j * np.pi * (cell * camera.pixel) ** 2 / (camera.wavelength * camera.f_mu))
    return np.tile(t, camera.count[0])[:, None] * np.tile(t, camera.count[1])[None, :]


def field_behind_lens(camera: Camera, x0: float, y0: float, dz: float) -> Complex:
    """Field behind aperture and main lens, scaled so that the sum of |u|^2 is 1."""
    grid, origin = (camera.shape, camera.pixel), camera.origin
    u = source_field(camera, x0, y0, dz)
    u *= circle_coverage(*grid, camera.aperture_diameter, origin=origin)
    u *= lens_phase(*grid, camera.focal_length, camera.wavelength, origin=origin)
    u /= np.linalg.norm(u)
    return u


def field_at_array(camera: Camera, x0: float, y0: float, dz: float, *, workers: int = 2) -> Complex:
    """Field arriving at the microlens array: band-limited angular spectrum over F, no padding."""
    u = field_behind_lens(camera, x0, y0, dz)
    step = (camera.pixel, camera.image_distance, camera.wavelength)
    return propagate(u, *step, method="blas", pad=1, workers=workers)


def simulate_raw(
    x0: float, y0: float, dz: float, *, params: Camera | None = None, workers: int = 2
) -> Real:
    """Raw image of one point source, shape params.shape, as it lies on the sensor.

    (x0, y0, dz): position of the source from the axis point of the focused plane, dz > 0 farther
    from the lens. The energy leaving the aperture is 1, so the image sums to just below 1.
    """
    camera = params or Camera()
    u = field_at_array(camera, x0, y0, dz, workers=workers)
    u *= array_phase(camera)
    step = (camera.pixel, camera.f_mu, camera.wavelength)
    u = propagate(u, *step, method="as", pad=1, workers=workers)
    return u.real**2 + u.imag**2


def simulate_scene(
    points: Sequence[tuple[float, float, float]], *, params: Camera | None = None
) -> Real:
    """Raw image of mutually incoherent points (x0, y0, dz), each leaving the aperture with 1."""
    return np.sum([simulate_raw(*point, params=params) for point in points], axis=0)
