"""Points in windows of their own beside windows as large as the sensor, and pixels that integrate.

python benchmarks/accuracy_local_windows.py [--device NAME] [--only whole|pixels|speed]

whole    the largest difference of a raw image by `method="local"` from one by `method="points"`, of
         the maximum; L2; and the energy, for five cameras whose pixels sample the light.
pixels   integrated pixels against the same camera with a fifth of the pixels' pitch, binned; beside
         them pixels that take the intensity in their middle.
speed    seconds for a point of a camera with f/2 lenslets of 20 um and pixels of 1.4 um, in focus
         and blurred, and over the bare transforms that it contains.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.fft

import clplen
from clplen.cameras import Aberrations, PixelArray

LAM = 532e-9
POINTS = [(0, 0, 0), (6e-4, -9e-4, 0), (1e-4, 0, 0.01), (3e-4, 2e-4, 0.05), (-3e-4, 5e-4, -0.05)]
REPEATS = 5


def slow_cameras(device: clplen.Device) -> dict[str, clplen.PlenopticCamera]:
    """Five cameras whose pixels sample the light."""
    shared = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 3.6e-3}
    shared["device"] = device
    square = clplen.MicrolensArray(150e-6, 10e-3, count=35, fill="full")
    turned = clplen.MicrolensArray(
        150e-6, 10e-3, count=(37, 33), lattice="hexagonal", rotation=0.07
    )
    short = clplen.MicrolensArray(150e-6, 3e-3, count=41, fill="full")
    bent = Aberrations(main_lens={5: 4e-8, 8: -3e-8, 11: 3e-8})
    make = clplen.PlenopticCamera
    return {
        "square": make.type1(mla=square, pixels_per_lenslet=15, **shared),
        "hexagonal, turned": make.type1(mla=turned, pixels_per_lenslet=16, **shared),
        "2.0 Keplerian": make.type2(mla=short, m=0.3, pixels_per_lenslet=24, **shared),
        "2.0 Galilean": make.type2(mla=short, m=-0.25, pixels_per_lenslet=24, **shared),
        "aberrated": make.type2(
            mla=short, m=0.3, pixels_per_lenslet=24, aberrations=bent, **shared
        ),
    }


def norm_of(difference: np.ndarray, reference: np.ndarray) -> float:
    """L2 of a difference over that of the reference."""
    return float(np.linalg.norm(difference) / np.linalg.norm(reference))


def whole(device: clplen.Device) -> None:
    """Local against whole windows."""
    print("| camera | point (x, y, dz) in mm | largest, of maximum | L2 | energy local, whole |")
    print("|---|---|---|---|---|")
    for name, camera in slow_cameras(device).items():
        for place in POINTS:
            scene = clplen.PointSources(place, diameter=10e-6)
            exact, local = (
                camera.expose(scene, method=method).to_numpy().astype(np.float64)
                for method in ("points", "local")
            )
            largest = np.abs(local - exact).max() / exact.max()
            point = ", ".join(f"{1e3 * value:g}" for value in place)
            print(
                f"| {name} | {point} | {largest:.1e} | {norm_of(local - exact, exact):.1e} | "
                f"{local.sum():.5f}, {exact.sum():.5f} |"
            )


def binned(image: np.ndarray, times: int) -> np.ndarray:
    """Sums over squares of samples."""
    ny, nx = (n // times for n in image.shape)
    return np.asarray(image.astype(np.float64).reshape(ny, times, nx, times).sum(axis=(1, 3)))


def pixels(device: clplen.Device) -> None:
    """Integrated pixels."""
    square = clplen.MicrolensArray(150e-6, 10e-3, count=21, fill="full")
    three = clplen.MicrolensArray(
        150e-6, (2.6e-3, 3e-3, 3.5e-3), count=(21, 21), lattice="hexagonal"
    )
    shared = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 2.9e-3}

    def camera(kind: str, across: int, finer: int = 1) -> Any:
        size = finer * 18 * across
        chosen = PixelArray(shape=(size, size))
        given = {"pixels_per_lenslet": finer * across, "pixels": chosen, "device": device, **shared}
        if kind == "square":
            return clplen.PlenopticCamera.type1(mla=square, **given)
        return clplen.PlenopticCamera.type2(mla=three, m=0.3, **given)

    print("| camera | point in mm | integrated, L2 | middles of pixels, L2 |")
    print("|---|---|---|---|")
    for kind, across, title in (
        ("square", 31, "1.0, 31 pixels a lenslet"),
        ("three", 26, "2.0, three types, 26 pixels"),
    ):
        for place in ((0, 0, 0), (3e-4, -2e-4, 0.02)):
            scene = clplen.PointSources(place, diameter=10e-6)
            fine = binned(camera(kind, across, finer=5).expose(scene).to_numpy(), 5)
            found = []
            for fill in (1.0, 0.0):
                pixels_of = replace(camera(kind, across).pixels, fill_factor=fill)
                coarse = replace(camera(kind, across), pixels=pixels_of)
                found.append(norm_of(coarse.expose(scene).to_numpy() - fine, fine))
            point = ", ".join(f"{1e3 * value:g}" for value in place)
            print(f"| {title} | {point} | {found[0]:.1e} | {found[1]:.1e} |")


def speed(device: clplen.Device) -> None:
    """Seconds a point of a fast camera."""
    mla = clplen.MicrolensArray(20e-6, 40e-6, count=(217, 270), lattice="hexagonal")
    camera = clplen.PlenopticCamera.type1(
        focal_length=0.03, object_distance=1.0, aperture_diameter=0.015, mla=mla,
        wavelength=550e-9, pixels=PixelArray(pitch=1.4e-6), device=device,
    )  # fmt: skip
    print("| blur in lenslets | window | seconds | over bare transforms |")
    print("|---|---|---|---|")
    for dz in (0.0, -0.1, -0.3, -0.45):
        scene = clplen.PointSources((3e-4, 0, dz))
        shape = camera.expose(scene).exposure.transforms[0][1]
        field = np.ones(shape, np.complex64)
        seconds, bare = [], []
        for _ in range(REPEATS):
            start = time.perf_counter()
            camera.expose(scene)
            seconds.append(time.perf_counter() - start)
            start = time.perf_counter()
            for _ in range(3):
                scipy.fft.fft2(field, workers=2)
            bare.append(time.perf_counter() - start)
        blur = camera.aperture_diameter * abs(1 - camera.alpha(dz)) / mla.pitch
        taken = float(np.median(seconds))
        print(
            f"| {blur:.1f} | {shape[0]} x {shape[1]} | {taken:.3f} | "
            f"{taken / float(np.median(bare)):.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device")
    parser.add_argument("--only", choices=["whole", "pixels", "speed"])
    given = parser.parse_args()
    device = clplen.Device.open(given.device)
    for name, table in (("whole", whole), ("pixels", pixels), ("speed", speed)):
        if given.only in (None, name):
            print(f"\n## {name}\n")
            table(device)


if __name__ == "__main__":
    main()
