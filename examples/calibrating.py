"""A camera calibrated from one raw image of points: the wave model, its likelihood, its descent."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from common import BLUE, GREEN, ORANGE, RED
from scipy.optimize import minimize

from clplen import MicrolensArray, PlenopticCamera, PointSources, SurfaceScene, estimate_lattice
from clplen.cameras import Aberrations, ExposureOperator, Plane, Plenoptic1, uniform

PITCH, F_MU = 150e-6, 10e-3
NAMES = ("pitch", "rotation", "offset y", "offset x", "f_mu")
UNITS = np.array([1e-3 * PITCH, 1e-3, 0.01 * PITCH, 0.01 * PITCH, 0.01 * F_MU])  # of the array
PLACE = np.array([1e-5, 1e-5, 1e-3])  # units of x, y, dz of a point
PLACES = np.array([(-5e-4, -4e-4, -0.05), (4e-4, -5e-4, 0.04), (1e-4, 5e-4, -0.03)])
WEAK, FIRST = (4, 7, 11, 15), 8  # unknowns that stay at first, for so many iterations
BACKGROUND = 0.5  # photons a pixel


def design(device: Any, count: int, pixels: int, diameter: float) -> Plenoptic1:
    """The camera of section 1.5 with fewer lenslets and pixels."""
    array = MicrolensArray(PITCH, F_MU, count=count, fill="full")
    return PlenopticCamera.type1(focal_length=0.12, mla=array, wavelength=532e-9,
                                 pixels_per_lenslet=pixels, aperture_diameter=diameter,
                                 device=device)


def built(camera: Plenoptic1, array: Any) -> Plenoptic1:
    """The camera with its array off the design by so many UNITS; pixels and sensor stay."""
    pitch, rotation, y, x, f_mu = np.array([PITCH, 0, 0, 0, F_MU]) + UNITS * array
    mla = MicrolensArray(pitch, f_mu, count=camera.mla.count, fill="full", offset=(y, x),
                         rotation=rotation)
    return replace(camera, mla=mla, aberrations=Aberrations(sensor_shift=F_MU - f_mu))


@dataclass(frozen=True)
class Calibration:
    """Unknowns: the array (5), then x, y, dz and the energy in units of `photons` of every point.

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
        points = unknowns[5:].reshape(-1, 4)
        scene = PointSources(points[:, :3] * PLACE, diameter=10e-6)
        exposure = ExposureOperator(built(self.camera, unknowns[:5]), scene, method="points")
        return exposure, points[:, 3] * self.photons

    def mean(self, unknowns: Any) -> Any:
        """Photons of every pixel."""
        exposure, energies = self.operator(unknowns)
        return exposure.forward(energies).astype(float) + BACKGROUND

    def loss(self, unknowns: Any, counts: Any) -> tuple[float, Any]:
        """The negative logarithm of Poisson's likelihood, and its gradient by adjoints."""
        exposure, energies = self.operator(unknowns)
        mean = exposure.forward(energies).astype(float) + BACKGROUND
        slope = 1 - counts / mean
        by_array = exposure.lenslet_gradient(energies, slope)
        by_points = exposure.gradient(energies, slope)
        along = np.r_[by_array["pitch"] + by_array["diameter"], by_array["rotation"],
                      by_array["offset"], by_array["focal_length"]]  # the diameter is the pitch
        points = np.c_[by_points.positions * PLACE, by_points.values * self.photons]
        return float((mean - counts * np.log(mean)).sum()), np.r_[along * UNITS, points.ravel()]

    def steps(self, start: Any, free: Any, floor: float = 0.0) -> Any:
        """C with C C' the inverse of Fisher's matrix, from one difference an unknown that is free.

        ``floor`` photons a pixel are added to the variance, which is not that of the counts where
        the start is wrong.
        """
        mean = self.mean(start)
        by = np.where(free < 5, 0.1, 0.05)
        slopes = np.array([(self.mean(start + h * unit) - mean).ravel() / h
                           for h, unit in zip(by, np.eye(len(start))[free], strict=True)])
        fisher = slopes @ (slopes / (mean + floor).ravel()).T
        return np.linalg.cholesky(np.linalg.inv(fisher))

    def fit(self, counts: Any, start: Any, free: Any) -> Any:
        """All iterates, at first without f_mu and dz, which would stray while the rest is wrong."""
        path = self._descent(counts, start, np.setdiff1d(free, WEAK), FIRST)
        return np.concatenate([path, self._descent(counts, path[-1], free, 30)[1:]])

    def _descent(self, counts: Any, start: Any, free: Any, iterations: int) -> Any:
        """L-BFGS in s of the unknowns start + C s, whose curvatures are about 1; all iterates."""
        scale = np.eye(len(start))[:, free] @ self.steps(start, free, floor=10.0)
        path = [start]

        def scaled(s: Any) -> tuple[float, Any]:
            value, slope = self.loss(start + scale @ s, counts)
            return value, scale.T @ slope

        minimize(scaled, np.zeros(len(free)), jac=True, method="L-BFGS-B",
                 callback=lambda s: path.append(start + scale @ s),
                 options={"maxiter": iterations, "ftol": 1e-9})
        return np.array(path)


def lattice_errors(camera: Plenoptic1, true: Any, photons: float) -> Any:
    """In UNITS, of pitch, rotation, offset by `estimate_lattice` on a white image by rays."""
    wall = SurfaceScene([Plane(0.0, texture=uniform(1.0))])
    white = built(camera, true).expose(wall, model="rays").to_numpy().astype(float)
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
    y, x = (size // 5 for size in values.shape)
    return values[y:-y, x:-x]


def draw_errors(panels: Any, path: Any, least: Any, white: Any) -> None:
    """Of the array over the iterations, and the last beside bounds and `lattice_errors`."""
    colours = (BLUE, GREEN, ORANGE, RED, "0.4")
    for k, (name, colour) in enumerate(zip(NAMES, colours, strict=True)):
        panels[0].semilogy(path[:, k], color=colour, label=name)
        panels[1].semilogy(k, path[-1, k], "o", color=colour)
    panels[0].set(xlabel="iterations", title="error", xticks=range(0, len(path), 4))
    panels[0].legend(fontsize=7)
    panels[1].semilogy(range(5), least, "_", color="k", ms=20, label="Cramer-Rao, 1 sigma")
    panels[1].semilogy(range(4), white, "x", color="k", label="from a white image")
    panels[1].set(xticks=range(5), xlim=(-0.5, 4.5), ylim=(1e-3, 1), title="last error")
    panels[1].set_xticklabels(NAMES, rotation=40)
    panels[1].legend(fontsize=7, loc="upper left")
