"""A camera calibrated from one raw image of points: the wave model, its Jacobian, Gauss-Newton."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from common import BLUE, GREEN, ORANGE, RED
from scipy.optimize import least_squares

from clplen import MicrolensArray, PlenopticCamera, PointSources, SurfaceScene, estimate_lattice
from clplen.cameras import Aberrations, ExposureOperator, Plane, Plenoptic1, uniform

PITCH, F_MU = 150e-6, 10e-3
NAMES = ("pitch", "rotation", "offset y", "offset x", "f_mu", "tilt y", "tilt x")
UNITS = np.array([1e-3 * PITCH, 1e-3, 0.01 * PITCH, 0.01 * PITCH, 0.01 * F_MU, 0.01, 0.01])
ARRAY = len(NAMES)  # unknowns of array and sensor
EXPECTED = np.r_[2, 4, 15, 15, 2, 2, 2, [1, 1, 1, 0.1] * 3]  # how far off a start usually is
PLACE = np.array([1e-5, 1e-5, 1e-3])  # units of x, y, dz of a point
PLACES = np.array([(-8e-4, -6e-4, -0.05), (7e-4, -8e-4, 0.04), (1e-4, 8e-4, -0.03)])
BACKGROUND = 0.5  # photons a pixel


def design(device: Any, count: int, pixels: int, diameter: float) -> Plenoptic1:
    """The camera of section 1.5 with fewer lenslets and pixels."""
    array = MicrolensArray(PITCH, F_MU, count=count, fill="full")
    return PlenopticCamera.type1(focal_length=0.12, mla=array, wavelength=532e-9,
                                 pixels_per_lenslet=pixels, aperture_diameter=diameter,
                                 device=device)


def built(camera: Plenoptic1, array: Any) -> Plenoptic1:
    """The camera off its design by so many UNITS; pixels and the middle of the sensor stay."""
    pitch, rotation, y, x, f_mu = (np.array([PITCH, 0, 0, 0, F_MU, 0, 0]) + UNITS * array)[:5]
    mla = MicrolensArray(pitch, f_mu, count=camera.mla.count, fill="full", offset=(y, x),
                         rotation=rotation)
    sensor = Aberrations(sensor_shift=F_MU - f_mu, sensor_tilt=tuple(UNITS[5:] * array[5:]))
    return replace(camera, mla=mla, aberrations=sensor)


@dataclass(frozen=True)
class Calibration:
    """Unknowns: array and sensor (7), then x, y, dz and the energy in `photons` of every point.

    Attributes
    ----------
    camera : Plenoptic1
        The design.
    photons : float
        Of the brightness 1 of a point.
    """

    camera: Plenoptic1
    photons: float

    def operator(self, unknowns: Any) -> tuple[ExposureOperator, Any]:
        """The exposure and the energies."""
        points = unknowns[ARRAY:].reshape(-1, 4)
        scene = PointSources(points[:, :3] * PLACE, diameter=10e-6)
        exposure = ExposureOperator(built(self.camera, unknowns[:ARRAY]), scene, method="points")
        return exposure, points[:, 3] * self.photons

    def mean(self, unknowns: Any) -> Any:
        """Photons of every pixel."""
        exposure, energies = self.operator(unknowns)
        return exposure.forward(energies).astype(float) + BACKGROUND

    def slopes(self, unknowns: Any) -> tuple[Any, Any]:
        """Photons of every pixel, and their derivatives by the unknowns, (unknowns, ny, nx)."""
        exposure, energies = self.operator(unknowns)
        found = exposure.jacobian(energies, by=("values", "positions", "lenslets", "sensor"))
        array, sensor = found.lenslets, found.sensor
        width = array["pitch"] + array["diameter"]  # the diameter is the pitch
        f_mu = array["focal_length"]  # all lengths behind the array stay
        first = np.stack([width, array["rotation"], *array["offset"], f_mu, *sensor["tilt"]])
        points = np.concatenate([found.positions * PLACE[:, None, None],
                                 found.values[:, None] * self.photons], axis=1)
        columns = points.reshape(-1, *first.shape[1:])
        return found.image + BACKGROUND, np.r_[first * UNITS[:, None, None], columns]

    def bounds(self, unknowns: Any, free: Any) -> Any:
        """Least standard deviations of the unknowns that are free (Cramer and Rao)."""
        mean, slopes = self.slopes(unknowns)
        columns = slopes[free].reshape(len(free), -1)
        return np.sqrt(np.diag(np.linalg.inv(columns @ (columns / mean.ravel()).T)))

    def fit(self, counts: Any, start: Any, free: Any) -> Any:
        """All iterates of Gauss-Newton in a trust region, to the largest likelihood of Poisson.

        The squares of the residuals add up to the deviance, 2 sum(mean - n + n log(n/mean)). The
        first region is that of errors that are EXPECTED; four times these bound the unknowns.
        """
        path = []

        def at(steps: Any) -> Any:
            unknowns = start.copy()
            unknowns[free] += steps
            return unknowns

        def jacobian(steps: Any) -> Any:
            path.append(at(steps))
            mean, slopes = self.slopes(path[-1])
            return (slopes[free] * root_slope(mean, counts)).reshape(len(free), -1).T

        scale = EXPECTED[free]
        least_squares(lambda steps: root(self.mean(at(steps)), counts).ravel(),
                      np.zeros(len(free)), jacobian, bounds=(-4 * scale, 4 * scale),
                      x_scale=scale, xtol=1e-4, ftol=1e-7)
        return np.array(path)


def root(mean: Any, counts: Any) -> Any:
    """Roots of the deviance of each pixel, with the sign of mean - counts."""
    logs = counts * np.log(np.where(counts > 0, counts, 1) / mean)
    return np.sign(mean - counts) * np.sqrt(2 * np.maximum(mean - counts + logs, 0))


def root_slope(mean: Any, counts: Any) -> Any:
    """The derivative of `root` by the mean, 1/sqrt(mean) where it is the count."""
    residual = root(mean, counts)
    near = abs(residual) < 1e-4
    return np.where(near, mean**-0.5, (1 - counts / mean) / np.where(near, 1, residual))


def lattice_errors(camera: Plenoptic1, true: Any, photons: float) -> Any:
    """In UNITS, of pitch, rotation, offset by `estimate_lattice` on a white image by rays.

    Of an untilted sensor, since rays of a wall know no other.
    """
    wall = SurfaceScene([Plane(0.0, texture=uniform(1.0))])
    flat = np.r_[true[:5], 0, 0]
    white = built(camera, flat).expose(wall, model="rays").to_numpy().astype(float)
    white *= photons * camera.mla.count[0] * camera.mla.count[1] / white.sum()
    found = estimate_lattice(np.random.default_rng(2).poisson(white))
    step = camera.grid.pitch[0] / (1 + F_MU / camera.image_distance)  # a pixel, on the array
    middle = (np.array(white.shape) - 1) / 2
    rotation = np.arctan2(found.column[0], found.column[1])
    offset = (np.array(found.origin) - middle) * step
    values = [np.mean(found.pitch) * step - PITCH, rotation, *offset]
    return np.array(values) / UNITS[:4] - true[:4]


def middle(values: Any) -> Any:
    """The lit part of a raw image."""
    y, x = (size // 16 for size in values.shape)
    return values[y:-y, x:-x]


def draw_errors(panels: Any, path: Any, least: Any, white: Any) -> None:
    """Of array and sensor over the iterations, and the last beside bounds and `lattice_errors`."""
    colours = (BLUE, GREEN, ORANGE, RED, "0.4", "#cc79a7", "#56b4e9")
    for k, (name, colour) in enumerate(zip(NAMES, colours, strict=True)):
        panels[0].semilogy(path[:, k], ".-", color=colour, label=name)
        panels[1].semilogy(k, path[-1, k], "o", color=colour)
    panels[0].set(xlabel="iterations", title="error", xticks=range(0, len(path), 2))
    panels[0].legend(fontsize=7)
    panels[1].semilogy(range(ARRAY), least, "_", color="k", ms=20, label="Cramer-Rao, 1 sigma")
    panels[1].semilogy(range(4), white, "x", color="k", label="from a white image")
    panels[1].set(xticks=range(ARRAY), xlim=(-0.5, ARRAY - 0.5), ylim=(1e-3, 3), title="last error")
    panels[1].set_xticklabels(NAMES, rotation=40)
    panels[1].legend(fontsize=7, loc="upper left")


def print_errors(error: Any, least: Any, white: Any) -> None:
    """Of the unknowns beside their bounds and, of the array, beside `lattice_errors`."""
    print("  in units of 0.1 % of the pitch, 1 mrad, 1 % of the pitch, 1 % of f_mu, 10 mrad:")
    rows = {"error": error[:7], "Cramer-Rao": least[:7], "white image": white}
    for name, values in rows.items():
        print(f"  {name:12}" + "".join(f"{value:10.4f}" for value in values))
    over = error / least
    print(f"  errors of all unknowns over their bounds: rms {np.sqrt((over**2).mean()):.2f}, "
          f"largest {abs(over).max():.2f}")
    if len(error) == 19:  # places are unknown, too
        places = error[7:].reshape(3, 4)[:, :3] * PLACE
        print("  errors of the points' x, y / um, dz / um: ", np.round(places * 1e6, 3).tolist())
