"""How right colours of raw images are: wavelengths by plan, and lenslets whose glass disperses.

    python benchmarks/accuracy_color.py [--device pocl] [--only plan,glass]

plan: white light on Bayer filters by as many wavelengths as `expose` takes, beside 41, as the L2
difference of the raw image of a point; and the fewest wavelengths that are right to 1e-3.
glass: the focal length of a lenslet of SF11, found in raw images at three wavelengths by the
closed form of a square opening (Fresnel integrals; Goodman 2005, section 4.5), beside R/(n - 1);
and how far a point in focus beside a lenslet's middle moves, X (1 - z3/f) + z3 X/z2.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fresnel

from clplen import Coherence, Device, MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import Aberrations, ColorFilterArray, PixelArray, Plenoptic1
from clplen.wave import Glass, LensletSurface, SpectralDistribution

Values = np.ndarray[Any, Any]

MOST = 41
GLASS = Glass.named("SF11")
DESIGN = 587.5618e-9  # helium's yellow line, of `LensletSurface.design_wavelength`
LIGHTS = {
    "D65": SpectralDistribution.illuminant("D65"),
    "A": SpectralDistribution.illuminant("A"),
    "LED 20 nm": SpectralDistribution.gaussian(530e-9, 20e-9),
}
POINTS = ((0.0, 0.0, 0.0), (2e-3, -1e-3, 0.0), (1e-3, 2e-3, -0.05))


def white_cameras(device: Device) -> dict[str, Plenoptic1]:
    """Cameras with Bayer filters, of small lenslets."""
    bayer = ColorFilterArray.bayer("GRBG")
    shared: dict[str, Any] = {"object_distance": 1.0, "wavelength": 550e-9, "device": device}
    fast = MicrolensArray(20e-6, 40e-6, count=(19, 17), lattice="hexagonal", fill="full")
    glass = MicrolensArray(
        30e-6, count=(15, 17), surface=LensletSurface(0.12e-3, GLASS), lattice="hexagonal"
    )
    slow = MicrolensArray(40e-6, 0.32e-3, count=13)
    pixels = {pitch: PixelArray(pitch=pitch, filters=bayer) for pitch in (1.4e-6, 3.1e-6, 4.1e-6)}
    return {
        "f/2, 20 um": PlenopticCamera.type1(
            focal_length=0.03, aperture_diameter=0.015, mla=fast, pixels=pixels[1.4e-6], **shared
        ),
        "f/5, SF11": PlenopticCamera.type1(
            focal_length=0.05, aperture_diameter=0.010, mla=glass, pixels=pixels[3.1e-6], **shared
        ),
        "f/8, 40 um": PlenopticCamera.type1(
            focal_length=0.04, aperture_diameter=0.005, mla=slow, pixels=pixels[4.1e-6], **shared
        ),
    }


def by_wavelengths(
    camera: Plenoptic1, position: Any, light: SpectralDistribution, number: int | None
) -> tuple[Values, int]:
    """The raw image of a point, and by how many wavelengths."""
    coherence = None if number is None else Coherence(None, light.spectrum, wavelengths=number)
    raw = camera.expose(PointSources(position, spectrum=light), coherence=coherence)
    assert raw.exposure is not None
    assert raw.exposure.wavelengths is not None
    return raw.to_numpy().astype(np.float64), raw.exposure.wavelengths


def apart(found: Values, wanted: Values) -> float:
    """L2 difference, relative."""
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def dispersive(
    device: Device, wavelength: float, *, pitch: float, focal_length: float, shift: float,
    aperture: float, count: int,
) -> Plenoptic1:  # fmt: skip
    """A camera of parabolic lenslets of SF11, its sensor moved by a share of the focal length."""
    radius = focal_length * (float(GLASS.index(DESIGN)) - 1)
    surface = LensletSurface(radius, GLASS, conic=-1.0)
    return PlenopticCamera.type1(
        focal_length=0.1, object_distance=0.4, aperture_diameter=aperture, wavelength=wavelength,
        mla=MicrolensArray(pitch, surface=surface, count=count, fill="full"),
        pixels=PixelArray(pitch=2e-6, shape=(201, 203)), lens_model="corrected",
        aberrations=Aberrations(sensor_shift=shift * focal_length), device=device,
    )  # fmt: skip


def focal_length_of(focal_length: float, wavelength: float) -> float:
    """R/(n(lam) - 1) of a lenslet with a focal length at the design wavelength."""
    powers = [float(GLASS.index(lam)) - 1 for lam in (DESIGN, wavelength)]
    return focal_length * powers[0] / powers[1]


def marginal(camera: Plenoptic1, position: Any) -> tuple[Values, Values]:
    """Energy by columns of the raw image of a point, sum 1, and their x in metres."""
    raw = camera.expose(PointSources(position)).to_numpy().astype(np.float64)
    n = camera.grid.shape[1]
    x = camera.grid.origin[1] + (np.arange(n) - n // 2) * camera.pixel_pitch
    return raw.sum(axis=0) / raw.sum(), x


def focal_length_in_image(camera: Plenoptic1, dz: float, guess: float) -> float:
    """Of the only lenslet, from the image of a point on the axis that fills it."""
    found, x = marginal(camera, (0.0, 0.0, dz))
    places = x[:, None] + (np.arange(8) - 3.5) / 8 * camera.pixel_pitch
    z2, z3 = camera.array_distance, camera.sensor_distance
    behind = z2 / float(camera.array_alpha(dz)) - z2  # from the array to the main lens' image

    def misfit(f: float) -> float:
        bent = 1 / z3 - 1 / f - 1 / behind
        middle, half = places / (z3 * bent), camera.mla.pitch / 2
        scale = np.sqrt(2 * abs(bent) / camera.wavelength)
        ends = [np.array(fresnel(scale * (edge - middle))) for edge in (-half, half)]
        expected = ((ends[1] - ends[0]) ** 2).sum(axis=0).mean(axis=1)
        return apart(expected / expected.sum(), found)

    coarse = guess * np.linspace(0.9, 1.1, 101)
    best = coarse[int(np.argmin([misfit(f) for f in coarse]))]
    fit = minimize_scalar(
        misfit, bounds=(0.996 * best, 1.004 * best), method="bounded",
        options={"xatol": 1e-6 * guess},
    )  # fmt: skip
    return float(fit.x)


def place_in_image(camera: Plenoptic1, X: float) -> float:
    """Median x of the light behind the middle lenslet, of a point in focus imaged at X."""
    magnification = float(camera.array_scale(0.0))
    found, x = marginal(camera, (X / magnification, 0.0, 0.0))
    own = np.abs(x) < camera.mla.pitch / 2
    share = np.concatenate([[0.0], np.cumsum(found[own])]) / found[own].sum()
    edges = np.append(x[own], x[own][-1] + camera.pixel_pitch) - camera.pixel_pitch / 2
    return float(np.interp(0.5, share, edges))


def plans(device: Device) -> Iterator[str]:
    """One line a camera, light and point."""
    yield "camera      light       point (mm)            n   off by n   fewest   off by fewest"
    for name, camera in white_cameras(device).items():
        for light, curve in LIGHTS.items():
            for point in POINTS:
                wanted, _ = by_wavelengths(camera, point, curve, MOST)
                found, n = by_wavelengths(camera, point, curve, None)
                fewest, least = n, apart(found, wanted)
                for fewer in range(n - 1, 0, -1):
                    off = apart(by_wavelengths(camera, point, curve, fewer)[0], wanted)
                    if off > 1e-3:
                        break
                    fewest, least = fewer, off
                where = ", ".join(f"{1e3 * value:g}" for value in point)
                yield (
                    f"{name:11s} {light:11s} {where:18s} {n:4d}   {apart(found, wanted):.2e}"
                    f"   {fewest:6d}   {least:.2e}"
                )


def glass(device: Device) -> Iterator[str]:
    """Focal lengths and places, a line a wavelength."""
    wide = {"pitch": 300e-6, "focal_length": 4e-3, "shift": 0.15, "aperture": 0.015}
    beside = {"pitch": 300e-6, "focal_length": 3e-3, "shift": 0.0, "aperture": 0.012}
    X, first = 100e-6, None
    yield "nm    f in the image   R/(n - 1)   off        place (um)   X (1 - z3/f) + z3 X/z2"
    for lam in (450e-9, 550e-9, 650e-9):
        wanted = focal_length_of(4e-3, lam)
        camera = dispersive(device, lam, count=1, **wide)  # type: ignore[arg-type]
        found = focal_length_in_image(camera, 0.06, wanted)
        camera = dispersive(device, lam, count=3, **beside)  # type: ignore[arg-type]
        place = place_in_image(camera, X)
        z2, z3 = camera.array_distance, camera.sensor_distance
        law = X * (1 - z3 / focal_length_of(3e-3, lam)) + z3 * X / z2
        first = first or (place, law)
        yield (
            f"{1e9 * lam:.0f}   {1e3 * found:.4f} mm        {1e3 * wanted:.4f} mm   "
            f"{100 * (found / wanted - 1):+.3f} %   {1e6 * place:+.3f}       {1e6 * law:+.3f}; "
            f"since 450 nm {1e6 * (place - first[0]):.3f} and {1e6 * (law - first[1]):.3f}"
        )


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default="plan,glass", show_default=True)
def main(selector: str | None, only: str) -> None:
    """Tables; about four minutes on two cores."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    for part in only.split(","):
        for line in {"plan": plans, "glass": glass}[part](device):
            click.echo(line)
        click.echo()


if __name__ == "__main__":
    main()
