"""A picture and its disparity, fitted together to the pixels of a raw image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from common import BLUE, ORANGE
from scipy.optimize import minimize

from clplen import LightField, MicrolensArray, PlenopticCamera, RawImage, Sensor, SurfaceScene
from clplen.analysis import score
from clplen.cameras import PixelArray, Plane, Sphere, bricks, checker, uniform
from clplen.lightfield import DecodeOperator, RawWarp, ViewWarp

ROUND = 0.02  # total variation is rounded below slopes of so much a pixel
BORDER = 6  # pixels that are not judged
ELECTRONS = 300.0  # of a white pixel
FULL = 0.95  # of those: pixels with less see from elsewhere than their centre, and do not count
DARK = 0.3  # of the brightest: views and samples below are not used
READ = 2.0  # electrons, standard deviation of a pixel's read noise


def wall_and_ball(size: int) -> SurfaceScene:
    """A slanted wall of bricks with a chequered ball before it."""
    wall = Plane(-0.6, (0.003, 0.006), texture=bricks(1, size=(10, 22)))
    ball = Sphere((4, -10), 0.235 * size, disparity=-0.6, height=1.1, texture=checker(14))
    return SurfaceScene([wall, ball])


def taken(scene: SurfaceScene, size: int, device: Any) -> tuple[RawImage, Any]:
    """A raw image in electrons, and a white image without noise.

    The array is turned, and its pitch is no whole number of pixels.
    """
    sensor = PixelArray(shape=(round(7.5 * size),) * 2)  # as large as the turned array
    mla = MicrolensArray(150e-6, 10e-3, count=size, fill="full", rotation=0.02)
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=7.3, pixels=sensor,
        device=device,
    )  # fmt: skip
    flat = SurfaceScene(Plane(0.0, texture=uniform(1.0)))
    white = camera.expose(flat, model="rays").to_numpy() * ELECTRONS
    noisy = Sensor(exposure=ELECTRONS, shot_noise=True, read_noise=READ)
    return noisy.record(camera.expose(scene, model="rays")), white


def decoded(raw: RawImage, white: Any) -> tuple[LightField, Any]:
    """The light field, of white 1 and with weights as views are lit, and its white views."""
    decoding = DecodeOperator(raw)
    level = decoding.forward(replace(raw, data=raw.device.upload(white))).to_numpy()
    weights = level.mean(axis=(2, 3)) / level.max()
    weights[weights < DARK] = 0
    level = np.where(weights[:, :, None, None] > 0, np.maximum(level, DARK * level.max()), np.inf)
    views = decoding.forward(raw).to_numpy() / level
    lf = LightField.from_array(
        views, device=raw.device, spacing=raw.spacing, weights=weights,
        camera=raw.camera,
    )  # fmt: skip
    return lf, np.where(np.isfinite(level), level, 0)


def total_variation(values: Any) -> tuple[float, Any]:
    """The sum of sqrt(|slope|^2 + ROUND^2) and its gradient."""
    down = np.diff(values, axis=0, append=values[-1:])
    right = np.diff(values, axis=1, append=values[:, -1:])
    size = np.sqrt(down**2 + right**2 + ROUND**2)
    down, right = down / size, right / size
    slope = -down - right
    slope[1:] += down[:-1]
    slope[:, 1:] += right[:, :-1]
    return float(size.sum()), slope


@dataclass
class JointFit:
    """The loss sum (model of picture and disparity - target)^2 trust / 2 + total variations.

    Attributes
    ----------
    model : RawWarp or ViewWarp
    target : numpy.ndarray
        Raw image, or samples of a light field.
    trust : numpy.ndarray
        One over the variance of its noise; 0 where a sample does not count.
    weights : tuple of float
        Of the total variation of picture and disparity.
    """

    model: RawWarp | ViewWarp
    target: Any
    trust: Any
    weights: tuple[float, float]

    @classmethod
    def to_raw(cls, raw: RawImage, white: Any, start: Any, weights: Any) -> JointFit:
        """Of raw pixels, whose photon noise is that of `start`."""
        model = RawWarp(raw, white=white)
        variance = np.maximum(model.forward(*start).to_numpy(), 0) + READ**2
        trust = (white > FULL * ELECTRONS) / variance
        return cls(model, raw.to_numpy(), trust, weights)

    @classmethod
    def to_views(cls, lf: LightField, white: Any, start: Any, weights: Any) -> JointFit:
        """Of samples of the decoded light field, as if each were a pixel."""
        model = ViewWarp(lf)
        electrons = np.maximum(model.forward(*start).to_numpy(), 0) * white
        trust = (white > FULL * ELECTRONS) * white**2 / (electrons + READ**2)
        return cls(model, lf.to_numpy(), trust, weights)

    def loss(self, values: Any) -> tuple[float, Any]:
        """Of picture and disparity, one behind the other, and its gradient."""
        picture, disparity = values.reshape(self.shape)
        error = self.model.forward(picture, disparity).to_numpy() - self.target
        rest = error * self.trust
        slopes = np.stack(self.model.vjp(picture, disparity, rest)).astype(float)
        value = float((error * rest).sum(dtype=float)) / 2
        for slope, part, weight in zip(slopes, (picture, disparity), self.weights, strict=True):
            roughness, gradient = total_variation(part)
            value += weight * roughness
            slope += weight * gradient
        return value, slopes.ravel()

    def fit(self, start: Any, note: Callable[[Any], None], iterations: int) -> Any:
        """L-BFGS from (picture, disparity); `note` is given both after each step."""
        first = np.stack(start).astype(float)
        self.shape = first.shape
        found = minimize(
            self.loss,
            first.ravel(),
            jac=True,
            method="L-BFGS-B",
            callback=lambda x: note(x.reshape(first.shape)),
            options={"maxiter": iterations},
        )
        return found.x.reshape(first.shape)


def psnr(picture: Any, truth: Any) -> float:
    """In dB, of white 1, inside the border."""
    error = (picture - truth)[BORDER:-BORDER, BORDER:-BORDER]
    return float(-10 * np.log10((error**2).mean()))


def rms(disparity: Any, truth: Any) -> float:
    """Of its error, inside the border."""
    error = (disparity - truth)[BORDER:-BORDER, BORDER:-BORDER]
    return float(np.sqrt((error**2).mean()))


def print_quality(name: str, found: Any, exact: Any) -> None:
    """Of a picture and a disparity, inside the border."""
    judged = score(found[1], exact[1], border=BORDER)
    print(f"  {name}: PSNR {psnr(found[0], exact[0]):.2f} dB; disparity: rms error "
          f"{rms(found[1], exact[1]):.4f} px, BadPix 0.07 {judged.badpix_07:.1f} %, "
          f"0.03 {judged.badpix_03:.1f} %")


def draw_paths(panels: Any, values: Any, known: float) -> None:
    """PSNR and rms error over the iterations of each fit; ``known``: with the true disparity."""
    for panel, lines, title in zip(panels, values, ("PSNR / dB", "rms error / px"), strict=True):
        for (name, line), colour in zip(lines.items(), (BLUE, ORANGE), strict=True):
            panel.plot(line, color=colour, label=name)
        panel.set(xlabel="iterations", title=title)
    panels[0].axhline(known, color="0.5", ls="--")
    panels[0].legend(title="fit to")
