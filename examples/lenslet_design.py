"""A lenslet for all depths: figure 6.2.

A focused camera (2.0) of lenslets of 200 um at f/4 in light of 532 nm sees objects at virtual
depths v = a/b from 3 to 10, two and a half waves of defocus (at the rim) from end to end. All
lenslets have one phase of Zernike polynomials, designed with one of them; contrasts are those on
the sensor at half of Nyquist's frequency of pixels of 2 um, a quarter of the lenslet's cut-off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from common import BLUE, GREEN, ORANGE, RED
from drawing import LIGHT, centred
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from scipy.optimize import minimize

from clplen import Device, Field, Grid, MicrolensArray, OpticalSystem, PlenopticCamera
from clplen.analysis import depth_scan
from clplen.cameras import Aberrations, Plenoptic2
from clplen.wave import (
    Lens,
    Space,
    ZernikePlate,
    intensity_gradient,
    noll,
    siemens_star,
    spherical_wave,
    wavefront,
)

LAM, PITCH, FOCAL, PIXEL = 532e-9, 200e-6, 0.65e-3, 2e-6
NEAR, FAR = 3.0, 10.0  # virtual depths
M = (1 / NEAR + 1 / FAR) / 2
B = FOCAL * (1 + M)  # array to sensor
RADIAN = LAM / (2 * np.pi)
LENSLET, SENSOR = Grid((140, 140), 1.6e-6), Grid((108, 108), 1e-6)
FREQUENCY = 1 / (4 * PIXEL)
WAVE = np.exp(-2j * np.pi * FREQUENCY * SENSOR.x)
SHARPNESS = (30.0, 200.0)  # of the soft minimum, one descent after the other
PHOTONS, NOISE = 1000, 3e-3  # of a clear micrometre of a picture; of Wiener's filter
KINDS = {"plain lenslet": RED, "designed": BLUE}
START_COLOURS = (BLUE, GREEN, ORANGE)
DESIGNED = 7  # depths
TERMS = tuple(range(4, 11))  # Noll's indices: defocus, astigmatism, coma, trefoil


def virtual_depths(count: int) -> np.ndarray:
    """From near to far, in equal steps of defocus."""
    return 1 / np.linspace(1 / NEAR, 1 / FAR, count)


def defocus(v: np.ndarray) -> np.ndarray:
    """In waves at the rim of a lenslet."""
    return PITCH**2 / (8 * LAM * B) * (1 / v - M)


def hopkins(v: np.ndarray) -> np.ndarray:
    """Contrast of a lens without aberrations but for defocus (Hopkins 1955), signed."""
    s = FREQUENCY * LAM * B / PITCH
    x = np.linspace(s - 1, 1 - s, 20001)
    chord = np.sqrt(np.maximum(1 - (np.abs(x) + s) ** 2, 0))
    turned = np.cos(8 * np.pi * s * np.multiply.outer(defocus(v), x))
    return 2 / np.pi * (chord * turned).sum(axis=-1) * (x[1] - x[0])


@dataclass(frozen=True)
class Design:
    """Coefficients in metres, and the worst contrast at each evaluation on the way."""

    c: np.ndarray
    worst: np.ndarray


@dataclass(frozen=True)
class Lenslet:
    """One lenslet before the sensor, on a device."""

    device: Device

    def light(self, v: np.ndarray) -> Field:
        """Of points at virtual depths, on the lenslet."""
        waves = [spherical_wave(LENSLET, float(one) * B, wavelength=LAM, device=self.device)
                 for one in v]
        return Field.from_array(np.stack([wave.to_numpy() for wave in waves]), LENSLET,
                                wavelength=LAM, device=self.device)

    def system(self, c: np.ndarray) -> OpticalSystem:
        """Phase, lens and space up to the sensor."""
        plate = ZernikePlate({j: float(value) for j, value in zip(TERMS, c, strict=True)},
                             diameter=PITCH)
        return OpticalSystem([plate, Lens(FOCAL, diameter=PITCH), Space(B, out_grid=SENSOR)])

    def images(self, c: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of points, with sum 1."""
        found = self.system(c)(self.light(v)).intensity().to_numpy().astype(float)
        return found / found.sum(axis=(1, 2), keepdims=True)

    def contrasts(self, c: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Along y and x at each depth."""
        return np.abs(_transfer(self.images(c, v)))

    def design(self, start: np.ndarray) -> Design:
        """Raise the least contrast over depths and axes, by L-BFGS-B."""
        light, worst = self.light(virtual_depths(DESIGNED)), []

        def loss(x: np.ndarray, sharpness: float) -> tuple[float, np.ndarray]:
            image, pullback = self.system(x * RADIAN).vjp(light, parameters=[0])
            least, slope, contrast = soft_minimum(image.intensity().to_numpy(), sharpness)
            worst.append(contrast.min())
            found = pullback(intensity_gradient(image, -slope)).parameters[0]["coefficients"]
            return -least, np.array([found[j] for j in TERMS]) * RADIAN

        x = start / RADIAN
        for sharpness in SHARPNESS:
            x = minimize(loss, x, (sharpness,), jac=True, method="L-BFGS-B",
                         options={"maxiter": 30, "ftol": 1e-5}).x
        return Design(x * RADIAN, np.array(worst))


def _transfer(images: np.ndarray) -> np.ndarray:
    """Complex contrast of images along y and x, shape (2, n)."""
    power = images.sum(axis=(1, 2))
    return np.stack([images.sum(axis=2) @ WAVE, images.sum(axis=1) @ WAVE]) / power


def soft_minimum(light: np.ndarray, sharpness: float) -> tuple[float, np.ndarray, np.ndarray]:
    """The least contrast of images, smoothed, its gradient by their light, and all contrasts."""
    images = light.astype(float)
    transfer = _transfer(images)
    contrast = np.abs(transfer)
    weight = np.exp(-sharpness * (contrast - contrast.min()))
    least = contrast.min() - np.log(weight.mean()) / sharpness
    weight /= weight.sum()
    along_y, along_x = weight[..., None] * np.real(
        np.multiply.outer(transfer.conj() / contrast, WAVE))
    slope = along_y[:, :, None] + along_x[:, None, :]
    slope -= (weight * contrast).sum(axis=0)[:, None, None]
    return float(least), slope / images.sum(axis=(1, 2), keepdims=True), contrast


def camera(device: Device, c: np.ndarray) -> Plenoptic2:
    """A focused camera of 9 x 9 such lenslets before pixels that integrate."""
    array = MicrolensArray(PITCH, FOCAL, count=9)
    built = PlenopticCamera.type2(
        focal_length=30e-3, object_distance=150e-3, aperture_diameter=7e-3, mla=array, m=M,
        wavelength=LAM, pixels_per_lenslet=PITCH / PIXEL, lens_model="corrected", device=device)
    terms = {j: float(value) for j, value in zip(TERMS, c, strict=True)}
    return built.with_aberrations(Aberrations(lenslets=terms))


def camera_contrast(cam: Plenoptic2, v: float) -> float:
    """Of its blended picture of a point at a virtual depth, for FREQUENCY on the sensor."""
    image = cam.array_distance - v * B  # from the main lens
    distance = 1 / (1 / cam.focal_length - 1 / image)
    transfer, _ = depth_scan(cam, [distance - cam.object_distance], positions=1, errors=False)
    return float(transfer.curves[0].contrast(FREQUENCY * image / distance / v))


def sampled(contrast: float) -> float:
    """With a pixel, and linear interpolation between pixels."""
    return contrast * np.sinc(FREQUENCY * PIXEL) ** 3


def pictures(images: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A star through each of the point images with photon noise, and by one Wiener filter."""
    star = siemens_star(SENSOR, 24, diameter=88e-6)
    transfer = np.fft.rfft2(np.fft.ifftshift(images, axes=(1, 2)))
    mean = np.fft.irfft2(np.fft.rfft2(star) * transfer, SENSOR.shape)
    taken = np.random.default_rng(seed).poisson(PHOTONS * np.maximum(mean, 0)) / PHOTONS
    filters = transfer.mean(axis=0)
    wiener = filters.conj() / (np.abs(filters) ** 2 + NOISE)
    return taken, np.fft.irfft2(np.fft.rfft2(taken) * wiener, SENSOR.shape)


def draw_stars(panels: np.ndarray, rows: list[np.ndarray], words: list[str], v: np.ndarray) -> None:
    """Pictures, a row of depths each."""
    for row, stars, word in zip(panels, rows, words, strict=True):
        for axes, star in zip(row, stars, strict=True):
            axes.imshow(star, cmap="gray", vmin=0, vmax=1, extent=centred(star.shape, 1.0))
            axes.set(xticks=[], yticks=[])
        row[0].set_ylabel(word)
    for axes, depth in zip(panels[0], v, strict=True):
        axes.set_title(f"v = {depth:.1f}")


def draw_points(row: np.ndarray, images: np.ndarray, word: str) -> None:
    """Images of points over depth, as the square root of the light, each over its largest."""
    for axes, image in zip(row, images, strict=True):
        axes.imshow(np.sqrt(image), cmap=LIGHT, extent=centred(image.shape, 1.0))
        axes.set(xlim=(-22, 22), ylim=(22, -22), xticks=[], yticks=[])
    row[0].set_ylabel(word)


def draw_phase(axes: Axes, c: np.ndarray) -> AxesImage:
    """The phase of a lenslet beside that of the lens."""
    terms = {noll(j): float(value) for j, value in zip(TERMS, c, strict=True)}
    path, inside = wavefront(LENSLET, terms, diameter=PITCH)
    axes.set(title="designed phase", xlabel="x / um", ylabel="y / um")
    return axes.imshow(np.where(inside, path / RADIAN, np.nan), cmap="RdBu_r", vmin=-6, vmax=6,
                       extent=centred(LENSLET.shape, LENSLET.pitch[0] * 1e6))


def draw_starts(axes: Axes, designs: list[Design]) -> None:
    """The worst contrast on the ways of designs."""
    for number, design in enumerate(designs):
        axes.plot(np.maximum.accumulate(design.worst), ".-", ms=4, color=START_COLOURS[number],
                  label=f"start {number + 1}")
    axes.set(xlabel="evaluations", ylabel="worst contrast", ylim=(0, 0.3),
             title="the way there")
    axes.legend(loc="lower right")


def draw_depth(axes: Axes, lenslet: Lenslet, c: np.ndarray, limit: float,
               measured: dict[str, dict[float, float]]) -> None:
    """Contrast over depth: one lenslet, and the whole camera over its pixels."""
    v = virtual_depths(57)
    axes.axhline(limit, color="0.5", ls="--", lw=1)
    axes.text(FAR, limit + 0.015, "diffraction limit in focus", color="0.4", ha="right")
    axes.semilogx(v, np.abs(hopkins(v)), "k:", lw=1, label="plain lens, Hopkins")
    for (word, colour), coefficients in zip(KINDS.items(), (0 * c, c), strict=True):
        axes.plot(v, lenslet.contrasts(coefficients, v).mean(axis=0), color=colour, label=word)
        found = measured.get(word, {})
        axes.plot(list(found), [value / sampled(1) for value in found.values()], "o", mfc="none",
                  color=colour)
    axes.plot([], [], "o", mfc="none", color="k", label="whole camera, pixels divided out")
    axes.set(xlabel="virtual depth v = a/b", ylabel=f"contrast at {FREQUENCY / 1e3:.0f} cycles/mm",
             xticks=[3, 4, 5, 7, 10], xticklabels=["3", "4", "5", "7", "10"], ylim=(0, 0.75))
    axes.minorticks_off()
    axes.legend(loc=(0.51, 0.5))
