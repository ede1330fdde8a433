"""The wavefront of a lens from three pictures of a star: figure 6.1.

A lens of 30 mm at f/25 in light of 532 nm, pixels of 6.5 um; the sensor stands in focus and one
wave of defocus (at the rim) to either side. The pictures to fit are an independent simulation:
Fresnel's integral with the next term of the path, from a pupil four times as fine, in float64.
Photons are those of all three.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from common import BLUE
from drawing import LIGHT, centred
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from scipy.optimize import minimize

from clplen import Device, Field, Grid, OpticalSystem
from clplen.wave import Lens, Space, ZernikePlate, intensity_gradient, noll, wavefront

LAM, F, D = 532e-9, 30e-3, 1.2e-3
K, AREA = 2 * np.pi / LAM, np.pi / 4 * D**2
DEFOCUS = np.array([-8, 0, 8]) * LAM * (F / D) ** 2
PUPIL, SENSOR = Grid((144, 144), 9e-6), Grid((64, 64), 6.5e-6)
FINE = Grid((576, 576), 2.25e-6)  # of the independent simulation
MODES = tuple(range(4, 16))  # Noll's indices
DARK = 0.2  # counts of a pixel without light
BEHIND = [OpticalSystem([Space(F + dz, out_grid=SENSOR)]) for dz in DEFOCUS]


def true_wavefront(rms: float) -> np.ndarray:
    """Coefficients in metres, that fall with the radial order."""
    drawn = np.random.default_rng(6).normal(size=len(MODES)) / [noll(j)[0] for j in MODES]
    return drawn * rms / np.linalg.norm(drawn)


def path(c: np.ndarray, grid: Grid) -> np.ndarray:
    """The wavefront in metres."""
    terms = {noll(j): value for j, value in zip(MODES, c, strict=True)}
    return wavefront(grid, terms, diameter=D)[0]


def simulated(c: np.ndarray) -> np.ndarray:
    """Share of the light in each pixel of the three pictures, in float64."""
    r2 = FINE.y[:, None] ** 2 + FINE.x**2
    inside = r2 <= (D / 2) ** 2
    pupil = inside * np.exp(1j * K * path(c, FINE))
    scale = (SENSOR.pitch[0] * FINE.pitch[0] ** 2) ** 2 / AREA
    found = []
    for z in F + DEFOCUS:
        bent = r2 / 2 * (1 / z - 1 / F) - r2**2 / (8 * z**3)
        turned = pupil * np.exp(1j * K * bent)
        wave = np.exp(-1j * K / z * np.outer(SENSOR.x, FINE.x))
        found.append(scale / (LAM * z) ** 2 * np.abs(wave @ turned @ wave.T) ** 2)
    return np.stack(found)


def counts_of(light: np.ndarray, photons: float, seed: int | None = None) -> np.ndarray:
    """Mean counts, or drawn ones, of pictures as `simulated`."""
    mean = photons / 3 * light + DARK
    return mean if seed is None else np.random.default_rng(seed).poisson(mean)


@dataclass(frozen=True)
class Fit:
    """Coefficients that were found, and those of each evaluation on the way."""

    c: np.ndarray
    way: np.ndarray


@dataclass(frozen=True)
class Camera:
    """The model of the lens and its sensor, on a device."""

    device: Device

    def field(self, data: np.ndarray) -> Field:
        """Samples of the pupil as a field."""
        return Field.from_array(data, PUPIL, wavelength=LAM, device=self.device)

    def star(self) -> Field:
        """Its light before the lens, which passes 1."""
        return self.field(np.full(PUPIL.shape, SENSOR.pitch[0] / np.sqrt(AREA)))

    def lens(self, c: np.ndarray) -> OpticalSystem:
        """A plate of the unknown wavefront, and the lens."""
        plate = ZernikePlate({j: float(value) for j, value in zip(MODES, c, strict=True)},
                             diameter=D)
        return OpticalSystem([plate, Lens(F, diameter=D)])

    def expected(self, c: np.ndarray, photons: float) -> np.ndarray:
        """Mean counts of the three pictures."""
        lit = self.lens(c)(self.star())
        light = [one(lit).intensity().to_numpy().astype(float) for one in BEHIND]
        return photons / 3 * np.stack(light) + DARK

    def misfit(self, c: np.ndarray, counts: np.ndarray, photons: float) -> tuple[float, np.ndarray]:
        """Poisson's negative log likelihood less its least, a photon, and its gradient by c."""
        lit, through_lens = self.lens(c).vjp(self.star(), parameters=[0])
        total, slope = 0.0, np.zeros(PUPIL.shape, complex)
        for space, n in zip(BEHIND, counts, strict=True):
            image, back = space.vjp(lit)
            mean = photons / 3 * image.intensity().to_numpy().astype(float) + DARK
            total += np.sum(mean - n + n * np.log(np.where(n > 0, n, 1) / mean)) / photons
            slope += back(intensity_gradient(image, (1 - n / mean) / 3)).field.to_numpy()
        found = through_lens(self.field(slope)).parameters[0]["coefficients"]
        return total, np.array([found[j] for j in MODES])

    def retrieve(self, counts: np.ndarray, photons: float) -> Fit:
        """The most likely coefficients, from 0 by L-BFGS-B."""
        unit, way = 1 / (2 * K), []  # in these units the misfit's curvature is about 1

        def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
            way.append(x * unit)
            value, gradient = self.misfit(x * unit, counts, photons)
            return value, gradient * unit

        options = {"maxiter": 60, "ftol": 1e-3 / photons, "gtol": 1e-9}
        found = minimize(loss, np.zeros(len(MODES)), jac=True, method="L-BFGS-B", options=options)
        return Fit(found.x * unit, np.array(way))

    def bounds(self, c: np.ndarray, photons: list[float]) -> np.ndarray:
        """Cramer and Rao's covariance of c for each number of photons: inverse information."""
        lens = self.lens(c)
        plate = lens[:1](self.star()).to_numpy().astype(complex)
        modes = [1j * K * path(unit, PUPIL) * plate for unit in np.eye(len(MODES))]
        behind = lens[1:](self.field(np.stack([plate, *modes])))
        waves = np.stack([space(behind).to_numpy() for space in BEHIND], axis=1).astype(complex)
        waves = waves.reshape(len(waves), -1)
        light, slope = np.abs(waves[0]) ** 2, 2 * (waves[0].conj() * waves[1:]).real
        shares = [(n / 3) ** 2 / (n / 3 * light + DARK) for n in photons]
        return np.stack([np.linalg.inv(slope * share @ slope.T) for share in shares])


def rms(covariance: np.ndarray) -> np.ndarray:
    """Of the wavefront, in nm."""
    return 1e9 * np.sqrt(np.trace(covariance, axis1=-2, axis2=-1))


def words(photons: float | str) -> str:
    """A number of photons as text."""
    return photons if isinstance(photons, str) else f"$10^{np.log10(photons):.0f}$ photons"


def draw_picture(axes: Axes, counts: np.ndarray, norm: Any, title: str) -> AxesImage:
    """The middle of a picture."""
    axes.set(title=title, xlabel="x / um", xticks=[-100, 0, 100], yticks=[-100, 0, 100])
    return axes.imshow(counts[8:-8, 8:-8], cmap=LIGHT, norm=norm,
                       extent=centred((48, 48), SENSOR.pitch[0] * 1e6))


def draw_wavefront(axes: Axes, c: np.ndarray, title: str, most: float) -> AxesImage:
    """A wavefront over the lens, in nm."""
    values = np.where(np.hypot(PUPIL.y[:, None], PUPIL.x) <= D / 2, path(c, PUPIL) * 1e9, np.nan)
    axes.set(title=title, xlabel="x / mm", xticks=[-0.5, 0, 0.5], yticks=[-0.5, 0, 0.5])
    drawn = axes.imshow(values, cmap="RdBu_r", vmin=-most * 1e9, vmax=most * 1e9,
                        extent=centred(PUPIL.shape, PUPIL.pitch[0] * 1e3))
    axes.set(xlim=(-D * 520, D * 520), ylim=(D * 520, -D * 520))
    return drawn


def draw_terms(axes: Axes, true: np.ndarray, found: np.ndarray, covariance: np.ndarray) -> None:
    """Coefficients with their bounds."""
    axes.bar(MODES, true * 1e9, color="0.8", width=0.8, label="true")
    sigma = 1e9 * np.sqrt(np.diag(covariance))
    axes.errorbar(MODES, found * 1e9, 2 * sigma, fmt="o", ms=3.5, capsize=2.5, color=BLUE,
                  label=r"found, $10^4$ photons, $\pm 2\sigma$ of the bound")
    axes.axhline(0, color="k", lw=0.6)
    axes.set(xlabel="Noll's index", ylabel="coefficient / nm", xticks=MODES)
    axes.legend()


def draw_way(axes: Axes, fit: Fit, true: np.ndarray, colour: str, photons: float | str) -> None:
    """The error after every evaluation."""
    off = 1e9 * np.linalg.norm(fit.way - true, axis=1)
    words = photons if isinstance(photons, str) else f"$10^{np.log10(photons):.0f}$ photons"
    axes.semilogy(off, ".-", color=colour, label=words)
    axes.set(xlabel="evaluations of misfit and gradient", ylabel="rms error / nm",
             xticks=range(0, 30, 5))
    axes.legend()


def draw_errors(axes: Axes, camera: Camera, true: np.ndarray, errors: dict) -> None:
    """Errors against the number of photons, with their bounds."""
    photons = np.logspace(2.7, 7.3, 24)
    axes.loglog(photons, rms(camera.bounds(true, photons)), "k-", lw=1,
                label="Cramer and Rao's bound, these pictures")
    least = 1e9 * np.sqrt(len(MODES)) / (2 * K * np.sqrt(photons))
    axes.loglog(photons, least, "k:", lw=1,
                label=r"any measurement: $\lambda\sqrt{12}/(4\pi\sqrt{N})$")
    for n, error in errors.items():
        axes.plot([n] * len(error), error, "o", ms=5, mfc="none", color=BLUE)
    axes.axhline(LAM * 1e7, color="0.6", ls="--", lw=0.8)
    axes.text(1.9e7, LAM * 1.1e7, r"$\lambda/100$", ha="right", color="0.4")
    axes.set(xlabel="photons in the three pictures", ylabel="rms error / nm")
    axes.legend(loc="lower left")
